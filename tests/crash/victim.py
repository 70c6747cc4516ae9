"""A process that imports everything once and then forks a training for each line on stdin, to be killed by the tests.

Line: JSON ``{"folder", "steps", "save_every", "keep_last", "die_at", "file_limit", "width"}``. Answers: the child's
process id, and, when it has ended, how: its exit code, or minus the signal. ``die_at`` kills the child with SIGKILL
just before its n-th durable operation (fsync or rename); ``file_limit`` makes writes beyond that many bytes fail.
"""

import json
import os
import resource
import signal
import sys
import traceback
from pathlib import Path

import lightning_fabric  # noqa: F401 (imported here so that the forked trainings start at once)

from moveset.errors import MovesetError
from tests.training.tiny_task import TinyConfig, train


def die_at(call: int) -> None:
    calls = iter(range(10**9))
    for name in ("fsync", "rename", "replace"):
        real = getattr(os, name)

        def deadly(*arguments, real=real):
            if next(calls) == call:
                os.kill(os.getpid(), signal.SIGKILL)
            return real(*arguments)

        setattr(os, name, deadly)


def child(order: dict) -> int:
    if order.get("die_at") is not None:
        die_at(order["die_at"])
    if order.get("file_limit"):
        resource.setrlimit(resource.RLIMIT_FSIZE, (order["file_limit"], resource.RLIM_INFINITY))
    config = TinyConfig(width=order.get("width", 16))
    every = {
        "save_every": order["save_every"],
        "keep_last": order.get("keep_last", 2),
        "validate_every": 0,
        "log_every": 1,
    }
    try:
        train(Path(order["folder"]), steps=order["steps"], resume=True, task=config, **every)
    except MovesetError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    for line in sys.stdin:
        process = os.fork()
        if process == 0:
            code = 70
            try:
                code = child(json.loads(line))
            except BaseException:
                traceback.print_exc()
            finally:
                sys.stderr.flush()
                os._exit(code)
        print(process, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]), flush=True)
