"""Features of an endless motion to ``Motion`` pieces, segment by segment, in constant memory.

n frames of a segment, D features, J joints. The last frame of a segment steps to the first frame of the next one, so
the pieces laid end to end are what decoding all features at once would give: only heading and place are carried, in
double precision. Pieces are float64 too, which a walk of kilometres needs to stay as smooth as it began.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.clip import Motion, concatenate
from moveset.motion.features import FeatureCodec
from moveset.motion.smoothing import decay

_SEAM = 0.5  # frames from the seam to either neighbour
_TAIL = 3  # frames on either side of a seam by which it is judged


class IncrementalDecoder:
    """Decodes segments one after the other; each goes on from where the one before it ended.

    Args:
        blend_seconds: 0 decodes the segments as they are. Above 0 a jump of pose or speed from one segment to the next
            becomes an offset that dies away within this time after the seam (``smoothing.decay``), or within the
            segment if that is shorter; a segment that goes on smoothly stays as it is. The path that is carried is not
            touched.

    Raises:
        InputError: a negative duration.
    """

    def __init__(self, codec: FeatureCodec, blend_seconds: float = 0.0) -> None:
        if not 0.0 <= blend_seconds < math.inf:
            raise InputError(f"cannot blend over {blend_seconds} s; give a duration such as 0.3, or 0 for none")
        self.codec = codec
        self.blend_seconds = blend_seconds
        self._heading = 0.0
        self._x = 0.0
        self._z = 0.0
        # The last frames that were given out, as they were given out, and the hardest jerk of the last segment.
        self._tail: Motion | None = None
        self._jerk = 0.0

    def __call__(self, features: Tensor) -> Motion:
        """The next piece, float64 on the CPU, of unnormalised features (n, D).

        Raises:
            InputError: no frames, another width, or features that are not finite.
        """
        if features.ndim != 2 or len(features) < 1 or features.shape[1] != self.codec.dim:
            raise InputError(f"a segment must be (n, {self.codec.dim}) with n >= 1, got {tuple(features.shape)}")
        features = features.detach().cpu().double()
        turn = rotations.yaw(torch.tensor(self._heading, dtype=torch.float64))
        # One frame more than there is, so that the path ends where the next segment begins.
        heading, root = self.codec.root_path(torch.cat((features, features[-1:])))
        local = self.codec.decode(features)
        local = replace(local, rotations=local.rotations.double(), root=local.root.double())
        piece = local.transformed(turn, turn.new_tensor((self._x, 0.0, self._z)))
        end = rotations.rotate(turn, root[-1])
        self._heading = math.remainder(self._heading + float(heading[-1]), 2.0 * math.pi)
        self._x += float(end[0])
        self._z += float(end[2])
        return self._blended(piece) if self.blend_seconds > 0 else piece

    def state(self) -> dict[str, Any]:
        """Everything that the next piece depends on, as numbers and lists that survive JSON exactly."""
        tail = self._tail
        return {
            "blend_seconds": self.blend_seconds,
            "heading": self._heading,
            "x": self._x,
            "z": self._z,
            "tail_rotations": tail.rotations.tolist() if tail else [],
            "tail_root": tail.root.tolist() if tail else [],
            "tail_jerk": self._jerk,
        }

    @classmethod
    def from_state(cls, codec: FeatureCodec, state: Mapping[str, Any]) -> "IncrementalDecoder":
        """A decoder that goes on where the one whose ``state()`` this is stood."""
        decoder = cls(codec, state["blend_seconds"])
        decoder._heading, decoder._x, decoder._z = state["heading"], state["x"], state["z"]
        if state["tail_root"]:
            turned, root = (torch.tensor(state[k], dtype=torch.float64) for k in ("tail_rotations", "tail_root"))
            decoder._tail, decoder._jerk = Motion(turned, root, codec.fps, codec.skeleton), state["tail_jerk"]
        return decoder

    def _blended(self, piece: Motion) -> Motion:
        """The piece with what it lacks at the seam to be the continuation of the tail, dying away."""
        tail, jerk = self._tail, _hardest(piece)
        # A seam that jerks no more than the segments on both sides do themselves stays as it is.
        if (
            tail is not None
            and min(len(tail), len(piece)) > 1
            and _hardest(concatenate([tail, piece[:_TAIL]])) > max(self._jerk, jerk)
        ):
            # Differences of frames are speeds half a frame inside; at the seam both sides are taken to keep them.
            spin = rotations.to_rotvec(rotations.mul(tail.rotations[-1], rotations.inv(tail.rotations[-2])))
            new_spin = rotations.to_rotvec(rotations.mul(piece.rotations[1], rotations.inv(piece.rotations[0])))
            step, new_step = tail.root[-1] - tail.root[-2], piece.root[1] - piece.root[0]
            end = rotations.mul(rotations.from_rotvec(_SEAM * spin), tail.rotations[-1])
            start = rotations.mul(rotations.from_rotvec(-_SEAM * new_spin), piece.rotations[0])
            turn = rotations.to_rotvec(rotations.mul(end, rotations.inv(start)))
            shift = (tail.root[-1] + _SEAM * step) - (piece.root[0] - _SEAM * new_step)
            count = min(math.ceil(self.blend_seconds * piece.fps), len(piece))
            at = torch.arange(count, dtype=torch.float64) + _SEAM
            turned, root = piece.rotations.clone(), piece.root.clone()
            offset = decay(turn, spin - new_spin, count + _SEAM, at)
            turned[:count] = rotations.mul(rotations.from_rotvec(offset), turned[:count])
            root[:count] += decay(shift, step - new_step, count + _SEAM, at)
            piece = Motion(rotations.normalize(turned), root, piece.fps, piece.skeleton)
        last = [piece[-_TAIL:]] if tail is None else [tail, piece[-_TAIL:]]
        self._tail, self._jerk = concatenate(last)[-_TAIL:], jerk
        return piece


def _hardest(motion: Motion) -> float:
    """The largest third difference, mean over joints; 0 for fewer than four frames."""
    if len(motion) < 4:
        return 0.0
    return float(torch.diff(motion.joints, n=3, dim=0).norm(dim=-1).mean(dim=-1).max())
