"""A training may die at any moment: resuming works, loses at most the steps since the last checkpoint, and ends as if
nothing had happened, byte for byte."""

import contextlib
import os
import random
import shutil
import signal
import time
from pathlib import Path

import pytest

from moveset.training import checkpoint
from tests.crash.metrics import logged_step
from tests.forks import Forks

pytestmark = pytest.mark.skipif(os.name == "nt", reason="kills by POSIX signals")


class Victims:
    """Trainings as orders say."""

    def __init__(self, forks: Forks) -> None:
        self.end, self._forks = forks.end, forks

    def start(self, folder: Path, **order: object) -> int:
        return self._forks.start("tests.crash.victim:resumed", {"folder": str(folder), **order})

    def train(self, folder: Path, **order: object) -> int:
        self.start(folder, **order)
        return self.end()


@pytest.fixture
def victims(forks):
    return Victims(forks)


def contents(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def saved_step(folder: Path) -> int:
    found = checkpoint.latest(folder)
    return int(found.name.removeprefix("step_")) if found else 0


# A kill must not even leave a damaged checkpoint that would have to be passed over.
@pytest.mark.filterwarnings("error")
def test_sigkill_at_random_moments(victims, tmp_path):
    steps, every = 120, 3
    order = {"steps": steps, "save_every": every}
    assert victims.train(tmp_path / "straight", **order) == 0
    chance, folder, kills, before = random.Random(7), tmp_path / "killed", 0, 0
    for _ in range(8):
        process = victims.start(folder, **order)
        # Let it get somewhere, then strike at a random moment, saving or not.
        deadline, goal = time.monotonic() + 20, before + chance.randint(0, 12)
        while logged_step(folder) < goal and time.monotonic() < deadline:
            time.sleep(0.001)
        time.sleep(chance.uniform(0, 0.03))
        # On a busy machine it may have come to its end meanwhile; that is then no kill.
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, signal.SIGKILL)
        kills += victims.end() == -signal.SIGKILL
        saved, logged = saved_step(folder), logged_step(folder)
        assert saved >= before
        assert saved >= (logged - 1) // every * every
        before = saved
    assert kills >= 6
    assert victims.train(folder, **order) == 0
    assert contents(folder / f"step_{steps}") == contents(tmp_path / "straight" / f"step_{steps}")
    assert not list(folder.glob(".tmp-*"))


@pytest.mark.filterwarnings("error")
def test_sigkill_before_every_durable_operation_of_a_resumed_training(victims, tmp_path):
    """Which cuts its log back before it goes on."""
    order = {"steps": 3, "save_every": 2, "keep_last": 1}
    assert victims.train(tmp_path / "straight", **order) == 0
    want = contents(tmp_path / "straight" / "step_3")
    begun = tmp_path / "begun"
    # Killed at its last save, it leaves a checkpoint and a line of its log that is after it.
    points = next(
        point for point in range(100) if victims.train(tmp_path / f"count_{point}", **order, die_at=point) == 0
    )
    assert victims.train(begun, **order, die_at=points - 4) == -signal.SIGKILL
    assert (saved_step(begun), logged_step(begun)) == (2, 3)
    for point in range(100):
        folder = tmp_path / f"point_{point}"
        shutil.copytree(begun, folder)
        code = victims.train(folder, **order, die_at=point)
        assert code in (0, -signal.SIGKILL)
        assert victims.train(folder, **order) == 0
        assert contents(folder / "step_3") == want
        assert not list(folder.glob(".tmp-*"))
        if code == 0:
            break
    assert point > 4


@pytest.mark.filterwarnings("error")
def test_sigkill_before_every_durable_operation(victims, tmp_path):
    """A first save and one that prunes its predecessor, killed at each point in turn."""
    order = {"steps": 2, "save_every": 1, "keep_last": 1}
    assert victims.train(tmp_path / "straight", **order) == 0
    want = contents(tmp_path / "straight" / "step_2")
    for point in range(100):
        folder = tmp_path / f"point_{point}"
        code = victims.train(folder, **order, die_at=point)
        assert saved_step(folder) >= logged_step(folder) - 1
        if code == 0:
            break
        assert code == -signal.SIGKILL
        assert victims.train(folder, **order) == 0
        assert contents(folder / "step_2") == want
        assert sorted(item.name for item in folder.iterdir()) == [".lock", "metrics.jsonl", "step_2"]
    # Two saves of eight files, manifest, two folders and a rename each, and the rename that prunes.
    assert point == 2 * (8 + 1 + 2 + 1) + 1


def test_a_full_disk_leaves_the_last_good_checkpoint(victims, tmp_path):
    wide = {"save_every": 5, "width": 512}
    assert victims.train(tmp_path, steps=5, **wide) == 0
    before = contents(tmp_path / "step_5")
    assert victims.train(tmp_path, steps=10, file_limit=30_000, **wide) == 1
    assert checkpoint.steps(tmp_path) == [5]
    assert contents(tmp_path / "step_5") == before
    assert not list(tmp_path.glob(".tmp-*"))
    assert victims.train(tmp_path, steps=10, **wide) == 0
    assert saved_step(tmp_path) == 10
