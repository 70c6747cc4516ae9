"""Segments of a corpus: what is cut, what is said to it, and that nothing of it is chance."""

from collections import defaultdict
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch

from moveset.data.corpus import CorpusWriter
from moveset.data.dataset import CorpusDataset, open_for_training
from moveset.data.feature_store import FeatureStore
from moveset.data.humanml3d import KIT
from moveset.data.records import ClipRecord
from moveset.data.segments import SEGMENT_FRAMES, ClipSet, CuttingConfig, Row, SegmentSet
from moveset.errors import InputError
from moveset.models.dip_decoder import DipDecoderConfig
from moveset.motion.features import get_codec
from moveset.motion.sides import favoured
from moveset.training.dip import PieceSet
from moveset.training.segment_data import forecast, spectrum
from tests.synthetic import synthetic_corpus, synthetic_motion
from tests.training.hml_folder import write_folder

N = 14
PLAIN = CuttingConfig(whole_caption=0.0)
ALIGNED = replace(PLAIN, aligned=True)


class Opened:
    """A source with its features."""

    def __init__(self, path, codec, cache):
        self.source, self.codec = open_for_training(path), get_codec(codec)
        self.store = FeatureStore.of(self.source, self.codec, cache)

    def cut(self, cutting, frames=N, split="train", **more):
        return SegmentSet(self.source, split, self.store, self.codec, cutting, frames, **more)


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    folder = tmp_path_factory.mktemp("corpus")
    return Opened(synthetic_corpus(folder / "corpus.safetensors", clips=24, seed=0), "native", folder / "features")


@pytest.fixture(scope="module")
def kit(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kit")
    return Opened(write_folder(folder / "data", KIT), "kit", folder / "features")


def numbered(found, lengths):
    """The set with clips whose only feature is 1000 clip + frame instead."""
    found.rows = [
        Row(
            ((1000 * k + np.arange(length, dtype=np.float32))[:, None],),
            (length,),
            ((f"clip {k}",),),
            (f"all {k}",),
            torch.zeros(2, 3),
        )
        for k, length in enumerate(lengths)
    ]
    found.weights = torch.ones(len(lengths), dtype=torch.float64)
    return found


def test_a_segment_follows_the_one_before_it(corpus):
    found = numbered(corpus.cut(PLAIN), [100, 40, 20, 9])
    batch = found.batch(600, seed=0, step=0)
    clip = batch.clean[:, 0, 0].div(1000).floor()
    for row in range(600):
        valid = int(batch.valid[row].sum())
        start = float(batch.clean[row, 0, 0])
        assert batch.clean[row, :valid, 0].tolist() == [start + k for k in range(valid)]
        assert not batch.clean[row, valid:].any()
        assert batch.captions[row] == f"clip {int(clip[row])}"
        if batch.index[row]:
            assert batch.previous[row, :, 0].tolist() == [start - N + k for k in range(N)]
            assert valid >= 8
            assert (batch.index[row] == 1) == (start == 1000 * clip[row] + N)
        else:
            assert not batch.previous[row].any()
    assert batch.index.unique().tolist() == [0, 1, 2]
    # Clips of 20 and of 9 frames are too short for a second segment.
    assert not batch.index[clip >= 2].any()
    assert (batch.valid.sum(1)[clip == 3] == 9).all()
    first = batch.index[clip == 0] == 0
    assert abs(float(first.float().mean()) - PLAIN.first_share) < 0.1


def test_of_two_places_the_one_is_taken_where_more_happens(corpus):
    few, all_ = (corpus.cut(replace(PLAIN, livelier=share)) for share in (0.0, 1.0))
    columns = corpus.codec.groups["velocities"]
    moved = []
    for found in (few, all_):
        batch = found.batch(400, seed=0, step=0)
        rows, shown = batch.index > 0, batch.valid[..., None]
        moved.append((batch.clean[..., columns].abs() * shown).sum((1, 2)) / batch.valid.sum(1))
    # The same clips, of which the first place is the other's only.
    assert (moved[1] >= moved[0] - 1e-4).all()
    assert torch.equal(moved[1][~rows], moved[0][~rows])
    assert (moved[1] > moved[0] + 1e-4)[rows].float().mean() > 0.3


def test_aligned_segments_lie_on_the_grid_and_count(corpus):
    found = numbered(corpus.cut(ALIGNED), [100, 196, 230])
    batch = found.batch(3000, seed=0, step=0)
    clip = batch.clean[:, 0, 0].div(1000).floor()
    start, begin = batch.clean[:, 0, 0] - 1000 * clip, batch.first[:, 0, 0] - 1000 * clip
    assert torch.equal(start - begin, N * batch.index.float())
    assert not begin[clip < 2].any()
    # Of a clip of 230 frames 196 in a row are shown, from any of 35.
    assert begin[clip == 2].unique().tolist() == list(range(35))
    for k, (segments_, last) in enumerate(((8, 2), (14, 14), (14, 14))):
        rows = clip == k
        assert batch.index[rows].unique().tolist() == list(range(segments_))
        assert batch.valid.sum(1)[rows & (batch.index == segments_ - 1)].unique().tolist() == [last]
        shares = torch.bincount(batch.index[rows]) / rows.sum()
        assert (shares - 1 / segments_).abs().max() < 0.04
    later = batch.index > 0
    assert torch.equal(batch.previous[later, -1, 0] + 1, batch.clean[later, 0, 0])


@pytest.mark.parametrize("count", [1, 4, 7, 14])
def test_the_longest_clip_has_so_many_segments(corpus, count):
    assert SEGMENT_FRAMES[count] * count == 196
    found = numbered(corpus.cut(ALIGNED, frames=SEGMENT_FRAMES[count]), [196, 199])
    index = found.batch(300, seed=0, step=0).index
    assert index.unique().tolist() == list(range(count))


def test_segments_are_those_of_the_store(corpus):
    found = corpus.cut(ALIGNED)
    batch = found.batch(16, seed=1, step=5)
    rows = [row for row, _ in found.draw(16, seed=1, step=5)]
    for k, row in enumerate(rows):
        start = int(batch.index[k]) * N
        want = torch.from_numpy(row.cut(start, start + N))
        assert torch.equal(batch.clean[k, : len(want)], want)
        assert batch.captions[k] in {sentence for said in row.said for sentence in said}


def test_a_part_of_a_clip_is_told_by_its_own_sentence(corpus):
    opened = corpus.source.corpus
    found = corpus.cut(replace(PLAIN, composed_share=0.9))
    clips = corpus.source.split("train")
    two = [(clip, row) for clip, row in zip(clips, found.rows, strict=True) if len(row.ends) == 2]
    assert {len(row.said) for _, row in two} == {2}
    assert two
    for clip, row in two:
        record, mirrored = opened.records[clip // 2], clip % 2 == 1
        assert record.kind == "in_time"
        first, second, *more = record.recipe.parts
        assert {part.clip for part in more} <= {second.clip}
        assert row.said[0] == opened.captions(first.clip, first.mirrored != mirrored)
        assert row.said[1] == opened.captions(second.clip, second.mirrored != mirrored)
        seam, end = row.ends
        assert seam == first.stop - first.start - record.recipe.blend // 2
        assert end == len(row)
        chance = [0.9, 0.0]
        assert found.say(row, seam - N, N, chance)[0] == row.said[0][0]
        # More of the segment belongs to the second part.
        assert found.say(row, seam - 3, N, chance)[0] == row.said[1][0]
        assert found.say(row, end - 5, N, chance)[0] == row.said[1][0]
    whole = corpus.cut(replace(PLAIN, whole_caption=1.0))
    assert whole.say(two[0][1], 0, N, [0.9, 0.0])[0] == two[0][1].whole[0]


def test_a_segment_lies_in_the_time_of_its_sentence(corpus):
    found = corpus.cut(replace(PLAIN, whole_caption=0.5))
    frames = np.arange(100, dtype=np.float32)[:, None]
    found.rows = [
        Row((frames,), (50, 100), (("one",), ("two",)), ("both",), torch.tensor([[1.0] * 3, [-1.0] * 3, [0.0] * 3])),
    ]
    found.weights = torch.ones(1, dtype=torch.float64)
    batch, seen = found.batch(400, seed=0, step=0), set()
    sides = {"one": 1.0, "two": -1.0, "both": 0.0}
    assert batch.sides.tolist() == [[sides[caption]] * 3 for caption in batch.captions]
    spans = {"one": (0, 50), "two": (50, 100), "both": (0, 100)}
    for clean, caption, begun in zip(batch.clean, batch.captions, batch.begun.tolist(), strict=True):
        start, (begin, _) = float(clean[0, 0]), spans[caption]
        assert begun == (begin < start)
        seen.add((caption, start < begin))
    assert seen == {("one", False), ("two", False), ("two", True), ("both", False)}


def test_a_segment_knows_how_far_its_way_has_turned_since_its_sentence_began(corpus):
    """The heading of the motion that a clip is, from where a sentence begins to where the segment does."""
    found, codec = corpus.cut(PLAIN), corpus.codec
    normalizer = corpus.store.normalizer
    batch = found.batch(200, seed=0, step=0)
    seen = 0
    where = defaultdict(list)  # the clips and frames that have these features
    for row in found.rows:
        for k, frame in enumerate(row.cut(0, len(row))):
            where[frame.tobytes()].append((row, k))
    for clean, begun, caption, turned in zip(
        batch.clean, batch.begun.tolist(), batch.captions, batch.turned.tolist(), strict=True
    ):
        places = where[clean[0].numpy().tobytes()]
        if len(places) != 1 or not begun:
            assert begun or turned == 0
            continue
        ((row, start),) = places
        begin = next(a for a, said in zip((0, *row.ends), row.said, strict=False) if caption in said)
        x = torch.from_numpy(row.cut(0, len(row))) * normalizer.std + normalizer.mean
        heading = codec.root_path(x)[0]
        assert turned == pytest.approx(float(heading[start] - heading[begin]), abs=1e-4)
        seen += 1
    assert seen > 20


def test_sides_are_those_that_each_part_favours(corpus):
    found, codec = corpus.cut(PLAIN), corpus.codec
    parts = 0
    for row in found.rows:
        joints = codec.joints(corpus.store.normalizer.denormalize(torch.from_numpy(row.cut(0, len(row)))))
        parts += len(row.ends) > 1
        for part, (begin, end) in enumerate(pairwise((0, *row.ends))):
            assert torch.equal(row.sides[part], favoured(joints[begin:end], codec.skeleton))
        assert torch.equal(row.sides[-1], favoured(joints, codec.skeleton))
    assert parts


def test_the_sentence_before_is_that_of_the_segment_before(corpus):
    found = corpus.cut(PLAIN)
    found.rows = [Row((np.zeros((100, 1), np.float32),), (50, 100), (("one",), ("two",)), ("both",), torch.zeros(3, 3))]
    found.weights = torch.ones(1, dtype=torch.float64)
    said = found.batch(400, seed=0, step=0)
    pairs = set(zip(said.previous_captions, said.captions, strict=True))
    assert pairs == {("one", "one"), ("one", "two"), ("two", "two")}


def test_segments_at_a_change_are_told_what_is_new_after_what_was_before(corpus):
    found = corpus.cut(replace(PLAIN, changes=0.5))
    frames = np.arange(200, dtype=np.float32)[:, None]
    sides = torch.zeros(3, 3)
    found.rows = [Row((frames,), (90, 200), (("one",), ("two",)), ("both",), sides)]
    found.weights = torch.ones(1, dtype=torch.float64)
    batch = found.batch(2000, seed=0, step=0)
    starts = batch.clean[batch.index > 0, 0, 0]
    near = (starts - 90).abs() <= N / 2
    # By chance a twelfth of them would be.
    assert 0.45 < float(near.float().mean()) < 0.6
    assert set(starts[near].tolist()) == set(range(90 - N // 2, 90 + N // 2 + 1))
    told = [caption for caption, k in zip(batch.captions, batch.index.tolist(), strict=True) if k]
    assert {caption for caption, at in zip(told, near.tolist(), strict=True) if at} == {"two"}
    # As near to the end as there is room; who is told one thing all the time has no change.
    found.cutting = replace(PLAIN, changes=1.0)
    for ends, said, lowest in (((195, 200), (("one",), ("two",)), 188), ((200,), (("one",),), N)):
        found.rows = [Row((frames,), ends, said, (), sides[: len(ends) + 1])]
        batch = found.batch(400, seed=0, step=0)
        starts = batch.clean[batch.index > 0, 0, 0]
        assert (float(starts.min()), float(starts.max())) == (lowest, 192)


def test_batches_are_functions_of_seed_and_step(corpus):
    one, other = (corpus.cut(PLAIN) for _ in range(2))
    a, b = one.batch(16, 3, 7), other.batch(16, 3, 7)
    for name, value in vars(a).items():
        same = getattr(b, name)
        assert torch.equal(value, same) if isinstance(value, torch.Tensor) else value == same
    assert not torch.equal(a.clean, one.batch(16, 3, 8).clean)
    assert not torch.equal(a.clean, one.batch(16, 4, 7).clean)


def test_rows_and_chances_are_those_of_the_clips(corpus):
    found = corpus.cut(replace(PLAIN, composed_share=0.3))
    assert isinstance(corpus.source, CorpusDataset)
    clips = corpus.source.split("train")
    assert [len(row) for row in found.rows] == [corpus.store.clips[clip].frames for clip in clips]
    composed = torch.tensor([corpus.source.corpus.records[clip // 2].kind != "take" for clip in clips])
    assert float(found.weights.sum()) == pytest.approx(1)
    assert float(found.weights[composed].sum()) == pytest.approx(0.3)


def test_where_there_is_nothing_but_takes_they_are_all_that_is_drawn(corpus):
    assert (corpus.source.weights(corpus.source.split("train", composed=False), 0.25, composed_share=1.0) > 0).all()
    with pytest.raises(InputError, match=r"cutting.composed_share 1.2 is not in 0 to 1"):
        CuttingConfig(composed_share=1.2)


def test_a_folder_is_cut_like_a_corpus(kit):
    found = kit.cut(ALIGNED)
    assert {len(row.ends) for row in found.rows} == {1}
    assert found.weights.unique().tolist() == pytest.approx([1 / len(found.rows)])
    batch = found.batch(64, 0, 0)
    assert batch.clean.shape == (64, N, 251)
    assert set(batch.captions) <= set(found.all_captions())
    assert int(batch.index.max()) > 1


def test_the_spectrum_is_of_whole_segments(corpus):
    found = corpus.cut(PLAIN)
    made = spectrum(found, 256)
    assert made.shape == (N, 269)
    # Motion is slow: of every feature's power most is in the lower half of the frequencies.
    power = made.square().sum(dim=1)
    assert float(power[: N // 2].sum() / power.sum()) > 0.9


def test_where_no_clip_has_a_whole_segment_there_is_no_spectrum_and_no_forecast(corpus):
    found = numbered(corpus.cut(PLAIN, frames=196), (100, 120))
    with pytest.raises(InputError, match="no clip has 196 frames; use fewer frames a segment"):
        spectrum(found, 64)
    assert not forecast(found, 64).any()


def test_pieces_are_prefix_and_frames_in_a_row(corpus):
    model = DipDecoderConfig(prefix=5, frames=9)
    found = PieceSet(corpus.source, "train", corpus.store, corpus.codec, PLAIN, model)
    numbered(found, [14, 100])
    batch = found.batch(300, 0, 0)
    whole = torch.cat((batch.prefix, batch.clean), dim=1)[..., 0]
    assert torch.equal(whole, whole[:, :1] + torch.arange(14.0))
    starts = whole[:, 0]
    assert set(starts[starts < 1000].tolist()) == {0.0}
    assert {1000.0, 1086.0} <= set(starts.tolist())
    assert float(starts.max()) == 1086.0
    assert batch.captions == [f"clip {int(start) // 1000}" for start in starts]


def test_some_pieces_begin_with_their_clip_after_a_person_who_stands(corpus):
    model = DipDecoderConfig(prefix=5, frames=9)
    found = PieceSet(corpus.source, "train", corpus.store, corpus.codec, PLAIN, model, standing=0.3)
    assert found.idle.shape == (5, 269)
    numbered(found, [14, 100])
    found.idle = torch.full((5, 1), -1.0)
    batch = found.batch(300, 0, 0)
    stands = (batch.prefix == -1).flatten(1).all(dim=1)
    assert 60 < int(stands.sum()) < 120
    first = batch.clean[:, 0, 0]
    assert set(first[stands].tolist()) == {0.0, 1000.0}
    assert not {0.0, 1000.0} & set(first[~stands].tolist())
    assert batch.captions == [f"clip {int(start) // 1000}" for start in first]


def test_people_stand_in_a_folder_of_features_too(kit):
    model = DipDecoderConfig(prefix=5, frames=9)
    found = PieceSet(kit.source, "train", kit.store, kit.codec, PLAIN, model, standing=0.3)
    pose = kit.store.normalizer.denormalize(found.idle[0])
    assert not pose[kit.codec.groups["velocities"]].abs().max() > 1e-4
    assert pose[kit.codec.groups["contacts"]].tolist() == pytest.approx([1.0] * 4)


def test_short_clips_have_no_pieces(corpus):
    model = DipDecoderConfig(prefix=20, frames=60)
    found = PieceSet(corpus.source, "train", corpus.store, corpus.codec, PLAIN, model)
    short = torch.tensor([len(row) < 80 for row in found.rows])
    assert short.any()
    assert not found.weights[short].any()
    assert (found.weights[~short] > 0).all()
    assert found.batch(32, 0, 0).clean.shape == (32, 60, 269)
    long = replace(model, frames=1000)
    with pytest.raises(InputError, match="has 1020 frames"):
        PieceSet(corpus.source, "train", corpus.store, corpus.codec, PLAIN, long)
    assert isinstance(found, ClipSet)


def test_clips_that_go_on_from_each_other_are_one_take_again(tmp_path):
    """Of one run four clips in a row are told, the third overlaps the second, another lies within it, and two are
    apart: cut into segments it is what the whole run is, but for the step on which clips end that share no frame."""
    writer = CorpusWriter()
    motion = synthetic_motion("walk", 300, seed=1)
    run = writer.add_run("take", motion, first_frame=10)
    spans = {
        "val": (0, 300),
        "a": (0, 60),
        "b": (60, 100),
        "c": (90, 150),
        "within": (100, 110),
        "far": (200, 240),
        "next": (240, 299),
    }
    for name, (start, stop) in spans.items():
        record = ClipRecord(
            name=name, take="take", source="synthetic", subject="s", group="take", kind="take", contents=("walk",),
            style=None, split="val" if name == "val" else "train", fps=20.0, frames=stop - start, captions=(),
            first_frame=10 + start, run=run,
        )  # fmt: skip
        writer.add_clip(record, (f"a person does {name}",))
    opened = Opened(writer.write(tmp_path / "corpus.safetensors"), "native", tmp_path / "cache")
    cut = opened.cut(replace(PLAIN, take_share=0.5))
    plain, taken = cut.rows[:12], cut.rows[12:]
    assert [row.ends for row in taken] == [(60, 95, 150)] * 2 + [(40, 99)] * 2
    assert [said[0].split()[-1] for said in taken[0].said] == ["a", "b", "c"]
    assert float(cut.weights[12:].sum()) == pytest.approx(0.5)
    assert len(opened.cut(PLAIN).rows) == len(plain)
    whole = opened.store.of_clip(0)
    joined = taken[0].cut(0, 150)
    alike = np.abs(joined - whole[:150]).max(axis=1) < 1e-3
    assert set(np.flatnonzero(~alike)) <= {59, 149}
    assert np.array_equal(taken[0].cut(50, 70), joined[50:70])
    switched = cut.batch(400, 0, 0)
    pairs = {(a.split()[-1], b.split()[-1]) for a, b in zip(switched.previous_captions, switched.captions, strict=True)}
    assert {("a", "b"), ("b", "c"), ("far", "next")} <= pairs
    assert ("c", "far") not in pairs
