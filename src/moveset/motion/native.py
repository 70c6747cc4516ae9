"""The ``native`` features: a motion seen from its own heading, with true rotations (269 numbers a frame on hml22).

Layout for J joints (F frames, D = 4 + 6J + 3(J-1) + 3J + 4):

====================  ======  =====================================================================================
root                  4       yaw step to the next frame (rad), planar step to the next frame in this frame's heading
                              (x, z, metres), height (metres)
rotations             6J      the pelvis relative to the heading, every other joint relative to its parent; two matrix
                              columns each (arXiv 1812.07035)
positions             3(J-1)  joints 1..J-1 relative to the root's ground point, in the heading frame, metres
velocities            3J      step of every joint to the next frame, in this frame's heading, metres
contacts              4       left ankle, left toe, right ankle, right toe: 1 = planted
====================  ======  =====================================================================================

Everything is invariant to the heading and the planar position of the clip, so a crop of features is the features of
the crop. Decoding uses the root and the rotations alone; the rest is there to be learned from. The last frame's steps
repeat those of the frame before.
"""

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.contacts import PLANTED, foot_contacts
from moveset.motion.features import grouped, integrated
from moveset.motion.kinematics import fk_matrices
from moveset.motion.skeleton import HML22, Skeleton


class NativeCodec:
    """Motions on hml22 at 20 fps to heading-invariant features and back."""

    name = "native"
    skeleton: Skeleton = HML22
    fps = 20.0

    def __init__(self) -> None:
        joints = len(self.skeleton)
        self.groups = grouped(
            root_yaw=1, root_velocity=2, root_height=1, rotations=6 * joints, positions=3 * (joints - 1),
            velocities=3 * joints, contacts=4,
        )  # fmt: skip
        self.dim = self.groups["contacts"].stop

    def mirror(self) -> tuple[Tensor, Tensor]:
        """(D,) order and (D,) signs: ``x[..., order] * signs`` are the features of the mirrored motion."""
        joints, sides = torch.tensor(self.skeleton.mirror_order), torch.tensor((-1.0, 1.0, 1.0))
        axes, columns = torch.arange(3), torch.arange(6)
        below = joints[1:] - 1
        parts = {
            "root_yaw": (torch.zeros(1).long(), -torch.ones(1)),
            "root_velocity": (torch.arange(2), sides[[0, 2]]),
            "root_height": (torch.zeros(1).long(), torch.ones(1)),
            # A mirrored rotation has the entries s_i s_j R_ij.
            "rotations": (joints[:, None] * 6 + columns, (sides[:2, None] * sides).flatten().repeat(len(joints))),
            "positions": (below[:, None] * 3 + axes, sides.repeat(len(below))),
            "velocities": (joints[:, None] * 3 + axes, sides.repeat(len(joints))),
            "contacts": (torch.tensor((2, 3, 0, 1)), torch.ones(4)),
        }
        order = torch.cat([self.groups[name].start + rows.flatten() for name, (rows, _) in parts.items()])
        return order, torch.cat([signs for _, signs in parts.values()])

    def encode(self, motion: Motion) -> Tensor:
        """Features (F, D) of a motion of F >= 2 frames.

        Raises:
            InputError: another skeleton, another frame rate, or a single frame.
        """
        # Bones may have other lengths, for bodies differ; the tree may not, whatever it is called.
        known = motion.skeleton.name == self.skeleton.name and motion.skeleton.parents == self.skeleton.parents
        if not known or motion.fps != self.fps or len(motion) < 2:
            raise InputError(
                f"native features need at least 2 frames on {self.skeleton.name!r} ({len(self.skeleton)} joints) at "
                f"{self.fps:g} fps; got {len(motion)} on {motion.skeleton.name!r} ({len(motion.skeleton)} joints) at "
                f"{motion.fps:g} (retarget and resample it first)"
            )
        heading = rotations.heading(motion.rotations[:, 0])
        back = rotations.inv(heading)
        turn = rotations.heading_angle(rotations.mul(heading[1:], back[:-1]))
        local = torch.cat((rotations.mul(back, motion.rotations[:, 0])[:, None], motion.rotations[:, 1:]), dim=1)
        joints = motion.joints
        steps = rotations.rotate(back[:-1, None], joints[1:] - joints[:-1])
        ground = motion.root * motion.root.new_tensor((1.0, 0.0, 1.0))
        positions = rotations.rotate(back[:, None], joints[:, 1:] - ground[:, None])
        frames = len(motion)
        return torch.cat(
            (
                _hold(turn)[:, None],
                _hold(steps[:, 0, [0, 2]]),
                motion.root[:, 1:2],
                rotations.to_6d(local).reshape(frames, -1),
                positions.reshape(frames, -1),
                _hold(steps).reshape(frames, -1),
                foot_contacts(joints, motion.fps, self.skeleton).to(joints.dtype),
            ),
            dim=-1,
        )

    def decode(self, features: Tensor) -> Motion:
        """The motion of features (F, D), starting above the origin and facing +Z."""
        heading, root = self.root_path(features)
        turned = rotations.from_6d(self._six(features))
        turned[..., 0, :] = rotations.yawed(turned[..., 0, :], heading)
        return Motion(turned, root, self.fps, self.skeleton)

    def joints(self, features: Tensor) -> Tensor:
        """World positions (..., F, J, 3) of features (..., F, D), differentiable."""
        heading, root = self.root_path(features)
        still = rotations.rotate(rotations.yaw(heading)[..., None, :], self.posture(features))
        ground = root * root.new_tensor((1.0, 0.0, 1.0))
        return still + ground[..., None, :]

    def posture(self, features: Tensor) -> Tensor:
        """Joint positions (..., F, J, 3) above the root's ground point, in the heading frame, from the rotations."""
        height = features[..., self.groups["root_height"]]
        root = torch.cat((torch.zeros_like(height), height, torch.zeros_like(height)), dim=-1)
        return fk_matrices(rotations.matrix_from_6d(self._six(features)), root, self.skeleton)

    def root_path(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Heading angle (..., F) in radians and root position (..., F, 3), integrated from zero."""
        heading = integrated(features[..., self.groups["root_yaw"]])[..., 0]
        step = features[..., self.groups["root_velocity"]]
        sin, cos = torch.sin(heading), torch.cos(heading)
        x = step[..., 0] * cos + step[..., 1] * sin
        z = step[..., 1] * cos - step[..., 0] * sin
        planar = integrated(torch.stack((x, z), dim=-1))
        height = features[..., self.groups["root_height"]]
        return heading, torch.cat((planar[..., :1], height, planar[..., 1:]), dim=-1)

    def with_steps(self, features: Tensor, change_S2: Tensor) -> Tensor:
        """Features (F, D) whose root goes further by (x, z) metres at each step; see ``FeatureCodec``."""
        # Steps are in the heading of the frame that they lead from.
        heading_F = self.root_path(features)[0]
        sin_S, cos_S = heading_F[:-1].sin(), heading_F[:-1].cos()
        x_S, z_S = change_S2.unbind(-1)
        local_S2 = torch.stack((x_S * cos_S - z_S * sin_S, x_S * sin_S + z_S * cos_S), dim=1)
        moved, steps = features.clone(), self.groups["root_velocity"]
        moved[:-1, steps] += local_S2
        moved[-1, steps] += local_S2[-1]
        return moved

    def planted(self, features: Tensor) -> Tensor:
        """Which feet stand, (F, 4) bool, by the features' own account."""
        return features[..., self.groups["contacts"]] > PLANTED

    def _six(self, features: Tensor) -> Tensor:
        return features[..., self.groups["rotations"]].unflatten(-1, (len(self.skeleton), 6))


def _hold(steps: Tensor) -> Tensor:
    """Repeat the last step, so that F - 1 steps become F rows."""
    return torch.cat((steps, steps[-1:]))
