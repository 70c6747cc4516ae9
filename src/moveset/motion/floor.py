"""Nobody is in the floor: a trunk that is under it rises, and limbs bend up to it.

Networks see few people who lie, roll or fall, and what they make of it is a posture or a height that is a little off.
Raised as a whole, such a body would float on the hand that was deepest; so only its trunk carries it up, elbows and
knees bend, and what is then still too low swings about its own joint. Legs that carry a body are left to the foot lock.
Each frame is by itself, without look-ahead.
Shapes: F frames, J joints.
"""

from dataclasses import replace

import torch
from torch import Tensor

from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.contacts import off_legs
from moveset.motion.kinematics import global_to_local
from moveset.motion.positions import HINGES
from moveset.motion.skeleton import Skeleton
from moveset.motion.two_bone_ik import two_bone

_NEAR = 0.02  # metres: what is lower is held back, the more the lower, so that nothing stops at once


def above_floor(motion: Motion) -> Motion:
    """The body above the floor y = 0, but for legs that it stands on.

    Args:
        motion: (F, J) on a skeleton with feet and known knees and elbows (hml22, kit21).
    """
    skeleton, joints = motion.skeleton, motion.joints.double().clone()
    trunk, limbs = _parts(skeleton)
    share = torch.ones_like(joints[..., 1])
    share[:, _legs(skeleton, trunk)] = off_legs(joints, skeleton)[:, None]
    if not bool((share * (joints[..., 1] < _NEAR)).any()):
        return motion
    rise = _missing(joints[:, trunk, 1].amin(dim=1, keepdim=True))
    joints[..., 1] += rise
    turned = motion.global_rotations.double().clone()
    ends, heights = _bend(turned, joints, skeleton, share)
    joints[:, ends, 1] = heights
    for bones in limbs:
        parents = [skeleton.parents[joint] for joint in bones]
        bone = rotations.rotate(turned[:, parents], skeleton.offsets[bones].to(turned))
        end = joints[:, parents, 1] + bone[..., 1]
        bent = torch.tensor([joint in ends for joint in bones])
        more = torch.where(bent, (joints[:, bones, 1] - end).clamp_min(0.0), share[:, bones] * _missing(end))
        raised = torch.where((more > 0)[..., None], _tilted(bone, more), bone)
        joints[:, bones] = joints[:, parents] + raised
        turned[:, parents] = rotations.mul(rotations.between(bone, raised), turned[:, parents])
    root = motion.root.clone()
    root[:, 1] += rise[:, 0].to(root)
    local = rotations.unroll(rotations.normalize(global_to_local(turned, skeleton)))
    return replace(motion, rotations=local.to(motion.rotations), root=root)


def _bend(turned: Tensor, joints: Tensor, skeleton: Skeleton, share: Tensor) -> tuple[list[int], Tensor]:
    """Elbows and knees bend, so that hands and feet rise where they are; feet keep their angle.

    Returns:
        The ends of limbs, and how high (F, 4) they should be.
    """
    hinges = HINGES[skeleton.name]
    middle = [skeleton.index(name) for name in hinges]
    start, end = [skeleton.parents[joint] for joint in middle], [skeleton.children[joint][0] for joint in middle]
    missing = share[:, end] * _missing(joints[:, end, 1])
    target = joints[:, end]
    target[..., 1] += missing
    hinge = rotations.rotate(turned[:, start], turned.new_tensor(list(hinges.values())))
    before = turned[:, middle]
    limb = (joints[:, start], joints[:, middle], joints[:, end])
    upper, lower = two_bone(turned[:, start], before, *limb, target, hinge)
    moved = (missing > 0)[..., None]
    turned[:, start] = torch.where(moved, upper, turned[:, start])
    turned[:, middle] = torch.where(moved, lower, before)
    hands = [k for k, joint in enumerate(end) if joint not in skeleton.feet]
    carried = rotations.mul(turned[:, middle], rotations.inv(before))
    at = [end[k] for k in hands]
    turned[:, at] = rotations.mul(carried[:, hands], turned[:, at])
    return end, target[..., 1]


def _missing(height: Tensor) -> Tensor:
    """How much higher heights (F, N) should be."""
    low = height.clamp(max=_NEAR)
    return _NEAR * torch.exp((low - _NEAR) / _NEAR) - low


def _tilted(bone: Tensor, more: Tensor) -> Tensor:
    """Bones (F, N, 3) whose ends are ``more`` (F, N) higher, each in its own direction over the floor."""
    height = bone[..., 1] + more
    level = bone * bone.new_tensor((1.0, 0.0, 1.0))
    level[..., 2] += more.clamp(max=1e-3)  # one that points straight down has no direction
    out = (bone.square().sum(dim=-1) - height.square()).clamp_min(0.0).sqrt()
    level = torch.nn.functional.normalize(level, dim=-1) * out[..., None]
    return torch.stack((level[..., 0], height, level[..., 2]), dim=-1)


def _parts(skeleton: Skeleton) -> tuple[list[int], list[list[int]]]:
    """Joints of the trunk, what branches and what is between; and of limbs, those next to the trunk first."""
    branching = {k for k, children in enumerate(skeleton.children) if len(children) > 1}
    inner = set(branching)
    for joint in branching:
        while (joint := skeleton.parents[joint]) >= 0:
            inner.add(joint)
    trunk = [k for k in range(len(skeleton)) if k in inner or skeleton.parents[k] in branching]
    limbs, above = [], trunk
    while above := [k for k in range(len(skeleton)) if skeleton.parents[k] in above and k not in trunk]:
        limbs.append(above)
    return trunk, limbs


def _legs(skeleton: Skeleton, trunk: list[int]) -> list[int]:
    """From the feet up to the trunk."""
    legs = set(skeleton.feet)
    for joint in skeleton.feet:
        while (joint := skeleton.parents[joint]) not in trunk:
            legs.add(joint)
    return sorted(legs)
