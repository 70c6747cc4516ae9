"""Compositions: what sentences say of them is done, and nothing jumps."""

import math
from functools import partial, reduce
from itertools import pairwise

import pytest
import torch

from moveset.data.augment import bent, compose_in_time, quiet_moments
from moveset.data.compose import add_compositions
from moveset.data.corpus import Corpus, CorpusWriter
from moveset.data.passages import find_rises
from moveset.motion import rotations
from moveset.motion.clip import Motion
from tests.motions import seated, standing
from tests.synthetic import TakeEntry, add_take, synthetic_motion

SENTENCES = {
    "walk": ("a person walks forward", "someone is walking"),
    "wave": ("a person waves", "a man waves with the left hand"),
    "run": ("the person runs",),
    "stand": ("a person stands still", "standing"),
}


def rising(rest: int, rise: int, stand: int) -> Motion:
    return seated(torch.cat((torch.full((rest,), 95.0), torch.linspace(95.0, 0.0, rise), torch.zeros(stand))))


@pytest.fixture(scope="module")
def corpus(tmp_path_factory) -> Corpus:
    writer = CorpusWriter()
    for k in range(32):
        content = list(SENTENCES)[k % 4]
        kind = {"wave": "wave-left-hand", "stand": "bow"}.get(content, content)
        motion = standing(50 + k) if content == "stand" else synthetic_motion(kind, 60 + 2 * k, seed=k)
        split = "train" if k < 24 else "test"
        name = f"{content}{k}"
        add_take(writer, TakeEntry(name, name, "test", content, None, SENTENCES[content], split, "s", motion))
    for k in range(3):
        sits = TakeEntry(f"sit{k}", f"sit{k}", "test", "sit", None, (), "train", "s", rising(40, 25 + k, 20))
        add_take(writer, sits)
    assert add_compositions(writer, train=60) == 60
    return Corpus.open(writer.write(tmp_path_factory.mktemp("composed") / "corpus.safetensors"))


def composed(corpus: Corpus, kind: str) -> list[int]:
    found = [i for i in corpus.indices(composed=True) if corpus.records[i].kind == kind]
    assert found, kind
    return found


def test_only_training_clips_are_composed_and_lengths_are_right(corpus):
    for i in corpus.indices(composed=True):
        record = corpus.records[i]
        assert record.split == "train"
        assert all(corpus.records[part.clip].split == "train" for part in record.recipe.parts)
        assert len(corpus.motion(i)) == record.frames <= 196
        assert corpus.captions(i)


def test_one_after_the_other_is_told_by_halves_of_both_sentences(corpus):
    for i in composed(corpus, "in_time"):
        first, second = (corpus.records[part.clip].contents[0] for part in corpus.records[i].recipe.parts[:2])
        assert corpus.contents(i) == (first, second)
        stem = {"walk": "walk", "wave": "wave", "run": "run", "stand": ("stand", "stop", "halt")}
        for sentence in corpus.captions(i):
            for content in (first, second):
                options = stem[content] if isinstance(stem[content], tuple) else (stem[content],)
                assert any(option in sentence for option in options), sentence
        steps = corpus.motion(i).joints.diff(dim=0).norm(dim=-1).amax(dim=1)
        parts = [
            corpus.motion(part.clip).joints.diff(dim=0).norm(dim=-1).max() for part in corpus.records[i].recipe.parts
        ]
        assert steps.max() < 1.4 * max(parts) + 0.03


def test_ways_turn_as_sentences_say(corpus):
    for i in composed(corpus, "bent"):
        recipe, motion = corpus.records[i].recipe, corpus.motion(i)
        yaw = rotations.heading_angle(motion.rotations[:, 0])
        steps = torch.remainder(yaw.diff() + math.pi, 2 * math.pi) - math.pi
        assert float(steps.sum()) == pytest.approx(recipe.turn, abs=0.15)
        side = "left" if recipe.turn > 0 else "right"
        other = "right" if recipe.turn > 0 else "left"
        for sentence in corpus.captions(i):
            assert other not in sentence
            assert side in sentence or "circle" in sentence or "back" in sentence or "around" in sentence


def test_a_way_that_is_not_bent_stays_and_steps_keep_their_length():
    motion = synthetic_motion("walk", 100, seed=1)
    assert (bent(motion, 0.0, False).joints - motion.canonical().joints).abs().max() < 1e-4
    corner = bent(motion, math.pi / 2, True)
    lengths = [m.root.diff(dim=0).norm(dim=1) for m in (motion, corner)]
    assert (lengths[0] - lengths[1]).abs().max() < 1e-4


def test_another_pace_keeps_the_sentences(corpus):
    for i in composed(corpus, "paced"):
        (part,) = corpus.records[i].recipe.parts
        assert corpus.captions(i) == corpus.captions(part.clip, part.mirrored)
        speed = (part.stop - part.start) / corpus.records[i].frames
        assert 0.84 < speed < 1.17


def test_moments_of_standing_are_found():
    walk, still = synthetic_motion("walk", 30, seed=2), standing(60)
    motion = Motion(
        torch.cat((walk.rotations, still.rotations, walk.rotations)),
        torch.cat((walk.root, still.root, walk.root)),
        20.0,
        walk.skeleton,
    )
    ((start, stop),) = quiet_moments(motion, 40)
    assert 28 <= start <= 33
    assert 86 <= stop <= 91
    assert quiet_moments(walk, 10) == []


def test_the_same_clips_give_the_same_recipes(corpus):
    kept = [corpus.records[i] for i in corpus.indices(composed=True)]
    assert len({record.recipe for record in kept}) == len(kept)
    assert all(a.name < b.name or a.kind != b.kind for a, b in pairwise(kept))
    assert add_compositions(CorpusWriter(), train=10) == 0


def test_a_gait_goes_on_straight_at_its_own_pace(corpus):
    for i in composed(corpus, "going_on"):
        record, motion = corpus.records[i], corpus.motion(i)
        one = record.recipe.parts[0]
        assert set(record.recipe.parts) == {one}
        assert len(record.recipe.parts) > 1
        assert record.frames > 1.5 * (one.stop - one.start)
        assert set(corpus.captions(i)) <= set(corpus.captions(one.clip))
        source = corpus.motion(one.clip).root[one.start : one.stop, [0, 2]].diff(dim=0).norm(dim=1).mean()
        path = motion.root[:, [0, 2]]
        assert (path[-1] - path[0]).norm() / (len(path) - 1) == pytest.approx(float(source), rel=0.1)
        steps = motion.joints.diff(dim=0).norm(dim=-1).amax(dim=1)
        assert steps.max() < 1.2 * corpus.motion(one.clip).joints.diff(dim=0).norm(dim=-1).max() + 0.01


def test_a_gait_in_place_is_one_that_gets_nowhere(corpus):
    for i in composed(corpus, "in_place"):
        record, motion = corpus.records[i], corpus.motion(i)
        source = reduce(
            partial(compose_in_time, blend_frames=record.recipe.blend),
            [corpus.motion(part.clip)[part.start : part.stop] for part in record.recipe.parts],
        )
        assert len(motion) == len(source) == record.frames >= 40
        assert any(way in said for said in corpus.captions(i) for way in ("in place", "spot", "one place", "without"))
        assert not any("forward" in said and "without" not in said for said in corpus.captions(i))
        assert (motion.root - motion.root[0])[:, [0, 2]].norm(dim=1).max() < 0.1
        torch.testing.assert_close(motion.root[:, 1], source.root[:, 1], atol=1e-4, rtol=0)
        toes = motion.joints[:, [10, 11]]
        assert (toes - toes.mean(dim=0))[..., [0, 2]].norm(dim=-1).max() < 0.15
        rises = toes[..., 1] - source.joints[:, [10, 11], 1]
        assert rises.min() > -0.02
        assert (rises.amax(dim=0) > 0.05).all()  # of a stride of half a metre and more
        planted = source.joints[:, [10, 11]].diff(dim=0).norm(dim=-1) < 0.01
        assert (toes.diff(dim=0).norm(dim=-1)[planted] < 0.03).all()  # 0.6 m/s


def test_who_stands_sets_off_and_goes_on(corpus):
    found = [i for i in composed(corpus, "in_time") if len(corpus.records[i].recipe.parts) > 2]
    assert found
    for i in found:
        record = corpus.records[i]
        stands, sets_off, *gait = record.recipe.parts
        assert corpus.contents(i)[0] == "stand"
        assert len(set(gait)) == 1
        assert (gait[0].clip, gait[0].stop) == (sets_off.clip, sets_off.stop)
        assert record.frames > 196 - (gait[0].stop - gait[0].start)
        path = corpus.motion(i).root[:, [0, 2]]
        speed = path.diff(dim=0).norm(dim=1)
        assert speed[: stands.stop - record.recipe.blend].max() < 0.01
        source = corpus.motion(gait[0].clip).root[gait[0].start : gait[0].stop, [0, 2]].diff(dim=0).norm(dim=1).mean()
        assert speed[record.recipe.seam + record.recipe.blend :].mean() == pytest.approx(float(source), rel=0.1)


@pytest.mark.parametrize("frames", [(40, 20, 20), (20, 50, 20), (90, 12, 60)])
def test_who_rests_and_then_gets_up_is_found(frames):
    rest, rise, _ = frames
    motion = rising(*frames)
    ((start, stop),) = find_rises(motion)
    assert max(0, rest - 33) <= start <= rest
    assert rest < stop <= rest + rise + 16
    assert motion.root[stop - 1, 1] > 0.95 * motion.root[-1, 1]
    assert find_rises(motion.mirrored()) == [(start, stop)]


def test_who_sits_down_or_squats_without_rest_or_never_gets_up_does_not_get_up():
    down = torch.cat((torch.zeros(30), torch.linspace(0.0, 95.0, 20), torch.full((40,), 95.0)))
    squats = 47.5 - 47.5 * torch.cos(torch.arange(100) * (2 * math.pi / 20))
    assert not any(map(find_rises, (seated(down), seated(squats), standing(90), synthetic_motion("walk", 90, seed=1))))
    assert find_rises(seated(torch.cat((down, torch.linspace(95.0, 0.0, 20), torch.zeros(20)))))


def test_who_gets_up_then_stands(corpus):
    for i in composed(corpus, "rising"):
        record, motion = corpus.records[i], corpus.motion(i)
        first, second = (corpus.records[part.clip].contents for part in record.recipe.parts)
        assert (first, second) == (("sit",), ("stand",))
        height = motion.root[:, 1]
        assert height[0] < 0.6
        assert height[-1] == pytest.approx(float(standing(1).root[0, 1]), abs=0.02)
        assert (height[-20:] - height[-1]).abs().max() < 0.02
        assert all("up" in sentence or "rises" in sentence for sentence in corpus.captions(i))
        steps = motion.joints.diff(dim=0).norm(dim=-1).amax(dim=1)
        assert (
            steps.max() < 1.2 * corpus.motion(record.recipe.parts[0].clip).joints.diff(dim=0).norm(dim=-1).max() + 0.01
        )
