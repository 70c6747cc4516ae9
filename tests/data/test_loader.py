"""Batches made ahead are the batches, in order, whatever makes them."""

import os
import signal
import time
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import pytest
import torch

from moveset.data.loader import Ahead
from moveset.errors import FormatError, InputError
from moveset.io.process import locked


@dataclass
class Batch:
    step: int
    values: torch.Tensor
    captions: list[str]


def make(step: int) -> Batch:
    if step == 13:
        raise ValueError("step 13 cannot be made")
    return Batch(step, torch.rand(3, generator=torch.Generator().manual_seed(step)), [f"step {step}"])


@pytest.mark.parametrize("workers", [0, 1, 2])
def test_every_step_gets_its_batch(workers):
    ahead = Ahead(workers, last=9)
    before = torch.get_rng_state()
    for step in (1, 2, 3, 7, 8, 9, 2, 3):
        found, wanted = ahead.get(step, make), make(step)
        assert (found.step, found.captions) == (step, wanted.captions)
        assert torch.equal(found.values, wanted.values)
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.parametrize("workers", [0, 2])
def test_the_last_step_may_be_passed(workers):
    assert Ahead(workers, last=4).get(6, make).step == 6


@pytest.mark.parametrize("workers", [0, 2])
def test_an_error_is_raised_where_its_batch_is_asked_for(workers):
    ahead = Ahead(workers, last=20)
    assert ahead.get(12, make).step == 12
    with pytest.raises(ValueError, match="step 13 cannot be made"):
        ahead.get(13, make)


def refused(step: int) -> Batch:
    raise FormatError(f"clip {step} is damaged")


@pytest.mark.parametrize("workers", [0, 2])
def test_what_is_wrong_with_a_file_is_said_in_its_own_words(workers):
    with pytest.raises(FormatError) as raised:
        Ahead(workers, last=20).get(3, refused)
    assert str(raised.value) == "clip 3 is damaged"


def terminated(step: int) -> Batch:
    os.kill(os.getpid(), signal.SIGTERM)
    return make(step)


@pytest.mark.skipif(os.name == "nt", reason="stops by POSIX signals")
def test_who_stops_a_group_of_processes_leaves_the_batch_in_work():
    """A scheduler does: the training then saves, and ends those that work for it."""
    assert Ahead(2, last=20).get(3, terminated).step == 3


def sentences(step: int) -> list[str]:
    return [f"sentence {k} of step {step}, which is as long as those of people" for k in range(2000)]


def ahead_of_a_long_step(folder: str) -> None:
    with locked(Path(folder)):
        ahead = Ahead(2, last=100)
        ahead.get(1, sentences)
        time.sleep(1)  # until more is made than anybody takes
        Path(folder, "waiting").touch()
        time.sleep(600)


@pytest.mark.skipif(os.name == "nt", reason="kills by POSIX signals")
def test_whoever_is_killed_leaves_no_workers_that_hold_its_lock(tmp_path):
    training = get_context("spawn").Process(target=ahead_of_a_long_step, args=(str(tmp_path),))
    training.start()
    while not (tmp_path / "waiting").exists():
        assert training.is_alive()
        time.sleep(0.01)
    training.kill()
    training.join()
    deadline = time.monotonic() + 60
    while True:
        try:
            with locked(tmp_path, "workers are left"):
                break
        except InputError:
            assert time.monotonic() < deadline
            time.sleep(0.05)


def failing() -> None:
    Ahead(2, last=20).get(13, make)


def test_a_program_that_fails_ends():
    """Not when somebody ends the workers that it still holds."""
    training = get_context("spawn").Process(target=failing)
    training.start()
    training.join(60)
    workers_left = training.is_alive()
    training.kill()
    assert not workers_left
