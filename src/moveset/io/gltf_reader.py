"""Reading animations from glTF: ours exactly, others' sampled at a frame rate. F frames, J joints."""

import itertools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.io.bvh import ROUNDING, STRETCH, warn_of_stretch
from moveset.io.bvh_parser import meant_rate
from moveset.io.glb import Glb
from moveset.io.gltf_clip import Clip, read_clip
from moveset.io.gltf_nodes import Nodes, read_nodes, turn_of
from moveset.io.limits import MAX_FRAMES, MAX_JOINTS, MAX_POSES, plain_text
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.rigs import as_skeleton, name_after, roles
from moveset.motion.skeleton import Skeleton
from moveset.motion.units import bone_reach

_FRAMES = 11.5  # keys a second on a grid: as many, or more, are frames, of 12 a second in drawn films
_SPARSE = 30.0  # frames a second where keys are no frames
_DENSE = 250.0


def read_glb(path: str | Path, *, fps: float | None = None, animation: str | None = None) -> Motion:
    """An animation of a glTF file (.glb, .gltf, .vrma), on the skin that it moves most joints of.

    Files of ``write_glb`` come back exactly (up to the sign of quaternions). Others are sampled at ``fps``, by default
    the rate of their keys, or 30 and more where these are sparse, from the first key to the last. Their joints' axes
    are turned to be the world's in the bind pose; a still chain of joints above the one that moves ("Armature",
    "root") is folded into it, never further down than to the pelvis where names tell which joint that is
    (``rigs.roles``); bones keep one length, scale channels are ignored. Without a skin the nodes that are animated are
    the joints; in VRM animations those that are named as bones, by these names.

    Args:
        fps: frames per second at which curves are sampled.
        animation: its name, or number from 1; without it the first that moves.

    Raises:
        InputError: the file cannot be read.
        FormatError: damaged, data elsewhere, no such animation, or over the limits of ``io.limits``.
    """
    glb = Glb(path)
    nodes = read_nodes(glb)
    clip = read_clip(glb, animation)
    joints, bind = _read_joints(glb, nodes, clip)
    rig = _rig(glb, nodes, clip, joints)
    nodes.check(glb, rig.chains[0], itertools.chain(*rig.chains))
    times, rate = _instants(glb, clip, fps)
    if len(times) * sum(map(len, rig.chains)) > MAX_POSES:
        glb.fail(f"{len(times)} frames of {len(rig.joints)} joints exceed the limit; split the file")

    turned = {
        node: clip.rotation(glb, node, times, nodes.rotation[node])
        for node in {n for chain in rig.chains for n in chain}
    }
    axes = torch.stack([bind[joint] for joint in rig.joints]) if bind else _default_axes(nodes, rig)
    local = []
    for j, chain in enumerate(rig.chains):
        turn = turned[chain[0]]
        for node in chain[1:]:
            turn = rotations.mul(turn, turned[node])
        turn = turn if j == 0 else rotations.mul(axes[rig.parents[j]], turn)
        local.append(rotations.mul(turn, rotations.inv(axes[j])))
    root = torch.zeros(len(times), 3, dtype=torch.float64)
    for node in reversed(rig.chains[0]):
        shift = clip.translation(node, times, nodes.translation[node])
        root = shift + rotations.rotate(turned[node], nodes.scale[node] * root)
    offsets = _offsets(nodes, clip, rig, axes)
    # As far as they slide along one axis; the root's own path is no sliding.
    slides = [
        float(nodes.scale[nodes.path(chain[0])].prod()) * max(map(clip.moves, chain)) / 2 for chain in rig.chains[1:]
    ]
    warn_of_stretch(
        [nodes.names[n] for n in rig.joints], torch.tensor([0.0, *slides]), bone_reach(rig.parents, offsets)
    )
    skeleton = as_skeleton(_name(glb, path), tuple(nodes.names[n] for n in rig.joints), rig.parents, offsets.float())
    return Motion(torch.stack(local, dim=1).float(), root.float(), rate, skeleton)


def _read_joints(glb: Glb, nodes: Nodes, clip: Clip) -> tuple[list[int], dict[int, Tensor]]:
    """Joint nodes and, where a skin has bind matrices, the world rotation of each when bound."""
    if bones := vrm_bones(glb):
        for bone, node in bones.items():
            nodes.names[node] = bone
        return list(bones.values()), {}
    skins = [glb.entry("skins", k) for k in range(len(glb.items(glb.tree, "skins")))]

    def joints_of(skin: dict[str, Any]) -> list[int]:
        return [glb.index(j, len(nodes.parents), "nodes") for j in glb.items(skin, "joints")]

    skin = max(skins, key=lambda s: (len(clip.turns.keys() & {*joints_of(s)}), len(joints_of(s))), default=None)
    if skin is None or not {*nodes.under(clip.turns)} & {*joints_of(skin)}:
        return _animated_tree(glb, nodes, clip), {}
    joints = joints_of(skin)
    if len(joints) > MAX_JOINTS:  # of the skin that is read: others, of a face perhaps, may have as many as they want
        glb.fail(f"{len(joints)} joints of its skin exceed the limit of {MAX_JOINTS}; simplify the skeleton")
    if not joints or len(set(joints)) != len(joints):
        glb.fail("its skin lists no joints or one twice; it is damaged")
    if "inverseBindMatrices" not in skin:
        return joints, {}
    matrices = torch.from_numpy(glb.accessor(skin["inverseBindMatrices"], "MAT4")).reshape(-1, 4, 4)
    if len(matrices) < len(joints):
        glb.fail("it has fewer bind matrices than joints; it is damaged")
    # Stored by columns: the transpose of what is read by rows, and the inverse of a rotation is its transpose.
    return joints, {j: turn_of(glb, m[:3, :3]) for j, m in zip(joints, matrices, strict=False)}


def vrm_bones(glb: Glb) -> dict[str, int]:
    """Node of each bone of a VRM animation, by VRM's names; empty in other files."""
    found: Any = glb.tree
    for key in ("extensions", "VRMC_vrm_animation", "humanoid", "humanBones"):
        found = found.get(key) if isinstance(found, dict) else None
    if not isinstance(found, dict) or len(found) > MAX_JOINTS:
        return {}
    count = len(glb.items(glb.tree, "nodes"))
    nodes = [glb.index(bone.get("node") if isinstance(bone, dict) else None, count, "nodes") for bone in found.values()]
    if len(set(nodes)) < len(nodes):
        glb.fail("two of its bones are one node; it is damaged")
    return dict(zip((plain_text(name, 64) for name in found), nodes, strict=True))


def _animated_tree(glb: Glb, nodes: Nodes, clip: Clip) -> list[int]:
    """The lowest node that has all below it that turns, and the pelvis, and what is below; meshes and cameras are not.

    Of several trees the one with most that turns.
    """
    weights = nodes.sums(clip.turns)
    top = max((k for k, above in enumerate(nodes.parents) if above == -1), key=weights.__getitem__)
    tree = [n for n in nodes.under([top]) if n in clip.turns or not _hangs(glb, n)]
    place, marked = {node: k for k, node in enumerate(tree)}, {*clip.turns}
    if len(tree) <= 4 * MAX_JOINTS:
        pelvis = _pelvis(nodes, tree, (-1, *(place[nodes.parents[node]] for node in tree[1:])))
        marked |= {pelvis} if pelvis is not None else set()
    weights, root = nodes.sums(marked), top
    while root not in marked and (heavy := [c for c in nodes.children[root] if weights[c] == weights[top]]):
        root = heavy[0]
    below = {*nodes.under([root])}
    joints = sorted(n for n in tree if n in below)
    if len(joints) > MAX_JOINTS:
        glb.fail(f"{len(joints)} animated nodes exceed the limit of {MAX_JOINTS}; simplify the skeleton")
    return joints


def _pelvis(nodes: Nodes, joints: list[int], parents: tuple[int, ...]) -> int | None:
    """The node that plays the pelvis, where names tell."""
    names = tuple(nodes.names[joint] for joint in joints)
    try:
        return joints[roles(Skeleton("glTF", names, parents, torch.zeros(len(joints), 3)))["pelvis"]]
    except InputError:
        return None


def _hangs(glb: Glb, node: int) -> bool:
    """Whether a node is no joint but a mesh, camera or light at the end of the tree."""
    entry = glb.entry("nodes", node)
    return bool({"mesh", "camera", "extensions"} & entry.keys()) and not entry.get("children")


@dataclass(frozen=True)
class _Rig:
    """Chosen joints, root first: their nodes, parents, and the nodes from below the parent down to each."""

    joints: list[int]
    parents: tuple[int, ...]
    chains: list[list[int]]


def _rig(glb: Glb, nodes: Nodes, clip: Clip, joints: list[int]) -> _Rig:
    inside = set(joints)
    parent = {}
    for joint in joints:
        above = nodes.parents[joint]
        while above != -1 and above not in inside:
            above = nodes.parents[above]
        parent[joint] = above
    size = nodes.sums(joints)
    top = max((j for j in joints if parent[j] == -1), key=size.__getitem__)
    whole = _tree(glb, nodes, joints, parent, top)
    if len(whole.joints) == 1:
        return whole
    reach = bone_reach(whole.parents, _offsets(nodes, clip, whole, rotations.identity(len(whole.joints)).double()))

    def travels(joint: int, part: float = ROUNDING) -> bool:
        """Whether a joint moves within its parent by more than a part of the body's reach."""
        unit = nodes.scale[nodes.path(nodes.parents[joint])].prod()
        return float(unit) * clip.moves(joint) > part * reach

    root, way = top, _way_to_pelvis(nodes, whole, parent)
    if way is not None:
        # Not beyond the pelvis: folding down to a spine that travels, too, would lose the legs.
        root = next((joint for joint in way if 2 * size[joint] >= size[top] and travels(joint)), top)
    while way is None:
        # Fold downwards while all, or most, of an unknown body hangs on a child that travels by itself.
        below = [j for j in whole.joints if parent[j] == root]
        limit = ROUNDING if len(below) == 1 else STRETCH
        heavy = [j for j in below if 2 * size[j] >= size[root] and travels(j, limit)]
        if not heavy:
            break
        root = heavy[0]
    return _tree(glb, nodes, joints, parent, root)


def _way_to_pelvis(nodes: Nodes, whole: _Rig, parent: dict[int, int]) -> list[int] | None:
    """Joints from the one that plays the pelvis up to just below the root; None where none is known to play it."""
    joint = _pelvis(nodes, whole.joints, whole.parents)
    if joint is None:
        return None
    way = []
    while joint != whole.joints[0]:
        way.append(joint)
        joint = parent[joint]
    return way


def _tree(glb: Glb, nodes: Nodes, joints: list[int], parent: dict[int, int], root: int) -> _Rig:
    below = {*nodes.under([root])}
    order = [j for j in joints if j in below]
    place = {j: k for k, j in enumerate(order)}
    if order[0] != root or any(place[parent[j]] >= place[j] for j in order[1:]):
        order = sorted(order, key=lambda j: nodes.depth[j])
        place = {j: k for k, j in enumerate(order)}
    chains = [nodes.path(root)] + [nodes.path(j, parent[j]) for j in order[1:]]
    if sum(map(len, chains)) > 4 * MAX_JOINTS:
        glb.fail(f"more than {4 * MAX_JOINTS} nodes lie between its joints; simplify the skeleton")
    return _Rig(order, (-1, *(place[parent[j]] for j in order[1:])), chains)


def _default_axes(nodes: Nodes, rig: _Rig) -> Tensor:
    """World rotations (J, 4) of the joints as the nodes stand, for skins without bind matrices."""
    axes: list[Tensor] = []
    for j, chain in enumerate(rig.chains):
        turn = axes[rig.parents[j]] if j else rotations.identity().double()
        for node in chain:
            turn = rotations.mul(turn, nodes.rotation[node])
        axes.append(turn)
    return torch.stack(axes)


def _offsets(nodes: Nodes, clip: Clip, rig: _Rig, axes: Tensor) -> Tensor:
    """(J, 3) rest offsets in world axes, metres."""
    offsets = torch.zeros(len(rig.joints), 3, dtype=torch.float64)
    size: list[Tensor] = []
    for j, chain in enumerate(rig.chains):
        place = torch.zeros(3, dtype=torch.float64)
        for node in reversed(chain):
            shift = clip.mean_translation(node, nodes.translation[node])
            place = shift + rotations.rotate(nodes.rotation[node], nodes.scale[node] * place)
        if j:
            offsets[j] = rotations.rotate(axes[rig.parents[j]], size[rig.parents[j]] * place)
        size.append((size[rig.parents[j]] if j else 1.0) * nodes.scale[chain].prod())
    return offsets


def _instants(glb: Glb, clip: Clip, fps: float | None) -> tuple[Tensor, float]:
    """Times (F,) at which to sample, seconds, and their rate: the first key's to the last one's."""
    clocks = {id(channel.keys): channel.keys for channel in (*clip.turns.values(), *clip.shifts.values())}
    start = min(float(keys[0]) for keys in clocks.values())
    length = max(float(keys[-1]) for keys in clocks.values()) - start
    stated = _stated_rate(glb)
    rate = fps or stated or _rate([keys - start for keys in clocks.values()])
    if length * rate >= MAX_FRAMES:
        glb.fail(f"{length * rate:.0f} frames exceed the limit of {MAX_FRAMES}; split the file")
    count = _count(length, rate, stated)
    return (start + torch.arange(count, dtype=torch.float64) / rate).clamp(max=start + length), rate


def _count(length: float, rate: float, stated: float | None) -> int:
    """Instants within ``length`` seconds, and one behind them for an end that lies between two.

    Where keys are frames, at the rate that a file of ours states, nothing is between two of them and behind the last:
    as many as ``Motion.resampled`` makes of them.
    """
    # Times are float32, so a last key at a frame's own time may lie behind it by a little.
    if stated and abs(length * stated - round(length * stated)) < 0.02:
        return math.floor(round(length * stated) / stated * rate + 1e-6) + 1
    return math.ceil(length * rate - 0.02) + 1


def _rate(clocks: list[Tensor]) -> float:
    """The rate of the grid that keys lie on, or a multiple of it.

    Editors and optimisers leave out keys where little happens: what happens between two of them is then only in the
    curve, so keys that are sparse are not taken for frames.
    """
    keys = torch.cat(clocks).unique()
    if len(keys) < 2:
        return _SPARSE
    for gap in (float(keys.diff().median()), float(keys.diff().min())):
        # Over the whole length the rounding of float32 does not matter.
        rate = max(round(float(keys[-1] / _longer(keys, max(gap, 1e-4)))), 1) / float(keys[-1])
        beside = (keys * rate - (keys * rate).round()).abs()
        if bool((beside < 0.02 + 1e-6 * keys * rate).all()) and rate < _DENSE:
            rate = rate if rate > _FRAMES else rate * math.ceil(_SPARSE / rate - 1e-3)
            return meant_rate(rate, 0.01)
    return float(min(max(_SPARSE, round(1.0 / float(keys.diff().median()))), 120))


def _longer(keys: Tensor, gap: float) -> float:
    """A gap of the grid that keys (K,) from 0 on lie on, measured over ever longer stretches of them: what float32 adds
    to a single gap is whole frames after a quarter of an hour."""
    frames = 8.0
    while frames * gap < float(keys[-1]):
        if (end := float(keys[keys <= frames * gap][-1])) > 0.0:
            gap = end / max(round(end / gap), 1)
        frames *= 8.0
    return gap


def _stated_rate(glb: Glb) -> float | None:
    """The rate of the frames in a file of ours; None in others."""
    stated = _own(glb).get("fps")
    return float(stated) if isinstance(stated, int | float) and 0.01 <= stated <= 1000 else None


def _own(glb: Glb) -> dict[str, Any]:
    """What ``write_glb`` put into ``asset.extras.moveset``; empty for others' files."""
    found: Any = glb.tree
    for key in ("asset", "extras", "moveset"):
        found = found.get(key) if isinstance(found, dict) else None
    return found if isinstance(found, dict) else {}


def _name(glb: Glb, path: str | Path) -> str:
    name = _own(glb).get("skeleton")
    return plain_text(name, 64) if isinstance(name, str) else name_after(Path(path))


def glb_metadata(path: str | Path) -> dict[str, Any]:
    """The metadata that ``write_glb`` stored, frame rate and skeleton name included.

    Raises:
        InputError, FormatError: as ``read_glb``.
    """
    return _own(Glb(path))
