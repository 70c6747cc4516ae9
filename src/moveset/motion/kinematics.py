"""Forward kinematics and local/global rotations. J joints; leading dimensions (frames, batch) are free."""

import torch
from torch import Tensor

from moveset.motion import rotations
from moveset.motion.skeleton import Skeleton


def fk(local: Tensor, root: Tensor, skeleton: Skeleton) -> tuple[Tensor, Tensor]:
    """Global rotations and joint positions.

    Args:
        local: (..., J, 4) local rotations, xyzw.
        root: (..., 3) world position of the root joint, metres.

    Returns:
        global rotations (..., J, 4) and joint positions (..., J, 3).
    """
    offsets = skeleton.offsets.to(local)
    turned: list[Tensor] = [local[..., 0, :]]
    placed: list[Tensor] = [root]
    for j, p in enumerate(skeleton.parents[1:], start=1):
        turned.append(rotations.mul(turned[p], local[..., j, :]))
        placed.append(placed[p] + rotations.rotate(turned[p], offsets[j]))
    return torch.stack(turned, dim=-2), torch.stack(placed, dim=-2)


def fk_matrices(local: Tensor, root: Tensor, skeleton: Skeleton) -> Tensor:
    """Joint positions (..., J, 3) from local rotation matrices (..., J, 3, 3): few large operations, for losses."""
    offsets = skeleton.offsets.to(local)
    turned = local[..., :1, :, :]
    placed = root[..., None, :]
    position = {0: 0}
    all_placed = [placed]
    for above, level in zip(skeleton.levels, skeleton.levels[1:], strict=False):
        place = {j: k for k, j in enumerate(above)}
        parents = [place[skeleton.parents[j]] for j in level]
        up = turned[..., parents, :, :]
        placed = placed[..., parents, :] + (up @ offsets[list(level)][..., None])[..., 0]
        turned = up @ local[..., list(level), :, :]
        position.update({j: len(position) + k for k, j in enumerate(level)})
        all_placed.append(placed)
    return torch.cat(all_placed, dim=-2)[..., [position[j] for j in range(len(skeleton))], :]


def global_to_local(turned: Tensor, skeleton: Skeleton) -> Tensor:
    """Local rotations (..., J, 4) of global ones."""
    parents = list(skeleton.parents[1:])
    local = rotations.mul(rotations.inv(turned[..., parents, :]), turned[..., 1:, :])
    return torch.cat((turned[..., :1, :], local), dim=-2)
