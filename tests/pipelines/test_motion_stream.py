"""Streams: laws of time, prompts, seeds and states, and the first segments worked out by hand."""

import gc
import itertools
import json
import pickle
import signal
from collections import deque
from dataclasses import replace

import pytest
import torch

from moveset.errors import FormatError, InputError
from moveset.models.condition import Condition, PastSegment
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.features import get_codec
from moveset.motion.retarget import retarget
from moveset.motion.skeleton import HML22, Skeleton
from moveset.pipelines.sides import read_sides
from moveset.pipelines.stream_state import Snapshot
from moveset.pipelines.timeline import Timeline
from moveset.rdm.noise import START, segment_noise
from tests.streams import FRAMES, same, take

WALK, BOW = "a person walks forward", "a person bows politely"
ONE_BY_ONE = {"network": "rdm", "start": 6, "lag": 6, "past_lag": 1}


def near(one, two):
    return torch.allclose(one.motion.joints, two.motion.joints, atol=1e-3)


def plain(opened, **options):
    return opened(foot_lock=False, blend_seconds=0.0, **options)


def walking(frames, speed=1.0, heading=0.0, start=(0.0, 0.0)):
    """A body in its rest pose that glides ahead, metres a second."""
    root = torch.zeros(frames, 3)
    root[:, 2] = torch.arange(frames) * speed / 20.0
    root[:, 1] = -float(HML22.rest_positions[:, 1].min())
    turn = rotations.yaw(torch.tensor(heading))
    return Motion(rotations.identity(frames, 22), root).transformed(turn, torch.tensor([start[0], 0.0, start[1]]))


def test_the_first_segments_worked_out_by_hand(opened, encoder):
    made = plain(opened, prompt="a person turns left", network="pcm-1", seed=5, guidance=2.0)
    network, flow = made.bundle.module("pcm-1").network, made.bundle.module("flow")
    sentences = ("a person turns left", "a person turns right")
    text, mirrored = (read_sides(made.bundle, encoder.encode([said]), "cpu") for said in sentences)
    level, clean = torch.tensor([999]), torch.tensor([0])
    n, (order, signs) = made.bundle.normalizer, get_codec("native").mirror()

    def said(sentence, prev, index, turned):
        return Condition(sentence, past=PastSegment(prev, clean, index, turned), scale=torch.tensor([2.0]))

    def even(x, prev, index, turned):
        one = network(x, level, said(text, prev, index, turned))
        x, prev = x[..., order] * signs, prev[..., order] * signs
        other = network(x, level, said(mirrored, prev, index, -turned))
        return one + 0.5 * ((other[..., order] * signs).mean(dim=1) - one.mean(dim=1))

    with torch.no_grad():
        noise = [network.colour(segment_noise(5, j, START, (FRAMES, 269))[None]) for j in (0, 1)]
        first = even(noise[0], torch.zeros(1, FRAMES, 269), clean, torch.zeros(1))
        pushed = flow(noise[1], flow.context(text.pooled, torch.tensor([1])))
        turned = (first * n["feature_std"] + n["feature_mean"])[..., 0].sum(dim=1)
        second = even(pushed, first, torch.tensor([1]), turned)
        both = torch.cat((first, second), dim=1)[0] * n["feature_std"] + n["feature_mean"]
    got, want = take(made, 2), get_codec("native").decode(both.double())
    assert torch.allclose(torch.cat([s.motion.root for s in got]), want.root, atol=1e-4)
    assert torch.allclose(torch.cat([s.motion.joints for s in got]), want.joints, atol=1e-3)


def test_guidance_without_a_student_is_two_evaluations(opened, encoder):
    made = plain(opened, network="md", steps=1, guidance=2.0)
    network, n = made.bundle.module("md"), made.bundle.normalizer
    text, empty = read_sides(made.bundle, encoder.encode([WALK]), "cpu"), encoder.encode([""])
    clean = torch.tensor([0])
    with torch.no_grad():
        noise = network.colour(segment_noise(0, 0, START, (FRAMES, 269))[None])
        told, untold = (
            network(noise, torch.tensor([1000]), Condition(e, past=PastSegment(torch.zeros_like(noise), clean, clean)))
            for e in (text, empty)
        )
    features = (told + 2.0 * (told - untold))[0] * n["feature_std"] + n["feature_mean"]
    segment = next(made)
    assert torch.allclose(segment.motion.root, get_codec("native").decode(features.double()).root, atol=1e-4)
    assert segment.network_evaluations == 2


@pytest.mark.parametrize(
    ("options", "evaluations"),
    [
        ({"network": "pcm-1"}, [2, 2, 2]),  # with its mirror image
        ({"network": "pcm-2"}, [2, 2, 2]),
        ({"network": "pcm-2", "lag": 1}, [3, 2, 2]),
        ({"steps": 2}, [2, 2, 2]),
        ({"network": "md"}, [6, 6, 6]),
        ({"network": "md", "guidance": 1.0}, [12, 12, 12]),
        # K steps of segment 0 with two and one of the segments behind it, then R a segment.
        ({"network": "rdm"}, [9, 3, 3]),
        ({"network": "rdm", "lag": 3}, [6, 3, 3]),
        ({"network": "rdm", "steps": 12, "start": 4, "lag": 12}, [12, 4, 4]),
    ],
)
def test_what_a_segment_says_of_itself(opened, options, evaluations):
    segments = take(opened(**options), 3)
    assert [s.number for s in segments] == [0, 1, 2]
    assert [s.first_frame for s in segments] == [0, 28, 56]
    assert [s.frames for s in segments] == [len(s.motion) for s in segments] == [28, 28, 28]
    assert {s.prompt for s in segments} == {WALK}
    assert [s.network_evaluations for s in segments] == evaluations
    assert all(s.latency_ms > 0 for s in segments)


@pytest.mark.parametrize("network", ["pcm-2", "rdm"])
def test_the_same_seed_gives_the_same_bytes(opened, network):
    one, two, other = (take(opened(network=network, seed=seed), 3) for seed in (3, 3, 4))
    assert all(map(same, one, two))
    assert not any(map(same, one, other))


@pytest.mark.parametrize("network", ["pcm-2", "md", "rdm"])
def test_a_prompt_takes_effect_at_the_frame_it_says(opened, network):
    kept, changed = opened(network=network), opened(network=network)
    before = take(changed, 2)
    frame = changed.prompt(BOW)
    after = take(changed, 5)
    old = take(kept, 7)
    first = frame // FRAMES
    # A staircase of three steps and lag 1 has two more segments in work.
    assert (first, frame % FRAMES) == (4 if network == "rdm" else 2, 0)
    assert [s.prompt for s in (*before, *after)] == [WALK] * first + [BOW] * (7 - first)
    for k, (one, two) in enumerate(zip(old, [*before, *after], strict=True)):
        assert near(one, two) == (k < first)
        # Where no other segment is in the batch, not a bit changes.
        assert same(one, two) == (k < first) or network == "rdm"


def test_a_prompt_is_checked_and_leaves_the_stream_as_it_was(opened):
    made = opened()
    with pytest.raises(InputError, match="empty"):
        made.prompt("  ")
    assert next(made).prompt == WALK


def test_a_timeline_is_rounded_together(opened):
    made = opened(["a", "b", "c"], [3.0, 0.1, 4.0])
    # 3.0, 3.1 and 7.1 s are 2.1, 2.2 and 5.1 segments; each prompt gets at least one.
    assert made.timeline == Timeline(("a", "b", "c"), (0, 2, 3), 5)
    assert [s.prompt for s in take(made, 7)] == ["a", "a", "b", "c", "c", "c", "c"]


def test_errors_of_rounding_do_not_add_up(opened):
    assert opened(["x"] * 50, 2.0).timeline.end == round(100 / 1.4)


def test_a_timeline_begins_again(opened):
    assert [s.prompt for s in take(opened(["a", "b"], [2.8, 1.4], loop=True), 7)] == ["a", "a", "b"] * 2 + ["a"]


def test_without_a_prompt_the_model_idles(opened):
    assert next(opened(None)).prompt == "a person stands still"


def test_memory_is_constant(opened):
    made = opened()

    def held():
        gc.collect()
        everything = gc.get_objects()
        return len(everything), sum(x.nbytes for x in everything if type(x) is torch.Tensor)

    take(made, 20)
    objects, tensors = held()
    size = len(json.dumps(made.state().numbers))
    last = deque(itertools.islice(made, 480), maxlen=1)
    assert last.pop().number == 499
    assert held()[0] < objects + 300
    assert held()[1] < tensors + 10_000
    assert len(json.dumps(made.state().numbers)) < size + 1000


@pytest.mark.parametrize(
    "options", [{"network": "pcm-2"}, {"network": "rdm"}, {"network": "rdm", "eta": 0.7}, ONE_BY_ONE], ids=str
)
@pytest.mark.parametrize("seeded", [False, True])
def test_a_state_goes_on_to_the_last_bit(opened, tmp_path, options, seeded):
    made = opened(["a", "b"], [4.2, 2.8], seed=9, seed_motion=walking(40) if seeded else None, **options)
    take(made, 2)
    made.save_state(tmp_path / "state.safetensors")
    rest = take(made, 4)
    # Into a stream of other prompts, seed and network.
    again = opened(network="md").load_state(tmp_path / "state.safetensors")
    for one, two in zip(rest, take(again, 4), strict=True):
        assert same(one, two)
        assert (one.number, one.first_frame, one.prompt, one.network_evaluations) == (
            two.number, two.first_frame, two.prompt, two.network_evaluations
        )  # fmt: skip
    assert (again.seed, again.settings) == (9, made.settings)


def test_a_state_is_what_it_says(opened, tmp_path):
    made = opened(network="rdm")
    take(made, 1)
    state = made.state()
    assert json.loads(json.dumps(state.numbers)) == json.loads(json.dumps(made.state().numbers))
    path = state.save(tmp_path / "s")
    back = Snapshot.load(path)
    assert back.numbers == json.loads(json.dumps(state.numbers))
    assert {k: v.tolist() for k, v in back.tensors.items()} == {k: v.tolist() for k, v in state.tensors.items()}
    data = bytearray(path.read_bytes())
    for where in (len(data) - 1, len(data) // 2, 40, 3):
        broken = bytes(data[:where]) + bytes([data[where] ^ 1]) + bytes(data[where + 1 :])
        (tmp_path / "broken").write_bytes(broken)
        with pytest.raises(FormatError, match="damaged"):
            made.load_state(tmp_path / "broken")
    (tmp_path / "short").write_bytes(data[:20])
    with pytest.raises(FormatError, match="damaged"):
        made.load_state(tmp_path / "short")
    with pytest.raises(FormatError, match="does not describe"):
        made.restore(Snapshot({**state.numbers, "sampler": {}}, state.tensors))
    with pytest.raises(InputError, match="open that model"):
        made.restore(Snapshot({**state.numbers, "model": "another"}, state.tensors))
    with pytest.raises(InputError, match="other weights"):
        made.restore(Snapshot({**state.numbers, "weights": {}}, state.tensors))


@pytest.mark.parametrize("network", ["pcm-1", "rdm"])
def test_a_stream_goes_on_from_a_motion(opened, network):
    clip = walking(50, speed=1.0, heading=0.7, start=(3.0, -2.0))
    made = plain(opened, seed_motion=clip, network=network)
    segment = next(made)
    assert (segment.number, segment.first_frame) == (0, 0)
    # One step of the clip further, at its pace.
    step = clip.root[-1] - clip.root[-2]
    assert torch.allclose(segment.motion.root[0, [0, 2]].float(), (clip.root[-1] + step)[[0, 2]], atol=1e-4)
    assert not near(segment, next(plain(opened, network=network)))


def test_where_a_motion_is_does_not_matter(opened):
    clip = walking(40, speed=0.6)
    turn, shift = rotations.yaw(torch.tensor(1.1)), torch.tensor([5.0, 0.0, -7.0])
    here, there = (take(opened(seed_motion=c), 2) for c in (clip, clip.transformed(turn, shift)))
    for one, two in zip(here, there, strict=True):
        moved = one.motion.transformed(turn.double(), shift.double())
        assert torch.allclose(moved.joints, two.motion.joints, atol=2e-3)


def test_a_seed_motion_is_told_clean_and_is_no_first_segment(opened, monkeypatch):
    made = opened(seed_motion=walking(28), network="rdm")
    read, seen = [], []
    network = made.bundle.module("rdm")

    def reads(condition, real=network.prepare):
        read.append((condition.past.level.tolist(), condition.past.index.tolist()))
        return real(condition)

    def denoises(x, t, *more, real=network.denoise):
        seen.extend(zip(t.tolist(), *read[-1], strict=True))
        return real(x, t, *more)

    monkeypatch.setattr(network, "prepare", reads)
    monkeypatch.setattr(network, "denoise", denoises)
    take(made, 2)
    assert all(index > 0 for _, _, index in seen)
    assert {prev_t for _, prev_t, index in seen if index == 1} == {0}
    assert {(t, prev_t) for t, prev_t, index in seen if index == 2} == {(500, 333), (333, 166), (166, 0)}


def test_another_body_with_the_same_names_is_another_body(opened):
    clip = walking(40)
    small = replace(clip, root=0.7 * clip.root, skeleton=replace(HML22, name="child", offsets=0.7 * HML22.offsets))
    own, child = (next(plain(opened, seed_motion=m)) for m in (clip, small))
    assert torch.allclose(own.motion.joints[..., 1], child.motion.joints[..., 1], atol=0.05)


def test_any_skeleton_and_rate_will_do(opened):
    other = retarget(walking(100), "mixamo").resampled(30.0)
    own, foreign = (next(plain(opened, seed_motion=m)) for m in (walking(99), other))
    assert torch.allclose(own.motion.joints, foreign.motion.joints, atol=0.05)


@pytest.mark.parametrize(
    ("motion", "said"),
    [
        (walking(27), "give at least 1.4 s"),
        ("walk.bvh", "not from 'walk.bvh'; read a file by moveset.load"),
        (walking(41).resampled(60.0)[:80], "80 frames at 60 fps"),
        (Motion(rotations.identity(40, 2), torch.zeros(40, 3), 20.0, Skeleton("stick", ("a", "b"), (-1, 0),
         torch.tensor([[0.0, 0, 0], [0, 1, 0]]))), "stick"),
    ],
)  # fmt: skip
def test_a_motion_that_cannot_be_gone_on_from(opened, motion, said):
    with pytest.raises(InputError, match=said):
        opened(seed_motion=motion)


@pytest.mark.parametrize("buffer", [0, 2])
def test_a_pickled_stream_goes_on_where_it_stood(opened, buffer):
    stream = opened([WALK, BOW], 3.0, buffer=buffer, seed=3)
    take(stream, 2)
    stream.prompt(BOW)
    again = pickle.loads(pickle.dumps(stream))
    for one, two in zip(take(stream, 4), take(again, 4), strict=True):
        assert (one.number, one.first_frame, one.prompt) == (two.number, two.first_frame, two.prompt)
        assert same(one, two)
    assert (again.seed, again.settings, again.timeline) == (stream.seed, stream.settings, stream.timeline)


def test_a_buffer_changes_nothing_but_the_time(opened):
    plain_ones, ahead = take(opened(), 6), opened(buffer=2)
    first = take(ahead, 2)
    state = ahead.state()
    frame = ahead.prompt(BOW)
    # Two segments are there already, of prompts that cannot be changed any more.
    assert frame == 4 * FRAMES
    more = take(ahead, 3)
    assert all(map(same, plain_ones[:4], [*first, *more[:2]]))
    assert more[2].prompt == BOW
    for one, two in zip(plain_ones[2:], take(opened().restore(state), 4), strict=True):
        assert same(one, two)


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="Windows has no timer that interrupts")
def test_whoever_is_interrupted_while_waiting_misses_no_segment(opened):
    def interrupt(*_):
        raise KeyboardInterrupt

    stream, seen = opened(buffer=1), []
    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.5)
        with pytest.raises(KeyboardInterrupt), stream._lock:  # nothing is finished as long as it is held
            seen.extend(made.number for made in iter(stream.__next__, None))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    seen += [made.number for made in take(stream, 3)]
    assert seen == list(range(len(seen)))


@pytest.mark.parametrize("buffer", [0, 2])
def test_a_state_may_be_restored_again_and_again_while_the_stream_makes_ahead(opened, buffer):
    stream = opened([WALK, BOW], 3.0, buffer=buffer, seed=3)
    take(stream, 2)
    state = stream.state()
    expected = take(stream, 5)
    for _ in range(3):
        # Segments are still being made by then.
        again = take(stream.restore(state), 5)
        assert [one.number for one in again] == [one.number for one in expected]
        assert all(map(same, expected, again))


def test_a_past_that_is_told_noisily_changes_what_follows_the_first_segment(opened):
    clean, noisy = (take(opened(**ONE_BY_ONE | {"past_lag": lag}), 3) for lag in (6, 1))
    assert same(clean[0], noisy[0])
    assert not any(near(a, b) for a, b in zip(clean[1:], noisy[1:], strict=True))


def test_a_state_of_before_there_was_a_choice_goes_on_clean(opened):
    stream = opened(**ONE_BY_ONE | {"past_lag": 6})
    take(stream, 2)
    state = stream.state()
    numbers = {**state.numbers, "settings": {k: v for k, v in state.numbers["settings"].items() if k != "past_lag"}}
    again = opened(**ONE_BY_ONE).restore(Snapshot(numbers, state.tensors))
    assert all(map(same, take(again, 2), take(stream, 2)))
