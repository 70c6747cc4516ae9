"""Segments of features to the motion that a stream gives out: continued, seams blended, feet held.

n frames of a segment, D features.
"""

from collections.abc import Mapping
from copy import copy
from typing import Any

from torch import Tensor

from moveset.motion.clip import Motion
from moveset.motion.features import FeatureCodec
from moveset.motion.foot_lock import FootLock
from moveset.motion.hold_root import hold_root
from moveset.motion.incremental import IncrementalDecoder


class StreamDecoder:
    """Decodes segments one after the other; each goes on from where the one before it ended.

    Args:
        blend_seconds: within which a jump from one segment to the next dies away (``IncrementalDecoder``).
        foot_lock: hold planted feet in place, and the root over them.

    Raises:
        InputError: a negative duration.
    """

    def __init__(self, codec: FeatureCodec, blend_seconds: float = 0.0, *, foot_lock: bool = True) -> None:
        self.codec = codec
        self._foot_lock = foot_lock
        self._pieces = IncrementalDecoder(codec, blend_seconds)
        self._feet = FootLock(codec.skeleton, codec.fps)

    def __call__(self, features: Tensor) -> Motion:
        """The next piece, float64 on the CPU, of unnormalised features (n, D).

        Raises:
            InputError: no frames, another width, or features that are not finite.
        """
        if not self._foot_lock:
            return self._pieces(features)
        planted = self.codec.planted(features)
        return self._feet(self._pieces(hold_root(features, planted, self.codec)), planted)

    def go_on_from(self, features: Tensor, heading: float, x: float, z: float) -> None:
        """Begin behind a given motion, which is not held: its features (n, D), and where its first frame is."""
        place = {"heading": heading, "x": x, "z": z}
        self._pieces = IncrementalDecoder.from_state(self.codec, {**self._pieces.state(), **place})
        self._feet(self._pieces(features), self.codec.planted(features))

    def copy(self) -> "StreamDecoder":
        # The decoder of pieces replaces what it remembers; the foot lock writes into it.
        other = copy(self)
        other._pieces = copy(self._pieces)
        other._feet = FootLock.from_state(self.codec.skeleton, self.codec.fps, self._feet.state())
        return other

    def state(self) -> dict[str, Any]:
        """Everything that the next piece depends on, as numbers and lists that survive JSON exactly."""
        return {"decoder": self._pieces.state(), "feet": self._feet.state()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on where the one whose ``state()`` this is stood."""
        self._pieces = IncrementalDecoder.from_state(self.codec, state["decoder"])
        self._feet = FootLock.from_state(self.codec.skeleton, self.codec.fps, state["feet"])
