import dataclasses
import os
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from moveset.training import checkpoint, tasks
from moveset.training.engine import run
from tests.crash import command
from tests.crash.metrics import logged_step
from tests.forks import Forks
from tests.training.tiny_task import TinyConfig, TinyTask

COMMAND = ("train", "vae", "--recipe", "tiny")
pytestmark = [pytest.mark.skipif(os.name == "nt", reason="stops by POSIX signals"), pytest.mark.timeout(600)]


def stopped(forks: Forks, folder: Path, number: int, *arguments: str) -> tuple[int, str]:
    """Exit code and stderr of a training that got a signal after its first own step."""
    before, deadline = logged_step(folder), time.monotonic() + 200
    process = forks.start("tests.crash.command:run", [*COMMAND, "--folder", str(folder), *arguments])
    while forks.running and logged_step(folder) <= before and time.monotonic() < deadline:
        time.sleep(0.02)
    with suppress(ProcessLookupError):
        os.kill(process, number)
    code, complained = forks.end(), forks.said
    assert "Traceback" not in complained
    return code, complained


def test_a_signal_saves_and_resuming_ends_as_if_there_had_been_none(forks, tmp_path, monkeypatch, capsys):
    slow = ("--set", "seconds_per_step=0.01", "--steps", "200", "--log-every", "1")
    code, complained = stopped(forks, tmp_path / "run", signal.SIGTERM, *slow)
    assert (code, "stopped by SIGTERM at step" in complained) == (143, True), complained
    (step,) = checkpoint.steps(tmp_path / "run")
    assert 0 < step < 200
    checkpoint.verify(tmp_path / "run" / f"step_{step}")

    code, complained = stopped(forks, tmp_path / "run", signal.SIGINT, *slow, "--resume")
    assert code == 130, complained
    assert checkpoint.steps(tmp_path / "run")[-1] > step

    # In this process, whose recipes come back afterwards.
    monkeypatch.setitem(sys.modules, "moveset.recipes.tiny", None)
    monkeypatch.setitem(tasks.TASKS, "vae", tasks.TASKS["vae"])
    code = command.run([*COMMAND, "--folder", str(tmp_path / "run"), *slow, "--resume"])
    said, complained = capsys.readouterr()
    assert (code, said) == (0, ""), complained
    assert "done" in complained

    settings = dataclasses.replace(command.ENGINE, steps=200, log_every=1)
    config = TinyConfig(seconds_per_step=0.01)
    run(lambda loop: TinyTask(config, loop), settings, tmp_path / "straight")
    for file in (tmp_path / "straight" / "step_200").iterdir():
        assert (tmp_path / "run" / "step_200" / file.name).read_bytes() == file.read_bytes()
