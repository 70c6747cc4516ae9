"""A training to be killed by the tests, as an order says.

``{"folder", "steps", "save_every", "keep_last", "die_at", "file_limit", "width"}``: ``die_at`` kills it with SIGKILL
just before its n-th durable operation (fsync or rename); ``file_limit`` makes writes beyond that many bytes fail.
"""

import os
import resource
import signal
import sys
from pathlib import Path

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


def resumed(order: dict) -> int:
    """The exit code."""
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
