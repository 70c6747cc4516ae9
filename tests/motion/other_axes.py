"""The same motion with other axes in every joint: no joint moves, yet neither zero pose nor rotations are the same."""

from dataclasses import replace

import torch

from moveset.motion import rotations
from moveset.motion.clip import Motion


def with_other_axes(motion: Motion, seed: int) -> Motion:
    """Joint j turns by R_j·B_j with random constants B_j, and its bones are given along the axes that this makes."""
    skeleton, generator = motion.skeleton, torch.Generator().manual_seed(seed)
    other = rotations.normalize(torch.randn(len(skeleton), 4, generator=generator))
    above = torch.cat((rotations.identity(1), other[list(skeleton.parents[1:])]))
    offsets = rotations.rotate(rotations.inv(above), skeleton.offsets)
    local = rotations.mul(rotations.inv(above), rotations.mul(motion.rotations, other))
    body = replace(skeleton, name=f"axes {seed}", offsets=offsets)
    return Motion(rotations.normalize(local), motion.root, motion.fps, body)
