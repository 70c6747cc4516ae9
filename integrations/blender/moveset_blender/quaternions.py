"""Quaternions as pure functions on arrays (..., 4), x y z w. Shapes broadcast; ``mul(a, b)`` applies ``b`` first."""

import numpy as np

IDENTITY = np.array((0.0, 0.0, 0.0, 1.0))


def mul(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Compose: rotate by b, then by a."""
    ax, ay, az, aw = np.moveaxis(np.asarray(a), -1, 0)
    bx, by, bz, bw = np.moveaxis(np.asarray(b), -1, 0)
    return np.stack(
        (
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ),
        axis=-1,
    )


def inv(q: np.ndarray) -> np.ndarray:
    """Inverse of unit quaternions."""
    return np.asarray(q) * (-1.0, -1.0, -1.0, 1.0)


def rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Vectors v (..., 3) turned by q (..., 4)."""
    u, w = q[..., :3], q[..., 3:]
    t = 2.0 * np.cross(u, v)
    return v + w * t + np.cross(u, t)


def normalize(q: np.ndarray) -> np.ndarray:
    """Unit quaternions."""
    return q / np.maximum(np.linalg.norm(q, axis=-1, keepdims=True), 1e-12)


def between(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(4,) shortest arc from direction u (3,) to v (3,); the identity where one of them is zero."""
    if min(np.linalg.norm(u), np.linalg.norm(v)) < 1e-9:
        return IDENTITY.copy()
    u, v = u / np.linalg.norm(u), v / np.linalg.norm(v)
    q = np.append(np.cross(u, v), 1.0 + u @ v)
    if np.linalg.norm(q) < 1e-6:
        # Opposite: half a turn about whatever is at right angles and nearest to the axis that u has least of.
        axis = np.eye(3)[np.abs(u).argmin()]
        q = np.append(axis - (axis @ u) * u, 0.0)
    return normalize(q)


def slerp(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Interpolation along the shorter arc; t (...) in [0, 1]."""
    dot = (a * b).sum(-1, keepdims=True)
    b = np.where(dot < 0.0, -b, b)
    theta = np.arccos(np.clip(np.abs(dot), 0.0, 1.0))
    t = np.asarray(t)[..., None]
    near = theta < 1e-5
    sine = np.where(near, 1.0, np.sin(theta))
    wa = np.where(near, 1.0 - t, np.sin((1.0 - t) * theta) / sine)
    wb = np.where(near, t, np.sin(t * theta) / sine)
    return normalize(wa * a + wb * b)


def unroll(q: np.ndarray) -> np.ndarray:
    """Signs flipped along axis 0 so that curves drawn through the components do not jump."""
    flips = np.where((q[1:] * q[:-1]).sum(-1) < 0.0, -1.0, 1.0)
    signs = np.concatenate((np.ones_like(q[:1, ..., 0]), np.cumprod(flips, axis=0)))
    return q * signs[..., None]


def from_matrix(m: np.ndarray) -> np.ndarray:
    """Unit quaternions of rotation matrices (..., 3, 3)."""
    m = np.asarray(m, dtype=np.float64)
    # 4 q qᵀ is linear in the matrix; of its rows the longest is the accurate multiple of q.
    a, b, c = np.moveaxis(m, -2, 0)
    xx, yy, zz = a[..., 0], b[..., 1], c[..., 2]
    xy, xz, yz = b[..., 0] + a[..., 1], a[..., 2] + c[..., 0], c[..., 1] + b[..., 2]
    xw, yw, zw = c[..., 1] - b[..., 2], a[..., 2] - c[..., 0], b[..., 0] - a[..., 1]
    rows = np.stack(
        (
            np.stack((1 + xx - yy - zz, xy, xz, xw), axis=-1),
            np.stack((xy, 1 - xx + yy - zz, yz, yw), axis=-1),
            np.stack((xz, yz, 1 - xx - yy + zz, zw), axis=-1),
            np.stack((xw, yw, zw, 1 + xx + yy + zz), axis=-1),
        ),
        axis=-2,
    )
    best = np.linalg.norm(rows, axis=-1).argmax(-1)
    return normalize(np.take_along_axis(rows, best[..., None, None], axis=-2)[..., 0, :])
