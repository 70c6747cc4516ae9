"""Where a way goes that a sentence bends: onto a circle, by so many degrees in all, or nowhere.

A network that was never told of circles walks straight on, and turns as far as its takes did. So its features are bent
(``way``); ``cleanup.lock_feet`` and ``StreamDecoder`` hold the feet that stand afterwards.

Angles are radians, to the left above zero. F frames, D features.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from moveset.motion import rotations
from moveset.motion.cleanup import move_feet
from moveset.motion.features import FeatureCodec
from moveset.motion.way import GOES, YAW, arc, side_of, steps, turned_by, way_of

RADIUS = 1.5  # metres, of a circle in a motion without an end
_SURELY = math.radians(75.0)  # within which most of a turn is done; whoever turns in a stream turns by 95 at least
_TO_THE_END = 1.1  # so that those who turn as far as most do end at the angle, not short of it
_ENDS = ("hip", "ankle")  # of legs
_AHEAD = torch.tensor((0.0, 0.0, 1.0), dtype=torch.float64)
_SPINS = math.radians(110.0)  # a second, on the spot, and the most of a whole motion:
_FASTEST_SPIN = math.radians(220.0)
_SHORTEST = 4.0  # seconds of a motion in which somebody turns on the spot and stands then
_TURNING = math.radians(30.0)  # in all; whoever turns by less does not turn
_MOST = 2.0  # times as fast as it was made a turn is made


class Steering(Protocol):
    """Bends what was made: where its way goes, or what a body does on it."""

    @property
    def says(self) -> str:
        """What is done, for users: "the way is bent to the left, onto a circle"."""

    @property
    def seconds(self) -> float:
        """How long a whole motion is made, if nobody says; 0 for as long as what is told takes."""

    @property
    def cuts(self) -> bool:
        """Whether it is made as long as that at least, and cut then."""

    def clip(self, features: Tensor, codec: FeatureCodec) -> Tensor:
        """Features (F, D) of a whole motion, bent."""

    def piece(self, features: Tensor, codec: FeatureCodec, turned: float, gone: float = 0.0) -> Tensor:
        """Features (F, D) of a piece of an endless motion, bent.

        Args:
            features: as they were made.
            codec: what they mean.
            turned: radians from where the sentence begins to where the piece does, in features as they were made.
            gone: metres from there to there along the way (``way_of``).
        """


@dataclass(frozen=True)
class Circle:
    """Whoever goes, goes round.

    Args:
        side: 1 to the left, -1 to the right.
        once: a whole clip is one circle, however long its way; else as many as its way is long enough for.
        radius: metres, of others.
    """

    side: int
    once: bool = True
    radius: float = RADIUS
    seconds = 0.0
    cuts = False

    @property
    def says(self) -> str:
        """What is done, for users."""
        return f"the way is bent to the {side_of(self.side)}, onto a circle"

    def clip(self, features: Tensor, codec: FeatureCodec) -> Tensor:
        """Features (F, D) of a whole motion, bent in proportion to the way that is gone.

        A way too short for its circle is bent as far as feet can follow.
        """
        if not self.once:
            return self.piece(features, codec, 0.0)
        way = way_of(features[:-1], codec)
        return arc(features, codec, self.side * 2.0 * math.pi / way) if way > 0 else features

    def piece(self, features: Tensor, codec: FeatureCodec, turned: float, gone: float = 0.0) -> Tensor:
        """Features (F, D) of a piece of an endless motion, bent onto a circle of the radius."""
        return arc(features, codec, self.side / self.radius)


@dataclass(frozen=True)
class Turn:
    """Whoever turns, turns by this angle in all."""

    angle: float
    seconds = 0.0
    cuts = False

    @property
    def says(self) -> str:
        """What is done, for users."""
        return f"the way is bent to the {side_of(self.angle)}, by {math.degrees(abs(self.angle)):.0f} degrees in all"

    def clip(self, features: Tensor, codec: FeatureCodec) -> Tensor:
        """Features (F, D) of a whole motion that ends at this angle to where it began.

        The turn that is there is made so much sharper, or wider; what that does not bring is added all along the way.
        Whoever stands turns no further.
        """
        turned = turned_by(features, codec)
        share = self.angle / turned if turned * self.angle > 0 and abs(turned) >= _TURNING else 1.0
        features = _scaled(features, codec, min(share, _MOST))
        rest, way = self.angle - turned_by(features, codec), way_of(features[:-1], codec)
        return arc(features, codec, rest / way) if way > 0 else features

    def piece(self, features: Tensor, codec: FeatureCodec, turned: float, gone: float = 0.0) -> Tensor:
        """Features (F, D) of a piece of an endless motion, which comes nearer to the angle and stays there.

        However far the network turns by itself, the way ends there: whatever it has turned by is bent to hardly more
        than the angle (``_bent``). Within a piece that is spread along the way, so that hips sway as they did.
        """
        way = way_of(features, codec)
        after = turned + YAW[codec.name] * float(features[:, codec.groups["root_yaw"]].double().sum())
        added = (self._bent(after) - after) - (self._bent(turned) - turned)
        return arc(features, codec, added / way) if way > 0 else features

    def _bent(self, turned: float) -> float:
        """The angle to which one is bent that was turned by."""
        return _TO_THE_END * abs(self.angle) * math.tanh(turned / _SURELY)


@dataclass(frozen=True)
class Stay:
    """Whoever goes steps on the spot: no way, and feet that rise and come down below the hips."""

    seconds = 0.0
    cuts = False

    @property
    def says(self) -> str:
        """What is done, for users."""
        return "feet step on the spot"

    def clip(self, features: Tensor, codec: FeatureCodec) -> Tensor:
        """Features (F, D) of a whole motion, on the spot. Legs follow in the features that decode by rotations."""
        still = features.clone()
        still[:, codec.groups["root_velocity"]] = 0.0
        if codec.name != "native":
            return still
        motion = codec.decode(still)
        joints = motion.joints.double()
        hips, ankles = ([motion.skeleton.index(f"{side}_{joint}") for side in ("left", "right")] for joint in _ENDS)
        ahead = rotations.rotate(rotations.heading(motion.rotations[:, :1].double()), _AHEAD)
        swing = ((joints[:, ankles] - joints[:, hips]) * ahead).sum(dim=-1, keepdim=True)
        moved = rotations.to_6d(move_feet(motion, -swing * ahead).rotations[:, 1:])
        turned = codec.groups["rotations"]
        still[:, turned.start + 6 : turned.stop] = moved.flatten(1).to(still.dtype)
        return still

    def piece(self, features: Tensor, codec: FeatureCodec, turned: float, gone: float = 0.0) -> Tensor:
        """Features (F, D) of a piece of an endless motion, on the spot."""
        return self.clip(features, codec)


@dataclass(frozen=True)
class Spin:
    """Whoever goes steps on the spot, and turns there by this angle in all."""

    angle: float
    cuts = False

    @property
    def says(self) -> str:
        """What is done, for users."""
        degrees = math.degrees(abs(self.angle))
        return f"feet step on the spot and turn to the {side_of(self.angle)}, by {degrees:.0f} degrees"

    @property
    def seconds(self) -> float:
        """How long a whole motion is made, if nobody says: half of it is that of who stands then."""
        return max(2.0 * abs(self.angle) / _SPINS, _SHORTEST)

    def clip(self, features: Tensor, codec: FeatureCodec) -> Tensor:
        """Features (F, D) of a whole motion, turned while it is on its way, gently at first and in the end."""
        goes = (steps(features, codec) * codec.fps > GOES).nonzero()
        still = Stay().clip(features, codec)
        if not len(goes):
            return still
        begin, end = int(goes[0]), int(goes[-1]) + 1
        most = _FASTEST_SPIN * (end - begin) / codec.fps
        done = torch.linspace(0.0, 1.0, end - begin + 1, dtype=torch.float64)
        angle = min(max(self.angle, -most), most) * done * done * (3.0 - 2.0 * done)
        still[begin:end, codec.groups["root_yaw"]] += (angle.diff() / YAW[codec.name])[:, None].to(still.dtype)
        return still

    def piece(self, features: Tensor, codec: FeatureCodec, turned: float, gone: float = 0.0) -> Tensor:
        """Features (F, D) of a piece of an endless motion, which turns on and on."""
        still = Stay().piece(features, codec, turned, gone)
        still[:, codec.groups["root_yaw"]] += math.copysign(_SPINS, self.angle) / codec.fps / YAW[codec.name]
        return still


@dataclass(frozen=True)
class During:
    """One of several things that are done on the way, one after the other, is bent.

    Args:
        steering: bends it.
        begin, end: its share of the time that a body is on its way.
    """

    steering: Steering
    begin: float
    end: float

    @property
    def seconds(self) -> float:
        """How long a whole motion is made, if nobody says."""
        return self.steering.seconds / (self.end - self.begin)

    @property
    def cuts(self) -> bool:
        """Whether it is made as long as that at least, and cut then."""
        return self.steering.cuts

    @property
    def says(self) -> str:
        """What is done, for users."""
        return self.steering.says

    def clip(self, features: Tensor, codec: FeatureCodec) -> Tensor:
        """Features (F, D) of a whole motion."""
        goes = (steps(features, codec) * codec.fps > GOES).double()
        time = goes.cumsum(0) / goes.sum().clamp_min(1.0)
        here = (time > self.begin) & (time <= self.end)
        if int(here.sum()) < 2:
            return features
        bent = features.clone()
        begin, end = int(here.nonzero()[0]), int(here.nonzero()[-1]) + 1
        bent[begin:end] = self.steering.clip(features[begin:end], codec)
        return bent

    def piece(self, features: Tensor, codec: FeatureCodec, turned: float, gone: float = 0.0) -> Tensor:
        """Features (F, D) of a piece of an endless motion, in which a sentence does one thing."""
        return self.steering.piece(features, codec, turned, gone)


@dataclass(frozen=True)
class Together:
    """Several, one after the other."""

    steering: tuple[Steering, ...]

    @property
    def seconds(self) -> float:
        """How long a whole motion is made, if nobody says."""
        return max((one.seconds for one in self.steering), default=0.0)

    @property
    def cuts(self) -> bool:
        """Whether it is made as long as that at least, and cut then."""
        return any(one.cuts for one in self.steering)

    @property
    def says(self) -> str:
        """What is done, for users."""
        return "; ".join(one.says for one in self.steering)

    def clip(self, features: Tensor, codec: FeatureCodec) -> Tensor:
        """Features (F, D) of a whole motion."""
        for one in self.steering:
            features = one.clip(features, codec)
        return features

    def piece(self, features: Tensor, codec: FeatureCodec, turned: float, gone: float = 0.0) -> Tensor:
        """Features (F, D) of a piece of an endless motion."""
        for one in self.steering:
            features = one.piece(features, codec, turned, gone)
        return features


def _scaled(features: Tensor, codec: FeatureCodec, share: float) -> Tensor:
    bent = features.clone()
    bent[:, codec.groups["root_yaw"]] *= share
    return bent
