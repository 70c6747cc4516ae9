"""The published evaluators of HumanML3D and KIT-ML (Guo et al. 2022), from their authors' files.

``text_mot_match/model/finest.tar``      weights of the three encoders, by the names of ``_NAMES``
``Comp_v6_KLD…/meta/mean.npy, std.npy``  the statistics they were trained with
``our_vab_*``                            words and their vectors (``data.glove_files``)

The authors' standard deviations have a bias: those of the root and of the foot contacts were divided by 5, in place and
twice, so that an evaluator sees these features 25 times as large as its data set's own ``Std.npy`` would make them.

Shapes: D features.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from moveset.data.glove_files import read_glove
from moveset.data.humanml3d import HUMANML3D, KIT, Layout
from moveset.errors import FormatError, InputError
from moveset.evaluation.evaluator import Evaluator, EvaluatorCard
from moveset.io.manifest import sha256
from moveset.io.numpy_file import read_array
from moveset.models.evaluator import CONTACTS, EvaluatorConfig, MatchingEvaluator
from moveset.text.glove import GloveWords

#: What the data set's standard deviations of root and contacts are divided by.
BIAS = 25.0
MAX_BYTES = 2 * 2**30
_MAX_FRAMES = 196
_FOLDERS = {"t2m": HUMANML3D, "kit": KIT}
_ROOT = 4
# Contacts are 0 or 1: over a whole data set their standard deviation is 0.36 (HumanML3D) or 0.13 (KIT-ML), which the
# bias makes 0.014 or 0.005.
_MOST_CONTACT_STD = 0.02
_STATISTICS = ("Comp_v6_KLD*/meta/mean.npy", "mean.npy")
_PARTS = {"movement_encoder": "movement", "motion_encoder": "motion", "text_encoder": "text"}
_NAMES = {
    "main": "convolutions",
    "out_net": "output",
    "output_net": "output",
    "input_emb": "input",
    "pos_emb": "speech",
    "gru": "gru",
    "hidden": "hidden",
}


@dataclass(frozen=True, eq=False)
class Official:
    """A published evaluator.

    Args:
        module: the three encoders, with the statistics they normalise features by; the bias is in them.
        sources: the files it was read from, by what they are.
    """

    layout: Layout
    module: MatchingEvaluator
    sources: Mapping[str, Path]


def import_official(found: Official, glove: str | Path) -> Evaluator:
    """The authors' evaluator as one of ours, to be saved as a folder.

    Args:
        glove: the folder with their ``our_vab`` files, or a text file of GloVe (see ``data.glove_files``).

    Raises:
        InputError: files are missing.
        FormatError: a file that is damaged, or does not fit the evaluator.
    """
    words = GloveWords(*read_glove(glove))
    card = EvaluatorCard(
        name=f"{'kit' if found.layout is KIT else 't2m'}-official",
        codec=found.layout.codec,
        fps=found.layout.fps,
        max_frames=_MAX_FRAMES,
        words=words.name,
        provenance={
            "source": "checkpoints of Guo et al. 2022, Generating Diverse and Natural 3D Human Motions from Text",
            "words": len(words.vocabulary),
            **{f"{name}_sha256": sha256(path) for name, path in found.sources.items()},
        },
    )
    return Evaluator(card, found.module, words)


def read_official(
    folder: str | Path, dataset: str | None = None, *, statistics: str | Path | None = None, bias: float | None = None
) -> Official:
    """Read the authors' checkpoints.

    Args:
        folder: their ``checkpoints`` folder, with ``t2m`` or ``kit`` in it, or one of these two.
        dataset: "t2m" or "kit"; None takes the one that is there.
        statistics: folder of ``mean.npy`` and ``std.npy`` (or ``Mean.npy`` and ``Std.npy``); None looks for those of
            the published generator, beside the evaluator.
        bias: what the standard deviations of root and contacts are still to be divided by: 1 for the authors' own
            files, 25 for those of the data set; None takes them as they are and checks that the bias is in them.

    Raises:
        InputError: files are missing, or it is not clear which are meant.
        FormatError: a checkpoint that is truncated, foreign or of another shape, or statistics that do not fit it.
    """
    home, layout = _home(Path(folder), dataset)
    checkpoint = home / "text_mot_match" / "model" / "finest.tar"
    module = read_checkpoint(checkpoint)
    if module.config.features != layout.features:
        raise FormatError(
            f"{checkpoint} judges {module.config.features} features, where {layout.name} has {layout.features}; "
            "give that data set's, or say another with --dataset"
        )
    found = _statistics_folder(home) if statistics is None else Path(statistics)
    paths = {name: _either(found, name) for name in ("mean", "std")}
    mean, std = (_read_statistic(path, layout.features) for path in paths.values())
    module.mean.copy_(mean)
    module.std.copy_(biased(std, bias))
    return Official(layout, module, {"checkpoint": checkpoint, **paths})


def read_checkpoint(path: str | Path) -> MatchingEvaluator:
    """The three encoders of a ``finest.tar``, of the sizes that it says; it has no statistics. No code of it is run.

    Raises:
        InputError: there is no such file.
        FormatError: it is truncated, holds more than plain tensors, or is no evaluator.
    """
    path = Path(path)
    state = _renamed(_load(path), path)
    try:
        config = EvaluatorConfig(
            features=state["movement.convolutions.0.weight"].shape[1] + CONTACTS,
            movement_width=state["movement.convolutions.0.weight"].shape[0],
            movement_latent=state["movement.convolutions.3.weight"].shape[0],
            word_width=state["text.speech.weight"].shape[0],
            speech_classes=state["text.speech.weight"].shape[1],
            text_hidden=state["text.input.weight"].shape[0],
            motion_hidden=state["motion.input.weight"].shape[0],
            joint=state["text.output.3.weight"].shape[0],
        )
        with torch.random.fork_rng(devices=[]):
            module = config.build()
        module.load_state_dict({**state, "mean": module.mean, "std": module.std}, strict=True)
    except (KeyError, IndexError, RuntimeError, InputError) as error:
        said = " ".join(str(error).split())[:120]
        raise FormatError(
            f"{path} is not an evaluator of text and motion ({said}); give text_mot_match/model/finest.tar"
        ) from None
    if wrong := [name for name, value in state.items() if not torch.isfinite(value).all()]:
        raise FormatError(f"{path} has weights that are not finite in {wrong[0]!r}; download it again")
    return module.eval().requires_grad_(False)


def biased(std: Tensor, bias: float | None) -> Tensor:
    """Standard deviations (D,) with those of root and contacts divided by the bias.

    Raises:
        InputError: a bias out of range, or None where the bias is not in them yet.
    """
    if bias is None:
        most = float(std[-CONTACTS:].max())
        if most > _MOST_CONTACT_STD:
            raise InputError(
                f"the standard deviation of the foot contacts is {most:.3g}, above {_MOST_CONTACT_STD}: these are "
                f"a data set's statistics; give the evaluator's own (Comp_v6_KLD005/meta), or --bias {BIAS:g}"
            )
        return std
    if not 1 <= bias <= 1000:
        raise InputError(f"a bias of {bias:g} is not in 1 to 1000; {BIAS:g} makes a data set's Std.npy an evaluator's")
    scaled = std.clone()
    scaled[:_ROOT] /= bias
    scaled[-CONTACTS:] /= bias
    return scaled


def _home(folder: Path, dataset: str | None) -> tuple[Path, Layout]:
    if dataset is not None and dataset not in _FOLDERS:
        raise InputError(f"unknown data set {dataset!r}; choose one of {', '.join(_FOLDERS)}")
    names = [dataset] if dataset else list(_FOLDERS)
    inside = [name for name in names if (folder / name / "text_mot_match").is_dir()]
    if len(inside) == 1:
        return folder / inside[0], _FOLDERS[inside[0]]
    if inside:
        raise InputError(f"{folder} has evaluators of {' and '.join(inside)}; say which with --dataset")
    if (folder / "text_mot_match").is_dir():
        name = dataset or folder.resolve().name
        if name not in _FOLDERS:
            raise InputError(f"of which data set {folder} is cannot be told from its name; say it with --dataset")
        return folder, _FOLDERS[name]
    raise InputError(
        f"{folder} has no {' or '.join(f'{name}/text_mot_match' for name in names)}; "
        "give the authors' unpacked checkpoints folder"
    )


def _statistics_folder(home: Path) -> Path:
    """Where the published statistics lie; all copies must agree."""
    for pattern in _STATISTICS:
        folders = sorted(path.parent for path in home.glob(pattern) if path.with_name("std.npy").is_file())
        if not folders:
            continue
        contents = {tuple((path / f"{name}.npy").read_bytes() for name in ("mean", "std")) for path in folders}
        if len(contents) > 1:
            names = ", ".join(str(path.relative_to(home)) for path in folders)
            raise InputError(f"{home} has statistics that differ, in {names}; say which with --statistics")
        return folders[0]
    raise InputError(
        f"{home} has no Comp_v6_KLD*/meta with mean.npy and std.npy; unpack the authors' generator beside the "
        "evaluator, or give a folder with --statistics"
    )


def _either(folder: Path, name: str) -> Path:
    """``mean.npy``, or ``Mean.npy`` as data sets call it."""
    lower, upper = folder / f"{name}.npy", folder / f"{name.title()}.npy"
    return upper if upper.is_file() and not lower.is_file() else lower


def _read_statistic(path: Path, features: int) -> Tensor:
    values = read_array(path)
    # Standard deviations of exactly 0 would come out as infinite features.
    positive = path.stem.lower() == "mean" or bool((values > 0).all())
    if tuple(values.shape) != (features,) or not torch.isfinite(values).all() or not positive:
        raise FormatError(f"{path} of shape {tuple(values.shape)} does not hold {features} usable numbers; restore it")
    return values


def _load(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise InputError(f"there is no {path}; give the authors' unpacked checkpoints folder")
    if path.stat().st_size > MAX_BYTES:
        raise FormatError(f"{path} is larger than the limit of {MAX_BYTES / 2**30:g} GB; it is no evaluator")
    try:
        found = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        # Truncated, foreign and hostile files end torch's reader in every kind of error there is.
        reason = re.split(r"[.\n]", f"{type(error).__name__}: {error}")[0][:120]
        raise FormatError(
            f"{path} is truncated or no checkpoint of plain tensors ({reason}); download it again"
        ) from error
    if not isinstance(found, dict):
        raise FormatError(f"{path} holds one {type(found).__name__}, not the parts of an evaluator; download it again")
    return found


def _renamed(found: dict[str, Any], path: Path) -> dict[str, Tensor]:
    """The authors' weights by the names of ``models.evaluator``."""
    state = {}
    for theirs, ours in _PARTS.items():
        part = found.get(theirs)
        if not isinstance(part, Mapping):
            raise FormatError(f"{path} has no {theirs!r}; give text_mot_match/model/finest.tar")
        for name, value in part.items():
            first, dot, rest = str(name).partition(".")
            if first not in _NAMES or not isinstance(value, Tensor):
                raise FormatError(
                    f"{path} has the unknown weight {theirs}.{name}; give text_mot_match/model/finest.tar"
                )
            state[f"{ours}.{_NAMES[first]}{dot}{rest}"] = value.float()
    return state
