"""Writers of takes, each forked and killed at another moment.

Of each format (".bvh"), writer n makes ``folder/.bvh/n/take.bvh`` of four pieces of ``motion()`` and dies by SIGKILL at
its n-th operation on the disk; a write is done by half before. After each piece it notes its number of frames in
``folder/.bvh/n.noted``. The next format comes after the first writer that survived; ``killed.json`` tells how many did
not.
"""

import itertools
import json
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

from moveset.io.take_writer import open_take
from moveset.motion.clip import Motion
from tests.motions import wander


def motion() -> Motion:
    return wander(40, seed=5, turn=1.0)


def die_at(point: int) -> None:
    calls = iter(range(10**9))
    for name in ("open", "write", "ftruncate", "fsync", "close", "replace", "unlink"):
        real = getattr(os, name)

        def deadly(*arguments, name=name, real=real):
            if next(calls) == point:
                if name == "write":
                    real(arguments[0], arguments[1][: len(arguments[1]) // 2])
                os.kill(os.getpid(), signal.SIGKILL)
            return real(*arguments)

        setattr(os, name, deadly)


def write(path: Path, whole: Motion, after: Callable[[int], None]) -> None:
    with open_take(path, whole.skeleton, whole.fps, metadata={"prompt": "a person walks"}) as take:
        for start in range(0, len(whole), 10):
            take.append(whole[start : start + 10])
            after(take.frames)


def record(path: Path, whole: Motion, noted: int, point: int) -> None:
    note = os.write
    die_at(point)
    write(path, whole, lambda frames: note(noted, f"{frames}\n".encode()))


def kill(folder: Path, suffix: str) -> int:
    """How many writers of a format were killed."""
    folder.mkdir()
    whole = motion()
    write(folder / f"warm{suffix}", whole, lambda _: None)  # so that the forked ones import nothing
    for point in itertools.count():
        (folder / str(point)).mkdir()
        noted = os.open(folder / f"{point}.noted", os.O_WRONLY | os.O_CREAT)
        process = os.fork()
        if process == 0:
            code = 70
            try:
                record(folder / str(point) / f"take{suffix}", whole, noted, point)
                code = 0
            finally:
                os._exit(code)
        os.close(noted)
        code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
        if code != -signal.SIGKILL:
            if code:
                sys.exit(code)
            return point
    raise AssertionError("unreachable")


def kill_all(folder: str, suffixes: list[str]) -> None:
    counts = {suffix: kill(Path(folder, suffix), suffix) for suffix in suffixes}
    Path(folder, "killed.json").write_text(json.dumps(counts))
