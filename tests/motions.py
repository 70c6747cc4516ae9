"""Synthetic motions for tests, with known properties and no captured data."""

import math

import torch

from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.kinematics import fk, global_to_local
from moveset.motion.skeleton import HML22, Skeleton
from moveset.motion.smoothing import gaussian_smooth
from moveset.motion.two_bone_ik import two_bone


def smooth_noise(frames: int, channels: int, seed: int, seconds: float = 0.3, fps: float = 20.0) -> torch.Tensor:
    """(F, C) float64 noise of unit deviation that changes within about ``seconds``."""
    generator = torch.Generator().manual_seed(seed)
    sigma = seconds * fps
    noise = torch.randn(frames + 200, channels, generator=generator, dtype=torch.float64)
    noise = gaussian_smooth(noise, sigma)[100 : 100 + frames]
    return noise * math.sqrt(2 * math.sqrt(math.pi) * sigma)


def wander(
    frames: int, seed: int, skeleton: Skeleton = HML22, fps: float = 20.0, bend: float = 0.25, turn: float = 0.0
) -> Motion:
    """Every joint sways (``bend`` radians), the body walks about and turns left at ``turn`` radians a second."""
    count = len(skeleton)
    sway = bend * smooth_noise(frames, 3 * count, seed, fps=fps).reshape(frames, count, 3)
    local = rotations.from_axis_angle(torch.nn.functional.normalize(sway, dim=-1), sway.norm(dim=-1))
    heading = rotations.yaw(turn * torch.arange(frames, dtype=torch.float64) / fps)
    local[:, 0] = rotations.mul(heading, local[:, 0])
    root = torch.cumsum(0.04 * smooth_noise(frames, 3, seed + 1000, fps=fps), dim=0)
    root[:, 1] = 0.9 + 0.05 * smooth_noise(frames, 1, seed + 2000, fps=fps)[:, 0]
    return Motion(rotations.normalize(local).float(), root.float(), fps, skeleton)


def gait(frames: int, fps: float = 20.0, speed: float = 1.0, cycle: float = 1.0) -> Motion:
    """A walk along +Z on flat feet, planted without any sliding for six tenths of each ``cycle`` (s), on hml22."""
    t = torch.arange(frames, dtype=torch.float64) / fps
    ankle_height = -float(HML22.offsets[10, 1])
    root = torch.stack((torch.zeros_like(t), 0.84 + 0.01 * torch.cos(4 * math.pi * t / cycle), speed * t), dim=-1)
    local = rotations.identity(frames, 22).double()
    swing = 0.3 * torch.sin(2 * math.pi * t / cycle)
    for shoulder, side, sign in ((16, -90.0, 1.0), (17, 90.0, -1.0)):
        hang = rotations.about("z", torch.full_like(t, side * 0.85))
        local[:, shoulder] = rotations.mul(rotations.about("x", torch.rad2deg(sign * swing)), hang)
    turned, placed = fk(local, root, HML22)
    for (hip, knee, ankle), phase, x in (((1, 4, 7), 0.0, 0.09), ((2, 5, 8), 0.5, -0.09)):
        step = t / cycle + phase
        part, count = torch.remainder(step, 1.0), torch.floor(step)
        s = ((part - 0.6) / 0.4).clamp(0.0, 1.0)
        eased = s**3 * (10 - 15 * s + 6 * s**2)
        z = (count + eased - phase + 0.3) * speed * cycle
        target = torch.stack((torch.full_like(z, x), ankle_height + 0.5 * (s * (1 - s)) ** 2, z), dim=-1)
        hinge = t.new_tensor((1.0, 0.0, 0.0)).expand(frames, 3)
        turned[:, hip], turned[:, knee] = two_bone(
            turned[:, hip], turned[:, knee], placed[:, hip], placed[:, knee], placed[:, ankle], target, hinge
        )
    return Motion(rotations.normalize(global_to_local(turned, HML22)).float(), root.float(), fps, HML22)


def shaken(motion: Motion, seed: int, degrees: float = 1.0, metres: float = 0.005) -> Motion:
    """A motion with jitter: every joint's rotation and the root shake, as a weak generator's do."""
    frames, count = motion.rotations.shape[:2]
    angle = math.radians(degrees) * smooth_noise(frames, 3 * count, seed, 0.05, motion.fps).reshape(frames, count, 3)
    shake = rotations.from_axis_angle(torch.nn.functional.normalize(angle, dim=-1), angle.norm(dim=-1)).float()
    root = motion.root + (metres * smooth_noise(frames, 3, seed + 1, 0.05, motion.fps)).float()
    return Motion(rotations.normalize(rotations.mul(motion.rotations, shake)), root, motion.fps, motion.skeleton)


def slid(motion: Motion, factor: float) -> Motion:
    """A walk along +Z that gets further than its feet carry it."""
    return Motion(motion.rotations, motion.root * torch.tensor([1.0, 1.0, factor]), motion.fps, motion.skeleton)


def sliding(motion: Motion, planted: torch.Tensor) -> float:
    """Mean planar speed of toes of hml22 that are planted (F, 4) in both frames, m/s."""
    speed = torch.diff(motion.joints.double()[:, [10, 11]], dim=0)[..., [0, 2]].norm(dim=-1) * motion.fps
    down = planted[:, [1, 3]]
    return speed[down[1:] & down[:-1]].mean().item()


def standing(frames: int) -> Motion:
    """Somebody who stands still on the floor with hanging arms."""
    turned = rotations.identity(frames, len(HML22)).clone()
    for side, down in (("left", -75.0), ("right", 75.0)):
        turned[:, HML22.index(f"{side}_shoulder")] = rotations.about("z", torch.tensor(down))
    still = Motion(turned, torch.zeros(frames, 3), 20.0, HML22)
    return Motion(turned, still.root - still.joints[..., 1].amin() * torch.tensor((0.0, 1.0, 0.0)), 20.0, HML22)


def seated(bend: torch.Tensor) -> Motion:
    """Somebody who sits on nothing, thighs and shins bent by so many degrees, feet where they are."""
    still = standing(len(bend))
    turned = still.rotations.clone()
    for side in ("left", "right"):
        turned[:, HML22.index(f"{side}_hip")] = rotations.about("x", -bend)
        turned[:, HML22.index(f"{side}_knee")] = rotations.about("x", bend)
    low = Motion(turned, still.root, 20.0, HML22)
    ankle = low.joints[:, HML22.index("left_ankle")]
    return Motion(turned, low.root + still.joints[:1, HML22.index("left_ankle")] - ankle, 20.0, HML22)
