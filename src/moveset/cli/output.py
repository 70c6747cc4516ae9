"""Which files a command writes, checked before anything is computed."""

import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from moveset.errors import InputError
from moveset.io.limits import system_errors, written_to
from moveset.pipelines.postprocess import Postprocess as Postprocess

if TYPE_CHECKING:
    from moveset.motion.clip import Motion


def plan_outputs(outputs: Sequence[Path], names: Sequence[str]) -> list[list[Path]]:
    """The files of each item: ``outputs`` as they are for the name "", else ``stem-name.suffix``.

    Raises:
        InputError: an extension that cannot be written, a name too long or given twice, or a folder that cannot
            be written to.
    """
    from moveset.io import WRITABLE, check_name

    for path in outputs:
        check_name(path)
        if path.suffix.lower() not in WRITABLE:
            raise InputError(f"cannot write {str(path)!r}: unknown extension; use one of {' '.join(WRITABLE)}")
    for folder in {written_to(path).parent for path in outputs}:
        check_folder(folder)
    planned = [[_named(path, name) if name else path for path in outputs] for name in names]
    everything = [path for paths in planned for path in paths]
    for path in everything:
        check_name(path)
        written_to(path)
    if len(outputs) > 1 and (twice := [path for path, count in Counter(everything).items() if count > 1]):
        raise InputError(f"{str(min(twice))!r} would be written twice; give every output a name of its own")
    return planned


def write(
    motion: "Motion", paths: Sequence[Path], finish: Postprocess, metadata: Mapping[str, str | int | float]
) -> tuple["Motion", float]:
    """Finish a motion and write it to every path; the motion as in the first of them and the milliseconds it took.

    A rate that was asked for and that a file cannot have is said on stderr.

    Raises:
        InputError: the files cannot be written.
    """
    from moveset.io import rate_of, save

    start = time.perf_counter()
    motion = finish(motion)
    for path in paths:
        with system_errors(f"write {str(path)!r}", "choose another place", InputError):
            save(motion, path, metadata=metadata)
        if finish.fps is not None and (kept := rate_of(motion.fps, path)) != motion.fps:
            print(f"moveset: {path} has {kept:g} frames a second, not {motion.fps:g}", file=sys.stderr)
    spent = round((time.perf_counter() - start) * 1e3, 3)
    return motion.resampled(rate_of(motion.fps, paths[0])), spent


def _named(path: Path, name: str) -> Path:
    # ".amass.npz" is one extension: a name within it would make another kind of npz.
    suffix = re.search(r"(\.amass)?\.[^.]+$", path.name, re.IGNORECASE)
    assert suffix is not None
    return path.with_name(f"{path.name[: suffix.start()]}-{name}{suffix[0]}")


def check_folder(folder: Path) -> None:
    """Refuse a folder that nothing can be written to.

    Raises:
        InputError: it is not there, or cannot be written to.
    """
    if not folder.is_dir():
        raise InputError(f"folder {str(folder)!r} does not exist; create it first")
    # Asking the file system beats asking for permissions: a read-only disk grants them to root.
    with (
        system_errors(f"write to folder {str(folder)!r}", "choose another", InputError),
        tempfile.TemporaryFile(dir=folder),
    ):
        pass
