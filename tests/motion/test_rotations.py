"""Each rotation function against scipy, or against what it is documented to give."""

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation, Slerp

from moveset.motion import rotations


def quaternions(*shape, seed=0, dtype=torch.float64):
    generator = torch.Generator().manual_seed(seed)
    return rotations.normalize(torch.randn(*shape, 4, generator=generator, dtype=torch.float64)).to(dtype)


def vectors(*shape, seed=1):
    return torch.randn(*shape, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def same(a, b, atol=1e-12):
    """Equal as rotations: up to sign."""
    sign = torch.where((a * b).sum(-1, keepdim=True) < 0, -1.0, 1.0)
    torch.testing.assert_close(a, b * sign, atol=atol, rtol=0)


def scipy_of(q):
    return Rotation.from_quat(q.reshape(-1, 4).numpy())


def test_angles_equal_scipys():
    a = quaternions(50)
    np.testing.assert_allclose(rotations.angle(a).numpy(), scipy_of(a).magnitude(), atol=1e-12)


def test_axis_and_angle_equal_scipy():
    axis = torch.nn.functional.normalize(vectors(20), dim=-1)
    angle = torch.linspace(-6.0, 6.0, 20, dtype=torch.float64)
    expected = Rotation.from_rotvec((axis * angle[:, None]).numpy()).as_quat()
    same(rotations.from_axis_angle(axis, angle), torch.from_numpy(expected))


@pytest.mark.parametrize("axis", "xyz")
def test_turns_about_an_axis_are_right_handed(axis):
    expected = torch.from_numpy(Rotation.from_euler(axis, 30.0, degrees=True).as_quat())
    same(rotations.about(axis, torch.tensor(30.0, dtype=torch.float64)), expected)
    same(rotations.about(axis, 30.0), expected.float(), atol=1e-6)


@pytest.mark.parametrize("order", ["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"])
def test_euler_angles_equal_scipy_in_every_order(order):
    generator = torch.Generator().manual_seed(3)
    span = torch.tensor([179.0, 89.0, 179.0], dtype=torch.float64)
    degrees = (2 * torch.rand(7, 40, 3, generator=generator, dtype=torch.float64) - 1) * span
    q = rotations.from_euler(degrees, order)
    expected = Rotation.from_euler(order, degrees.reshape(-1, 3).numpy(), degrees=True)
    same(q.reshape(-1, 4), torch.from_numpy(expected.as_quat()))


def test_slerp_equals_scipy():
    a, b = quaternions(20), quaternions(20, seed=4)
    for k in range(20):
        path = Slerp([0.0, 1.0], Rotation.from_quat(np.stack([a[k].numpy(), b[k].numpy()])))
        for t in (0.0, 0.25, 0.9, 1.0):
            same(rotations.slerp(a[k], b[k], t), torch.from_numpy(path(t).as_quat()), atol=1e-9)


def test_slerp_carries_gradient_also_where_nothing_turns():
    b = torch.stack((rotations.identity(), -rotations.identity(), rotations.about("y", 30.0))).double()
    for t in (0.0, 0.3, 1.0):
        a = rotations.identity(3).double().requires_grad_()
        rotations.slerp(a, b, t)[..., 1].sum().backward()
        assert torch.isfinite(a.grad).all()


@pytest.mark.parametrize("degrees", [0.0, 1e-5, 1e-3, 0.01, 1.0])
def test_slerp_between_close_rotations_is_even(degrees):
    a = quaternions(1)[0]
    b = rotations.mul(a, rotations.about("x", torch.tensor(degrees, dtype=torch.float64)))
    third = rotations.mul(a, rotations.about("x", torch.tensor(degrees / 3, dtype=torch.float64)))
    same(rotations.slerp(a, b, 1 / 3), third, atol=1e-12)


def test_heading_is_the_yaw_of_a_tilted_pelvis():
    yaw = torch.linspace(-3.1, 3.1, 25, dtype=torch.float64)
    tilt = rotations.about("x", torch.tensor(20.0, dtype=torch.float64))
    q = rotations.mul(rotations.yaw(yaw), tilt)
    same(rotations.heading(q), rotations.yaw(yaw))
    torch.testing.assert_close(rotations.heading_angle(q), yaw)
    torch.testing.assert_close(rotations.heading_angle(-q), yaw)
    assert rotations.heading(rotations.about("x", 180.0)).tolist() == [0.0, 0.0, 0.0, 1.0]


def test_shortest_arc_takes_one_direction_to_the_other():
    u, v = vectors(100), 7.0 * vectors(100, seed=5)
    q = rotations.between(u, v)
    aligned = torch.nn.functional.normalize(rotations.rotate(q, u), dim=-1)
    torch.testing.assert_close(aligned, torch.nn.functional.normalize(v, dim=-1), atol=1e-12, rtol=0)
    cosine = torch.nn.functional.cosine_similarity(u, v, dim=-1)
    torch.testing.assert_close(rotations.angle(q), torch.acos(cosine))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    "u", [(0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.0, -2.0, 0.0), (0.3, 0.9, -0.2), (0.0, 0.999, 0.01)]
)
def test_shortest_arc_to_the_opposite_is_a_half_turn(u, dtype):
    u = torch.tensor(u, dtype=dtype)
    q = rotations.between(u, -u)
    torch.testing.assert_close(rotations.rotate(q, u), -u, atol=1e-6, rtol=0)
    assert rotations.angle(q).item() == pytest.approx(math.pi, abs=1e-6)
    assert rotations.between(torch.zeros(3, dtype=dtype), u).tolist() == [0.0, 0.0, 0.0, 1.0]


def test_an_about_face_is_a_turn_about_the_vertical():
    q = rotations.between(torch.tensor([0.0, 0.0, -1.0]), torch.tensor([0.0, 0.0, 1.0]))
    same(q, torch.tensor([0.0, 1.0, 0.0, 0.0]))


def test_unroll_leaves_no_sign_flips():
    path = rotations.slerp(rotations.identity(1), rotations.about("y", 170.0), torch.linspace(0, 1, 30))
    flipped = path * torch.where(torch.rand(30, generator=torch.Generator().manual_seed(6)) < 0.5, -1.0, 1.0)[:, None]
    smooth = rotations.unroll(flipped)
    assert ((smooth[1:] * smooth[:-1]).sum(-1) > 0).all()
    same(smooth, path)


def test_six_numbers_are_two_matrix_columns():
    q = quaternions(10)
    m = torch.from_numpy(scipy_of(q).as_matrix())
    torch.testing.assert_close(rotations.to_6d(q), torch.cat((m[:, :, 0], m[:, :, 1]), dim=-1))


def test_six_numbers_need_not_be_a_rotation():
    d = torch.randn(50, 6, generator=torch.Generator().manual_seed(7), dtype=torch.float64)
    m = rotations.matrix_from_6d(d)
    torch.testing.assert_close(m @ m.mT, torch.eye(3, dtype=torch.float64).expand(50, 3, 3), atol=1e-12, rtol=0)
    torch.testing.assert_close(torch.linalg.det(m), torch.ones(50, dtype=torch.float64))
    torch.testing.assert_close(m[:, :, 0], torch.nn.functional.normalize(d[:, :3], dim=-1))
    assert torch.autograd.gradcheck(rotations.matrix_from_6d, d[:5].requires_grad_())


def test_matrices_of_half_turns_and_of_nothing_come_back():
    """Where one component after the other is the only one that is not small."""
    q = torch.cat((torch.eye(4, dtype=torch.float64), rotations.normalize(torch.eye(4, dtype=torch.float64) + 1e-9)))
    same(rotations.from_matrix(rotations.to_matrix(q)), q)
    turn = quaternions(3, 500, seed=5)
    same(rotations.from_matrix(rotations.to_matrix(turn)), turn)
    same(rotations.from_matrix(rotations.to_matrix(turn.float())), turn.float(), atol=1e-6)


def test_quaternions_of_six_numbers_equal_those_of_the_matrix():
    d = torch.randn(4, 30, 6, generator=torch.Generator().manual_seed(6), dtype=torch.float64)
    same(rotations.from_6d(d), rotations.from_matrix(rotations.matrix_from_6d(d)))


def test_a_yaw_before_a_rotation():
    angle, q = vectors(40)[:, 0] * 4, quaternions(40)
    torch.testing.assert_close(rotations.yawed(q, angle), rotations.mul(rotations.yaw(angle), q))
    many = quaternions(2, 3, 5)
    torch.testing.assert_close(rotations.yawed(many, angle[:5]), rotations.mul(rotations.yaw(angle[:5]), many))
