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
_LIGHT = LIGHT.astype(np.float32)


@dataclass(frozen=True, eq=False)
class Shapes:
    """Parts of a body in view coordinates, frame by frame.

    Args:
        low, high: (F, P, 3) box around each part.
        depth: (F, P) of its middle.
        maps: (F, P, 7, 3, 3) coefficients of 1, y, y² times 1, x, x² of the polynomials that ``paint`` adds up.
        tilt: (F, P, 2) the sign of the cone's root, and how the place along the axis changes with depth.
        facing: (F, P, 4, 4) from (x, y, 1, z) to the normal before ``bend`` is taken off, and to the place on the axis.
        bend: (F, P, 3) how the normal changes along the axis.
        balls: (F, B, 3) world centres of spheres that fill the body, for its shadow.
        ball_radii: (B,) their radii.
    """

    low: np.ndarray
    high: np.ndarray
    depth: np.ndarray
    maps: np.ndarray
    tilt: np.ndarray
    facing: np.ndarray
    bend: np.ndarray
    balls: np.ndarray
    ball_radii: np.ndarray


def posed_shapes(
    parts: tuple[Part, ...], motion: Motion, axes: np.ndarray, targets: np.ndarray, frames: Sequence[int] | None
) -> Shapes:
    """Parts of all or some frames in view coordinates: ``axes`` (3, 3) to the right, up and towards the viewer, from
    ``targets`` (F, 3)."""
    owner = [part.joint for part in parts]
    start, end = (np.stack([getattr(part, name) for part in parts]) for name in ("start", "end"))
    radii = np.array([part.radii for part in parts])
    chosen = slice(None) if frames is None else list(frames)
    turned = rotations.to_matrix(motion.global_rotations[chosen][:, owner])
    place = motion.joints[chosen][:, owner].numpy().astype(np.float64)
    to_world = turned.numpy().astype(np.float64) @ np.stack([part.frame for part in parts])
    to_view = axes @ to_world
    centre = (place - targets[:, None]) @ axes.T
    # A part's own coordinates are q = B (v - c); seen from its first sphere, q = rays · (x, y, 1, z).
    inverse = np.linalg.inv(to_view)
    middle = -np.einsum("fpij,fpj->fpi", inverse, centre) - start
    rays = np.concatenate((inverse[..., :2], middle[..., None], inverse[..., 2:]), axis=-1)
    maps, tilt = _polynomials(rays, end - start, radii)

    axis = np.broadcast_to((end - start)[:, None], (*rays.shape[:2], 1, 3))
    back = np.swapaxes(inverse, -1, -2)
    facing = np.concatenate((back @ rays, axis @ rays), axis=-2)
    # Along the axis, 0 is the first sphere and 1 the second.
    lean, spread = _lean(end - start, radii)
    facing[..., 3, 2] -= lean
    facing[..., 3, :] /= spread[:, None]

    ends = [centre + np.einsum("fpij,pj->fpi", to_view, q) for q in (start, end)]
    reach = [np.linalg.norm(to_view, axis=-1) * radii[:, k, None] for k in (0, 1)]
    shares = np.linspace(0.0, 1.0, 5)
    filling = [place + np.einsum("fpij,pj->fpi", to_world, start + share * (end - start)) for share in shares]
    return Shapes(
        low=np.minimum(ends[0] - reach[0], ends[1] - reach[1]),
        high=np.maximum(ends[0] + reach[0], ends[1] + reach[1]),
        depth=0.5 * (ends[0] + ends[1])[..., 2],
        maps=maps.astype(np.float32),
        tilt=tilt.astype(np.float32),
        facing=facing.astype(np.float32),
        bend=(back @ np.swapaxes(axis, -1, -2))[..., 0].astype(np.float32),
        balls=np.concatenate(filling, axis=1),
        ball_radii=np.concatenate([radii @ (1.0 - share, share) for share in shares]),
    )


def _lean(axis: np.ndarray, radii: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of each part (P,): where along its axis the cone leaves the first sphere, and how far on the second (squared
    metres); a part whose one sphere holds the other has no cone and counts as infinitely long."""
    difference = radii[:, 0] - radii[:, 1]
    spread = (axis * axis).sum(axis=-1) - difference**2
    return radii[:, 0] * difference, np.where(spread > 1e-9, spread, np.inf)


def _polynomials(rays: np.ndarray, axis: np.ndarray, radii: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``Shapes.maps`` and ``Shapes.tilt``.

    The intersection is Quilez's (iquilezles.org, "round cone"), its terms gathered into polynomials of x and y: a ray
    meets a sphere, or the cone, at depth p + sqrt(d) where d is not negative, p being a plane and d a quadratic.
    """
    u, v, w, e = (rays[..., k] for k in range(4))
    length = np.linalg.norm(e, axis=-1)
    ray = -e / length[..., None]
    m2 = np.einsum("fpi,pi->fp", ray, axis)
    per_part = (*radii.T, (axis * axis).sum(axis=-1), *_lean(axis, radii))
    ra, rb, m0, lean, spread = (np.broadcast_to(value, m2.shape) for value in per_part)
    m1 = _plane(*(np.einsum("fpi,pi->fp", k, axis) for k in (u, v, w)))
    m3 = _plane(*((k * ray).sum(axis=-1) for k in (u, v, w)))
    square = np.stack([_squared(_plane(u[..., k], v[..., k], w[..., k])) for k in range(3)]).sum(axis=0)
    m6 = m3 - _constant(m2)
    ball_a = _squared(m3) - square + _constant(ra * ra)
    ball_b = _squared(m6) - square + 2.0 * m1 + _constant(rb * rb - m0)

    def times(p: np.ndarray, by: np.ndarray) -> np.ndarray:
        return p * by[..., None, None]

    solid = np.isfinite(spread)
    d2 = np.where(solid, spread, 1.0)
    k2 = d2 - m2 * m2
    k2 = np.where(np.abs(k2) > 1e-6 * m0, k2, 1e-6)
    k1 = times(m3, d2) - times(m1, m2) + _constant(m2 * lean)
    k0 = times(square, d2) - _squared(m1) + times(m1, 2.0 * lean) - _constant(m0 * ra * ra)
    cone = times(_squared(k1) - times(k0, k2), (k2 * length) ** -2)
    cone = np.where(solid[..., None, None], cone, -_constant(np.ones_like(m2)))
    along = times(m1 - _constant(lean + 0.5 * d2), 2.0 / d2)
    maps = (
        times(ball_a, length**-2), times(ball_b, length**-2), cone,
        times(m3, 1.0 / length), times(m6, 1.0 / length), times(k1, 1.0 / (k2 * length)), along,
    )  # fmt: skip
    return np.stack(maps, axis=2), np.stack((np.sign(k2), -2.0 * length * m2 / d2), axis=-1)


def _constant(c: np.ndarray) -> np.ndarray:
    """(F, P, 3, 3) coefficients of a constant (F, P)."""
    out = np.zeros((*c.shape, 3, 3))
    out[..., 0, 0] = c
    return out


def _plane(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """(F, P, 3, 3) coefficients of a x + b y + c."""
    out = _constant(c)
    out[..., 0, 1], out[..., 1, 0] = a, b
    return out


def _squared(p: np.ndarray) -> np.ndarray:
    """(F, P, 3, 3) coefficients of a plane's square."""
    a, b, c = p[..., 0, 1], p[..., 1, 0], p[..., 0, 0]
    out = _plane(2 * a * c, 2 * b * c, c * c)
    out[..., 0, 2], out[..., 2, 0], out[..., 1, 1] = a * a, b * b, 2 * a * b
    return out


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
    """Cast rays at one part into a rectangle of the depth and colour buffers (H, W); ``ramp``: colours by brightness.

    Where a ray misses, a square root is not a number and every comparison with it false: callers silence the warning.
    """
    columns = np.stack((np.ones_like(y), y, y * y), axis=1)
    rows = np.stack((np.ones_like(x), x, x * x))
    ball_a, ball_b, cone, plane_a, plane_b, plane_c, along = columns @ shapes.maps[index, part] @ rows
    sign, slope = shapes.tilt[index, part]
    for root, plane in ((ball_a, plane_a), (ball_b, plane_b)):
        np.sqrt(root, out=root)
        root += plane
    depth = np.fmax(ball_a, ball_b, out=ball_a)
    np.sqrt(cone, out=cone)
    if sign < 0:
        np.negative(cone, out=cone)
    cone += plane_c
    along += np.multiply(cone, slope, out=plane_c)
    np.abs(along, out=along)
    np.fmax(depth, cone, out=depth, where=along < 1.0)

    hit = depth > nearest
    np.copyto(nearest, depth, where=hit)
    points = np.ones((4, np.count_nonzero(hit)), dtype=np.float32)
    if not points.size:
        return
    points[0] = np.broadcast_to(x, hit.shape)[hit]
    points[1] = np.broadcast_to(y[:, None], hit.shape)[hit]
    points[3] = depth[hit]
    # The surface faces away from the nearest of the spheres that sweep the part out.
    facing = shapes.facing[index, part] @ points
    place = np.clip(facing[3], 0.0, 1.0)
    normal = facing[:3] - shapes.bend[index, part][:, None] * place
    size = np.sqrt(np.einsum("ij,ij->j", normal, normal))
    lit = (_LIGHT @ normal) / size
    lit *= 0.5
    lit += 0.5
    bright = np.maximum(normal[2] / size, 0.0) * np.float32(45.0)
    bright += np.float32(85.0) * lit * lit
    bright += np.float32(90.0)
    colour[hit] = ramp[bright.astype(np.uint8)]
