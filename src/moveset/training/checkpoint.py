"""Checkpoints: a folder ``step_N/`` of safetensors and JSON with a sha256 manifest. No pickle is ever read or written.

The protocol that makes ``kill -9`` harmless: everything is written into ``.tmp-step_N-PID/``, every file and the folder
are fsynced, the folder is renamed to ``step_N/``, the parent is fsynced. A folder is a checkpoint if and only if its
``manifest.json`` is there and every file it names has that size and hash; "the latest" is the highest N of those.
"""

import os
import re
import shutil
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import safetensors.torch
from torch import Tensor, nn

from moveset.errors import FormatError, InputError, MovesetError
from moveset.io.limits import read_limited
from moveset.io.manifest import (
    MANIFEST,
    MAX_JSON,
    VerifiedFolder,
    json_bytes,
    json_object,
    parse_tensors,
    sync_folder,
    write_files,
)

_STEP = re.compile(r"step_(0|[1-9]\d*)")
_TEMPORARY = ".tmp-"
_REMEDY = "use another checkpoint"


def write(
    folder: Path, step: int, tensors: Mapping[str, Mapping[str, Tensor]], documents: Mapping[str, Mapping[str, Any]]
) -> Path:
    """Writes ``folder/step_N`` as a whole or not at all.

    Args:
        folder: the run's folder; made if absent.
        step: how many steps are finished.
        tensors: what goes into NAME.safetensors, by NAME.
        documents: what goes into NAME.json, by NAME.

    Returns:
        The path of the checkpoint.

    Raises:
        MovesetError: the disk is full or not writable; nothing of the attempt is left, older checkpoints are untouched.
    """
    target = folder / f"step_{step}"
    temporary = folder / f"{_TEMPORARY}step_{step}-{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        temporary.mkdir()
        write_files(temporary, _contents(tensors, documents), {"format": 1, "step": step})
        os.rename(temporary, target)
        sync_folder(folder)
    except OSError as error:
        shutil.rmtree(temporary, ignore_errors=True)
        raise MovesetError(
            f"the checkpoint {target} could not be written ({error.strerror or error}); older checkpoints are intact: "
            "make room or fix the permissions, then resume"
        ) from error
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise
    return target


def verify(path: Path) -> dict[str, Any]:
    """Checks every file of a checkpoint against its manifest.

    Returns:
        The manifest: ``{"format", "step", "files": {name: {"bytes", "sha256"}}}``.

    Raises:
        InputError: there is no such folder.
        FormatError: the manifest or a file is missing, damaged or not listed.
    """
    if not path.is_dir():
        raise InputError(f"there is no checkpoint at {path}; give a folder step_N written by `moveset train`")
    folder = VerifiedFolder(path, "checkpoint", _REMEDY)
    if folder.document.get("format") != 1:
        raise FormatError(f"{path / MANIFEST} is not a checkpoint manifest of format 1; {_REMEDY}")
    folder.verify()
    return folder.document


def steps(folder: Path) -> list[int]:
    """Steps of the folders named ``step_N`` in a run's folder, ascending, valid or not."""
    if not folder.is_dir():
        return []
    return sorted(int(match[1]) for item in folder.iterdir() if (match := _STEP.fullmatch(item.name)) and item.is_dir())


def latest(folder: Path) -> Path | None:
    """The valid checkpoint with the most steps, or None. Damaged ones are passed over with a warning."""
    for step in reversed(steps(folder)):
        path = folder / f"step_{step}"
        try:
            verify(path)
        except FormatError as error:
            warnings.warn(f"passing over a damaged checkpoint: {error}", stacklevel=2)
        else:
            return path
    return None


def resolve(path: Path) -> Path:
    """The verified checkpoint meant by a path: a ``step_N`` folder itself, or a run's folder (then its latest).

    Raises:
        InputError: there is none.
        FormatError: the one named is damaged.
    """
    if (path / MANIFEST).exists() or _STEP.fullmatch(path.name):
        verify(path)
        return path
    found = latest(path)
    if found is None:
        raise InputError(f"there is no usable checkpoint in {path}; train it first or give another folder")
    return found


def read_tensors(path: Path, name: str) -> dict[str, Tensor]:
    """Tensors of ``NAME.safetensors`` of a checkpoint, on the CPU.

    Raises:
        InputError: the checkpoint has no such file.
        FormatError: it is not safetensors.
    """
    file = path / f"{name}.safetensors"
    if not file.is_file():
        have = sorted(item.stem for item in path.glob("*.safetensors"))
        raise InputError(f"{path} holds no {name!r}; it holds {', '.join(have) or 'nothing'}")
    return parse_tensors(file.read_bytes(), file, _REMEDY)


def read_document(path: Path, name: str) -> dict[str, Any]:
    """The JSON object in ``NAME.json`` of a checkpoint. Raises FormatError if it is missing or damaged."""
    file = path / f"{name}.json"
    if not file.is_file():
        raise FormatError(f"{file} is missing, so its folder is not a complete checkpoint; {_REMEDY}")
    return json_object(read_limited(file, MAX_JSON), file, _REMEDY)


def load_module(module: nn.Module, path: Path, name: str) -> None:
    """Loads ``NAME.safetensors`` of a checkpoint into a module, strictly.

    Raises:
        InputError: the checkpoint has no such file, or was made for a module of other sizes.
        FormatError: the file is damaged.
    """
    tensors = read_tensors(path, name)
    try:
        module.load_state_dict(tensors)
    except RuntimeError as error:
        reason = " ".join(str(error).split())[:300]
        raise InputError(
            f"{name} in {path} does not fit this {type(module).__name__}: {reason}; check the recipe"
        ) from error


def prune(folder: Path, keep_last: int, keep_every: int = 0) -> None:
    """Deletes all checkpoints but the last ``keep_last`` and those at multiples of ``keep_every`` (0: none).

    It goes by number, so the last one must be good: it has just been written, or ``set_aside`` was called.
    """
    for step in steps(folder)[:-keep_last]:
        if not (keep_every and step % keep_every == 0):
            # Renamed first, so that a kill halfway leaves rubbish that clean() knows, not a broken checkpoint.
            doomed = folder / f"{_TEMPORARY}pruned-step_{step}-{os.getpid()}"
            os.rename(folder / f"step_{step}", doomed)
            shutil.rmtree(doomed)


def set_aside(folder: Path, after: int) -> None:
    """Renames the damaged checkpoints after a step to ``damaged_step_N``, out of the way of good ones to come."""
    for step in steps(folder):
        if step > after:
            aside = folder / f"damaged_step_{step}"
            if aside.exists():
                shutil.rmtree(aside)
            os.rename(folder / f"step_{step}", aside)


def clean(folder: Path) -> None:
    """Deletes what killed processes left. Only for the holder of the run's lock."""
    for item in (*folder.glob(f"{_TEMPORARY}*"), *folder.glob(".*.part")):
        if item.is_dir():
            shutil.rmtree(item)
        else:  # a log that was being cut back
            item.unlink()


def _contents(
    tensors: Mapping[str, Mapping[str, Tensor]], documents: Mapping[str, Mapping[str, Any]]
) -> Iterator[tuple[str, bytes]]:
    for name, values in tensors.items():
        # Cloning resolves tensors that share memory, which safetensors rightly refuses.
        content = {key: value.detach().cpu().clone().contiguous() for key, value in values.items()}
        yield f"{name}.safetensors", safetensors.torch.save(content)
    for name, document in documents.items():
        yield f"{name}.json", json_bytes(document, allow_nan=False)
