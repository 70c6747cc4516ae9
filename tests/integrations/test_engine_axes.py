"""The table of axes in docs/integrations.md: a body posed by it stands in an engine where moveset's does here."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from moveset.motion.skeleton import HML22
from tests.motions import wander

DOCS = Path(__file__).resolve().parents[2] / "docs" / "integrations.md"
ROW = re.compile(
    r"^\| (?P<engine>[^|]+) \| (?P<hand>left|right), (?P<up>\S+), (?P<front>\S+) \| `\((?P<v>[^)]+)\)` "
    r"\| `\((?P<q>[^)]+)\)` \| (?P<unit>\d+) \|$",
    re.MULTILINE,
)
TABLE = {match["engine"]: match for match in ROW.finditer(DOCS.read_text())}
AXES = dict(zip("XYZ", np.eye(3), strict=True))


def mapping(words):
    """The matrix of "(-x, z, y)"."""
    matrix = np.zeros((len(words), len(words)))
    for i, word in enumerate(words):
        matrix[i, "xyzw".index(word[-1])] = -1.0 if word.startswith("-") else 1.0
    return matrix


def direction(word):
    """The unit vector of "+Z", "Y" or "−Y"."""
    return AXES[word[-1]] * (-1.0 if word[0] in "-−" else 1.0)


def hamilton(a, b):
    """Product of quaternions x y z w, as every engine here has it, whatever its handedness."""
    u, v = a[..., :3], b[..., :3]
    vector = a[..., 3:] * v + b[..., 3:] * u + np.cross(u, v)
    return np.concatenate((vector, a[..., 3:] * b[..., 3:] - (u * v).sum(-1, keepdims=True)), axis=-1)


def turned(q, v):
    """q v q*."""
    pure = np.concatenate((np.broadcast_to(v, (*q.shape[:-1], 3)), np.zeros((*q.shape[:-1], 1))), axis=-1)
    return hamilton(hamilton(q, pure), q * (-1, -1, -1, 1))[..., :3]


def forward(local, root, offsets):
    """World rotations and positions, as an engine's scene graph finds them."""
    world, place = [local[:, 0]], [root]
    for j, parent in enumerate(HML22.parents[1:], start=1):
        place.append(place[parent] + turned(world[parent], offsets[j]))
        world.append(hamilton(world[parent], local[:, j]))
    return np.stack(world, axis=1), np.stack(place, axis=1)


def test_the_table_names_the_engines():
    assert len(TABLE) == 6
    assert [sum(name in engine for engine in TABLE) for name in ("Unity", "Unreal", "Godot", "Blender")] == [1, 2, 1, 1]


@pytest.mark.parametrize("engine", TABLE)
def test_a_body_stands_in_the_engine_as_here(engine):
    row = TABLE[engine]
    place, turn, unit = mapping(row["v"].split(", ")), mapping(row["q"].split(", ")), float(row["unit"])
    assert np.linalg.det(place) == (1.0 if row["hand"] == "right" else -1.0)
    assert np.array_equal(place @ (0, 1, 0), direction(row["up"]))
    assert np.array_equal(place @ (0, 0, 1), direction(row["front"]))
    # In a left-handed world, right is where up x front points; in a right-handed one that is left.
    left = np.cross(direction(row["up"]), direction(row["front"])) * np.linalg.det(place)
    assert np.array_equal(place @ (1, 0, 0), left)

    motion = wander(30, seed=6, bend=0.8, turn=2.0)
    local = motion.rotations.double().numpy() @ turn.T
    root = unit * motion.root.double().numpy() @ place.T
    _, seen = forward(local, root, unit * HML22.offsets.double().numpy() @ place.T)
    assert np.abs(seen - unit * motion.joints.double().numpy() @ place.T).max() < 1e-5 * unit
    # And by matrices: R' = M R M⁻¹.
    whole = Rotation.from_quat(local.reshape(-1, 4)).as_matrix()
    wanted = place @ Rotation.from_quat(motion.rotations.double().numpy().reshape(-1, 4)).as_matrix() @ place.T
    assert np.abs(whole - wanted).max() < 1e-6


def test_forgetting_to_reverse_the_axis_is_noticed():
    """The usual mistake, mirroring the quaternion's vector like a position, gives another motion."""
    motion = wander(30, seed=6, bend=0.8)
    place = np.diag((-1.0, 1.0, 1.0))
    local = motion.rotations.double().numpy() * (-1, 1, 1, 1)
    _, seen = forward(local, motion.root.double().numpy() @ place.T, HML22.offsets.double().numpy() @ place.T)
    assert np.abs(seen - motion.joints.double().numpy() @ place.T).max() > 0.1


def test_bones_with_axes_of_their_own():
    """local = b · B⁻¹ · L · B: the bones' world rotations are G · B, whatever B."""
    motion = wander(10, seed=9, bend=0.8)
    rest = Rotation.random(len(HML22), rng=np.random.default_rng(2)).as_quat()
    back = rest * (-1, -1, -1, 1)
    parents = np.array(HML22.parents)
    own = np.where((parents < 0)[:, None], rest, hamilton(back[parents], rest))
    local = hamilton(own, hamilton(hamilton(back, motion.rotations.double().numpy()), rest))
    world = [local[:, 0]]
    for j, parent in enumerate(HML22.parents[1:], start=1):
        world.append(hamilton(world[parent], local[:, j]))
    wanted = hamilton(motion.global_rotations.double().numpy(), rest)
    assert np.abs((np.stack(world, axis=1) * wanted).sum(-1)).min() > 1 - 1e-6
