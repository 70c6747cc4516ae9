"""Halves of the training takes have nothing in common, nor has what is composed of them."""

import pytest

from moveset.data.dataset import open_dataset
from tests.synthetic import synthetic_corpus


@pytest.fixture
def cross_fitting():
    import cross_fitting

    return cross_fitting


def test_halves_share_no_take_and_val_stays_as_it_is(cross_fitting, tmp_path):
    data = open_dataset(synthetic_corpus(tmp_path / "corpus.safetensors", clips=48))
    records = data.corpus.records

    def takes(clips):
        recipes = {clip: records[clip // 2].recipe for clip in clips}
        parts = [[clip // 2] if r is None else [part.clip for part in r.parts] for clip, r in recipes.items()]
        return {records[number].group for numbers in parts for number in numbers}

    whole, val = data.split("train"), data.split("val")
    halves = []
    for half in (0, 1):
        with cross_fitting.half_of_takes(half):
            assert data.split("val") == val
            halves.append(data.split("train"))
    assert data.split("train") == whole
    assert all(halves)
    assert not takes(halves[0]) & takes(halves[1])
    assert takes(halves[0]) | takes(halves[1]) == takes(whole)
    # Left out is only what is composed of takes of both.
    left = set(whole) - {*halves[0], *halves[1]}
    assert all(records[clip // 2].recipe is not None for clip in left)
