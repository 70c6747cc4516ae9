"""A folder whose files are known by their sha256: a byte that is read is a byte that was checked.

``manifest.json`` has sha256 and size of every other file, under ``"files"``. Model folders and checkpoints are such.
"""

import hashlib
import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load as load_safetensors
from torch import Tensor

from moveset.errors import FormatError, InputError
from moveset.io.limits import NO_SPACE, read_limited, system_errors

MANIFEST = "manifest.json"
MAX_FILE = 512 * 2**20
MAX_JSON = 16 * 2**20
REMEDY = "reinstall moveset or copy it again"
_PLAIN_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")


class VerifiedFolder:
    """Files beside a manifest.

    Args:
        kind: what it is called where it is none.
        remedy: what to do where it is damaged, the end of a sentence.

    Raises:
        FormatError: there is no manifest.
    """

    def __init__(self, path: Path, kind: str = "model folder", remedy: str = REMEDY) -> None:
        self.path, self.remedy = path, remedy
        if not (path / MANIFEST).is_file():
            raise FormatError(f"{path} is no {kind}: it has no {MANIFEST}; give a folder that is one")

    def __reduce__(self) -> tuple[Any, ...]:
        # A pickle says where the folder is: it is read, and checked, again by whoever opens it.
        return type(self), (self.path.absolute(),)

    @cached_property
    def document(self) -> dict[str, Any]:
        where = self.path / MANIFEST
        return json_object(read_limited(where, MAX_JSON), where, self.remedy)

    @cached_property
    def files(self) -> dict[str, tuple[str, int]]:
        """sha256 and size in bytes of every file, by name, as the manifest has them."""
        try:
            if any(not _PLAIN_NAME.fullmatch(name) for name in self.document["files"]):
                raise ValueError("a name that is no plain file's")
            return {n: (str(entry["sha256"]), int(entry["bytes"])) for n, entry in self.document["files"].items()}
        except (TypeError, ValueError, KeyError, AttributeError) as error:
            raise FormatError(f"{self.path / MANIFEST} is not a manifest; {self.remedy}") from error

    def read(self, file: str) -> bytes:
        """The bytes of one file.

        Raises:
            FormatError: not in the manifest, or damaged.
            InputError: missing.
        """
        if file not in self.files:
            raise FormatError(f"{self.path} has no {file} in its manifest; {self.remedy}")
        data = read_limited(self.path / file, MAX_FILE)
        if (hashlib.sha256(data).hexdigest(), len(data)) != self.files[file]:
            raise self._damaged(file)
        return data

    def tensors(self, file: str) -> dict[str, Tensor]:
        """The tensors of one safetensors file, verified."""
        return parse_tensors(self.read(file), self.path / file, self.remedy)

    def verify(self) -> int:
        """Check every file against the manifest; the number of bytes checked.

        Raises:
            FormatError: naming the first file that is damaged or missing.
        """
        for name, (known, size) in self.files.items():
            file = self.path / name
            if not file.is_file() or file.stat().st_size != size or sha256(file) != known:
                raise self._damaged(name)
        return sum(size for _, size in self.files.values())

    def _damaged(self, file: str) -> FormatError:
        path = self.path / file
        what = "is damaged: it does not match the sha256 in manifest.json" if path.is_file() else "is missing"
        return FormatError(f"{path} {what}; {self.remedy}")


def write_files(folder: Path, files: Iterable[tuple[str, bytes]], more: Mapping[str, object] | None = None) -> None:
    """Write new files into a folder, and the manifest that lists them; the disk confirms each, and the folder.

    Args:
        files: names and contents, written one by one as they come.
        more: what the manifest says besides.

    Raises:
        OSError: the disk is full or not writable, or a file is there already.
    """
    listed = {}
    for name, content in files:
        if not _PLAIN_NAME.fullmatch(name):
            raise ValueError(f"{name!r} cannot be the name of a file beside a manifest")
        listed[name] = {"sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content)}
        _write(folder / name, content)
    _write(folder / MANIFEST, json_bytes({**(more or {}), "files": dict(sorted(listed.items()))}))
    sync_folder(folder)


def write_whole(path: Path, blobs: Mapping[str, bytes]) -> None:
    """The files and their manifest as a folder that replaces an older one of its kind at ``path`` by renaming.

    Raises:
        InputError: what is there is a file, or a folder that holds something and is none of these: it would be lost.
        MovesetError: the disk is full or not writable; what was there is untouched.
    """
    if path.exists() and not (path / MANIFEST).is_file() and (not path.is_dir() or any(path.iterdir())):
        raise InputError(f"{path} is there already and is no model folder; give a folder that is new")
    path.parent.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    try:
        with system_errors(f"write {path}", NO_SPACE):
            write_files(folder, blobs.items())
            folder.chmod(0o755)
            if path.exists():
                path.rename(folder / ".old")
            folder.rename(path)
            shutil.rmtree(path / ".old", ignore_errors=True)
    except BaseException:
        if (folder / ".old").exists() and not path.exists():
            (folder / ".old").rename(path)
        shutil.rmtree(folder, ignore_errors=True)
        raise


def sync_folder(folder: Path) -> None:
    """Have the disk confirm the names in a folder."""
    if os.name == "nt":  # Windows cannot open folders; its rename is journaled
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def json_bytes(data: Mapping[str, object], *, allow_nan: bool = True) -> bytes:
    """A JSON object as it is written. Raises ValueError for numbers that JSON lacks, unless they are allowed."""
    return (json.dumps(data, indent=1, ensure_ascii=False, allow_nan=allow_nan) + "\n").encode()


def json_object(data: bytes | str, where: Path, remedy: str = "copy the model folder again") -> dict[str, Any]:
    """The JSON object in the bytes of a file.

    Args:
        remedy: what to do where it is none.

    Raises:
        FormatError: anything else.
    """
    try:
        raw = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{where} is not JSON: {error}; {remedy}") from error
    if not isinstance(raw, dict):
        raise FormatError(f"{where} is not a JSON object; {remedy}")
    return raw


def parse_tensors(data: bytes, where: Path, remedy: str = REMEDY) -> dict[str, Tensor]:
    """The tensors in the bytes of a safetensors file, on the CPU. Raises FormatError for anything else."""
    try:
        return load_safetensors(data)
    except SafetensorError as error:
        raise FormatError(f"{where} is not a safetensors file: {error}; {remedy}") from error


def _write(file: Path, content: bytes) -> None:
    with file.open("xb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def sha256(file: Path) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
