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
_TURNING = math.radians(30.0)  # in all; whoever turns by less does not turn
_MOST = 2.0  # times as fast as it was made a turn is made


class Steering(Protocol):
    """Bends ways."""

    @property
    def says(self) -> str:
        """What is done, for users: "the way is bent to the left, onto a circle"."""

    @property
    def seconds(self) -> float:
        """How long a whole motion should be made that is cut to what is said of it; 0 where nothing is cut."""

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
        """How long a whole motion should be made; 0 where nothing is cut."""
        return self.steering.seconds

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
        """How long a whole motion should be made; 0 where nothing is cut."""
        return max((one.seconds for one in self.steering), default=0.0)

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
