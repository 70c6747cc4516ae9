"""Where a way goes that a sentence bends: onto a circle, by so many degrees in all, or nowhere.

A network that was never told of circles walks straight on, and turns as far as its takes did. Features of every codec
are seen from their own heading, so adding to their yaw step bends the way and leaves everything else as it was
made: steps, pace, and which feet stand (``cleanup.lock_feet`` and ``StreamDecoder`` hold those afterwards).

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

RADIUS = 1.5  # metres, of a circle in a motion without an end
_SURELY = math.radians(75.0)  # within which most of a turn is done; whoever turns in a stream turns by 95 at least
_TO_THE_END = 1.1  # so that those who turn as far as most do end at the angle, not short of it
_FASTEST = math.radians(120.0)  # a second, on a circle: a run leans into it, a walk trips
# What 1 is in a codec's features: radians to the left (T2M's half-angles turn the world, KIT-ML's in a mirror); metres.
_YAW = {"native": 1.0, "hml": -2.0, "kit": 2.0}
_METRES = {"native": 1.0, "hml": 1.0, "kit": 0.001}
_ENDS = ("hip", "ankle")  # of legs
_AHEAD = torch.tensor((0.0, 0.0, 1.0), dtype=torch.float64)
_TIGHTEST = 0.4  # metres, radius of a way; who stands and sways does not spin
_TURNING = math.radians(30.0)  # in all; whoever turns by less does not turn
_MOST = 2.0  # times as fast as it was made a turn is made


class Steering(Protocol):
    """Bends ways."""

    @property
    def says(self) -> str:
        """What is done, for users: "the way is bent to the left, onto a circle"."""

    def clip(self, features: Tensor, codec: FeatureCodec) -> Tensor:
        """Features (F, D) of a whole motion, bent."""

    def piece(self, features: Tensor, codec: FeatureCodec, turned: float) -> Tensor:
        """Features (F, D) of a piece of an endless motion, bent.

        Args:
            features: as they were made.
            codec: what they mean.
            turned: radians from where the sentence begins to where the piece does, in features as they were made.
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

    @property
    def says(self) -> str:
        """What is done, for users."""
        return f"the way is bent to the {_side(self.side)}, onto a circle"

    def clip(self, features: Tensor, codec: FeatureCodec) -> Tensor:
        """Features (F, D) of a whole motion, bent in proportion to the way that is gone.

        A way too short for its circle is bent as far as feet can follow.
        """
        if not self.once:
            return self.piece(features, codec, 0.0)
        way = _gone(features, codec)
        return _arc(features, codec, self.side * 2.0 * math.pi / way) if way > 0 else features

    def piece(self, features: Tensor, codec: FeatureCodec, turned: float) -> Tensor:
        """Features (F, D) of a piece of an endless motion, bent onto a circle of the radius."""
        return _arc(features, codec, self.side / self.radius)


@dataclass(frozen=True)
class Turn:
    """Whoever turns, turns by this angle in all."""

    angle: float

    @property
    def says(self) -> str:
        """What is done, for users."""
        return f"the way is bent to the {_side(self.angle)}, by {math.degrees(abs(self.angle)):.0f} degrees in all"

    def clip(self, features: Tensor, codec: FeatureCodec) -> Tensor:
        """Features (F, D) of a whole motion that ends at this angle to where it began.

        The turn that is there is made so much sharper, or wider; what that does not bring is added all along the way.
        Whoever stands turns no further.
        """
        turned = _turned(features, codec)
        share = self.angle / turned if turned * self.angle > 0 and abs(turned) >= _TURNING else 1.0
        features = _scaled(features, codec, min(share, _MOST))
        rest, way = self.angle - _turned(features, codec), _gone(features, codec)
        return _arc(features, codec, rest / way) if way > 0 else features

    def piece(self, features: Tensor, codec: FeatureCodec, turned: float) -> Tensor:
        """Features (F, D) of a piece of an endless motion, which comes nearer to the angle and stays there.

        However far the network turns by itself, the way ends there: whatever it has turned by is bent to hardly more
        than the angle (``_bent``). Within a piece that is spread along the way, so that hips sway as they did.
        """
        way = float(_steps(features, codec).sum())
        after = turned + _YAW[codec.name] * float(features[:, codec.groups["root_yaw"]].double().sum())
        added = (self._bent(after) - after) - (self._bent(turned) - turned)
        return _arc(features, codec, added / way) if way > 0 else features

    def _bent(self, turned: float) -> float:
        """The angle to which one is bent that was turned by."""
        return _TO_THE_END * abs(self.angle) * math.tanh(turned / _SURELY)


@dataclass(frozen=True)
class Stay:
    """Whoever goes steps on the spot: no way, and feet that rise and come down below the hips."""

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

    def piece(self, features: Tensor, codec: FeatureCodec, turned: float) -> Tensor:
        """Features (F, D) of a piece of an endless motion, on the spot."""
        return self.clip(features, codec)


def _side(side: float) -> str:
    return "left" if side > 0 else "right"


def _turned(features: Tensor, codec: FeatureCodec) -> float:
    """From the first frame to the last; the last step leads out of the motion."""
    return _YAW[codec.name] * float(features[:-1, codec.groups["root_yaw"]].double().sum())


def _gone(features: Tensor, codec: FeatureCodec) -> float:
    """Metres from the first frame to the last, along the way."""
    return float(_steps(features, codec)[:-1].sum())


def _steps(features: Tensor, codec: FeatureCodec) -> Tensor:
    """Metres (F,) to the next frame."""
    return features[:, codec.groups["root_velocity"]].double().norm(dim=1) * _METRES[codec.name]


def _scaled(features: Tensor, codec: FeatureCodec, share: float) -> Tensor:
    bent = features.clone()
    bent[:, codec.groups["root_yaw"]] *= share
    return bent


def _arc(features: Tensor, codec: FeatureCodec, curvature: float) -> Tensor:
    """Bent by ``curvature`` radians a metre, but within ``_TIGHTEST`` and ``_FASTEST``."""
    most = _FASTEST / codec.fps
    curvature = min(max(curvature, -1.0 / _TIGHTEST), 1.0 / _TIGHTEST)
    bend = (curvature * _steps(features, codec)).clamp(-most, most)
    bent = features.clone()
    bent[:, codec.groups["root_yaw"]] += (bend / _YAW[codec.name])[:, None].to(bent.dtype)
    return bent
