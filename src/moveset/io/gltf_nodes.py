"""The tree of a glTF file's nodes and how they stand. N nodes."""

from collections.abc import Iterable
from dataclasses import dataclass

import torch
from torch import Tensor

from moveset.io.glb import MAX_NODES, Glb
from moveset.io.gltf_clip import unit_quaternions
from moveset.io.limits import MAX_JOINT_NAME, plain_text
from moveset.motion import rotations


@dataclass(frozen=True, eq=False)
class Nodes:
    """The node tree: parents (-1 at the top), rest transforms (N, …) float64 with one scale a node.

    ``mirrored`` (or sheared) and ``uneven`` are numbers of nodes whose transform one scale does not say.
    """

    names: list[str]
    parents: list[int]
    children: list[list[int]]
    depth: list[int]
    translation: Tensor
    rotation: Tensor
    scale: Tensor
    mirrored: set[int]
    uneven: set[int]

    def under(self, some: Iterable[int]) -> list[int]:
        """Some nodes and all below them, each once; of one tree parents before children."""
        out = dict.fromkeys(some)
        queue = [*out]
        for node in queue:
            fresh = [child for child in self.children[node] if child not in out]
            out |= dict.fromkeys(fresh)
            queue += fresh
        return [*out]

    def sums(self, some: Iterable[int]) -> list[int]:
        """How many of some nodes each node has at and below itself."""
        out = [0] * len(self.parents)
        for node in some:
            out[node] += 1
        for node in sorted(range(len(out)), key=self.depth.__getitem__, reverse=True):
            if self.parents[node] != -1:
                out[self.parents[node]] += out[node]
        return out

    def path(self, node: int, stop: int = -1) -> list[int]:
        """Nodes from just below ``stop`` (or the top) down to ``node``."""
        out = []
        while node not in (stop, -1):
            out.append(node)
            node = self.parents[node]
        return out[::-1]

    def check(self, glb: Glb, above: Iterable[int], joints: Iterable[int]) -> None:
        """Raises FormatError where the nodes down to the root or below it make another body of it than bones can be.

        A joint below that stretches unevenly squashes little: its bones keep their mean length.
        """
        above = {*above}
        if wrong := (above & self.uneven) | ((above | {*joints}) & self.mirrored):
            name = self.names[min(wrong)]
            glb.fail(f"its node {name!r} mirrors, shears or stretches unevenly; apply all transforms and export again")


def read_nodes(glb: Glb) -> Nodes:
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
    names = [plain_text(entry.get("name", ""), MAX_JOINT_NAME) for entry in entries]
    names = [name or f"node_{k}" for k, name in enumerate(names)]
    translation, rotation, scale = torch.zeros(count, 3), rotations.identity(count), torch.ones(count)
    translation, rotation, scale = translation.double(), rotation.double(), scale.double()
    mirrored, uneven = set[int](), set[int]()
    for k, entry in enumerate(entries):
        if "matrix" in entry:
            matrix = torch.from_numpy(glb.vector(entry, "matrix", (0.0,) * 16)).reshape(4, 4).T
            translation[k], sizes = matrix[:3, 3], matrix[:3, :3].norm(dim=0)
            turn = matrix[:3, :3] / sizes.clamp_min(1e-12)
            if _turns(turn):
                rotation[k] = rotations.from_matrix(turn)
            else:
                mirrored.add(k)
        else:
            translation[k] = torch.from_numpy(glb.vector(entry, "translation", (0.0, 0.0, 0.0)))
            rotation[k] = unit_quaternions(glb, torch.from_numpy(glb.vector(entry, "rotation", (0.0, 0.0, 0.0, 1.0))))
            sizes = torch.from_numpy(glb.vector(entry, "scale", (1.0, 1.0, 1.0)))
            if (sizes < 0).any():
                mirrored.add(k)
        scale[k] = sizes.mean()
        if sizes.max() - sizes.min() > _EVEN * sizes.max():
            uneven.add(k)
    return Nodes(names, parents, children, depth, translation, rotation, scale, mirrored, uneven)


def turn_of(glb: Glb, matrix: Tensor) -> Tensor:
    """Rotation (4,) of a (3, 3) matrix."""
    turn = matrix / matrix.norm(dim=0).mean().clamp_min(1e-12)
    if not _turns(turn):
        glb.fail("a bind matrix mirrors, shears or stretches unevenly; apply all transforms and export again")
    return rotations.from_matrix(turn)


_EVEN = 0.02  # of a size, between axes


def _turns(matrix: Tensor) -> bool:
    return bool((matrix.T @ matrix - torch.eye(3).double()).abs().max() <= _EVEN and torch.linalg.det(matrix) > 0)
