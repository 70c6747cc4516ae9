"""Compositions made for training: of what, what is said to them, and that they are made once."""

import numpy as np
import pytest

from moveset.data.compose import plan_bodies
from moveset.data.dataset import open_for_training
from moveset.data.feature_store import FeatureStore
from moveset.errors import MovesetError
from moveset.motion.features import get_codec
from moveset.training import compositions
from moveset.training.compositions import composed_rows
from tests.training.segment_corpus import write_corpus

CODEC = get_codec("native")


@pytest.fixture(scope="module")
def opened(tmp_path_factory):
    folder = tmp_path_factory.mktemp("corpus")
    source = open_for_training(write_corpus(folder))
    return source.corpus, FeatureStore.of(source, CODEC, folder / "features"), folder / "made"


def rows(opened, kind, count, split="train"):
    corpus, store, folder = opened
    return composed_rows(kind, corpus, split, store, CODEC, count, folder)


def taken(opened, part):
    """Normalised features of the frames of a part, as the store has them."""
    _, store, _ = opened
    place = store.clips[2 * part.clip + part.mirrored]
    return np.array(store.features[place.start + part.start : place.start + part.stop])


def test_a_continuation_begins_as_its_first_part_and_is_told_by_its_sentence(opened):
    corpus, *_ = opened
    planned = compositions.plan_continuations(corpus, "train", 6)
    made = rows(opened, "continuations", 6)
    assert len(made) == len(planned) > 0
    for row, (_, recipe) in zip(made, planned, strict=True):
        first, second = recipe.parts
        assert row.ends == (recipe.seam, len(row.features))
        assert row.whole == row.said[0] == corpus.captions(first.clip, first.mirrored)
        assert row.said[1] == corpus.captions(second.clip, second.mirrored)
        # In half precision; velocities of the first frame of a piece are of its own.
        assert np.abs(row.features[1:8] - taken(opened, first)[1:8]).max() < 0.02


def test_a_body_walks_as_its_legs_and_is_told_by_both(opened):
    corpus, *_ = opened
    planned = plan_bodies(corpus, "train", 12)
    made = rows(opened, "bodies", 12)
    assert len(made) == len(planned) > 0
    yaw = CODEC.groups["root_yaw"]
    for row, (contents, recipe) in zip(made, planned, strict=True):
        legs = taken(opened, recipe.parts[1])
        assert row.ends == (len(row.features),) == (len(legs),)
        assert np.abs(row.features[1:-1, yaw] - legs[1:-1, yaw]).max() < 0.02
        assert row.whole == row.said[0]
        assert [corpus.contents(part.clip, part.mirrored) for part in recipe.parts] == [(c,) for c in contents]
        if "left" in contents[0]:
            assert all("left" in sentence for sentence in row.whole)


def test_pairs_of_contents_take_turns(opened):
    corpus, *_ = opened
    planned = plan_bodies(corpus, "train", 40)
    assert len({recipe for _, recipe in planned}) == len(planned)
    assert planned[:20] == plan_bodies(corpus, "train", 20)
    counts = np.unique([" ".join(contents) for contents, _ in planned], return_counts=True)[1]
    assert counts.max() <= 2 + 40 // len(counts)
    assert all(corpus.records[p.clip].split == "train" for _, recipe in planned for p in recipe.parts)


@pytest.mark.parametrize("kind", ["continuations", "bodies"])
def test_they_are_made_once(opened, kind, monkeypatch):
    made = rows(opened, kind, 5)
    for name in ("plan_continuations", "plan_bodies"):
        monkeypatch.setattr(compositions, name, None)  # would fail if called again
    again = rows(opened, kind, 5)
    assert [(a.said, a.ends, a.whole) for a in made] == [(b.said, b.ends, b.whole) for b in again]
    assert all(np.array_equal(a.features, b.features) for a, b in zip(made, again, strict=True))


def test_what_was_half_written_is_made_anew(opened, monkeypatch):
    def full(file, **arrays):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(compositions.np, "savez", full)
        with pytest.raises(MovesetError, match="No space left"):
            rows(opened, "bodies", 7)
    assert rows(opened, "bodies", 7)
