"""The body of ``io.body`` as triangles, for files that carry a skinned mesh."""

from dataclasses import dataclass

import numpy as np

from moveset.io.body import Part, human_body
from moveset.motion.skeleton import Skeleton

_SEGMENTS, _RINGS = 14, 4


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of one colour in the rest pose, each vertex fixed to one joint. V vertices, T triangles.

    Args:
        positions: (V, 3) float32 metres, the root joint at the origin.
        normals: (V, 3) float32 unit vectors.
        joints: (V,) joint index of each vertex.
        triangles: (T, 3) vertex indices, counter-clockwise from outside.
    """

    positions: np.ndarray
    normals: np.ndarray
    joints: np.ndarray
    triangles: np.ndarray


def body_meshes(skeleton: Skeleton) -> dict[str, Mesh]:
    """The body as one mesh per tone ("trunk", "left", "right", "face")."""
    rest = skeleton.rest_positions.numpy().astype(np.float64)
    by_tone: dict[str, list[Part]] = {}
    for part in human_body(skeleton):
        by_tone.setdefault(part.tone, []).append(part)
    return {tone: _joined(parts, rest) for tone, parts in by_tone.items()}


def _joined(parts: list[Part], rest: np.ndarray) -> Mesh:
    surfaces = [_surface(part) for part in parts]
    triangles = _triangles()
    count = len(surfaces[0][0])
    return Mesh(
        positions=np.concatenate([p + rest[part.joint] for (p, _), part in zip(surfaces, parts, strict=True)]).astype(
            "f4"
        ),
        normals=np.concatenate([n for _, n in surfaces]).astype(np.float32),
        joints=np.repeat([part.joint for part in parts], count),
        triangles=np.concatenate([triangles + k * count for k in range(len(parts))]),
    )


def _surface(part: Part) -> tuple[np.ndarray, np.ndarray]:
    """Positions and normals (V, 3) of a round cone, from its joint: a pole, rings around either end, a pole."""
    axis = part.end - part.start
    length = float(np.linalg.norm(axis))
    along = axis / length if length > 1e-9 else np.array([0.0, 1.0, 0.0])
    # Where the normals lean this much towards the end, one sphere hands over to the other.
    lean = float(np.clip((part.radii[0] - part.radii[1]) / max(length, 1e-9), -0.95, 0.95))
    side = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    side /= np.linalg.norm(side)
    turn = np.arange(_SEGMENTS) * (2.0 * np.pi / _SEGMENTS)
    around = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(along, side)

    normals, places = [-along[None]], [(part.start - part.radii[0] * along)[None]]
    tilt = np.arcsin(lean)
    for centre, radius, angles in (
        (part.start, part.radii[0], np.linspace(-0.5 * np.pi, tilt, _RINGS + 1)[1:]),
        (part.end, part.radii[1], np.linspace(tilt, 0.5 * np.pi, _RINGS + 1)[:-1]),
    ):
        for angle in angles:
            normal = np.sin(angle) * along + np.cos(angle) * around
            normals.append(normal)
            places.append(centre + radius * normal)
    normals.append(along[None])
    places.append((part.end + part.radii[1] * along)[None])
    outward = np.concatenate(normals) @ np.linalg.inv(part.frame)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    return np.concatenate(places) @ part.frame.T, outward


def _triangles() -> np.ndarray:
    """(T, 3) indices into what ``_surface`` returns."""
    here = np.arange(_SEGMENTS)
    ahead = (here + 1) % _SEGMENTS
    rings = 2 * _RINGS
    pole = np.full(_SEGMENTS, 1 + rings * _SEGMENTS)
    faces = [np.stack((0 * here, 1 + ahead, 1 + here), axis=1)]
    for ring in range(rings - 1):
        low, high = 1 + ring * _SEGMENTS, 1 + (ring + 1) * _SEGMENTS
        faces.append(np.stack((low + here, low + ahead, high + ahead), axis=1))
        faces.append(np.stack((low + here, high + ahead, high + here), axis=1))
    last = 1 + (rings - 1) * _SEGMENTS
    faces.append(np.stack((pole, last + here, last + ahead), axis=1))
    return np.concatenate(faces)
