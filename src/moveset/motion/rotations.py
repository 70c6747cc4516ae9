"""Quaternions as tiny pure functions on tensors of shape (..., 4), in x, y, z, w order (as glTF, scipy and roma).

Rotations act on column vectors; ``mul(a, b)`` applies ``b`` first. Angles are radians unless a name says degrees.
"""

import math
from functools import cache

import roma
import torch
from torch import Tensor


def identity(*shape: int) -> Tensor:
    """Identity rotations, shape (*shape, 4).

    >>> identity(2).tolist()
    [[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0]]
    """
    q = torch.zeros(*shape, 4)
    q[..., 3] = 1.0
    return q


def normalize(q: Tensor) -> Tensor:
    return q / q.norm(dim=-1, keepdim=True).clamp_min(1e-12)


def mul(a: Tensor, b: Tensor) -> Tensor:
    """Compose: rotate by b, then by a. Shapes broadcast."""
    ax, ay, az, aw = a.unbind(-1)
    bx, by, bz, bw = b.unbind(-1)
    return torch.stack(
        (
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ),
        dim=-1,
    )


def inv(q: Tensor) -> Tensor:
    return q * q.new_tensor((-1.0, -1.0, -1.0, 1.0))


def rotate(q: Tensor, v: Tensor) -> Tensor:
    """Rotate vectors v (..., 3) by q (..., 4); shapes broadcast."""
    u, w = q[..., :3], q[..., 3:]
    u, v = torch.broadcast_tensors(u, v)
    t = 2.0 * torch.linalg.cross(u, v)
    return v + w * t + torch.linalg.cross(u, t)


def from_axis_angle(axis: Tensor, angle: Tensor) -> Tensor:
    """Rotation by angle (...) about the unit axis (..., 3)."""
    half = 0.5 * angle[..., None]
    return torch.cat((axis * torch.sin(half), torch.cos(half)), dim=-1)


def about(axis: str, degrees: float | Tensor) -> Tensor:
    """Rotation about the coordinate axis "x", "y" or "z" by degrees (any shape).

    >>> [round(v, 4) for v in rotate(about("y", 90.0), torch.tensor([0.0, 0.0, 1.0])).tolist()]
    [1.0, 0.0, 0.0]
    """
    angle = torch.as_tensor(degrees, dtype=torch.get_default_dtype() if isinstance(degrees, float | int) else None)
    half = torch.deg2rad(angle) * 0.5
    zero = torch.zeros_like(half)
    parts = [zero, zero, zero, torch.cos(half)]
    parts["xyz".index(axis)] = torch.sin(half)
    return torch.stack(parts, dim=-1)


def yaw(angle: Tensor) -> Tensor:
    """Rotation about +Y by angle (...) radians."""
    half, zero = 0.5 * angle, torch.zeros_like(angle)
    return torch.stack((zero, torch.sin(half), zero, torch.cos(half)), dim=-1)


def yawed(q: Tensor, angle: Tensor) -> Tensor:
    """``mul(yaw(angle), q)`` in a few operations."""
    half = 0.5 * angle[..., None]
    return torch.cos(half) * q + torch.sin(half) * torch.cat((q[..., 2:], -q[..., :2]), dim=-1)


def heading(q: Tensor) -> Tensor:
    """The twist of q about +Y, as a quaternion (swing-twist decomposition).

    Left multiplication by a yaw turns it by just that yaw, which makes it the heading of a pelvis; it is undefined only
    for half turns about a horizontal axis, where it returns the identity.
    """
    twist = torch.stack((torch.zeros_like(q[..., 1]), q[..., 1], torch.zeros_like(q[..., 1]), q[..., 3]), dim=-1)
    size = twist.norm(dim=-1, keepdim=True)
    unit = torch.tensor((0.0, 0.0, 0.0, 1.0), dtype=q.dtype, device=q.device)
    return torch.where(size > 1e-6, twist / size.clamp_min(1e-6), unit)


def heading_angle(q: Tensor) -> Tensor:
    """Angle of ``heading(q)`` in (-pi, pi]."""
    angle = 2.0 * torch.atan2(q[..., 1], q[..., 3])
    return torch.remainder(angle + math.pi, 2 * math.pi) - math.pi


def between(u: Tensor, v: Tensor) -> Tensor:
    """Shortest arc that takes directions u (..., 3) to v (..., 3).

    Where they are opposite every axis is as short: the one nearest to Y is taken (X for vertical u). Where one of them
    is zero (below 1e-12) the result is the identity.
    """
    lengths = torch.minimum(u.norm(dim=-1), v.norm(dim=-1))
    u, v = torch.broadcast_tensors(torch.nn.functional.normalize(u, dim=-1), torch.nn.functional.normalize(v, dim=-1))
    q = torch.cat((torch.linalg.cross(u, v), 1.0 + (u * v).sum(-1, keepdim=True)), dim=-1)
    x, y, z = u.unbind(-1)
    zero, one = torch.zeros_like(x), torch.ones_like(x)
    # Y, or X, less its part along u.
    level = torch.stack((-x * y, x * x + z * z, -y * z, zero), dim=-1)
    upright = torch.stack((y * y + z * z, -x * y, -x * z, zero), dim=-1)
    half_turn = torch.where((y.abs() > 0.99)[..., None], upright, level)
    q = torch.where(q.norm(dim=-1, keepdim=True) <= 1e-6, half_turn, q)
    unit = torch.stack((zero, zero, zero, one), dim=-1)
    return normalize(torch.where((lengths > 1e-12)[..., None], q, unit))


def angle(q: Tensor) -> Tensor:
    """Rotation angle in [0, pi]."""
    return 2.0 * torch.atan2(q[..., :3].norm(dim=-1), q[..., 3].abs())


def slerp(a: Tensor, b: Tensor, t: Tensor | float) -> Tensor:
    """Spherical interpolation along the shorter arc; t in [0, 1] broadcasts over the leading shape."""
    dot = (a * b).sum(-1, keepdim=True)
    b = torch.where(dot < 0, -b, b)
    dot = dot.abs().clamp(max=1.0)
    near = torch.acos(dot.detach()) < 1e-4
    # Where both are one rotation the slope of the angle is infinite, which times nothing is a gradient of NaN.
    theta = torch.acos(torch.where(near, 0.0, dot))
    t = torch.as_tensor(t, dtype=a.dtype, device=a.device)
    t = t[..., None] if t.ndim else t
    sine = torch.sin(theta).clamp_min(1e-8)
    wa = torch.where(near, 1.0 - t, torch.sin((1.0 - t) * theta) / sine)
    wb = torch.where(near, t, torch.sin(t * theta) / sine)
    return normalize(wa * a + wb * b)


def unroll(q: Tensor) -> Tensor:
    """Flip signs along dimension 0 so that consecutive frames lie in the same hemisphere."""
    flips = torch.where((q[1:] * q[:-1]).sum(-1) < 0, -1.0, 1.0).to(q.dtype)
    signs = torch.cat((torch.ones_like(q[:1, ..., 0]), torch.cumprod(flips, dim=0)))
    return q * signs[..., None]


def to_matrix(q: Tensor) -> Tensor:
    """Rotation matrices (..., 3, 3)."""
    return roma.unitquat_to_rotmat(q)


def from_matrix(m: Tensor) -> Tensor:
    """Unit quaternions of rotation matrices (..., 3, 3); the largest component is positive."""
    return _from_columns(m.transpose(-1, -2).reshape(-1, 9).T).T.reshape(*m.shape[:-2], 4)


def _from_columns(m_9N: Tensor) -> Tensor:
    """Quaternions (4, N) of matrices given as their three columns one below the other."""
    # 4 q qᵀ is linear in the matrix; each of its rows is the quaternion times one component. The row of the largest
    # component is the accurate one (Shepperd 1978).
    table, constant = _outer_table(m_9N.dtype, m_9N.device)
    x, y, z, w = torch.addmm(constant, table, m_9N).view(4, 4, -1)
    xy = torch.where(x[0] > y[1], x, y)
    zw = torch.where(z[2] > w[3], z, w)
    q = torch.where(torch.maximum(x[0], y[1]) > torch.maximum(z[2], w[3]), xy, zw)
    return q * torch.rsqrt((q * q).sum(0))


@cache
def _outer_table(dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    """(16, 9) and (16, 1): 4 q qᵀ from the columns of the matrix of q = (x, y, z, w)."""
    terms = {
        (0, 0): "1 +00 -11 -22", (1, 1): "1 -00 +11 -22", (2, 2): "1 -00 -11 +22", (3, 3): "1 +00 +11 +22",
        (0, 1): "0 +10 +01", (0, 2): "0 +02 +20", (1, 2): "0 +21 +12",
        (0, 3): "0 +21 -12", (1, 3): "0 +02 -20", (2, 3): "0 +10 -01",
    }  # fmt: skip
    with torch.inference_mode(False):
        table, constant = torch.zeros(4, 4, 3, 3, dtype=dtype), torch.zeros(4, 4, dtype=dtype)
        for (i, j), term in terms.items():
            first, *entries = term.split()
            for a, b in {(i, j), (j, i)}:
                constant[a, b] = float(first)
                for entry in entries:
                    table[a, b, int(entry[2]), int(entry[1])] = float(entry[0] + "1")
        return table.view(16, 9).to(device), constant.view(16, 1).to(device)


def to_6d(q: Tensor) -> Tensor:
    """First two matrix columns, concatenated: (..., 6) (Zhou et al. 2019, arXiv 1812.07035)."""
    m = to_matrix(q)
    return torch.cat((m[..., :, 0], m[..., :, 1]), dim=-1)


def matrix_from_6d(d: Tensor) -> Tensor:
    """Gram-Schmidt of the two columns in (..., 6): rotation matrices (..., 3, 3), differentiable."""
    a = torch.nn.functional.normalize(d[..., :3], dim=-1)
    b = torch.nn.functional.normalize(d[..., 3:] - (a * d[..., 3:]).sum(-1, keepdim=True) * a, dim=-1)
    return torch.stack((a, b, torch.linalg.cross(a, b)), dim=-1)


def from_6d(d: Tensor) -> Tensor:
    """Unit quaternions of (..., 6)."""
    # Components first: the sums run over rows, not over threes, and no operation has tiny inner loops.
    a, b = d.reshape(-1, 6).T.contiguous().split(3)
    a = a * torch.rsqrt((a * a).sum(0).clamp_min(1e-24))
    b = b - (a * b).sum(0) * a
    b = b * torch.rsqrt((b * b).sum(0).clamp_min(1e-24))
    q_4N = _from_columns(torch.cat((a, b, torch.linalg.cross(a, b, dim=0))))
    return q_4N.T.contiguous().view(*d.shape[:-1], 4)


def to_rotvec(q: Tensor) -> Tensor:
    """Rotation vectors (..., 3) of the shorter way around."""
    v: Tensor = roma.unitquat_to_rotvec(q)
    return v


def from_rotvec(v: Tensor) -> Tensor:
    q: Tensor = roma.rotvec_to_unitquat(v)
    return q


def from_euler(degrees: Tensor, order: str) -> Tensor:
    """Intrinsic Euler angles in degrees (..., n) about the axes of ``order`` ("ZXY": R = Rz·Rx·Ry)."""
    q = about(order[0].lower(), degrees[..., 0])
    for k, axis in enumerate(order[1:], start=1):
        q = mul(q, about(axis.lower(), degrees[..., k]))
    return q
