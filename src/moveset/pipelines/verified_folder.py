"""A folder whose files are known by their sha256: a byte that is read is a byte that was checked.

``manifest.json`` has sha256 and size of every other file.
"""

import hashlib
import json
import shutil
import tempfile
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load as load_safetensors
from torch import Tensor

from moveset.errors import FormatError, InputError
from moveset.io.limits import atomic_write, read_limited

MAX_FILE = 512 * 2**20


class VerifiedFolder:
    """Files beside a manifest.

    Args:
        path: the folder.

    Raises:
        FormatError: no model folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if not (path / "manifest.json").is_file():
            raise FormatError(f"{path} is no model folder: it has no manifest.json; give a packed model")

    def __reduce__(self) -> tuple[Any, ...]:
        # A pickle says where the folder is: it is read, and checked, again by whoever opens it.
        return type(self), (self.path.absolute(),)

    @cached_property
    def files(self) -> dict[str, tuple[str, int]]:
        """sha256 and size in bytes of every file, by name, as the manifest has them."""
        where = self.path / "manifest.json"
        raw = json_object(read_limited(where, 2**20), where)
        try:
            if any(Path(name).name != name for name in raw["files"]):
                raise ValueError("a file outside the folder")
            return {name: (str(entry["sha256"]), int(entry["bytes"])) for name, entry in raw["files"].items()}
        except (TypeError, ValueError, KeyError, AttributeError) as error:
            raise FormatError(f"{where} is not a manifest; copy the model folder again") from error

    def read(self, file: str) -> bytes:
        """The bytes of one file.

        Raises:
            FormatError: not in the manifest, or damaged.
            InputError: missing.
        """
        if file not in self.files:
            raise FormatError(f"{self.path} has no {file} in its manifest; copy the model folder again")
        path = self.path / file
        data = read_limited(path, MAX_FILE)
        sha256, size = self.files[file]
        if len(data) != size or hashlib.sha256(data).hexdigest() != sha256:
            raise FormatError(
                f"{path} is damaged: it does not match the sha256 in manifest.json; reinstall moveset or copy it again"
            )
        return data

    def tensors(self, file: str) -> dict[str, Tensor]:
        """The tensors of one safetensors file, verified."""
        data = self.read(file)
        try:
            return load_safetensors(data)
        except SafetensorError as error:
            raise FormatError(f"{self.path / file} is not a safetensors file: {error}") from error

    def verify(self) -> int:
        """Check every file against the manifest; the number of bytes checked.

        Raises:
            FormatError: naming the first file that is damaged or missing.
        """
        return sum(len(self.read(name)) for name in self.files)


def write_whole(path: Path, blobs: Mapping[str, bytes]) -> None:
    """The files and their manifest as a folder that replaces an older one of its kind at ``path`` by renaming.

    Raises:
        InputError: what is there is a file, or a folder that holds something and is none of these: it would be lost.
    """
    if path.exists() and not (path / "manifest.json").is_file() and (not path.is_dir() or any(path.iterdir())):
        raise InputError(f"{path} is there already and is no model folder; give a folder that is new")
    files = {k: {"sha256": hashlib.sha256(v).hexdigest(), "bytes": len(v)} for k, v in sorted(blobs.items())}
    path.parent.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    try:
        for name, blob in {**blobs, "manifest.json": json_bytes({"files": files})}.items():
            with atomic_write(folder / name) as file:
                file.write(blob)
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


def json_bytes(data: Mapping[str, object]) -> bytes:
    """A JSON object as it is written."""
    return (json.dumps(data, indent=1, ensure_ascii=False) + "\n").encode()


def json_object(data: bytes, where: Path, remedy: str = "copy the model folder again") -> dict[str, Any]:
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
