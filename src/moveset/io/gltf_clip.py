"""The channels of a glTF animation and their values at any time. F frames."""

from dataclasses import dataclass

import torch
from torch import Tensor

from moveset.io.glb import Glb
from moveset.io.limits import MAX_FRAMES
from moveset.motion import rotations

_Keys = tuple[Tensor, Tensor, str]


@dataclass(frozen=True, eq=False)
class Clip:
    """Channels by node: key times, values, interpolation."""

    turns: dict[int, _Keys]
    shifts: dict[int, _Keys]

    def rotation(self, glb: Glb, node: int, times: Tensor, default: Tensor) -> Tensor:
        """(F, 4)"""
        if node not in self.turns:
            return default.expand(len(times), 4)
        keys, values, interpolation = self.turns[node]
        if interpolation == "CUBICSPLINE":
            return rotations.normalize(_spline(keys, values, times))
        values = unit_quaternions(glb, values)
        low, high, t = _between(keys, times)
        t = t.floor() if interpolation == "STEP" else t
        a, b = values[low], values[high]
        # Keys themselves are returned untouched.
        mixed = torch.where((t == 1.0)[:, None], b, rotations.slerp(a, b, t))
        return torch.where((t == 0.0)[:, None], a, mixed)

    def translation(self, node: int, times: Tensor, default: Tensor) -> Tensor:
        """(F, 3)"""
        if node not in self.shifts:
            return default.expand(len(times), 3)
        keys, values, interpolation = self.shifts[node]
        if interpolation == "CUBICSPLINE":
            return _spline(keys, values, times)
        low, high, t = _between(keys, times)
        t = t.floor() if interpolation == "STEP" else t
        return torch.lerp(values[low], values[high], t[:, None])

    def mean_translation(self, node: int, default: Tensor) -> Tensor:
        """(3,)"""
        if node not in self.shifts:
            return default
        _, values, interpolation = self.shifts[node]
        return (values[1::3] if interpolation == "CUBICSPLINE" else values).mean(dim=0)

    def moves(self, node: int) -> float:
        """How far a node's own translation ranges, in its units."""
        if node not in self.shifts:
            return 0.0
        _, values, interpolation = self.shifts[node]
        values = values[1::3] if interpolation == "CUBICSPLINE" else values
        return float((values.amax(dim=0) - values.amin(dim=0)).max())


def read_clip(glb: Glb) -> Clip:
    if not glb.items(glb.tree, "animations"):
        glb.fail("it has no animation; export the character with one")
    animation = glb.entry("animations", 0)
    samplers = glb.items(animation, "samplers")
    turns: dict[int, _Keys] = {}
    shifts: dict[int, _Keys] = {}
    clocks: dict[int, Tensor] = {}
    for channel in glb.items(animation, "channels"):
        target = channel.get("target") if isinstance(channel, dict) else None
        if not isinstance(target, dict):
            glb.fail("an animation channel has no target; it is damaged")
        kind = target.get("path")
        if kind not in ("rotation", "translation") or "node" not in target:
            continue
        sampler = samplers[glb.index(channel.get("sampler"), len(samplers), "samplers")]
        if not isinstance(sampler, dict):
            glb.fail("an animation sampler is not an object; it is damaged")
        interpolation = sampler.get("interpolation", "LINEAR")
        if interpolation not in ("LINEAR", "STEP", "CUBICSPLINE"):
            glb.fail(f"there is no interpolation {str(interpolation)[:32]!r}; it is damaged")
        clock = glb.index(sampler.get("input"), 1_000_000, "accessors")
        if clock not in clocks:
            clocks[clock] = _clock(glb, clock)
        values = torch.from_numpy(glb.accessor(sampler.get("output"), "VEC4" if kind == "rotation" else "VEC3"))
        if len(values) != len(clocks[clock]) * (3 if interpolation == "CUBICSPLINE" else 1):
            glb.fail("an animation has other numbers of times and values; it is damaged")
        node = glb.index(target["node"], len(glb.items(glb.tree, "nodes")), "nodes")
        (turns if kind == "rotation" else shifts)[node] = clocks[clock], values, interpolation
    if not turns:
        glb.fail("its animation turns no joint; export the character with its motion")
    return Clip(turns, shifts)


def _clock(glb: Glb, index: int) -> Tensor:
    keys = torch.from_numpy(glb.accessor(index, "SCALAR"))[:, 0]
    if not len(keys) or keys[0] < 0 or len(keys) > MAX_FRAMES or not (keys.diff() > 0).all():
        glb.fail(f"its key times are not 1 to {MAX_FRAMES} increasing seconds from 0 on; it is damaged")
    return keys


def unit_quaternions(glb: Glb, q: Tensor) -> Tensor:
    """Quaternions as they are where they are of length 1, made so where they nearly are."""
    off = (q.norm(dim=-1, keepdim=True) - 1.0).abs()
    if len(q) and off.max() > 0.1:
        glb.fail("a rotation is not a unit quaternion; export the file again")
    return torch.where(off > 1e-5, rotations.normalize(q), q)


def _between(keys: Tensor, times: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Indices of the keys around each time and the share of the later one, 0 or 1 where a time is a key's own."""
    if len(keys) == 1:
        zero = torch.zeros(len(times), dtype=torch.long)
        return zero, zero, zero.double()
    low = (torch.searchsorted(keys, times, right=True) - 1).clamp(0, len(keys) - 2)
    gap = keys[low + 1] - keys[low]
    t = ((times - keys[low]) / gap).clamp(0.0, 1.0)
    # Times are stored in float32, so a key's own time is found to that precision only.
    close = 1e-3 + 2e-7 * times / gap
    t = torch.where(t < close, 0.0, torch.where(t > 1.0 - close, 1.0, t))
    return low, low + 1, t


def _spline(keys: Tensor, values: Tensor, times: Tensor) -> Tensor:
    """Hermite spline; values (3 K, n) are in-tangent, value, out-tangent of each key (glTF 2.0, appendix C)."""
    low, high, t = _between(keys, times)
    gap, t = (keys[high] - keys[low])[:, None], t[:, None]
    into, at, out = values[0::3], values[1::3], values[2::3]
    t2, t3 = t * t, t * t * t
    start = (2 * t3 - 3 * t2 + 1) * at[low] + gap * (t3 - 2 * t2 + t) * out[low]
    return start + (3 * t2 - 2 * t3) * at[high] + gap * (t3 - t2) * into[high]
