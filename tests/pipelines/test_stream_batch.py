"""Grouped streams are the same streams: whoever else is in the batch, whenever they joined, wherever they go back."""

import itertools

import pytest
import torch

from moveset.errors import InputError
from moveset.motion.foot_lock import FootLock
from moveset.motion.incremental import IncrementalDecoder
from moveset.pipelines.motion_stream import MotionStream
from moveset.pipelines.stream_batch import StreamBatch
from moveset.pipelines.stream_settings import check_stream

WALK, BOW = "a person walks forward", "a person bows politely to everybody who is there"


@pytest.fixture
def group(bundle, encoder):
    def make(**options):
        settings = check_stream(bundle.config, **options).settings
        return StreamBatch(bundle, settings, device="cpu", encoder=encoder)

    return make


def alone(bundle, encoder, prompt, count, **options):
    request = check_stream(bundle.config, prompt, **options)
    return list(itertools.islice(MotionStream(bundle, request, device="cpu", encoder=encoder), count))


def differ(one, two):
    """Metres between two segments' joints."""
    return float((one.motion.joints - two.motion.joints).norm(dim=-1).max())


@pytest.mark.parametrize(
    "options",
    [
        {"network": "pcm-1"},
        {"network": "pcm-2"},
        {"network": "md", "steps": 3, "guidance": 2.0},
        {"network": "md", "steps": 2, "guidance": 0.0},
        {"network": "md", "steps": 3, "eta": 0.7},
        {"network": "rdm", "steps": 4, "start": 4, "lag": 4, "past_lag": 1, "guidance": 2.0},
        {"network": "rdm", "steps": 4, "start": 4, "lag": 4, "past_lag": 3, "guidance": 0.0},
    ],
    ids=str,
)
def test_each_stream_of_a_group_is_what_it_is_alone(bundle, encoder, group, options):
    together = group(**options)
    lanes = [together.open(text, seed) for text, seed in ((WALK, 1), (BOW, 2), (WALK, 3))]
    rounds = [together.step(lanes) for _ in range(3)]
    for k, (text, seed) in enumerate(((WALK, 1), (BOW, 2), (WALK, 3))):
        want = alone(bundle, encoder, text, 3, seed=seed, **options)
        for pieces, segment in zip(rounds, want, strict=True):
            made = pieces[k]
            assert differ(made, segment) < 1e-4
            assert (made.number, made.first_frame, made.frames, made.prompt, made.network_evaluations) == (
                segment.number, segment.first_frame, segment.frames, segment.prompt, segment.network_evaluations
            )  # fmt: skip
    assert differ(rounds[0][0], rounds[0][2]) > 1e-3


def test_joining_late_prompts_and_guidance_of_ones_own_change_nothing_for_others(bundle, encoder, group):
    together = group(network="pcm-2")
    first = together.open(WALK, 1)
    made = [together.step([first])[0]]
    late = together.open(BOW, 2, guidance=4.0)
    made.append(together.step([first, late])[0])
    assert together.prompt(first, BOW) == 56
    pieces = together.step([late, first])
    made.append(pieces[1])

    lone = MotionStream(bundle, check_stream(bundle.config, WALK, seed=1, network="pcm-2"), encoder=encoder)
    want = [next(lone), next(lone)]
    assert lone.prompt(BOW) == 56
    want.append(next(lone))
    assert max(differ(a, b) for a, b in zip(made, want, strict=True)) < 1e-4
    second = alone(bundle, encoder, BOW, 2, seed=2, network="pcm-2", guidance=4.0)[1]
    assert differ(pieces[0], second) < 1e-4


def test_a_lane_goes_back_and_over_to_another_network(bundle, encoder, group):
    one, two = group(network="pcm-1"), group(network="pcm-2")
    lane = one.open(WALK, 5)
    one.step([lane])
    kept = lane.copy()
    ahead = [one.step([lane])[0] for _ in range(2)]
    again = [one.step([kept])[0] for _ in range(2)]
    assert all(torch.equal(a.motion.root, b.motion.root) for a, b in zip(ahead, again, strict=True))
    assert all(torch.equal(a.planted, b.planted) for a, b in zip(ahead, again, strict=True))
    other = two.step([kept])[0]
    assert (other.number, other.network_evaluations) == (3, 2)
    assert differ(other, one.step([lane])[0]) > 1e-3


def test_planted_feet_are_those_that_the_lock_holds(group, monkeypatch):
    together = group(network="pcm-1")
    seen, held, decode, lock = [], [], IncrementalDecoder.__call__, FootLock.__call__

    def decoded(self, features):
        seen.append(features[:, together.codec.groups["contacts"]])
        return decode(self, features)

    def locked(self, motion, planted):
        held.append(planted)
        return lock(self, motion, planted)

    monkeypatch.setattr(IncrementalDecoder, "__call__", decoded)
    monkeypatch.setattr(FootLock, "__call__", locked)
    together.step([together.open(WALK, seed) for seed in (1, 2)])
    # An untrained network's feet all stand or none does: let half of them.
    limit = float(torch.cat(seen).median())
    monkeypatch.setattr("moveset.motion.native.PLANTED", limit)
    held.clear()
    pieces = together.step([together.open(WALK, seed) for seed in (1, 2)])
    for piece, contacts, one in zip(pieces, seen[2:], held, strict=True):
        assert piece.planted.shape == (28, 4)
        assert torch.equal(piece.planted, contacts > limit)
        assert torch.equal(piece.planted, one)
    assert not torch.equal(pieces[0].planted, pieces[1].planted)


def test_what_cannot_be_grouped_is_refused(group):
    with pytest.raises(InputError, match="several segments of a stream at once"):
        group(network="rdm")
    made = group(network="pcm-1")
    lane = made.open(WALK, 1)
    with pytest.raises(InputError, match="empty"):
        made.prompt(lane, "  ")
    assert lane.condition.prompt == WALK
    with pytest.raises(InputError, match="empty"):
        made.open("", 1)
