"""Decoding an endless motion: the pieces are the whole, the state is numbers, and seams do not pop."""

import json
import math

import pytest
import torch

from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.incremental import IncrementalDecoder
from moveset.motion.native import NativeCodec
from tests.motions import gait, smooth_noise, wander

CODEC = NativeCodec()


def features(frames: int, seed: int = 0) -> torch.Tensor:
    return CODEC.encode(wander(frames, seed, turn=0.7)).double()


def laid(pieces: list[Motion]) -> Motion:
    return Motion(torch.cat([p.rotations for p in pieces]), torch.cat([p.root for p in pieces]), 20.0)


def decoded(segments, **options) -> Motion:
    decoder = IncrementalDecoder(CODEC, **options)
    return laid([decoder(segment) for segment in segments])


def apart(a: Motion, b: Motion) -> tuple[float, float]:
    """Farthest joints (m) and farthest rotations (rad, from the sine: the cosine of small angles says nothing)."""
    turned = rotations.mul(rotations.inv(a.rotations), b.rotations)
    return (a.joints - b.joints).norm(dim=-1).max().item(), 2.0 * turned[..., :3].norm(dim=-1).max().item()


@pytest.mark.parametrize("lengths", [(28,) * 6, (1,) * 20, (5, 1, 60, 2, 28)])
def test_segments_decode_as_the_whole_does(lengths):
    whole = features(sum(lengths))
    metres, radians = apart(decoded(whole.split(lengths)), CODEC.decode(whole))
    assert max(metres, radians) < 1e-9


def test_an_hour_does_not_drift():
    """Over an hour and kilometres away: still what one pass over all features gives, to a hundredth of a millimetre."""
    count, n = 1000, 84
    rows = features(n, 3).repeat(count, 1)
    rows[:, CODEC.groups["root_yaw"]] = 0.002 * smooth_noise(count * n, 1, 4)
    rows[:, CODEC.groups["root_velocity"]] = 0.07 + 0.01 * smooth_noise(count * n, 2, 5)
    rows = rows.float()
    heading, root = CODEC.root_path(rows.double())
    decoder = IncrementalDecoder(CODEC)
    far = 0.0
    for k, segment in enumerate(rows.split(n)):
        piece = decoder(segment)
        at = slice(k * n, (k + 1) * n)
        far = max(far, float(piece.root.norm(dim=-1).max()))
        assert (piece.root - root[at]).abs().max() < 1e-5
        if k % 100 == 99:
            whole = CODEC.decode(segment.double()).transformed(rotations.yaw(heading[at][0]), torch.zeros(3).double())
            turned = rotations.mul(rotations.inv(piece.rotations), whole.rotations)
            assert 2.0 * turned[..., :3].norm(dim=-1).max() < 1e-5
    assert far > 1000.0
    assert abs(decoder.state()["heading"]) <= math.pi


@pytest.mark.parametrize("blend", [0.0, 0.3])
def test_a_resumed_stream_goes_on_as_if_nothing_had_happened(blend):
    segments = [features(28, seed) for seed in range(4)]
    decoder = IncrementalDecoder(CODEC, blend)
    for segment in segments[:2]:
        decoder(segment)
    resumed = IncrementalDecoder.from_state(CODEC, json.loads(json.dumps(decoder.state())))
    for segment in segments[2:]:
        a, b = decoder(segment), resumed(segment)
        assert torch.equal(a.rotations, b.rotations)
        assert torch.equal(a.root, b.root)
    assert resumed.state() == decoder.state()


def test_the_state_does_not_grow():
    decoder = IncrementalDecoder(CODEC, 0.3)
    sizes = []
    for segment in features(28 * 40).split(28):
        decoder(segment)
        sizes.append(len(torch.tensor(decoder.state()["tail_rotations"]).flatten()))
    assert set(sizes) == {3 * 22 * 4}


def stepped(count: int, size: float) -> list[torch.Tensor]:
    """Segments of one smooth motion, every second one in another pose, at another height and speed."""
    segments = list(features(28 * count, 7).split(28))
    generator = torch.Generator().manual_seed(8)
    for k in range(1, count, 2):
        segment = segments[k].clone()
        push = size * torch.randn(269, generator=generator, dtype=torch.float64)
        for group, scale in (("rotations", 1.0), ("root_height", 0.3), ("root_velocity", 0.1), ("root_yaw", 0.2)):
            segment[:, CODEC.groups[group]] += scale * push[CODEC.groups[group]]
        segments[k] = segment
    return segments


def jerk(motion: Motion) -> torch.Tensor:
    return torch.diff(motion.joints, n=3, dim=0).norm(dim=-1).mean(dim=-1) * motion.fps**3


def at_seams(values: torch.Tensor, n: int = 28) -> torch.Tensor:
    """Values of the third differences that reach over a seam."""
    frames = torch.arange(len(values))
    return values[(frames % n >= n - 3) & (frames // n < (len(values) + 3) // n - 1)]


def test_a_step_at_a_seam_pops_only_without_blending():
    segments = stepped(8, 0.1)
    raw, blended = decoded(segments), decoded(segments, blend_seconds=0.3)
    inside = jerk(CODEC.decode(features(28 * 8, 7))).mean()
    assert at_seams(jerk(raw)).mean() > 10.0 * inside
    assert at_seams(jerk(blended)).mean() < 0.25 * at_seams(jerk(raw)).mean()
    assert at_seams(jerk(blended)).max() < 0.4 * at_seams(jerk(raw)).max()
    # What is taken from the seam is not paid back behind it.
    assert jerk(blended).max() < 0.4 * jerk(raw).max()


@pytest.mark.parametrize(("before", "after"), [(0.1, 0.1), (0.1, -0.1), (0.0, 0.1), (-0.1, 0.0)])
def test_a_limb_that_swings_swings_on_across_a_seam(before, after):
    """An elbow at these speeds (radians a frame), with a jump in between: neither its angle nor its speed jumps."""
    still, elbow = gait(56).rotations[:1].double().repeat(56, 1, 1), CODEC.skeleton.index("left_elbow")
    angle = torch.cat((before * torch.arange(-28, 0), 0.2 + after * torch.arange(28))).double()
    swung = still.clone()
    swung[:, elbow] = rotations.about("y", torch.rad2deg(angle))
    motion = Motion(swung, torch.tensor((0.0, 0.9, 0.0)).double().repeat(56, 1), CODEC.fps, CODEC.skeleton)
    blended = decoded(CODEC.encode(motion).double().split(28), blend_seconds=0.3).rotations[:, elbow]
    turned = rotations.mul(blended[1:], rotations.inv(blended[:-1]))
    speed = 2.0 * torch.atan(turned[:, 1] / turned[:, 3])
    assert float(speed.diff()[25:34].abs().max()) < 0.09  # the jump alone is .2 there and back
    assert speed[:26].sub(before).abs().max() < 1e-5
    assert speed[34:].sub(after).abs().max() < 1e-5


def test_the_blend_ends_after_its_time_and_the_path_is_the_same():
    segments = stepped(6, 0.1)
    raw, blended = decoded(segments), decoded(segments, blend_seconds=0.3)
    off = (raw.joints - blended.joints).norm(dim=-1).amax(dim=-1).reshape(6, 28)
    assert off[1:, 0].min() > 0.01
    assert off[0].max() == 0.0
    assert off[:, 6:].max() < 1e-12
    late = IncrementalDecoder(CODEC, 0.3)
    raw_late = IncrementalDecoder(CODEC)
    for segment in segments:
        late(segment)
        raw_late(segment)
    assert all(late.state()[key] == raw_late.state()[key] for key in ("heading", "x", "z"))


def test_a_motion_that_goes_on_smoothly_is_left_alone():
    walk = CODEC.encode(gait(140)).double()
    metres, _ = apart(decoded(walk.split(28), blend_seconds=0.3), CODEC.decode(walk))
    assert metres < 1e-9


@pytest.mark.parametrize("n", [1, 2, 3])
def test_short_segments_are_blended_within_themselves(n):
    joints = decoded(stepped(8, 0.1)[1].split(n), blend_seconds=0.3).joints
    assert torch.isfinite(joints).all()


def test_bad_segments_are_named():
    with pytest.raises(InputError, match=r"\(n, 269\) with n >= 1, got \(28, 263\)"):
        IncrementalDecoder(CODEC)(torch.zeros(28, 263))
    with pytest.raises(InputError, match=r"got \(0, 269\)"):
        IncrementalDecoder(CODEC)(torch.zeros(0, 269))
    with pytest.raises(InputError, match="-1"):
        IncrementalDecoder(CODEC, -1.0)
