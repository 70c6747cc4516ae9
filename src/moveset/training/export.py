"""From trained networks to the folders that users and the evaluation open: weights, statistics, and what is known.

What a folder holds an ``Export`` says, which a recipe names; its networks come from run folders, the rest from a
dataset. Nothing is trained here.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from torch import Tensor

from moveset.data.dataset import Dataset
from moveset.data.feature_store import FeatureStore
from moveset.data.glove_files import read_glove
from moveset.data.latents import LatentSet
from moveset.diffusion.steps import Variance
from moveset.errors import InputError
from moveset.evaluation.evaluator import Evaluator, EvaluatorCard
from moveset.motion.features import get_codec
from moveset.motion.native import NativeCodec
from moveset.pipelines.model_config import (
    DENOISER,
    FLOW,
    IDLE,
    SIDES,
    BaselineConfig,
    ClipConfig,
    FolderConfig,
    StreamConfig,
)
from moveset.pipelines.model_folder import save_model
from moveset.pipelines.role import is_student, named
from moveset.text.encoder import get_text_encoder
from moveset.text.familiarity import KnownPrompts
from moveset.text.glove import GloveWords
from moveset.text.vocabulary import words_of
from moveset.text.words import TokenWords, Words
from moveset.training.dip import idle_pose
from moveset.training.reading import embedded
from moveset.training.teacher import normalised_latents
from moveset.training.trained import TrainedNetwork, load_trained, require_learned_from, warn_of_another_corpus

KNOWN_CAPTIONS = 2000
_JUDGED = 256  # sentences by which it is found how near known ones a sentence of the data lies
_UNFAMILIAR = 0.05  # share of them that may be taken for something else
RDM, DECODER, EVALUATOR = "rdm", "decoder", "evaluator"


@dataclass(frozen=True, kw_only=True)
class Export:
    """What every folder is made of.

    Args:
        runs: by name of a network, the run that trained it.
        guidance: default guidance scales by name of the network.
        last: take the students' last weights instead of the averaged ones.
        differences: store students as 8-bit differences from what they were started from.
        compact: networks whose matrices are stored in 8 bits.
        examples: sentences to begin with (``FolderConfig``).
    """

    name: str
    runs: Mapping[str, str]
    guidance: Mapping[str, float] = field(default_factory=dict)
    last: bool = False
    differences: bool = True
    compact: tuple[str, ...] = ()
    examples: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if unknown := set(self.guidance) - set(self.runs):
            raise InputError(f"there is no network {sorted(unknown)[0]!r} to guide; choose {', '.join(self.runs)}")


@dataclass(frozen=True, kw_only=True)
class ClipExport(Export):
    """A text-to-motion model of networks vae, teacher, length and students; of a "decoder" run its VAE is that."""


@dataclass(frozen=True, kw_only=True)
class StreamExport(Export):
    """A stream's model of "rdm", with its flow, and any of "md", "sides", "pcm-1", "pcm-2" and "pcm-4".

    Args:
        tremor: damping of fast frequencies of a network's output by its name, instead of that of its training
            (``SegmentTransformerConfig``); guidance and ``eps_scale`` make it tremble.
        sampling: fields of ``StreamConfig``: what a stream does by default.
    """

    tremor: Mapping[str, float] = field(default_factory=dict)
    sampling: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class BaselineExport(Export):
    """What recurrent models are compared with: one network, "denoiser", of whole clips or of chunks.

    Args:
        steps: K of whole clips; chunks take all of their schedule.
        eta, variance: of whole clips, as in ``BaselineConfig``; chunks are sampled as DDPM does.
    """

    steps: int = 50
    eta: float = BaselineConfig.eta
    variance: Variance = BaselineConfig.variance


@dataclass(frozen=True, kw_only=True)
class EvaluatorExport(Export):
    """The network "evaluator", which judges motion."""


def export(what: Export, dataset: Dataset, runs: Path, cache: Path, out: Path) -> Path:
    """Write the folder ``out``.

    Args:
        cache: the trainings' folder of features, latents and embedded captions.
        out: the folder to write; it appears whole or not at all.

    Raises:
        InputError: no checkpoint where one should be, networks that do not belong together, or a cache of other data.
        FormatError: something is damaged.
    """
    found = {network: _load(what, network, runs) for network in what.runs}
    if isinstance(what, EvaluatorExport):
        return _evaluator(what, found[EVALUATOR], out)
    of = {ClipExport: _clips, StreamExport: _stream, BaselineExport: _baseline}[type(what)]
    return of(what, dataset, found, runs, cache, out)


def _load(what: Export, network: str, runs: Path) -> TrainedNetwork:
    weights = {"rdm": "denoiser_ema", "md": "denoiser_ema", "decoder": "vae_ema", "length": "length", "sides": "sides"}
    if is_student(network):
        chosen = "student" if what.last else "student_ema"
    else:
        chosen = weights.get(network, f"{network}_ema")
    found = load_trained(runs / what.runs[network], chosen)
    if is_student(network) and named(network).steps != found.task["phases"]:
        raise InputError(f"{network!r} would be a student of {found.task['phases']} phases; give it its own run folder")
    return found


def _common(
    what: Export, dataset: Dataset, task: Mapping[str, Any], found: Mapping[str, TrainedNetwork], cache: Path, out: Path
) -> tuple[dict[str, Any], FeatureStore, Callable[..., Path]]:
    """What every configuration says, the features, and what writes the folder."""
    encoder, codec = task["text_encoder"], get_codec(task["codec"])
    for name, network in found.items():
        if (other := network.task.get("text_encoder", encoder)) != encoder:
            raise InputError(f"{name!r} reads sentences by {other!r}, not by {encoder!r}; export networks of one kind")
    known = known_captions(dataset)
    pooled = embedded(cache, encoder, known).pooled_of(known)
    steps = {name: f"{what.runs[name]}, {network.path.name.replace('_', ' ')}" for name, network in found.items()}
    fields = {
        "name": what.name,
        "codec": codec.name,
        "fps": codec.fps,
        "text_encoder": encoder,
        "guidance": dict(what.guidance),
        "examples": what.examples,
        "far_prompt": familiarity_limit(dataset, known, pooled, encoder),
        "provenance": {"data": dataset.describe(), **steps},
    }
    warn_of_another_corpus(found.values(), dataset)
    store = FeatureStore.cached(dataset, codec.name, cache)
    features = {"feature_mean": store.normalizer.mean, "feature_std": store.normalizer.std}

    def save(
        config: FolderConfig, modules: Mapping[str, Any], statistics: Mapping[str, Tensor], teacher: str = ""
    ) -> Path:
        """Students are stored as differences from their teacher, if there is one, with the words it was trained on."""
        bases = {name: teacher for name in modules if is_student(name)} if teacher and what.differences else None
        words = trained_words(dataset) if teacher else ()
        return save_model(out, config, modules, features | {**statistics}, known, pooled, bases, words, what.compact)

    return fields, store, save


def _clips(
    what: Export, dataset: Dataset, found: Mapping[str, TrainedNetwork], runs: Path, cache: Path, out: Path
) -> Path:
    vae, teacher, points = found["vae"], found["teacher"], _one_grid(found)
    for network in found.values():
        require_learned_from(network, "vae", vae.digest, f"export it with that one, not with {vae.path}")
    task = {**teacher.task, "codec": vae.task["codec"]}
    fields, store, save = _common(what, dataset, task, found, cache, out)
    path = cache / f"latents-{vae.digest[:12]}-train.safetensors"
    latents = LatentSet.of(dataset, "train", store, vae.module, path)
    if not normalised_latents(teacher):
        latents = latents.as_encoded()
    modules = {name: network.module for name, network in found.items() if name != DECODER}
    modules["vae"] = found.get(DECODER, vae).module
    config = ClipConfig(**fields, latent=(vae.module.config.tokens, vae.module.config.token_dim), points=points)
    return save(config, modules, {"latent_mean": latents.center, "latent_std": latents.scale}, "teacher")


def _stream(
    what: StreamExport, dataset: Dataset, found: Mapping[str, TrainedNetwork], runs: Path, cache: Path, out: Path
) -> Path:
    if RDM not in found:
        raise InputError(f"a stream needs the network {RDM!r}, got {', '.join(found) or 'none'}; name its run")
    rdm = found[RDM]
    for name, network in found.items():
        for size in ("features", "frames", "text_dim") if name != SIDES else ("text_dim",):
            if (ours := network.config[size]) != rdm.config[size]:
                theirs = rdm.config[size]
                raise InputError(f"{name!r} has {ours} {size} and {RDM!r} {theirs}; export networks of one kind")
    if unknown := set(what.tremor) - set(found):
        raise InputError(f"there is no network {sorted(unknown)[0]!r} to steady; choose {', '.join(found)}")
    modules = {name: network.module for name, network in found.items()}
    for name, value in what.tremor.items():
        modules[name].config = replace(modules[name].config, tremor=value)
    digest = ""
    if rdm.task["flow"] is not None:
        flow = load_trained(runs / what.runs[RDM], "flow_ema", part="coupling_flow")
        modules[FLOW], digest = flow.module, flow.digest
    for network in found.values():
        require_learned_from(network, "flow", digest, f"export it with its teacher, not with {rdm.path}")
    points = _one_grid(found)
    fields, _, save = _common(what, dataset, rdm.task, found, cache, out)
    sampling = {**what.sampling}
    if not isinstance(get_codec(rdm.task["codec"]), NativeCodec):
        sampling.pop("symmetric", None)  # only native features have a mirror image of their own
    config = StreamConfig(
        **fields,
        segment=rdm.task["grid"]["frames"],
        depth_cap=rdm.task["depth_cap"],
        points=points,
        **{"network": RDM, **sampling},
    )
    return save(config, modules, {}, RDM)


def _baseline(
    what: BaselineExport, dataset: Dataset, found: Mapping[str, TrainedNetwork], runs: Path, cache: Path, out: Path
) -> Path:
    network = found[DENOISER]
    task = network.task
    chunks = "levels" in task
    if not chunks and (task["flow"] is not None or task["grid"]["condition"] == "clean"):
        raise InputError(f"{network.path} is a stream's network, given the segment before; export it as a stream's")
    fields, store, save = _common(what, dataset, task, found, cache, out)
    statistics = {}
    sampling: dict[str, Any] = {"frames": task["model"]["frames"], "sampler_steps": what.steps}
    if chunks:
        statistics[IDLE] = idle_pose(dataset, store, get_codec(task["codec"]))
        every = {"timesteps": task["levels"], "sampler_steps": task["levels"]}
        sampling |= {"prefix": task["model"]["prefix"], "schedule": "cosine", "eta": 1.0, **every}
    else:
        sampling |= {"predict": task["predict"], "eta": what.eta, "variance": what.variance}
    return save(BaselineConfig(**fields, **sampling), {DENOISER: network.module}, statistics)


def _evaluator(what: Export, found: TrainedNetwork, out: Path) -> Path:
    task, step = found.task, int(found.path.name.removeprefix("step_"))
    provenance = {"steps": step, "movement": "frozen", "weights_sha256": found.digest}
    kind, _, table = task["words"].partition(":")
    words: Words
    if kind == "glove":
        words, read = GloveWords(*read_glove(Path(table))), kind
    else:
        words, read = TokenWords(get_text_encoder(task["words"]), task["max_words"]), task["words"]
    fps = get_codec(task["codec"]).fps
    card = EvaluatorCard(name=what.name, codec=task["codec"], fps=fps, words=read, provenance=provenance)
    return Evaluator(card, found.module, words).save(out, half=True)


def _one_grid(found: Mapping[str, TrainedNetwork]) -> int:
    """The solver points that all students were distilled on."""
    grids = {network.task["points"] for name, network in found.items() if is_student(name)} or {ClipConfig.points}
    if len(grids) > 1:
        raise InputError(f"the students were distilled on grids of {sorted(grids)} points; export those of one grid")
    return int(grids.pop())


def known_captions(dataset: Dataset) -> list[str]:
    """Captions that stand for what the training data show, some of every group of clips."""
    by_group: dict[Any, dict[str, None]] = {}
    for item in dataset.split("train"):
        clip = dataset.clip(item)
        # What shows one thing after another is made of clips that are there, too.
        if not clip.parts:
            by_group.setdefault(clip.group, {}).update(dict.fromkeys(clip.captions))
    each = max(1, KNOWN_CAPTIONS // len(by_group))
    chosen: set[str] = set()
    for captions in list(by_group.values())[:: -(-len(by_group) // KNOWN_CAPTIONS)]:
        # The first ones are what people type; the rest is sampled evenly.
        written = list(captions)
        chosen.update(written[: -(-each // 2)] + written[each // 2 :: max(1, 2 * len(written) // each)])
    return sorted(chosen)


def trained_words(dataset: Dataset) -> set[str]:
    captions = {caption for item in dataset.split("train") for caption in dataset.clip(item).captions}
    return {word for caption in captions for word in words_of(caption)}


def familiarity_limit(dataset: Dataset, known: list[str], pooled_PC: Tensor, text_encoder: str) -> float:
    """The similarity to the known captions that 95 % of unseen ones, those of the validation split, exceed.

    Where all of them have been seen, ``FolderConfig``'s own.
    """
    unseen = {caption for item in dataset.split("val") for caption in dataset.clip(item).captions} - set(known)
    if not unseen:
        return ClipConfig.far_prompt
    chosen = sorted(unseen)[:: -(-len(unseen) // _JUDGED)]
    found = get_text_encoder(text_encoder).encode(chosen).pooled
    best_B, _ = KnownPrompts(tuple(known), pooled_PC).similarity(found)
    return round(float(best_B.quantile(_UNFAMILIAR)), 3)
