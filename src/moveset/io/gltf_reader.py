"""Reading a skinned animation from GLB: ours exactly, others' sampled at a frame rate. F frames, J joints, N nodes."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.io.bvh import ROUNDING, STRETCH, bone_reach
from moveset.io.glb import MAX_NODES, Glb
from moveset.io.gltf_clip import Clip, read_clip, unit_quaternions
from moveset.io.limits import MAX_FRAMES, MAX_JOINTS, MAX_POSES
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.rigs import as_skeleton, name_after, roles
from moveset.motion.skeleton import Skeleton


def read_glb(path: str | Path, *, fps: float | None = None) -> Motion:
    """The first animation of a GLB file, on its largest skin.

    Files of ``write_glb`` come back exactly (up to the sign of quaternions). Others are sampled at ``fps``, by default
    the rate of their keys. Their joints' axes are turned to be the world's in the bind pose; a still chain of joints
    above the one that moves ("Armature", "root") is folded into it, never further down than to the pelvis where names
    tell which joint that is (``rigs.roles``); bones keep one length, scale channels are ignored.

    Raises:
        InputError: the file cannot be read.
        FormatError: damaged, external data, no skin or animation, or over the limits of ``io.limits``.
    """
    glb = Glb(path)
    nodes = _read_nodes(glb)
    clip = read_clip(glb)
    joints, bind = _read_skin(glb, nodes)
    rig = _rig(glb, nodes, clip, joints)
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
    skeleton = as_skeleton(_name(glb, path), tuple(nodes.names[n] for n in rig.joints), rig.parents, offsets.float())
    return Motion(torch.stack(local, dim=1).float(), root.float(), rate, skeleton)


@dataclass(frozen=True, eq=False)
class _Nodes:
    """The node tree: parents (-1 at the top), rest transforms (N, …) float64 with one scale a node."""

    names: list[str]
    parents: list[int]
    depth: list[int]
    translation: Tensor
    rotation: Tensor
    scale: Tensor

    def path(self, node: int, stop: int = -1) -> list[int]:
        """Nodes from just below ``stop`` (or the top) down to ``node``."""
        out = []
        while node not in (stop, -1):
            out.append(node)
            node = self.parents[node]
        return out[::-1]


def _read_nodes(glb: Glb) -> _Nodes:
    entries = [glb.entry("nodes", k) for k in range(len(glb.items(glb.tree, "nodes", MAX_NODES)))]
    count = len(entries)
    parents, depth = [-1] * count, [-1] * count
    children = []
    for k, entry in enumerate(entries):
        children.append([glb.index(c, count, "nodes") for c in glb.items(entry, "children")])
        for child in children[-1]:
            if parents[child] != -1:
                glb.fail(f"node {child} has two parents; it is damaged")
            parents[child] = k
    queue = [k for k in range(count) if parents[k] == -1]
    for k in queue:
        depth[k] = 0
    for k in queue:
        for child in children[k]:
            depth[child] = depth[k] + 1
            queue.append(child)
    if len(queue) < count:
        glb.fail("its nodes form a cycle; it is damaged")
    names = [str(entry.get("name", ""))[:256] or f"node_{k}" for k, entry in enumerate(entries)]
    translation, rotation, scale = torch.zeros(count, 3), rotations.identity(count), torch.ones(count)
    translation, rotation, scale = translation.double(), rotation.double(), scale.double()
    for k, entry in enumerate(entries):
        if "matrix" in entry:
            matrix = torch.from_numpy(glb.vector(entry, "matrix", (0.0,) * 16)).reshape(4, 4).T
            rotation[k], scale[k] = _turn_and_size(glb, matrix[:3, :3])
            translation[k] = matrix[:3, 3]
        else:
            translation[k] = torch.from_numpy(glb.vector(entry, "translation", (0.0, 0.0, 0.0)))
            rotation[k] = unit_quaternions(glb, torch.from_numpy(glb.vector(entry, "rotation", (0.0, 0.0, 0.0, 1.0))))
            scale[k] = float(glb.vector(entry, "scale", (1.0, 1.0, 1.0)).mean())
    return _Nodes(names, parents, depth, translation, rotation, scale)


def _turn_and_size(glb: Glb, matrix: Tensor) -> tuple[Tensor, Tensor]:
    """Rotation (4,) and scale () of a (3, 3) matrix."""
    size = matrix.norm(dim=0).mean()
    turn = matrix / size.clamp_min(1e-12)
    if size < 1e-9 or (turn.T @ turn - torch.eye(3).double()).abs().max() > 0.02 or torch.linalg.det(turn) < 0:
        glb.fail("a matrix mirrors, shears or stretches unevenly; apply all transforms and export again")
    return rotations.from_matrix(turn), size


def _read_skin(glb: Glb, nodes: _Nodes) -> tuple[list[int], dict[int, Tensor]]:
    """Joint nodes of the largest skin and, where it has bind matrices, the world rotation of each when bound."""
    count = len(nodes.parents)
    skins = [glb.entry("skins", k) for k in range(len(glb.items(glb.tree, "skins")))]
    if not skins:
        glb.fail("it has no skin, so no joints; export the character with its armature")
    skin = max(skins, key=lambda s: len(glb.items(s, "joints")))
    joints = [glb.index(j, count, "nodes") for j in glb.items(skin, "joints", MAX_JOINTS)]
    if not joints or len(set(joints)) != len(joints):
        glb.fail("its skin lists no joints or one twice; it is damaged")
    if "inverseBindMatrices" not in skin:
        return joints, {}
    matrices = torch.from_numpy(glb.accessor(skin["inverseBindMatrices"], "MAT4")).reshape(-1, 4, 4)
    if len(matrices) < len(joints):
        glb.fail("it has fewer bind matrices than joints; it is damaged")
    # Stored by columns: the transpose of what is read by rows, and the inverse of a rotation is its transpose.
    return joints, {j: _turn_and_size(glb, m[:3, :3])[0] for j, m in zip(joints, matrices, strict=False)}


@dataclass(frozen=True)
class _Rig:
    """Chosen joints, root first: their nodes, parents, and the nodes from below the parent down to each."""

    joints: list[int]
    parents: tuple[int, ...]
    chains: list[list[int]]


def _rig(glb: Glb, nodes: _Nodes, clip: Clip, joints: list[int]) -> _Rig:
    inside = set(joints)
    parent = {}
    for joint in joints:
        above = nodes.parents[joint]
        while above != -1 and above not in inside:
            above = nodes.parents[above]
        parent[joint] = above
    size = dict.fromkeys(joints, 1)
    for joint in sorted(joints, key=lambda j: -nodes.depth[j]):
        if parent[joint] != -1:
            size[parent[joint]] += size[joint]
    top = max((j for j in joints if parent[j] == -1), key=lambda j: size[j])
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


def _way_to_pelvis(nodes: _Nodes, whole: _Rig, parent: dict[int, int]) -> list[int] | None:
    """Joints from the one that plays the pelvis up to just below the root; None where none is known to play it."""
    count = len(whole.joints)
    names = tuple(nodes.names[joint] for joint in whole.joints)
    try:
        joint = whole.joints[roles(Skeleton("glTF", names, whole.parents, torch.zeros(count, 3)))["pelvis"]]
    except InputError:
        return None
    way = []
    while joint != whole.joints[0]:
        way.append(joint)
        joint = parent[joint]
    return way


def _tree(glb: Glb, nodes: _Nodes, joints: list[int], parent: dict[int, int], root: int) -> _Rig:
    """The joints below a root."""
    chosen = {root}
    for joint in sorted(joints, key=lambda j: nodes.depth[j]):
        if parent[joint] in chosen:
            chosen.add(joint)
    order = [j for j in joints if j in chosen]
    place = {j: k for k, j in enumerate(order)}
    if order[0] != root or any(place[parent[j]] >= place[j] for j in order[1:]):
        order = sorted(order, key=lambda j: nodes.depth[j])
        place = {j: k for k, j in enumerate(order)}
    chains = [nodes.path(root)] + [nodes.path(j, parent[j]) for j in order[1:]]
    if sum(map(len, chains)) > 4 * MAX_JOINTS:
        glb.fail(f"more than {4 * MAX_JOINTS} nodes lie between its joints; simplify the skeleton")
    return _Rig(order, (-1, *(place[parent[j]] for j in order[1:])), chains)


def _default_axes(nodes: _Nodes, rig: _Rig) -> Tensor:
    """World rotations (J, 4) of the joints as the nodes stand, for skins without bind matrices."""
    axes: list[Tensor] = []
    for j, chain in enumerate(rig.chains):
        turn = axes[rig.parents[j]] if j else rotations.identity().double()
        for node in chain:
            turn = rotations.mul(turn, nodes.rotation[node])
        axes.append(turn)
    return torch.stack(axes)


def _offsets(nodes: _Nodes, clip: Clip, rig: _Rig, axes: Tensor) -> Tensor:
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
    """Times (F,) at which to sample, seconds, and their rate."""
    clocks = [keys for keys, _, _ in (*clip.turns.values(), *clip.shifts.values())]
    start, end = min(float(k[0]) for k in clocks), max(float(k[-1]) for k in clocks)
    rate = fps or _rate(glb, clocks)
    if (end - start) * rate >= MAX_FRAMES:
        glb.fail(f"{(end - start) * rate:.0f} frames exceed the limit of {MAX_FRAMES}; split the file")
    count = round((end - start) * rate) + 1
    return (start + torch.arange(count, dtype=torch.float64) / rate).clamp(max=end), rate


def _rate(glb: Glb, clocks: list[Tensor]) -> float:
    """The rate that the file states if it is ours, else that of the densest keys."""
    stated = _own(glb).get("fps")
    if isinstance(stated, int | float) and 0.01 <= stated <= 1000:
        return float(stated)
    longest = max(clocks, key=len)
    rate = min(max(1.0 / float(longest.diff().median()), 1.0), 240.0) if len(longest) > 1 else 30.0
    return float(round(rate)) if abs(rate - round(rate)) < 0.01 * rate else rate


def _own(glb: Glb) -> dict[str, Any]:
    """What ``write_glb`` put into ``asset.extras.moveset``; empty for others' files."""
    found: Any = glb.tree
    for key in ("asset", "extras", "moveset"):
        found = found.get(key) if isinstance(found, dict) else None
    return found if isinstance(found, dict) else {}


def _name(glb: Glb, path: str | Path) -> str:
    name = _own(glb).get("skeleton")
    return name[:64] if isinstance(name, str) else name_after(Path(path))


def glb_metadata(path: str | Path) -> dict[str, Any]:
    """The metadata that ``write_glb`` stored, frame rate and skeleton name included.

    Raises:
        InputError, FormatError: as ``read_glb``.
    """
    return _own(Glb(path))
