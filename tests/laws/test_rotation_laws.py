"""Rotations are a group that acts on vectors, whatever the shape and the precision."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from moveset.motion import rotations

SHAPES = [(), (1,), (7,), (2, 3), (0,), (4, 1, 5)]
DTYPES = [torch.float32, torch.float64]
TOLERANCE = {torch.float32: 2e-6, torch.float64: 1e-12}
every_shape = pytest.mark.parametrize("shape", SHAPES, ids=str)
every_dtype = pytest.mark.parametrize("dtype", DTYPES, ids=str)


def quaternions(shape, dtype, seed):
    q = torch.randn(*shape, 4, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return rotations.normalize(q).to(dtype)


def vectors(shape, dtype, seed):
    return torch.randn(*shape, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64).to(dtype)


def assert_same(a, b, times=1.0):
    """Equal as rotations, with shape and precision."""
    assert a.shape == b.shape
    assert a.dtype == b.dtype
    sign = torch.where((a * b).sum(-1, keepdim=True) < 0, -1.0, 1.0).to(a)
    torch.testing.assert_close(a, sign * b, atol=times * TOLERANCE[a.dtype], rtol=0)


@every_shape
@every_dtype
class TestGroup:
    def test_it_is_scipys(self, shape, dtype):
        a, b, v = quaternions(shape, dtype, 0), quaternions(shape, dtype, 1), vectors(shape, dtype, 2)
        one, other = (Rotation.from_quat(q.reshape(-1, 4).double().numpy()) for q in (a, b))

        def same(found, wanted, *last):
            wanted = torch.from_numpy(wanted).reshape(*shape, *last).to(dtype)
            assert_same(found, wanted, times=3.0) if last == (4,) else torch.testing.assert_close(
                found, wanted, atol=20 * TOLERANCE[dtype], rtol=0
            )

        same(rotations.mul(a, b), (one * other).as_quat(), 4)
        same(rotations.inv(a), one.inv().as_quat(), 4)
        same(rotations.rotate(a, v), one.apply(v.reshape(-1, 3).double().numpy()), 3)
        same(rotations.to_matrix(a), one.as_matrix(), 3, 3)
        assert_same(rotations.from_matrix(rotations.to_matrix(a)), a, times=2.0)
        assert_same(rotations.mul(rotations.inv(a), a), rotations.identity(*shape).to(dtype))

    def test_six_numbers_come_back(self, shape, dtype):
        q = quaternions(shape, dtype, 0)
        assert rotations.to_6d(q).shape == (*shape, 6)
        assert_same(rotations.from_6d(rotations.to_6d(q)), q, times=3.0)

    def test_opposite_quaternions_are_one_rotation(self, shape, dtype):
        q, v = quaternions(shape, dtype, 0), vectors(shape, dtype, 1)
        torch.testing.assert_close(rotations.rotate(-q, v), rotations.rotate(q, v))
        torch.testing.assert_close(rotations.to_6d(-q), rotations.to_6d(q))
        torch.testing.assert_close(rotations.heading_angle(-q), rotations.heading_angle(q), atol=1e-5, rtol=0)
        torch.testing.assert_close(rotations.angle(-q), rotations.angle(q))


@every_shape
@every_dtype
class TestSlerp:
    def test_ends_are_kept(self, shape, dtype):
        a, b = quaternions(shape, dtype, 0), quaternions(shape, dtype, 1)
        assert_same(rotations.slerp(a, b, 0.0), a)
        assert_same(rotations.slerp(a, b, 1.0), b)

    def test_the_middle_is_equally_far_from_both(self, shape, dtype):
        a, b = quaternions(shape, dtype, 0), quaternions(shape, dtype, 1)
        m = rotations.slerp(a, b, 0.5)
        to_a = rotations.angle(rotations.mul(rotations.inv(m), a))
        to_b = rotations.angle(rotations.mul(rotations.inv(m), b))
        whole = rotations.angle(rotations.mul(rotations.inv(a), b))
        torch.testing.assert_close(to_a, to_b, atol=1e-3, rtol=0)
        torch.testing.assert_close(to_a + to_b, whole, atol=2e-3, rtol=0)

    def test_it_goes_with_the_group(self, shape, dtype):
        """slerp(g·a, g·b) = g·slerp(a, b)."""
        g, a, b = (quaternions(shape, dtype, seed) for seed in range(3))
        moved = rotations.slerp(rotations.mul(g, a), rotations.mul(g, b), 0.3)
        assert_same(moved, rotations.mul(g, rotations.slerp(a, b, 0.3)), times=10.0)


angles = st.floats(-math.pi, math.pi)
tilts = st.floats(-1.4, 1.4)


@settings(max_examples=60, deadline=None)
@given(angles, angles, tilts, tilts)
def test_heading_follows_every_yaw(turn, yaw, pitch, roll):
    """heading(yaw·q) = yaw·heading(q), and what is left after the heading has none."""
    radians = torch.tensor([yaw, pitch, roll], dtype=torch.float64)
    q = rotations.from_euler(torch.rad2deg(radians), "YXZ")
    g = rotations.yaw(torch.tensor(turn, dtype=torch.float64))
    assert_same(rotations.heading(rotations.mul(g, q)), rotations.mul(g, rotations.heading(q)), times=1e3)
    rest = rotations.mul(rotations.inv(rotations.heading(q)), q)
    assert rotations.heading_angle(rest).abs() < 1e-9


coordinates = st.floats(-10.0, 10.0)


@settings(max_examples=60, deadline=None)
@given(st.tuples(*[coordinates] * 3), st.tuples(*[coordinates] * 3), st.sampled_from(DTYPES))
def test_the_shortest_arc_arrives(u, v, dtype):
    u, v = torch.tensor(u, dtype=dtype), torch.tensor(v, dtype=dtype)
    q = rotations.between(u, v)
    assert q.norm().item() == pytest.approx(1.0, abs=1e-5)
    if u.norm() > 0.1 and v.norm() > 0.1:
        arrived = rotations.rotate(q, u) / u.norm()
        assert (arrived - v / v.norm()).abs().max() < (3e-3 if dtype == torch.float32 else 1e-5)


@every_dtype
def test_an_axis_and_an_angle_are_a_one_parameter_group(dtype):
    axis = torch.nn.functional.normalize(vectors((9,), dtype, 0), dim=-1)
    a, b = torch.linspace(-3, 3, 9).to(dtype), torch.linspace(2, -1, 9).to(dtype)
    product = rotations.mul(rotations.from_axis_angle(axis, a), rotations.from_axis_angle(axis, b))
    assert_same(product, rotations.from_axis_angle(axis, a + b), times=2.0)
