"""Weights as they are stored: what a rounding may cost, what is kept exactly, and what is refused."""

import pytest
import torch

from moveset.io.quantization import compacted, halved, restored, rounded, subtracted


@pytest.fixture
def base():
    g = torch.Generator().manual_seed(0)
    return {
        "matrix": torch.randn(40, 64, generator=g),
        "kernel": torch.randn(12, 8, 3, generator=g),
        "bias": torch.randn(40, generator=g),
        "narrow": torch.randn(30, 4, generator=g),
        "counts": torch.arange(20).view(2, 10),
    }


@pytest.fixture
def state(base):
    g = torch.Generator().manual_seed(1)
    moved = {k: v + 0.05 * torch.randn(v.shape, generator=g) if v.is_floating_point() else v for k, v in base.items()}
    return moved | {"new": torch.randn(16, 64, generator=g)}


def test_each_entry_is_off_by_half_a_step_at_most(state, base):
    stored = subtracted(state, halved(base))
    again = restored(stored, halved(base))
    assert again.keys() == state.keys()
    for key in ("matrix", "kernel"):
        assert stored[f"{key}:difference"].dtype == torch.int8
        largest = (state[key] - base[key].half().float()).flatten(1).abs().amax(1)
        step = (largest / 127).view(-1, *[1] * (state[key].ndim - 1))
        assert ((again[key] - state[key]).abs() <= 0.501 * step).all()
        # The bound bites: some entries do lie half-way between two steps.
        assert ((again[key] - state[key]).abs() > 0.4 * step).any()


def test_a_difference_from_a_compacted_base_takes_its_rounding_back(state, base):
    stored = compacted(base)
    assert stored["matrix:rounded"].dtype == torch.int8
    assert torch.equal(stored["narrow"], base["narrow"].half())
    rounding = (restored(stored)["matrix"] - base["matrix"]).abs()
    assert 0 < float(rounding.max()) <= 0.51 * float(base["matrix"].abs().max()) / 127
    again = restored(subtracted(state, stored), stored)
    largest = (state["matrix"] - restored(stored)["matrix"]).abs().amax(1, keepdim=True)
    assert ((again["matrix"] - state["matrix"]).abs() <= 0.501 * largest / 127).all()


def test_what_is_small_or_new_is_whole(state, base):
    stored = subtracted(state, halved(base))
    for key in ("bias", "narrow", "new"):
        assert torch.equal(stored[key], state[key].half())
    assert torch.equal(stored["counts"], state["counts"])
    assert restored(stored, halved(base))["counts"].dtype == torch.int64


def test_other_shapes_are_whole(state, base):
    wider = base | {"matrix": torch.zeros(40, 65)}
    assert torch.equal(subtracted(state, halved(wider))["matrix"], state["matrix"].half())


def test_unlike_tensors_are_whole(state, base):
    """Eight bits of a difference as large as the tensor itself would be off by more than a percent."""
    g = torch.Generator().manual_seed(2)
    stranger = base | {"matrix": torch.randn(40, 64, generator=g)}
    stored = subtracted(state, halved(stranger))
    assert torch.equal(stored["matrix"], state["matrix"].half())
    assert "kernel:difference" in stored


def test_the_base_itself_comes_back_exactly(base):
    stored_base = halved(base)
    same = {k: v.float() if v.is_floating_point() else v for k, v in stored_base.items()}
    again = restored(subtracted(same, stored_base), stored_base)
    assert all(torch.equal(again[key], same[key]) for key in same)


def test_the_rounding_of_the_base_does_not_count(base):
    """Differences of 1e-5 from weights near 1 survive; half precision would lose nearly all of them."""
    g = torch.Generator().manual_seed(3)
    stored_base = halved(base)
    near = {"matrix": stored_base["matrix"].float() + 1e-5 * torch.randn(40, 64, generator=g)}
    again = restored(subtracted(near, stored_base), stored_base)["matrix"]
    assert float((again - near["matrix"]).abs().max()) < 5e-7
    assert float((near["matrix"].half() == stored_base["matrix"]).float().mean()) > 0.8


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e6])
def test_numbers_that_cannot_be_stored_are_refused(state, base, value):
    state["matrix"][3, 3] = value
    with pytest.raises(ValueError, match="matrix has values that half precision cannot hold"):
        subtracted(state, halved(base))


def test_differences_need_their_base(state, base):
    stored, stored_base = subtracted(state, halved(base)), halved(base)
    none, other = "'matrix' is a difference from nothing", "no difference from a tensor of shape"
    for difference, from_base, message in (
        (stored, None, none),
        (stored, {k: v for k, v in stored_base.items() if k != "matrix"}, none),
        ({k: v for k, v in stored.items() if k != "matrix:scale"}, stored_base, none),
        (stored, stored_base | {"matrix": torch.zeros(64, 40)}, other),
        (stored | {"matrix:scale": torch.ones(39)}, stored_base, other),
    ):
        with pytest.raises(ValueError, match=message):
            restored(difference, from_base)


def test_rounded_blocks_are_off_by_half_a_step_of_their_own(base):
    base["matrix"] *= torch.logspace(-3, 0, 64)  # columns of a row that one unit would not serve
    stored = rounded("matrix", base["matrix"], 8)
    again = restored(stored)["matrix"].view(40, 8, 8)
    blocks = base["matrix"].view(40, 8, 8)
    step = blocks.abs().amax(-1, keepdim=True) / 127
    # The step is the one of half precision, and so a little larger where it is tiny.
    assert ((again - blocks).abs() <= 0.51 * step).all()
    assert ((again - blocks).abs() > 0.4 * step).any()


def test_rounded_integers_need_their_units(base):
    stored = rounded("matrix", base["matrix"], 8)
    for other in ({}, {"matrix:scale": torch.ones(39, 8)}, {"matrix:scale": torch.ones(40, 7)}):
        with pytest.raises(ValueError, match="'matrix' has no units for its rows of integers"):
            restored({"matrix:rounded": stored["matrix:rounded"]} | other)
