"""Raw motion capture as it is handed out: folders, or archives that are unpacked with care."""

import lzma
import os
import shutil
import sys
import tarfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from moveset.data import bandai_namco, cmu, more_mocap
from moveset.data.spans import Span, read_spans
from moveset.data.takes import TakeRef
from moveset.errors import FormatError, InputError, MovesetError
from moveset.io.process import locked

_ARCHIVES = {
    "cmu.tar.xz": ("cmu",),
    "cmu-more.tar.xz": ("cmu-more",),
    "more-mocap.tar.xz": ("more-mocap",),
    "bandai-namco.tar.xz": ("dataset-1", "dataset-2"),
}
#: Whose content may be used for anything, products too.
FREE = ("cmu", "cmu-more", "more-mocap")
SOURCES = (*FREE, "bandai-namco")
_SPANS = "humanml3d-cmu.jsonl"
_MAX_UNPACKED = 16 * 2**30
_MAX_MEMBERS = 200_000


def unpacked(raw: Path, scratch: Path, sources: Sequence[str] = FREE) -> Path:
    """The folder that holds the sources' folders; archives in ``raw`` are unpacked to ``scratch``.

    Where both are one folder, what is still packed is unpacked beside what is there.

    Raises:
        InputError: ``raw`` holds neither folders nor archives of these sources; or, where ``scratch`` is another
            folder, a folder of one and an archive of another, which would be left out.
        FormatError: an archive is damaged, tries to write elsewhere, or is absurdly large.
        MovesetError: the disk is full or not writable.
    """
    wanted = {f"{source}.tar.xz": _ARCHIVES[f"{source}.tar.xz"] for source in sources}
    folders = [folder for names in wanted.values() for folder in names]
    there = [folder for folder in folders if (raw / folder).is_dir()]
    archives = [raw / name for name in wanted if (raw / name).is_file()]
    in_place = raw.resolve() == scratch.resolve()
    # In place, part of an archive may be what an interrupted build left.
    enough = all if in_place else any
    packed = [archive.name for archive in archives if not enough(folder in there for folder in wanted[archive.name])]
    if there and not packed:
        return raw
    if there and not in_place:
        raise InputError(f"{raw} has {there[0]} as a folder and {packed[0]} still packed; unpack that beside it")
    if not archives:
        raise InputError(f"{raw} holds none of {', '.join((*folders, *wanted))}; give the folder with the raw data")
    # Who builds another corpus at the same time waits, and finds everything there.
    with locked(scratch):
        for archive in archives:
            if not all((scratch / folder).is_dir() for folder in wanted[archive.name]):
                _unpack(archive, scratch)
        if not in_place and (raw / _SPANS).is_file():
            shutil.copyfile(raw / _SPANS, scratch / _SPANS)
    return scratch


def _unpack(archive: Path, to: Path) -> None:
    # Into a hidden folder first: a folder with its final name is always complete.
    partial = to / f".{archive.name}.part"
    shutil.rmtree(partial, ignore_errors=True)
    print(f"unpacking {archive.name} …", file=sys.stderr)
    try:
        with tarfile.open(archive, "r:xz") as tar:
            tar.extractall(partial, members=_bounded(tar, archive), filter="data")
        for folder in _ARCHIVES[archive.name]:
            if (partial / folder).is_dir() and not (to / folder).is_dir():
                os.replace(partial / folder, to / folder)
    except (tarfile.TarError, lzma.LZMAError, EOFError) as error:
        raise FormatError(f"{archive} cannot be unpacked ({error}); copy or download it again") from error
    except OSError as error:
        remedy = "make room, or choose another disk"
        raise MovesetError(f"{archive} cannot be unpacked to {to}: {error.strerror or error}; {remedy}") from error
    finally:
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


def find_takes(raw: Path, sources: Sequence[str] = FREE) -> list[TakeRef]:
    """All takes of the sources below a folder of unpacked data, in the order of their sources and names.

    Raises:
        InputError: there are none.
    """
    refs: list[TakeRef] = []
    for folder in ("cmu", "cmu-more"):
        if folder in sources and (raw / folder).is_dir():
            refs += cmu.list_takes(raw / folder)
    if "more-mocap" in sources and (raw / "more-mocap").is_dir():
        refs += more_mocap.list_takes(raw / "more-mocap")
    if "bandai-namco" in sources and any((raw / folder).is_dir() for folder in _ARCHIVES["bandai-namco.tar.xz"]):
        refs += bandai_namco.list_takes(raw)
    if not refs:
        raise InputError(f"{raw} holds no takes of {', '.join(sources)}; give the folder with the raw data")
    return refs


def find_spans(raw: Path) -> dict[str, list[Span]]:
    """Sentences for spans of the CMU takes, by take; none where there is no file of them.

    Raises:
        FormatError: the file is damaged.
    """
    return read_spans(raw / _SPANS) if (raw / _SPANS).is_file() else {}
