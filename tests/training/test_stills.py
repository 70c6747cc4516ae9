"""Standing still: clips made of moments in which somebody does."""

import pytest
import torch

from moveset.data.corpus import Corpus
from moveset.data.synthetic import synthetic_corpus, synthetic_motion
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.features import Normalizer, get_codec
from moveset.motion.skeleton import HML22
from moveset.training import stills
from moveset.training.stills import SENTENCES, make_stills, quiet_moment, swaying

CODEC = get_codec("native")
FPS = 20.0


def hanging(frames):
    """A person who stands with hanging arms and sways a little, breathing every two seconds."""
    turned = rotations.identity(frames, len(HML22))
    for side, degrees in (("left", -75.0), ("right", 75.0)):
        turned[:, HML22.index(f"{side}_shoulder")] = rotations.about("z", degrees)
    lean = torch.sin(torch.arange(frames) / FPS * torch.pi) * 0.5
    turned[:, HML22.index("spine1")] = rotations.about("x", lean)
    root = torch.tensor([0.0, -float(HML22.rest_positions[:, 1].min()), 0.0]).repeat(frames, 1)
    return Motion(turned, root, FPS, HML22)


def after(motion, moment):
    """The motion, and then the moment, without any passage between them."""
    return Motion(torch.cat((motion.rotations, moment.rotations)), torch.cat((motion.root, moment.root)), FPS, HML22)


def test_a_quiet_moment_is_found_where_it_is():
    walk, still = synthetic_motion("walk", 30), hanging(40)
    start, stop = quiet_moment(after(walk, still))
    assert (start, stop) == (30, 70)
    assert quiet_moment(still) == (0, 40)


def test_who_moves_or_holds_a_hand_up_does_not_stand_still():
    assert quiet_moment(synthetic_motion("walk", 60)) is None
    raised = hanging(40)
    raised.rotations[:, HML22.index("left_shoulder")] = rotations.about("z", 75.0)
    assert quiet_moment(Motion(raised.rotations, raised.root, FPS, HML22)) is None
    assert quiet_moment(hanging(stills.LEAST - 1)) is None


def test_swaying_goes_on_for_as_long_as_asked_without_a_jump():
    still = hanging(40)
    swayed = swaying(still, 200, phase=7)
    assert len(swayed) == 200
    step = still.joints.diff(dim=0).norm(dim=-1).max()
    assert swayed.joints.diff(dim=0).norm(dim=-1).max() <= step + 1e-6
    assert torch.equal(swayed.rotations[:30], still.rotations[7:37])


def test_a_short_moment_is_played_slowly():
    still = hanging(stills.SLOW - 4)
    fast, slow = (m.joints.diff(dim=0).norm(dim=-1).max() for m in (still, swaying(still, 100)))
    assert slow == pytest.approx(float(fast) / 2, rel=0.1)
    assert swaying(still, 100).fps == FPS


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    return Corpus.open(synthetic_corpus(tmp_path_factory.mktemp("stills") / "corpus.safetensors", clips=24, seed=0))


@pytest.fixture
def standing(corpus, monkeypatch):
    """The corpus, every clip of which ends in a second of standing."""
    own = corpus.motion

    def motion(k, mirrored=False):
        return after(own(k, mirrored), hanging(40))

    monkeypatch.setattr(corpus, "motion", motion)
    return corpus


def plain():
    return Normalizer(torch.zeros(CODEC.dim), torch.ones(CODEC.dim))


def test_half_stand_all_the_time_and_the_others_before_or_after_an_action(standing):
    made = make_stills(standing, "train", CODEC, plain(), 12)
    assert len(made) == 12
    alone = [clip for clip in made if clip.said == (SENTENCES,)]
    first = [clip for clip in made if clip.said[0] == SENTENCES and len(clip.said) == 2]
    last = [clip for clip in made if clip.said[-1] == SENTENCES and len(clip.said) == 2]
    assert (len(alone), len(first), len(last)) == (6, 3, 3)
    known = {caption for k in standing.indices("train") for m in (False, True) for caption in standing.captions(k, m)}
    for clip in made:
        assert clip.ends[-1] == len(clip.features)
        assert set(clip.said[0] + clip.said[-1]) <= known | set(SENTENCES)
        features = torch.from_numpy(clip.features).float()
        assert features.isfinite().all()
        joints = CODEC.decode(features).joints
        begin, end = {0: (0, clip.ends[0]), 1: (clip.ends[0], clip.ends[-1])}[len(clip.said) - 1 if clip in last else 0]
        still = joints[begin + 8 : end - 8]
        assert still.diff(dim=0).norm(dim=-1).max() * FPS < 2 * stills.QUIET


def test_the_same_seed_makes_the_same_clips(standing):
    one, same, other = (make_stills(standing, "train", CODEC, plain(), 6, seed) for seed in (0, 0, 1))
    assert all((a.features == b.features).all() and a.said == b.said for a, b in zip(one, same, strict=True))
    assert any(a.features.shape != b.features.shape or (a.features != b.features).any()
               for a, b in zip(one, other, strict=True))  # fmt: skip


def test_where_nobody_stands_long_enough_there_are_none(corpus, monkeypatch):
    monkeypatch.setattr(stills, "LEAST", 1000)
    assert make_stills(corpus, "train", CODEC, plain(), 8) == []
