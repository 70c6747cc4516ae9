"""Passages of clips that are found by motion: a gait that can go on, somebody who gets up.

F frames, J joints, on ``hml22``.
"""

import torch
from torch import Tensor

from moveset.data.augment import MAX_FRAMES
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.contacts import stands_on
from moveset.motion.skeleton import HML22
from moveset.motion.smoothing import gaussian_smooth, spans

# Of a gait that is repeated: its least frames, how alike its ends are, m/s of who gets somewhere, the share of the
# clip's best pace, and metres that it climbs and radians that it turns at most.
_PERIOD, _SAME, _STEADY, _FULL, _LEVEL, _ASTRAY = 12, 0.4, 0.4, 0.8, 0.03, 0.15
STRAIGHT = 0.9
"""Of the length of a way that is straight, from its first to its last place."""

# Of who gets up: metres under which hips rest and m/s of all joints then, the share of the legs' length at which hips
# are up and the uprightness of the trunk, and frames that it takes at most, and that rest and standing last at least.
_LOW, _RESTING, _UP, _UPRIGHT = 0.6, 0.4, 0.92, 0.85
_RISING, _LEAST, _SHOWN = 60, 8, 32
_TRUNK = [HML22.index(name) for name in ("pelvis", "neck")]
_HIPS = [HML22.index(f"{side}_hip") for side in ("left", "right")]


def find_gait(motion: Motion, poses: Tensor, blend: int) -> tuple[int, int] | None:
    """Frames after which a gait begins again, straight ahead and at full pace; None if there is none.

    Args:
        motion: (F, J).
        poses: (F - 1, D) what is to be alike at both ends.
        blend: frames of overlap, which are included.
    """
    path, half = motion.root[:, [0, 2]], blend // 2
    gone = torch.cat((path.new_zeros(1), path.diff(dim=0).norm(dim=1).cumsum(0)))
    second = min(round(motion.fps), len(path) - 1)
    pace = float((gone[second:] - gone[:-second]).max()) / second
    first, last = torch.triu_indices(len(poses), len(poses), _PERIOD)
    facing = rotations.heading(motion.rotations[:, 0])
    turned = rotations.heading_angle(rotations.mul(facing[last], rotations.inv(facing[first])))
    way = gone[last] - gone[first]
    good = ((path[last] - path[first]).norm(dim=1) > STRAIGHT * way) & (turned.abs() < _ASTRAY)
    good &= way > (last - first) * max(_STEADY / motion.fps, _FULL * pace)
    good &= ((motion.root[last, 1] - motion.root[first, 1]).abs() < _LEVEL) & (first >= half)
    # Twice at least within a clip.
    good &= (last <= len(motion) - half) & (last - first <= (MAX_FRAMES - blend) // 2)
    if not good.any():
        return None
    first, last = first[good], last[good]
    apart = (poses[last] - poses[first]).norm(dim=1)
    best = int(apart.argmin())
    # Beside what half a gait differs by, which grows with its pace.
    most = float((poses - poses[first[best]]).norm(dim=1).max())
    return (int(first[best]) - half, int(last[best]) + half) if float(apart[best]) < _SAME * most else None


def find_rises(motion: Motion) -> list[tuple[int, int]]:
    """Frames [start, stop) of each time that somebody gets up: from at most 1.6 s before rest ends until at most .8 s
    after the body is upright.

    Rest is low and hardly moves, whether on a chair, on the knees or lying; what never rests, like a roll or a dance on
    the floor, is no getting up.

    Args:
        motion: (F, J) at 20 frames a second.
    """
    joints, found = motion.joints, list[tuple[int, int]]()
    if len(joints) < 2 * _LEAST:
        return found
    trunk = joints[:, _TRUNK[1]] - joints[:, _TRUNK[0]]
    tall = stands_on(joints, HML22, _UP) & (trunk[:, 1] > _UPRIGHT * trunk.norm(dim=1))
    speed = joints.diff(dim=0).norm(dim=-1).mean(dim=1) * motion.fps
    speed = gaussian_smooth(torch.cat((speed, speed[-1:]))[:, None], 2.0)[:, 0]
    low = joints[:, _HIPS, 1].mean(dim=1) < _LOW
    lows = [span for span in spans(low) if span[1] - span[0] >= _LEAST]
    rests = [(since, frame) for since, until in lows for frame in range(since, until) if speed[frame] < _RESTING]
    for begin, end in spans(tall):
        since, last = max((rest for rest in rests if rest[1] < begin), default=(0, 0))
        rested = last - since >= _LEAST and begin - last <= _RISING and not tall[last:begin].any()
        if rested and end - begin >= _LEAST:
            found.append((max(since, last - _SHOWN), min(end, begin + 2 * _LEAST)))
    return found
