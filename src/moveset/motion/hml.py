"""HumanML3D's 263 and KIT-ML's 251 features, with all their quirks, so that public data, evaluators and figures keep
their meaning here (Guo et al. 2022, "Generating Diverse and Natural 3D Human Motions from Text").

Layout for J joints; T frames of positions give F = T - 1 rows, all steps are per frame, lengths in metres (KIT-ML: mm).

=============  =======  ==========================================================================================
root_yaw       1        step of the heading to the next frame as a half-angle (rad)
root_velocity  2        planar step of the root to the next frame, seen in the *next* frame's heading (x, z)
root_height    1        height of the root
positions      3(J-1)   joints 1..J-1, planar relative to the root, height absolute, heading turned to +Z
rotations      6(J-1)   joints 1..J-1, two matrix columns of a shortest-arc rotation (no twist; see below)
velocities     3J       step of every joint to the next frame, seen in this frame's heading
contacts       4        left ankle, left toe, right ankle, right toe
=============  =======  ==========================================================================================

Quirks kept on purpose; features "corrected" in any of them no longer fit the public statistics and evaluators:

* The per-frame heading takes the hips with the wrong sign (so they work against the shoulders) and is smoothed over
  time with a Gaussian of 20 frames. It deviates from where the body faces by ten degrees on average.
* The heading of frame 0 is overwritten with +Z, so the first row holds a jump of the heading that nobody made.
* Rotations are shortest arcs in the *world*, made local with the heading's rotation in the wrong sense: they change
  when the clip is turned (everything else does not), hold no twist, and do not fit other skeletons.
* The yaw step is the arcsine of a quaternion's y, whose sign flips where the heading passes straight backward (-Z):
  that step is recovered with the wrong sign, and the rest of the clip is turned by twice its angle.
* Contacts ask for speed alone, loosely: below 0.89 m/s (KIT-ML: 2.8 mm/s, which is hardly ever).
"""

from collections.abc import Sequence
from functools import cached_property
from itertools import accumulate, pairwise

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.contacts import foot_contacts
from moveset.motion.features import grouped, integrated
from moveset.motion.hml_skeletons import HmlConvention
from moveset.motion.positions import positions_to_motion
from moveset.motion.skeleton import Skeleton
from moveset.motion.smoothing import gaussian_smooth

_SMOOTHING = 20.0  # frames, the Gaussian's standard deviation


class HmlCodec:
    """Motions and joint positions to HumanML3D or KIT-ML features and back.

    ``joints`` and ``encode_clips`` speak the dataset's own axes (in metres). KIT-ML's are a mirror image: its joints
    named left lie at -X of a body that faces +Z. ``encode`` and ``decode`` reflect, so that motions are right-handed.

    Args:
        convention: ``hml_skeletons.HUMANML3D`` or ``KIT_ML``.
    """

    def __init__(self, convention: HmlConvention) -> None:
        self.convention = convention
        self.name: str = convention.name
        self.skeleton: Skeleton = convention.skeleton
        self.fps: float = convention.fps
        self.lengths = convention.lengths.double()
        joints = len(self.skeleton)
        self.groups: dict[str, slice] = grouped(
            root_yaw=1, root_velocity=2, root_height=1, positions=3 * (joints - 1), rotations=6 * (joints - 1),
            velocities=3 * joints, contacts=4,
        )  # fmt: skip
        self.dim: int = self.groups["contacts"].stop

    def encode(self, motion: Motion) -> Tensor:
        """Features (F - 1, D) of a motion of F >= 2 frames, re-posed onto the dataset's body.

        Raises:
            InputError: another skeleton, another frame rate, or a single frame.
        """
        if motion.skeleton.name != self.skeleton.name or motion.fps != self.fps:
            raise InputError(
                f"{self.name} features need motion on {self.skeleton.name!r} at {self.fps:g} fps; got "
                f"{motion.skeleton.name!r} at {motion.fps:g} (retarget and resample it first)"
            )
        return self.encode_world([motion.joints])[0]

    def encode_clips(self, clips: Sequence[Tensor], uniform: bool = True) -> list[Tensor]:
        """Features (T_i - 1, D), float32, of clips of joint positions (T_i, J, 3) in metres; computed in float64.

        Several clips at once have the numbers that each has alone, many times as fast where they are short.

        Args:
            clips: Y up, in the dataset's axes.
            uniform: re-pose onto the dataset's body first, as the datasets did; off for joints that already are.

        Raises:
            InputError: another shape, fewer than two frames, or values that are not finite.
        """
        count = len(self.skeleton)
        for joints in clips:
            if joints.ndim != 3 or len(joints) < 2 or tuple(joints.shape[1:]) != (count, 3):
                raise InputError(f"{self.name} features need joints (T >= 2, {count}, 3); got {tuple(joints.shape)}")
            if not torch.isfinite(joints).all():
                raise InputError("joint positions must be finite; repair or cut the clip")
        if not clips:
            return []
        # The clips lie end to end; what looks along time looks at each by itself.
        lengths = [len(joints) for joints in clips]
        p = torch.cat([joints.detach().double().cpu() for joints in clips])
        p = self._on_ground((self._uniform(p, lengths) if uniform else p) / self.convention.unit, lengths)

        q = self._headings(p, lengths)
        step = p[1:] - p[:-1]
        turn = rotations.mul(q[1:], rotations.inv(q[:-1]))
        root_step = rotations.rotate(q[1:], step[:, 0])
        around = p.clone()
        around[..., [0, 2]] -= p[:, :1, [0, 2]]
        around = rotations.rotate(q[:, None], around)
        contacts = (step[:, list(self.convention.feet)] ** 2).sum(-1) < self.convention.contact
        rows = (
            torch.arcsin(turn[:, 1:2].clamp(-1.0, 1.0)),
            root_step[:, [0, 2]],
            p[:-1, 0, 1:2],
            around[:-1, 1:].flatten(1),
            rotations.to_6d(self._locals(p, q))[:-1, 1:].flatten(1),
            rotations.rotate(q[:-1, None], step).flatten(1),
            contacts.double(),
        )
        features = torch.cat(rows, dim=-1).float()
        # The row between two clips belongs to neither.
        starts = _starts(lengths)
        return [features[start : start + length - 1] for start, length in zip(starts, lengths, strict=True)]

    def encode_world(self, clips: Sequence[Tensor]) -> list[Tensor]:
        """Features of clips of joints (T_i, J, 3) in the axes of ``Motion``, re-posed onto the dataset's body.

        Raises:
            InputError: as ``encode_clips``.
        """
        return self.encode_clips([joints.double() * self.reflection for joints in clips])

    def joints(self, features: Tensor) -> Tensor:
        """Joint positions (..., F, J, 3) in metres from the root and position columns alone; differentiable."""
        heading, root = self._root(features)
        around = features[..., self.groups["positions"]].unflatten(-1, (-1, 3))
        ground = root * root.new_tensor((1.0, 0.0, 1.0))
        placed = rotations.rotate(rotations.inv(heading)[..., None, :], around) + ground[..., None, :]
        return torch.cat((root[..., None, :], placed), dim=-2) * self.convention.unit

    def decode(self, features: Tensor) -> Motion:
        """The motion of features (F, D): joint positions fitted with rotations (see ``positions_to_motion``)."""
        joints = self.joints(features.detach().double()) * self.reflection
        return positions_to_motion(joints, self.fps, self.skeleton)

    def root_path(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Heading angle (..., F) in radians and root position (..., F, 3) in metres, in the axes of ``Motion``."""
        heading = -2.0 * self.reflection[0].item() * integrated(features[..., self.groups["root_yaw"]])[..., 0]
        return heading, self._root(features)[1] * self.convention.unit * self.reflection.to(features)

    def with_steps(self, features: Tensor, change_S2: Tensor) -> Tensor:
        """Features (F, D) whose root goes further by (x, z) metres at each step; see ``FeatureCodec``."""
        heading, _ = self._root(features)
        x_S, z_S = (change_S2 * self.reflection[[0, 2]].to(features) / self.convention.unit).unbind(-1)
        # Steps are seen in the heading of the frame that they lead to.
        step = rotations.rotate(heading[1:], torch.stack((x_S, torch.zeros_like(x_S), z_S), dim=-1))
        moved, steps = features.clone(), self.groups["root_velocity"]
        moved[:-1, steps] += step[:, [0, 2]]
        moved[-1, steps] += step[-1, [0, 2]]
        return moved

    def planted(self, features: Tensor) -> Tensor:
        """Which feet stand, (F, 4) bool, by where they are: the features' contacts only say which ones are slow."""
        return foot_contacts(self.joints(features) * self.reflection.to(features), self.fps, self.skeleton)

    @cached_property
    def reflection(self) -> Tensor:
        """(3,) what takes positions in the dataset's axes to those of ``Motion``, and back."""
        return torch.tensor((-1.0 if self.convention.reflected else 1.0, 1.0, 1.0), dtype=torch.float64)

    def _uniform(self, p: Tensor, lengths: Sequence[int]) -> Tensor:
        """Each clip on the dataset's body: same bone directions, its bone lengths, root path scaled by the legs.

        The datasets get here by inverse and forward kinematics with shortest arcs, which keep every direction.
        """
        parents = self.skeleton.parents
        legs = list(self.convention.legs)
        first = p[_starts(lengths)]
        own = (first[:, legs] - first[:, [parents[j] for j in legs]]).norm(dim=-1).sum(dim=-1)
        placed = {0: p[:, 0] * _each_frame(self.lengths[legs].sum() / own, lengths)[:, None]}
        for chain in self.convention.chains:
            for above, joint in pairwise(chain):
                bone = torch.nn.functional.normalize(p[:, joint] - p[:, above], dim=-1)
                placed[joint] = placed[above] + bone * self.lengths[joint]
        return torch.stack([placed[j] for j in range(len(parents))], dim=1)

    def _on_ground(self, p: Tensor, lengths: Sequence[int]) -> Tensor:
        """Lowest joint of each clip at y = 0, frame 0 above the origin and facing +Z by its hips and shoulders."""
        start = p[_starts(lengths), 0].clone()
        start[:, 1] = torch.stack([clip[..., 1].min() for clip in p.split(list(lengths))])
        p = p - _each_frame(start, lengths)[:, None]
        hip, other_hip, shoulder, other_shoulder = p[_starts(lengths)][:, list(self.convention.face)].unbind(1)
        turn = _front_to_z(_forward(hip - other_hip + shoulder - other_shoulder))
        return rotations.rotate(_each_frame(turn, lengths)[:, None], p)

    def _headings(self, p: Tensor, lengths: Sequence[int]) -> Tensor:
        """(T, 4) rotations that take each frame's smoothed forward to +Z; identity at frame 0. Hips in wrong order."""
        hip, other_hip, shoulder, other_shoulder = p[:, list(self.convention.face)].unbind(1)
        across = torch.nn.functional.normalize(other_hip - hip + shoulder - other_shoulder, dim=-1)
        forward = _forward(across).split(list(lengths))
        q = _front_to_z(torch.cat([gaussian_smooth(clip, _SMOOTHING) for clip in forward]))
        q[_starts(lengths)] = rotations.identity(1)[0].to(q)
        return q

    def _locals(self, p: Tensor, q: Tensor) -> Tensor:
        """(T, J, 4) rotations: each bone's shortest arc from its canonical direction, relative to the one before."""
        local = rotations.identity(len(p), len(self.convention.directions)).to(p)
        for chain in self.convention.chains:
            above_turn = q
            for above, joint in pairwise(chain):
                bone = p[:, joint] - p[:, above]
                turn = rotations.between(self.convention.directions[joint], bone)
                local[:, joint] = rotations.mul(rotations.inv(above_turn), turn)
                above_turn = turn
        return local

    def _root(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Heading (..., F, 4) and root path (..., F, 3) in the dataset's unit, integrated from frame 0."""
        half = integrated(features[..., self.groups["root_yaw"]])[..., 0]
        heading = rotations.yaw(2.0 * half)
        step = features[..., self.groups["root_velocity"]]
        step = torch.stack((step[..., 0], torch.zeros_like(half), step[..., 1]), dim=-1)
        # Row t's step is seen in the heading of row t + 1.
        turned = rotations.rotate(rotations.inv(heading[..., 1:, :]), step[..., :-1, :])
        path = torch.cat((torch.zeros_like(step[..., :1, :]), torch.cumsum(turned, dim=-2)), dim=-2)
        height = features[..., self.groups["root_height"]]
        return heading, torch.cat((path[..., :1], height, path[..., 2:]), dim=-1)


def _starts(lengths: Sequence[int]) -> list[int]:
    """Where each of the clips begins that lie end to end."""
    return [end - length for end, length in zip(accumulate(lengths), lengths, strict=True)]


def _each_frame(of_clips: Tensor, lengths: Sequence[int]) -> Tensor:
    return of_clips.repeat_interleave(torch.tensor(lengths), dim=0)


def _forward(across: Tensor) -> Tensor:
    """Y × across: the horizontal direction in front of a body whose right-hand side is at ``across``."""
    return torch.stack((across[..., 2], torch.zeros_like(across[..., 0]), -across[..., 0]), dim=-1)


def _front_to_z(forward: Tensor) -> Tensor:
    return rotations.between(forward, forward.new_tensor((0.0, 0.0, 1.0)))
