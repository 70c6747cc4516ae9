"""A process that has imported what trains and what writes takes, and forks it: to start that anew costs seconds.

Line on stdin: JSON ``{"call": "module:function", "given": […]}``. Answers: the child's process id, and, when it has
ended, how: its exit code (what the function returned, 0 for None), or minus the signal.
"""

import importlib
import json
import os
import select
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
BROKEN = 70  # a child that ended by an exception of no kind that users may see


class Forks:
    """Calls functions in children of that process, one after the other."""

    def __init__(self) -> None:
        path = os.pathsep.join(filter(None, (str(REPOSITORY), os.environ.get("PYTHONPATH"))))
        environment = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115 (a pipe that nobody reads would fill up)
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": self._errors}
        command = [sys.executable, "-m", "tests.forks"]
        self._server = subprocess.Popen(command, cwd=REPOSITORY, env=environment, text=True, **pipes)

    def start(self, call: str, *given: object) -> int:
        """The child's process id."""
        self._before = self._errors.seek(0, os.SEEK_END)
        self._server.stdin.write(json.dumps({"call": call, "given": given}) + "\n")
        self._server.stdin.flush()
        return int(self._server.stdout.readline())

    @property
    def running(self) -> bool:
        return not select.select([self._server.stdout], [], [], 0)[0]

    def end(self) -> int:
        """The child's exit code, or minus the signal that ended it."""
        code = int(self._server.stdout.readline())
        assert code != BROKEN, self.said
        return code

    def run(self, call: str, *given: object) -> int:
        self.start(call, *given)
        return self.end()

    @property
    def said(self) -> str:
        """What the last child printed."""
        self._errors.seek(self._before)
        return self._errors.read()

    def close(self) -> None:
        self._server.kill()  # to end as programs do would take it seconds
        self._server.wait(60)
        for pipe in (self._server.stdin, self._server.stdout, self._errors):
            pipe.close()


def child(function: Callable[..., int | None], given: list) -> int:
    os.dup2(2, 1)  # standard output is for answers
    try:
        return function(*given) or 0
    except Exception:
        traceback.print_exc()
        return BROKEN


if __name__ == "__main__":
    import lightning_fabric  # noqa: F401 (imported here so that forked trainings start at once)

    for line in sys.stdin:
        order = json.loads(line)
        module, name = order["call"].split(":")
        called = getattr(importlib.import_module(module), name)
        process = os.fork()
        if process == 0:
            # Who leaves by sys.exit ends as programs do, with all that is to be done at exit.
            code = child(called, order["given"])
            sys.stderr.flush()
            os._exit(code)
        print(process, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]), flush=True)
