"""Forward kinematics and local/global rotations. J joints, F frames; leading dimensions (frames, batch) are free."""

from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from moveset.motion import rotations
from moveset.motion.skeleton import Skeleton


def fk(local: Tensor, root: Tensor, skeleton: Skeleton) -> tuple[Tensor, Tensor]:
    """Global rotations and joint positions.

    A clip of ten seconds is limited by the number of operations, not by their size: joints of one depth are turned
    together, components first. There are no matrix products, so a frame is the same to the last bit in any clip.

    Args:
        local: (..., J, 4) local rotations, xyzw.
        root: (..., 3) world position of the root joint, metres.

    Returns:
        global rotations (..., J, 4) and joint positions (..., J, 3).
    """
    plan = _plan(skeleton, local.dtype, local.device)
    lead, joints = local.shape[:-2], len(skeleton)
    local_4JF = local.reshape(-1, joints, 4).permute(2, 1, 0).contiguous()
    # A product of quaternions is a matrix of the right one's components, with signs, times the left one.
    right_44JF = (local_4JF.index_select(0, plan.components) * plan.signs).unflatten(0, (4, 4))
    turned = local_4JF[:, :1]
    levels = [turned]
    for parents, level in plan.levels:
        turned = (turned.index_select(1, parents)[:, None] * right_44JF.index_select(2, level)).sum(0)
        levels.append(turned)
    turned_4JF = torch.cat(levels, dim=1).index_select(1, plan.order)
    bones_3JF = _turn(turned_4JF.index_select(1, plan.parents), plan.offsets_3J1)
    placed = root.reshape(-1, 1, 3).permute(2, 1, 0)
    levels = [placed]
    for parents, level in plan.levels:
        placed = placed.index_select(1, parents) + bones_3JF.index_select(1, level)
        levels.append(placed)
    placed_3JF = torch.cat(levels, dim=1).index_select(1, plan.order)
    return (
        turned_4JF.permute(2, 1, 0).contiguous().view(*lead, joints, 4),
        placed_3JF.permute(2, 1, 0).contiguous().view(*lead, joints, 3),
    )


def _turn(q_4JF: Tensor, v_3J1: Tensor) -> Tensor:
    """Vectors turned by quaternions, components first: v + w t + u x t with t = 2 u x v."""
    # Components x y z x y, so that a cross product is made of slices.
    u_5 = torch.cat((q_4JF[:3], q_4JF[:2]))
    v_5 = 2.0 * torch.cat((v_3J1, v_3J1[:2]))
    t = u_5[1:4] * v_5[2:5] - u_5[2:5] * v_5[1:4]
    t_5 = torch.cat((t, t[:2]))
    return v_3J1 + q_4JF[3:] * t + (u_5[1:4] * t_5[2:5] - u_5[2:5] * t_5[1:4])


class _Plan(NamedTuple):
    """What forward kinematics needs to know of a skeleton.

    Args:
        levels: for every depth below the root the places of the parents among the joints above, and the joints.
        order: place of each joint among the levels.
        parents: (J,) of each joint; of the root itself.
        offsets_3J1: bones at rest.
        components: (16,) which component of b stands at [i, k] in (a b)_k = sum_i a_i b_[i, k]
        signs: (16, 1, 1) and its sign.
    """

    levels: tuple[tuple[Tensor, Tensor], ...]
    order: Tensor
    parents: Tensor
    offsets_3J1: Tensor
    components: Tensor
    signs: Tensor


@lru_cache(maxsize=32)
def _plan(skeleton: Skeleton, dtype: torch.dtype, device: torch.device) -> _Plan:
    # Plans first made while sampling must still be able to enter a training graph later.
    with torch.inference_mode(False):
        parents = skeleton.parents
        flat = [j for level in skeleton.levels for j in level]
        # The product of every pair of components: [i, j, k] is +-1 where a_i b_j is part of (a b)_k.
        unit = torch.eye(4, dtype=dtype)
        product = rotations.mul(unit[:, None], unit)
        return _Plan(
            tuple(
                (
                    torch.tensor([above.index(parents[j]) for j in level], device=device),
                    torch.tensor(level, device=device),
                )
                for above, level in zip(skeleton.levels, skeleton.levels[1:], strict=False)
            ),
            torch.tensor([flat.index(j) for j in range(len(skeleton))], device=device),
            torch.tensor((0, *parents[1:]), device=device),
            skeleton.offsets.T[:, :, None].contiguous().to(device, dtype),
            product.abs().argmax(1).flatten().to(device),
            product.sum(1).reshape(16, 1, 1).to(device),
        )


def fk_matrices(local: Tensor, root: Tensor, skeleton: Skeleton) -> Tensor:
    """Joint positions (..., J, 3) from local rotation matrices (..., J, 3, 3): few large operations, for losses."""
    offsets = skeleton.offsets.to(local)
    turned = local[..., :1, :, :]
    placed = root[..., None, :]
    all_placed = [placed]
    for above, level in zip(skeleton.levels, skeleton.levels[1:], strict=False):
        parents = [above.index(skeleton.parents[j]) for j in level]
        up = turned[..., parents, :, :]
        placed = placed[..., parents, :] + (up @ offsets[list(level)][..., None])[..., 0]
        turned = up @ local[..., list(level), :, :]
        all_placed.append(placed)
    flat = [j for level in skeleton.levels for j in level]
    return torch.cat(all_placed, dim=-2)[..., [flat.index(j) for j in range(len(skeleton))], :]


def global_to_local(turned: Tensor, skeleton: Skeleton) -> Tensor:
    """Local rotations (..., J, 4) of global ones."""
    parents = list(skeleton.parents[1:])
    local = rotations.mul(rotations.inv(turned[..., parents, :]), turned[..., 1:, :])
    return torch.cat((turned[..., :1, :], local), dim=-2)
