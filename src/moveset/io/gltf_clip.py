"""The channels of a glTF animation and their values at any time. F frames."""

import warnings
from dataclasses import dataclass

import torch
from torch import Tensor

from moveset.io.glb import Glb
from moveset.io.limits import MAX_BYTES, MAX_FRAMES
from moveset.motion import rotations

_STILL = 1.0 - 1e-5  # cosine of half an angle of half a degree
_MAX_NUMBERS = MAX_BYTES // 4  # of an animation: as many float32 as the largest file has, if each is there once


@dataclass(frozen=True, eq=False)
class Channel:
    """Key times (K,), seconds, and values (K, n); of splines (3 K, n): in-tangent, value, out-tangent of each key."""

    keys: Tensor
    values: Tensor
    interpolation: str

    @property
    def smooth(self) -> bool:
        return self.interpolation == "CUBICSPLINE"

    @property
    def at(self) -> Tensor:
        """(K, n) what is there at the keys."""
        return self.values[1::3] if self.smooth else self.values

    def between(self, times: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Indices of the keys around each time and the share of the later one, 0 or 1 where a time is a key's own."""
        keys = self.keys
        if len(keys) == 1:
            zero = torch.zeros(len(times), dtype=torch.long)
            return zero, zero, zero.double()
        low = (torch.searchsorted(keys, times, right=True) - 1).clamp(0, len(keys) - 2)
        gap = keys[low + 1] - keys[low]
        t = ((times - keys[low]) / gap).clamp(0.0, 1.0)
        # Times are stored in float32, so a key's own time is found to that precision only.
        close = 1e-3 + 2e-7 * times / gap
        t = torch.where(t < close, 0.0, torch.where(t > 1.0 - close, 1.0, t))
        return low, low + 1, t.floor() if self.interpolation == "STEP" else t


@dataclass(frozen=True, eq=False)
class Clip:
    """Channels by node, and whether there are channels of morph targets."""

    turns: dict[int, Channel]
    shifts: dict[int, Channel]
    morphs: bool

    @property
    def lively(self) -> bool:
        """Whether a joint turns visibly: T-poses, which often come first in files, hold still."""
        moving = (c.at for c in {id(c.values): c for c in self.turns.values()}.values() if len(c.keys) > 1)
        return any(float((at * at[:1]).sum(dim=-1).abs().min()) < _STILL for at in moving)

    def rotation(self, glb: Glb, node: int, times: Tensor, default: Tensor) -> Tensor:
        """(F, 4)"""
        if node not in self.turns:
            return default.expand(len(times), 4)
        channel = self.turns[node]
        if channel.smooth:
            return rotations.normalize(_spline(channel, times))
        values = unit_quaternions(glb, channel.values)
        low, high, t = channel.between(times)
        a, b = values[low], values[high]
        # Keys themselves are returned untouched.
        mixed = torch.where((t == 1.0)[:, None], b, rotations.slerp(a, b, t))
        return torch.where((t == 0.0)[:, None], a, mixed)

    def translation(self, node: int, times: Tensor, default: Tensor) -> Tensor:
        """(F, 3)"""
        if node not in self.shifts:
            return default.expand(len(times), 3)
        channel = self.shifts[node]
        if channel.smooth:
            return _spline(channel, times)
        low, high, t = channel.between(times)
        return torch.lerp(channel.values[low], channel.values[high], t[:, None])

    def mean_translation(self, node: int, default: Tensor) -> Tensor:
        """(3,)"""
        return self.shifts[node].at.mean(dim=0) if node in self.shifts else default

    def moves(self, node: int) -> float:
        """How far a node's own translation ranges, in its units."""
        if node not in self.shifts:
            return 0.0
        at = self.shifts[node].at
        return float((at.amax(dim=0) - at.amin(dim=0)).max())


def animation_names(glb: Glb) -> list[str]:
    """Names of a file's animations; those without one are called by their number, from 1."""
    count = len(glb.items(glb.tree, "animations"))
    return [str(glb.entry("animations", k).get("name") or k + 1)[:64] for k in range(count)]


def read_clip(glb: Glb, animation: str | None = None) -> Clip:
    """An animation by name or number, or the first one that moves.

    Raises:
        FormatError: there is none such, it turns nothing, or it is damaged.
    """
    names = animation_names(glb)
    if not names:
        glb.fail("it has no animation; export the character with one")
    if animation is not None:
        return _turning(glb, _clip(glb, _chosen(glb, names, animation)))
    clips = (_clip(glb, k) for k in range(len(names)))
    chosen, clip = next(((k, clip) for k, clip in enumerate(clips) if clip.lively), (0, None))
    if len(names) > 1:
        said = f"of its {len(names)} animations ({_listed(names)}) {names[chosen]!r} is read"
        warnings.warn(f"{glb.path}: {said}; --animation NAME reads another", stacklevel=2)
    return _turning(glb, clip or _clip(glb, 0))


def _chosen(glb: Glb, names: list[str], wanted: str) -> int:
    alike = [k for k, name in enumerate(names) if name.lower() == wanted.lower()]
    if alike:
        return names.index(wanted) if wanted in names else alike[0]
    if wanted.isdecimal() and len(wanted) < 9 and 1 <= int(wanted) <= len(names):
        return int(wanted) - 1
    glb.fail(f"it has no animation {wanted[:64]!r}; choose one of {_listed(names)}")


def _listed(names: list[str]) -> str:
    return ", ".join(names[:12]) + ", …" * (len(names) > 12)


def _turning(glb: Glb, clip: Clip) -> Clip:
    if not clip.turns and clip.morphs:
        glb.fail("its animation changes shapes alone (morph targets, of a face perhaps); export one that turns joints")
    if not clip.turns:
        glb.fail("its animation turns no joint; export the character with its motion")
    return clip


def _clip(glb: Glb, index: int) -> Clip:
    animation = glb.entry("animations", index)
    samplers = glb.items(animation, "samplers")
    turns: dict[int, Channel] = {}
    shifts: dict[int, Channel] = {}
    clocks: dict[int, Tensor] = {}
    # Channels may share their numbers: unfolded for each of them, a small file would fill the memory.
    outputs: dict[tuple[int, str], Tensor] = {}
    numbers, morphs = 0, False
    for channel in glb.items(animation, "channels"):
        target = channel.get("target") if isinstance(channel, dict) else None
        if not isinstance(target, dict):
            glb.fail("an animation channel has no target; it is damaged")
        kind = target.get("path")
        morphs = morphs or kind == "weights"
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
            numbers += clocks[clock].numel()
        output = glb.index(sampler.get("output"), 1_000_000, "accessors"), "VEC4" if kind == "rotation" else "VEC3"
        if output not in outputs:
            outputs[output] = torch.from_numpy(glb.accessor(*output))
            numbers += outputs[output].numel()
            if numbers > _MAX_NUMBERS:
                glb.fail(f"its animation has more than {_MAX_NUMBERS} numbers; split the file")
        values = outputs[output]
        if len(values) != len(clocks[clock]) * (3 if interpolation == "CUBICSPLINE" else 1):
            glb.fail("an animation has other numbers of times and values; it is damaged")
        node = glb.index(target["node"], len(glb.items(glb.tree, "nodes")), "nodes")
        (turns if kind == "rotation" else shifts)[node] = Channel(clocks[clock], values, interpolation)
    return Clip(turns, shifts, morphs)


def _clock(glb: Glb, index: int) -> Tensor:
    keys = torch.from_numpy(glb.accessor(index, "SCALAR"))[:, 0]
    if len(keys) > MAX_FRAMES:
        glb.fail(f"{len(keys)} keys exceed the limit of {MAX_FRAMES}; split the animation")
    if not len(keys) or keys[0] < 0 or not (keys.diff() > 0).all():
        glb.fail("its key times are not increasing seconds from 0 on; it is damaged")
    return keys


def unit_quaternions(glb: Glb, q: Tensor) -> Tensor:
    """Quaternions as they are where they are of length 1, made so where they nearly are."""
    off = (q.norm(dim=-1, keepdim=True) - 1.0).abs()
    if len(q) and off.max() > 0.1:
        glb.fail("a rotation is not a unit quaternion; export the file again")
    return torch.where(off > 1e-5, rotations.normalize(q), q)


def _spline(channel: Channel, times: Tensor) -> Tensor:
    """Hermite spline (glTF 2.0, appendix C)."""
    keys, values = channel.keys, channel.values
    low, high, t = channel.between(times)
    gap, t = (keys[high] - keys[low])[:, None], t[:, None]
    into, at, out = values[0::3], values[1::3], values[2::3]
    t2, t3 = t * t, t * t * t
    start = (2 * t3 - 3 * t2 + 1) * at[low] + gap * (t3 - 2 * t2 + t) * out[low]
    return start + (3 * t2 - 2 * t3) * at[high] + gap * (t3 - t2) * into[high]
