"""Batches made ahead are the batches, in order, whatever makes them."""

import os
import signal
from dataclasses import dataclass

import pytest
import torch

from moveset.data.loader import Ahead
from moveset.errors import FormatError


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
