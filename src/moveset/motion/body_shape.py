"""Which joint plays which role where names say nothing: a humanoid tree has two like legs, two like arms and a head.

The tree is taken at rest; left and right are told by where the toes point.
"""

import itertools

import torch
from torch import Tensor

from moveset.motion.skeleton import Skeleton

_ALIKE = 0.15  # legs, or arms, differ less in length
_FOLDED = 0.5  # cosine: between trunk and legs of a body that stands, rather than on all fours
_FORKS = 60  # joints with several children: more have no human bodies
_TINY = 1e-6


def body_shape(skeleton: Skeleton) -> dict[str, int] | None:
    """Role -> joint by the shape of the tree at rest; None where it is none of a human body, or left could be right."""
    tree = _Tree(skeleton)
    forks = [j for j, below in enumerate(skeleton.children) if len(below) > 1]
    if len(forks) > _FORKS:
        return None
    best: tuple[float, dict[str, int]] | None = None
    for pelvis in forks:
        for chest in tree.below(pelvis, forks):
            found = tree.body(pelvis, chest)
            if found is not None and (best is None or found[0] > best[0]):
                best = found
    return None if best is None else best[1]


class _Tree:
    def __init__(self, skeleton: Skeleton) -> None:
        self.skeleton = skeleton
        self.rest = skeleton.rest_positions.double()
        self.length = skeleton.offsets.double().norm(dim=-1).tolist()
        self.chains: dict[int, list[int]] = {}
        for j in reversed(range(len(skeleton))):
            # The longest way down from a joint, the joint included.
            below = [self.chains[c] for c in skeleton.children[j]]
            self.chains[j] = [j, *max(below, key=self.reach, default=[])]

    def reach(self, chain: list[int]) -> float:
        return sum(self.length[j] for j in chain)

    def below(self, joint: int, candidates: list[int]) -> list[int]:
        inside = {joint}
        for j, parent in enumerate(self.skeleton.parents):
            if parent in inside:
                inside.add(j)
        return [j for j in candidates if j in inside and j != joint]

    def body(self, pelvis: int, chest: int) -> tuple[float, dict[str, int]] | None:
        """Size of the body whose legs meet in one joint and whose arms meet in another, and its roles."""
        way = [chest]
        while way[0] != pelvis:
            way.insert(0, self.skeleton.parents[way[0]])
        legs = self._alike([c for c in self.skeleton.children[pelvis] if c != way[1]], 3)
        arms = self._alike(list(self.skeleton.children[chest]), 3)
        if legs is None or arms is None:
            return None
        others = [c for c in self.skeleton.children[chest] if c not in (arms[0][0], arms[1][0])]
        head = max((self.chains[c] for c in others), key=self.reach, default=[])
        trunk = self.reach(way[1:])
        if not self.reach(legs[0]) > max(0.8 * trunk, self.reach(head)) or trunk < _TINY:
            return None
        left = self._left(pelvis, chest, legs)
        if left is None:
            return None
        spine = way[1:]
        roles = {"pelvis": pelvis, "spine3": spine[-1]}
        if len(spine) > 1:
            roles["spine1"] = spine[0]
        if len(spine) > 2:
            roles["spine2"] = spine[len(spine) // 2]
        if head:
            roles["neck" if len(head) > 1 else "head"] = head[0]
            if len(head) > 1:
                roles["head"] = head[1]
        for pair, fill in ((legs, self._leg), (arms, self._arm)):
            ends = [self.rest[chain[1]] @ left for chain in pair]
            order = (0, 1) if ends[0] > ends[1] else (1, 0)
            for side, k in zip(("left", "right"), order, strict=True):
                roles |= {f"{side}_{part}": j for part, j in fill(pair[k]).items()}
        return trunk + 2 * self.reach(legs[0]) + 2 * self.reach(arms[0]), roles

    def _alike(self, starts: list[int], joints: int) -> tuple[list[int], list[int]] | None:
        """The two longest ways down from different joints that are like each other."""
        chains = [self._without_doubles(self.chains[c]) for c in starts]
        pairs = [
            (a, b) for a, b in itertools.combinations(chains, 2)
            if min(len(a), len(b)) >= joints
            and abs(self.reach(a) - self.reach(b)) < _ALIKE * max(self.reach(a), _TINY)
        ]  # fmt: skip
        return max(pairs, key=lambda pair: self.reach(pair[0]) + self.reach(pair[1]), default=None)

    def _without_doubles(self, chain: list[int]) -> list[int]:
        """Without joints that sit where their only child sits."""
        keep = [j for j, below in itertools.pairwise(chain) if self.length[below] > _TINY]
        return [*keep, chain[-1]]

    def _leg(self, chain: list[int]) -> dict[str, int]:
        """Thigh and shin are the two longest neighbours."""
        bones = [self.length[j] for j in chain]
        knee = max(range(1, len(chain) - 1), key=lambda k: bones[k] + bones[k + 1])
        parts = {"hip": knee - 1, "knee": knee, "ankle": knee + 1, "foot": knee + 2}
        return {part: chain[k] for part, k in parts.items() if k < len(chain)}

    def _arm(self, chain: list[int]) -> dict[str, int]:
        found = self._leg(chain)
        shoulder = chain.index(found["hip"])
        parts = {"shoulder": found["hip"], "elbow": found["knee"], "wrist": found["ankle"]}
        return parts | ({"collar": chain[shoulder - 1]} if shoulder else {})

    def _left(self, pelvis: int, chest: int, legs: tuple[list[int], list[int]]) -> Tensor | None:
        """The left of the body at rest; None where legs do not hang below the trunk or nothing points ahead."""
        found = [self._leg(chain) for chain in legs]
        if any("foot" not in leg for leg in found):
            return None
        up = torch.nn.functional.normalize(self.rest[chest] - self.rest[pelvis], dim=0)
        down = sum((self.rest[leg["ankle"]] - self.rest[leg["hip"]] for leg in found), torch.zeros(3).double())
        ahead = sum((self.rest[leg["foot"]] - self.rest[leg["ankle"]] for leg in found), torch.zeros(3).double())
        ahead = ahead - (ahead @ up) * up
        if float(torch.nn.functional.normalize(down, dim=0) @ up) > -_FOLDED or float(ahead.norm()) < _TINY:
            return None
        return torch.nn.functional.normalize(torch.linalg.cross(up, ahead), dim=0)
