"""Raw motion capture as it is handed out: folders, or archives that are unpacked with care."""

import os
import shutil
import sys
import tarfile
from collections.abc import Iterator
from pathlib import Path

from moveset.data import bandai_namco, cmu
from moveset.data.takes import TakeRef
from moveset.errors import FormatError, InputError
from moveset.io.process import locked

_ARCHIVES = {"bandai-namco.tar.xz": ("dataset-1", "dataset-2"), "cmu.tar.xz": ("cmu",)}
_MAX_UNPACKED = 16 * 2**30
_MAX_MEMBERS = 200_000


def unpacked(raw: Path, scratch: Path) -> Path:
    """The folder that holds ``dataset-1``, ``dataset-2`` and ``cmu``; archives in ``raw`` are unpacked to ``scratch``.

    Raises:
        InputError: ``raw`` holds neither the folders nor the archives.
        FormatError: an archive is damaged, tries to write elsewhere, or is absurdly large.
    """
    folders = [f for names in _ARCHIVES.values() for f in names]
    if any((raw / f).is_dir() for f in folders):
        return raw
    archives = [raw / name for name in _ARCHIVES if (raw / name).is_file()]
    if not archives:
        raise InputError(f"{raw} holds none of {', '.join((*folders, *_ARCHIVES))}; give the folder with the raw data")
    # Who builds another corpus at the same time waits, and finds everything there.
    with locked(scratch):
        for archive in archives:
            if not all((scratch / f).is_dir() for f in _ARCHIVES[archive.name]):
                _unpack(archive, scratch)
    return scratch


def _unpack(archive: Path, to: Path) -> None:
    # Into a hidden folder first: a folder with its final name is always complete.
    partial = to / f".{archive.name}.part"
    shutil.rmtree(partial, ignore_errors=True)
    print(f"unpacking {archive.name} …", file=sys.stderr)
    try:
        with tarfile.open(archive, "r:xz") as tar:
            tar.extractall(partial, members=_bounded(tar, archive), filter="data")
    except (tarfile.TarError, EOFError, OSError) as error:
        shutil.rmtree(partial, ignore_errors=True)
        raise FormatError(f"{archive} cannot be unpacked ({error}); copy or download it again") from error
    for folder in _ARCHIVES[archive.name]:
        if (partial / folder).is_dir():
            shutil.rmtree(to / folder, ignore_errors=True)
            os.replace(partial / folder, to / folder)
    shutil.rmtree(partial, ignore_errors=True)


def _bounded(tar: tarfile.TarFile, archive: Path) -> Iterator[tarfile.TarInfo]:
    size = 0
    for count, member in enumerate(tar):
        size += member.size
        if size > _MAX_UNPACKED or count > _MAX_MEMBERS:
            limits = f"{_MAX_UNPACKED >> 30} GB or {_MAX_MEMBERS} files"
            raise FormatError(f"{archive} unpacks to more than {limits}; check where it is from")
        if member.isfile() or member.isdir():
            yield member


def find_takes(raw: Path) -> list[TakeRef]:
    """All takes below a folder of unpacked data, in the order of their sources and names.

    Raises:
        InputError: there are none.
    """
    refs: list[TakeRef] = []
    if any((raw / f).is_dir() for f in ("dataset-1", "dataset-2")):
        refs += bandai_namco.list_takes(raw)
    if (raw / "cmu").is_dir():
        refs += cmu.list_takes(raw / "cmu")
    if not refs:
        raise InputError(f"{raw} holds no takes; give the folder with dataset-1, dataset-2 or cmu")
    return refs
