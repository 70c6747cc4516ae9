"""Laws of the native features."""

from dataclasses import replace

import pytest
import torch

from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.native import NativeCodec
from moveset.motion.retarget import retarget


@pytest.fixture
def motion() -> Motion:
    generator = torch.Generator().manual_seed(3)
    wobble = torch.cumsum(torch.randn(60, 22, 3, generator=generator) * 0.05, dim=0)
    local = rotations.from_axis_angle(torch.nn.functional.normalize(wobble, dim=-1), wobble.norm(dim=-1))
    root = torch.cumsum(torch.randn(60, 3, generator=generator) * 0.02, dim=0) + torch.tensor([0.0, 0.9, 0.0])
    return Motion(local, root)


def test_decoding_inverts_encoding(motion: Motion) -> None:
    codec = NativeCodec()
    start = motion.canonical()
    back = codec.decode(codec.encode(motion))
    assert (back.joints - start.joints).norm(dim=-1).max() < 1e-5
    assert rotations.angle(rotations.mul(rotations.inv(back.rotations), start.rotations)).max() < 2e-3


def test_heading_and_place_do_not_show(motion: Motion) -> None:
    codec = NativeCodec()
    moved = motion.transformed(rotations.about("y", 137.0), torch.tensor([3.0, 0.0, -8.0]))
    assert torch.allclose(codec.encode(moved), codec.encode(motion), atol=2e-5)


def test_joints_equal_those_of_the_decoded_motion_and_carry_gradient(motion: Motion) -> None:
    codec = NativeCodec()
    features = codec.encode(motion).requires_grad_()
    joints = codec.joints(features[None])[0]
    assert torch.allclose(joints, codec.decode(features.detach()).joints, atol=1e-5)
    joints.square().mean().backward()
    assert features.grad is not None
    assert features.grad[:, codec.groups["rotations"]].abs().sum() > 0


def test_a_crop_of_features_is_the_features_of_the_crop(motion: Motion) -> None:
    codec = NativeCodec()
    whole, part = codec.encode(motion)[10:40], codec.encode(motion[10:40])
    steps = [s for g in ("root_yaw", "root_velocity", "velocities", "contacts") for s in range(269)[codec.groups[g]]]
    keep = [d for d in range(269) if d not in steps]
    assert torch.allclose(whole[:-1], part[:-1], atol=1e-5)
    assert torch.allclose(whole[-1, keep], part[-1, keep], atol=1e-5)


def test_another_rate_is_refused(motion: Motion) -> None:
    with pytest.raises(InputError, match="20 fps"):
        NativeCodec().encode(motion.resampled(30.0))


def test_another_tree_is_refused_even_under_the_same_name(motion: Motion) -> None:
    there = retarget(motion, "mixamo")
    with pytest.raises(InputError, match="25 joints"):
        NativeCodec().encode(replace(there, skeleton=replace(there.skeleton, name="hml22")))
