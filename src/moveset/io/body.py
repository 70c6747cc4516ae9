"""A simple human body hung on a skeleton: the shapes that pictures draw and GLB files carry.

Every part is a round cone (two spheres and the cone that touches both), stretched along its axes, fixed to one joint.
Round ends that meet at a joint stay closed however the joint bends, so no weight painting is needed.
"""

from dataclasses import dataclass

import numpy as np

from moveset.errors import InputError
from moveset.motion.rigs import roles
from moveset.motion.skeleton import Skeleton

Vector = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Part:
    """A round cone fixed to a joint.

    A point q of the round cone lies at ``frame @ q`` from the joint, in the joint's axes, metres.

    Args:
        joint: index of the joint it moves with.
        start, end: (3,) centres of the two spheres.
        radii: radii of the two spheres.
        frame: (3, 3) directions and stretch of its axes.
        tone: "left", "right", "trunk" or "face".
    """

    joint: int
    start: np.ndarray
    end: np.ndarray
    radii: tuple[float, float]
    frame: np.ndarray
    tone: str


# Sizes for a body whose legs (hip to ankle) measure this many metres; other bodies are scaled in proportion.
_LEG = 0.82094
_NO_SIZE = 1e-6  # of that: legs so short say nothing of a body
_FAR_BACK = -0.5  # cosine between a forearm and the way it points at rest in a body that faces +Z; where it hangs: 0
_TRUNK: tuple[tuple[str, Vector, Vector, tuple[float, float], Vector, str], ...] = (
    ("pelvis", (-0.060, -0.050, -0.02), (0.060, -0.050, -0.02), (0.096, 0.096), (1.0, 1.05, 1.06), "trunk"),
    ("pelvis", (0.0, -0.02, -0.01), (0.0, 0.14, -0.015), (0.108, 0.092), (1.36, 1.0, 1.0), "trunk"),
    ("spine1", (0.0, 0.01, 0.022), (0.0, 0.18, 0.030), (0.092, 0.108), (1.46, 1.0, 0.97), "trunk"),
    ("spine3", (0.0, -0.05, 0.008), (0.0, 0.085, -0.012), (0.104, 0.096), (1.52, 1.0, 1.06), "trunk"),
    ("spine3", (0.0, 0.10, -0.020), (0.0, 0.205, -0.030), (0.088, 0.052), (1.45, 1.0, 1.0), "trunk"),
    ("neck", (0.0, -0.03, -0.005), (0.0, 0.08, 0.030), (0.056, 0.052), (1.0, 1.0, 1.0), "trunk"),
    ("head", (0.0, 0.020, 0.030), (0.0, 0.070, 0.010), (0.082, 0.100), (0.88, 1.15, 1.06), "trunk"),
    ("head", (-0.035, 0.050, 0.084), (0.035, 0.050, 0.084), (0.034, 0.034), (1.0, 0.9, 1.0), "face"),
)


def human_body(skeleton: Skeleton) -> tuple[Part, ...]:
    """Parts of a mannequin for a skeleton with human roles and legs; for any other tree, one slim part per bone."""
    try:
        found = roles(skeleton)
    except InputError:
        return _bones(skeleton)
    rest = skeleton.rest_positions.numpy().astype(np.float64)
    place = {role: rest[j] for role, j in found.items()}
    legs = [
        np.linalg.norm(place[f"{side}_{end}"] - place[f"{side}_{start}"])
        for side in ("left", "right")
        for start, end in (("hip", "knee"), ("knee", "ankle"))
    ]
    size = float(sum(legs)) / 2 / _LEG
    if size < _NO_SIZE:
        return _bones(skeleton)
    parts = [
        _part(found[role], start, end, radii, np.diag(stretch), tone, size)
        for role, start, end, radii, stretch, tone in _TRUNK
        if role in found
    ]
    for side in ("left", "right"):
        parts += _side(side, found, place, size)
    return tuple(parts)


def _part(
    joint: int,
    start: Vector | np.ndarray,
    end: Vector | np.ndarray,
    radii: tuple[float, float],
    frame: np.ndarray,
    tone: str,
    size: float,
) -> Part:
    """A part from centres in the joint's axes, before ``frame`` stretches the spheres around them."""
    inverse = np.linalg.inv(frame)
    a, b = (size * (inverse @ np.asarray(v, dtype=np.float64)) for v in (start, end))
    return Part(joint, a, b, (size * radii[0], size * radii[1]), frame, tone)


def _turn(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(3, 3) shortest rotation from the level direction u to direction v, after half a turn about Y where v is nearer
    to opposite, as in a body that faces backward: so palms stay down. The identity where v has no length."""
    if (length := np.linalg.norm(v)) < 1e-9:
        return np.eye(3)
    u, v = u / np.linalg.norm(u), v / length
    if u @ v < _FAR_BACK:
        return _turn(-u, v) @ np.diag([-1.0, 1.0, -1.0])
    w = np.cross(u, v)
    skew = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    turn: np.ndarray = np.eye(3) + skew + skew @ skew / (1.0 + float(u @ v))
    return turn


def _side(side: str, found: dict[str, int], place: dict[str, np.ndarray], size: float) -> list[Part]:
    out = 1.0 if side == "left" else -1.0
    parts: list[Part] = []

    def limb(start: str, end: str, radii: tuple[float, float]) -> None:
        names = f"{side}_{start}", f"{side}_{end}"
        if all(name in place for name in names):
            reach = (place[names[1]] - place[names[0]]) / size
            parts.append(_part(found[names[0]], np.zeros(3), reach, radii, np.eye(3), side, size))

    limb("hip", "knee", (0.080, 0.056))
    limb("knee", "ankle", (0.055, 0.038))
    limb("collar", "shoulder", (0.052, 0.058))
    limb("shoulder", "elbow", (0.052, 0.039))
    limb("elbow", "wrist", (0.038, 0.028))

    if f"{side}_wrist" in place and f"{side}_elbow" in place:
        # The hand lies flat, palm down, where the arm is stretched out sideways; the thumb shows how the forearm turns.
        wrist = found[f"{side}_wrist"]
        turn = _turn(np.array([out, 0.0, 0.0]), place[f"{side}_wrist"] - place[f"{side}_elbow"])
        palm, tip = turn @ [0.03 * out, 0.0, 0.0], turn @ [0.125 * out, 0.0, 0.0]
        parts.append(_part(wrist, palm, tip, (0.036, 0.024), turn @ np.diag([1.0, 0.62, 1.1]), side, size))
        root, thumb = turn @ [0.03 * out, 0.0, 0.025], turn @ [0.075 * out, 0.0, 0.062]
        parts.append(_part(wrist, root, thumb, (0.018, 0.012), np.eye(3), side, size))

    ankle = place[f"{side}_ankle"]
    toe = place.get(f"{side}_foot", ankle + size * np.array([0.0, -0.064, 0.132]))
    reach = (toe - ankle) / size
    # The sole is as low as the toe joint: motions stand with their lowest joint on the floor.
    heel = np.array([0.0, reach[1] + 0.036, -0.045])
    ball = reach + np.array([0.0, 0.030, 0.0])
    foot = np.diag([1.18, 1.0, 1.0])
    parts.append(_part(found[f"{side}_ankle"], heel, ball, (0.036, 0.030), foot, side, size))
    parts.append(_part(found[f"{side}_ankle"], np.zeros(3), ball * 0.72, (0.040, 0.034), np.eye(3), side, size))
    owner = found.get(f"{side}_foot", found[f"{side}_ankle"])
    near = np.array([0.0, 0.030, 0.0]) + (0.0 if f"{side}_foot" in found else reach)
    far = near + np.array([0.0, -0.006, 0.062])
    parts.append(_part(owner, near, far, (0.030, 0.024), np.diag([1.30, 1.0, 1.0]), side, size))
    return parts


def _bones(skeleton: Skeleton) -> tuple[Part, ...]:
    """One part per bone, a tenth as thick as long."""
    sides = {j: tone for pair in skeleton.pairs for j, tone in zip(pair, ("left", "right"), strict=True)}
    parts = []
    for j, parent in enumerate(skeleton.parents):
        reach = skeleton.offsets[j].numpy().astype(np.float64)
        radius = float(np.clip(0.1 * np.linalg.norm(reach), 0.01, 0.05))
        tone = sides.get(j, "trunk")
        parts.append(_part(max(parent, 0), np.zeros(3), reach, (radius, 0.8 * radius), np.eye(3), tone, 1.0))
    return tuple(parts)
