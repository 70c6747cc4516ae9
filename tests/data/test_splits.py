"""Splits: fixed by the name alone, in the promised proportions."""

from collections import Counter

import pytest

from moveset.data.splits import split_of


@pytest.mark.parametrize(
    ("name", "split"),
    [
        # Golden: every model ever trained depends on these.
        ("dataset-2_walk_active_001", "train"),
        ("dataset-1_kick_normal_001", "train"),
        ("39_03", "val"),
        ("07_02", "test"),
        ("60_01", "test"),
        ("60_03", "val"),
    ],
)
def test_golden_splits(name, split):
    assert split_of(name) == split


def test_proportions():
    counts = Counter(split_of(f"take_{k}") for k in range(20_000))
    assert counts["train"] / 20_000 == pytest.approx(0.90, abs=0.01)
    assert counts["val"] / 20_000 == pytest.approx(0.05, abs=0.006)
    assert counts["test"] / 20_000 == pytest.approx(0.05, abs=0.006)


def test_partners_of_a_dance_are_never_apart():
    assert all(split_of(f"60_{k:02d}") == split_of(f"61_{k:02d}") for k in range(100))
    assert any(split_of(f"60_{k:02d}") != split_of(f"62_{k:02d}") for k in range(100))
