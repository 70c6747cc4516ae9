"""From run folders to a model folder: averaged weights, statistics, the length predictor and the known captions."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import nn

from moveset.data.corpus import Corpus
from moveset.data.dataset import CorpusDataset
from moveset.data.disturbance import Disturbance, wordings
from moveset.data.feature_store import FeatureStore
from moveset.data.latents import LatentSet
from moveset.data.rewordings import all_words, reword
from moveset.errors import InputError, exit_code_of
from moveset.pipelines.bundle import BundleConfig, save_folder
from moveset.text.encoder import get_text_encoder
from moveset.text.familiarity import calibrate
from moveset.text.vocabulary import words_of
from moveset.training import checkpoint, frozen
from moveset.training.length import LengthTraining, train_length
from moveset.training.reading import embedded
from moveset.training.tasks import Sources

KNOWN_CAPTIONS = 2000
ROWS = 1024  # captions looked up at once
UNKNOWN_ACTIONS = (
    "a person plays the piano", "someone cooks dinner", "a cat sleeps on the sofa", "a man drives a car",
    "a person swims in a pool", "someone rides a bicycle", "a person sits on a chair", "climb the stairs",
    "a person lies down on the floor", "doing push-ups", "a person crawls on the floor", "the stock market fell today",
    "juggling three balls", "a person does a backflip", "typing on a keyboard", "a person squats",
    "someone kneels and prays", "two people hug", "a woman drinks tea at a table", "he opens the door",
    "a person throws a ball", "someone rolls over", "a person skips rope", "she combs her hair",
)  # fmt: skip


def pack(
    sources: Sources,
    students: dict[str, Path],
    guidance: dict[str, float],
    name: str,
    out: Path,
    averaged: bool = True,
    decoder: Path | None = None,
    differences: bool = True,
) -> Path:
    """Write the model folder ``out``.

    Args:
        sources: corpus, vae and teacher runs, and their cache.
        students: run folders of students by name ("lcm-1", "pcm-1", …).
        guidance: default guidance scale by network name.
        name: what the model is called.
        out: the folder to write.
        averaged: ship the students' averaged weights instead of the last ones.
        decoder: a run that went on with the VAE's decoder; None ships the VAE as it is.
        differences: store the students as 8-bit differences from the teacher, which they were started from.

    Raises:
        InputError: no checkpoint where one should be, a name that is no student's, students of other phases than
            their names say or of different grids, or a cache of another corpus.
    """
    phases = {student: student_phases(student) for student in students}
    corpus = Corpus.open(sources.corpus)
    vae = frozen.load(sources.vae, "vae_ema")
    store = FeatureStore.cached(CorpusDataset(corpus), vae.task["codec"], sources.cache)
    latents = LatentSet.of(
        CorpusDataset(corpus),
        "train",
        store,
        vae.module,
        sources.cache / f"latents-{vae.digest[:12]}-train.safetensors",
    )
    shipped = frozen.load(decoder, "vae_ema") if decoder else vae
    teacher = frozen.load(sources.teacher, "teacher_ema")
    text_encoder = teacher.task["text_encoder"]
    modules: dict[str, nn.Module] = {"vae": shipped.module, "teacher": teacher.module}
    grids = set()
    for student, folder in students.items():
        found = frozen.load(folder, "student_ema" if averaged else "student")
        if student.startswith("pcm-"):
            check_phases(student, phases[student], found)
        grids.add(found.task["points"])
        modules[student] = found.module
    if len(grids) > 1:
        raise InputError(f"the students were distilled on grids of {sorted(grids)} points; pack those of one grid")
    captions, frames, held_out = caption_lengths(corpus)
    known = known_captions(corpus)
    text = embedded(sources.cache, text_encoder, [*captions, *known])
    pooled = text.pooled_of(captions)
    if Disturbance(**teacher.task["disturbance"]).reworded:
        length = length_of_rewordings(captions, pooled, frames, held_out, text_encoder)
    else:
        length = train_length(pooled, frames, held_out=held_out, epochs=4)
    print(f"length predictor: median error {length.median_error:.0f} frames, constant {length.constant_error:.0f}")
    modules["length"] = length.model
    known_pooled = text.pooled_of(known)
    config = BundleConfig(
        name=name,
        codec=vae.task["codec"],
        text_encoder=text_encoder,
        latent=(vae.module.config.tokens, vae.module.config.token_dim),
        guidance={network: guidance[network] for network in modules if network in guidance},
        far_prompt=familiarity_limit(known_pooled, text_encoder),
        points=grids.pop() if grids else BundleConfig.points,
        provenance={
            "corpus": f"{len(corpus.indices(composed=False))} clips, {corpus.seconds / 3600:.2f} h",
            **{name: checkpoint.resolve(path).name.replace("_", " ") for name, path in students.items()},
        },
    )
    normalizer = {
        "feature_mean": store.normalizer.mean,
        "feature_std": store.normalizer.std,
        "latent_mean": latents.center,
        "latent_std": latents.scale,
    }
    bases = dict.fromkeys(students, "teacher") if differences else None
    words = trained_words(corpus, teacher.task)
    return save_folder(out, config, modules, normalizer, known, known_pooled, bases, words)


def student_phases(name: str) -> int:
    """N of "pcm-N" and "lcm-N".

    Raises:
        InputError: another name.
    """
    method, _, phases = name.partition("-")
    if method not in ("pcm", "lcm") or not phases.isdigit():
        raise InputError(f"{name!r} is no student; there are pcm-1, pcm-2, pcm-4 and lcm-1")
    return int(phases)


def check_phases(name: str, phases: int, found: frozen.Frozen) -> None:
    """Raises InputError for a student that learned other phases than those of its name."""
    if found.task["phases"] != phases:
        raise InputError(f"{name!r} would be a student of {found.task['phases']} phases; give it its own run folder")


def caption_lengths(corpus: Corpus, per_clip: int = 2) -> tuple[list[str], torch.Tensor, torch.Tensor]:
    """Captions with the frames of their clips, and which of them are of the validation split.

    Clips in which an action goes on and on say nothing of how long it lasts.
    """
    rows = [
        (caption, corpus.records[k].frames, split == "val")
        for split in ("train", "val")
        for k in corpus.indices(split)
        if not corpus.records[k].goes_on
        for caption in corpus.captions(k)[k % 3 :: max(1, len(corpus.captions(k)) // per_clip)][:per_clip]
    ]
    captions, frames, held_out = zip(*rows, strict=True)
    return list(captions), torch.tensor(frames), torch.tensor(held_out)


def length_of_rewordings(
    captions: Sequence[str], pooled: torch.Tensor, frames: torch.Tensor, held_out: torch.Tensor, text_encoder: str
) -> LengthTraining:
    """The length predictor of a teacher that reads captions in other words, too: each caption, once more reworded.

    Once through all of them: seen more often, lengths are learned of the very words, and those of unknown wordings get
    worse (``docs/decisions.md``).

    Args:
        captions: N, as written.
        pooled: (N, P) their sentence embeddings.
        frames: (N,) lengths of their clips, frames.
        held_out: (N,) bool, those that are only measured.
        text_encoder: which made the embeddings.
    """
    encoder = get_text_encoder(text_encoder)
    said = [reword(caption, k) for k, caption in enumerate(captions) if not held_out[k]]
    # Not kept in the text cache, which has the states of all tokens.
    others = [encoder.encode(said[k : k + 256]).pooled for k in range(0, len(said), 256)]
    lengths = torch.cat((frames, frames[~held_out]))
    measured = torch.cat((held_out, torch.zeros(len(said), dtype=torch.bool)))
    return train_length(torch.cat((pooled, *others)), lengths, held_out=measured, epochs=1)


def known_captions(corpus: Corpus) -> list[str]:
    """Captions that stand for what the model knows: plain and styled ones of every single content."""
    by_content: dict[tuple[str, ...], dict[str, None]] = {}
    for k in corpus.indices("train", composed=False):
        for mirrored in (False, True):
            by_content.setdefault(corpus.contents(k, mirrored), {}).update(dict.fromkeys(corpus.captions(k, mirrored)))
    each = max(1, KNOWN_CAPTIONS // len(by_content))
    chosen: set[str] = set()
    for captions in by_content.values():
        # The first ones are what people type; the rest is sampled evenly.
        written = list(captions)
        chosen.update(written[: each // 2] + written[each // 2 :: max(1, 2 * len(written) // each)])
    return sorted(chosen)


def trained_words(corpus: Corpus, task: Mapping[str, Any]) -> set[str]:
    """Words of all that a network was told in its training: captions, composed ones too, and their other wordings.

    Args:
        corpus: of the training.
        task: its configuration.
    """
    captions = {
        caption
        for composed in (False, True)
        for k in corpus.indices("train", composed=composed)
        for mirrored in (False, True)
        for caption in corpus.captions(k, mirrored)
    }
    disturbance = Disturbance(**task["disturbance"])
    words = {word for said in wordings(sorted(captions), disturbance) for word in words_of(said)}
    return words | all_words() if disturbance.reworded else words


def familiarity_limit(known: torch.Tensor, text_encoder: str) -> float:
    """The similarity that best separates captions, each looked up among the others, from actions not in the data.

    Args:
        known: (N, C) sentence embeddings of captions.
        text_encoder: which made them.
    """
    unit = torch.nn.functional.normalize(known.float(), dim=-1)
    inside = []
    for start in range(0, len(unit), ROWS):
        similar = unit[start : start + ROWS] @ unit.T
        similar[torch.arange(len(similar)), torch.arange(start, start + len(similar))] = -1.0
        inside.append(similar.amax(dim=1))
    outside = torch.nn.functional.normalize(get_text_encoder(text_encoder).encode(list(UNKNOWN_ACTIONS)).pooled, dim=-1)
    found = calibrate(torch.cat(inside), (outside @ unit.T).amax(dim=1))
    print(f"far prompts: below {found.cosine:.2f}; {found.false_alarms:.0%} false alarms, {found.missed:.0%} missed")
    return round(found.cosine, 3)


def main() -> None:
    """Command line: ``python -m moveset.training.pack --runs runs/small --out FOLDER``."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--runs", type=Path, default=Path("runs/small"))
    parser.add_argument("--corpus", type=Path, default=Path("data/corpus.safetensors"))
    parser.add_argument("--students", nargs="*", default=["lcm-1", "pcm-1", "pcm-2", "pcm-4"])
    parser.add_argument("--guidance", type=float, nargs="*", default=[3.0], help="teacher's, then each student's")
    parser.add_argument("--last", action="store_true", help="the students' last weights instead of the averaged ones")
    parser.add_argument("--no-decoder", action="store_true", help="ship the VAE's own decoder, not that of decoder/")
    parser.add_argument(
        "--whole", action="store_true", help="the students' weights, not differences from the teacher's"
    )
    parser.add_argument("--name", default="motionpcm-small")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    networks = ["teacher", *given.students]
    scales = given.guidance if len(given.guidance) > 1 else given.guidance * len(networks)
    if len(scales) != len(networks):
        raise InputError(f"{len(scales)} guidance scales for {', '.join(networks)}; give one for each, or one for all")
    sources = Sources(
        corpus=given.corpus, vae=given.runs / "vae", teacher=given.runs / "teacher", cache=given.runs / "cache"
    )
    print(
        pack(
            sources,
            {name: given.runs / name for name in given.students},
            dict(zip(networks, scales, strict=True)),
            given.name,
            given.out,
            not given.last,
            None if given.no_decoder else given.runs / "decoder",
            differences=not given.whole,
        )
    )


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
