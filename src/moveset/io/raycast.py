"""A ray caster for round cones seen without perspective.

Seen so, everything that a round cone needs (where a ray meets it, how deep, which way the surface faces) is a
polynomial in the two pixel coordinates, and a part costs a few array operations on the pixels it covers. View axes: x
right, y up, z towards the viewer, metres from the point looked at. F frames, P parts.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from moveset.io.body import Part
from moveset.motion import rotations
from moveset.motion.clip import Motion

LIGHT = np.array((-0.38, 0.72, 0.58)) / np.linalg.norm((-0.38, 0.72, 0.58))


@dataclass(frozen=True, eq=False)
class Shapes:
    """What ``paint`` needs of every part in every frame, all (F, P, …): see ``posed_shapes``."""

    low: np.ndarray
    high: np.ndarray
    depth: np.ndarray
    inverse: np.ndarray
    rays: np.ndarray
    axis: np.ndarray
    radii: np.ndarray
    balls: np.ndarray
    ball_radii: np.ndarray


def posed_shapes(
    parts: tuple[Part, ...], motion: Motion, axes: np.ndarray, targets: np.ndarray, frames: Sequence[int] | None
) -> Shapes:
    """Parts of all or some frames in view coordinates: ``axes`` (3, 3) to the right, up and towards the viewer, from
    ``targets`` (F, 3).

    A part's own coordinates q follow from view coordinates v by q = B (v - c). ``inverse`` holds B; ``rays`` holds the
    columns u, v, w, e of q - start = u x + v y + w + e z, z being the depth.
    """
    owner = [part.joint for part in parts]
    start, end = (np.stack([getattr(part, name) for part in parts]) for name in ("start", "end"))
    radii = np.array([part.radii for part in parts])
    chosen = slice(None) if frames is None else list(frames)
    turned = rotations.to_matrix(motion.global_rotations[chosen][:, owner])
    place = motion.joints[chosen][:, owner].numpy().astype(np.float64)
    to_world = turned.numpy().astype(np.float64) @ np.stack([part.frame for part in parts])
    to_view = axes @ to_world
    centre = (place - targets[:, None]) @ axes.T
    inverse = np.linalg.inv(to_view)
    w = -np.einsum("fpij,fpj->fpi", inverse, centre) - start
    rays = np.concatenate((inverse[..., :2], w[..., None], inverse[..., 2:]), axis=-1)
    ends = [centre + np.einsum("fpij,pj->fpi", to_view, q) for q in (start, end)]
    spread = [np.linalg.norm(to_view, axis=-1) * radii[:, k, None] for k in (0, 1)]
    balls, ball_radii = [], []
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        q = start + share * (end - start)
        balls.append(place + np.einsum("fpij,pj->fpi", to_world, q))
        ball_radii.append(radii @ (1.0 - share, share))
    return Shapes(
        low=np.minimum(ends[0] - spread[0], ends[1] - spread[1]),
        high=np.maximum(ends[0] + spread[0], ends[1] + spread[1]),
        depth=0.5 * (ends[0] + ends[1])[..., 2],
        inverse=inverse,
        rays=rays,
        axis=end - start,
        radii=radii,
        balls=np.concatenate(balls, axis=1),
        ball_radii=np.concatenate(ball_radii),
    )


def paint(
    shapes: Shapes,
    index: int,
    part: int,
    x: np.ndarray,
    y: np.ndarray,
    nearest: np.ndarray,
    colour: np.ndarray,
    ramp: np.ndarray,
) -> None:
    """Ray-cast one round cone into a rectangle of the depth and colour buffers (H, W); ``ramp``: colours by brightness.

    The intersection is Quilez's (iquilezles.org, "round cone"), with its terms gathered into polynomials of x and y.
    """
    u, v, w, e = shapes.rays[index, part].T
    axis, (ra, rb) = shapes.axis[part], shapes.radii[part]
    length = float(np.sqrt(e @ e))
    ray = -e / length
    rr = ra - rb
    m0, m2 = float(axis @ axis), float(axis @ ray)
    d2 = m0 - rr * rr
    m1 = np.array((axis @ u, axis @ v, axis @ w))
    m3 = np.array((ray @ u, ray @ v, ray @ w))
    square = np.array((u @ u, v @ v, 2 * (u @ v), 2 * (u @ w), 2 * (v @ w), w @ w))

    ball_a = _squared(m3) - square + (0, 0, 0, 0, 0, ra * ra)
    m6 = m3 - (0.0, 0.0, m2)
    ball_b = _squared(m6) - square + 2.0 * _linear(m1) + (0, 0, 0, 0, 0, rb * rb - m0)
    t = _entry(_plane(m3, x, y), _quadratic(ball_a, x, y), 1.0)
    np.minimum(t, _entry(_plane(m6, x, y), _quadratic(ball_b, x, y), 1.0), out=t)
    k2 = d2 - m2 * m2
    if d2 > 0.0 and abs(k2) > 1e-6 * m0:
        k1 = d2 * m3 - m2 * m1 + (0.0, 0.0, m2 * rr * ra)
        k0 = d2 * square - _squared(m1) + 2.0 * rr * ra * _linear(m1) - (0, 0, 0, 0, 0, m0 * ra * ra)
        side = _entry(_plane(k1, x, y), _quadratic(_squared(k1) - k2 * k0, x, y), k2)
        along = _plane(m1 - (0.0, 0.0, ra * rr), x, y) + np.float32(m2) * side
        # Comparing with NaN and infinity is False, as it should be where the ray misses the cone.
        np.minimum(t, np.where((along > 0.0) & (along < d2), side, np.inf), out=t)

    t *= np.float32(-1.0 / length)
    hit = t > nearest
    np.copyto(nearest, t, where=hit)
    depth = t[hit]
    if not len(depth):
        return
    points = np.ones((4, len(depth)), dtype=np.float32)
    points[0] = np.broadcast_to(x, hit.shape)[hit]
    points[1] = np.broadcast_to(y[:, None], hit.shape)[hit]
    points[3] = depth
    # The surface faces away from the nearest sphere of those that sweep the cone out; the rows of ``facing`` give that
    # direction for the first sphere and, last, how far along the axis the sphere lies.
    back = shapes.inverse[index, part].T
    rays = shapes.rays[index, part]
    facing = np.concatenate((back @ rays, axis[None] @ rays)).astype(np.float32) @ points
    along = np.clip((facing[3] - np.float32(ra * rr)) * np.float32(1.0 / max(d2, 1e-9)), 0.0, 1.0)
    normal = facing[:3] - (back @ axis).astype(np.float32)[:, None] * along
    size = np.sqrt(np.einsum("ij,ij->j", normal, normal))
    lit = (LIGHT.astype(np.float32) @ normal) / size
    bright = np.maximum(normal[2] / size, 0.0) * np.float32(45.0)
    lit *= 0.5
    lit += 0.5
    bright += np.float32(85.0) * lit * lit
    bright += np.float32(90.0)
    colour[hit] = ramp[bright.astype(np.uint8)]


def _linear(p: np.ndarray) -> np.ndarray:
    """Coefficients of x², y², xy, x, y, 1 of a plane's p0 x + p1 y + p2."""
    return np.array((0.0, 0.0, 0.0, p[0], p[1], p[2]))


def _squared(p: np.ndarray) -> np.ndarray:
    """Coefficients of x², y², xy, x, y, 1 of (p0 x + p1 y + p2)²."""
    a, b, c = p
    return np.array((a * a, b * b, 2 * a * b, 2 * a * c, 2 * b * c, c * c))


def _plane(p: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    a, b, c = p.astype(np.float32)
    out: np.ndarray = (b * y + c)[:, None] + a * x
    return out


def _quadratic(p: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    xx, yy, xy, x1, y1, c = p.astype(np.float32)
    out: np.ndarray = y[:, None] * (xy * x) + ((yy * y + y1) * y + c)[:, None] + (xx * x + x1) * x
    return out


def _entry(half_b: np.ndarray, discriminant: np.ndarray, a: float) -> np.ndarray:
    """Distance at which a ray enters: the smaller root of a t² + 2 b t + c; infinite where there is none."""
    missed = discriminant < 0.0
    np.maximum(discriminant, 0.0, out=discriminant)
    np.sqrt(discriminant, out=discriminant)
    discriminant += half_b
    discriminant *= np.float32(-1.0 / a)
    discriminant[missed] = np.inf
    return discriminant
