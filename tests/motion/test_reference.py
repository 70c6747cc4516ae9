"""Laws of how bodies stand: axes of joints, zero pose, up axis, facing and size of a file change nothing."""

from dataclasses import replace

import pytest
import torch

from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.reference import find_reference, upright
from moveset.motion.retarget import retarget
from moveset.motion.rigs import get_rig
from tests.motion.other_axes import with_other_axes
from tests.motions import gait

pytestmark = pytest.mark.filterwarnings("ignore:.*was worked out")


def foreign(rig: str) -> Motion:
    """A walk on a skeleton that is none of the built-in ones, though like one."""
    walk = retarget(gait(40), rig)
    return replace(walk, skeleton=replace(walk.skeleton, name="foreign"))


def with_rest_first(motion: Motion) -> Motion:
    still = rotations.identity(1, len(motion.skeleton))
    return replace(
        motion, rotations=torch.cat((still, motion.rotations)), root=torch.cat((motion.root[:1], motion.root))
    )


@pytest.mark.parametrize("rig", ["mixamo", "vrm", "ue5", "smpl"])
@pytest.mark.parametrize("seed", [1, 2])
def test_axes_of_joints_do_not_matter(rig, seed):
    """Where a frame shows how the body rests, results are equal; else nearly so."""
    walk = foreign(rig)
    plain = retarget(walk, "hml22")
    shown = with_rest_first(walk)
    there = retarget(with_other_axes(shown, seed), "hml22")
    assert (there.joints - retarget(shown, "hml22").joints).abs().max() < 1e-4
    guessed = retarget(with_other_axes(walk, seed), "hml22")
    assert (guessed.joints - plain.joints).norm(dim=-1).max() < 0.04
    again = retarget(with_other_axes(walk, seed + 10), "hml22")
    assert (again.joints - guessed.joints).abs().max() < 1e-4
    assert rotations.angle(rotations.mul(rotations.inv(again.rotations), guessed.rotations)).max() < 2e-3


@pytest.mark.parametrize("axis", ["x", "y", "z"])
@pytest.mark.parametrize("degrees", [90.0, 180.0, -90.0])
def test_up_axis_and_facing_of_a_file_do_not_matter(axis, degrees):
    """The whole file turned, rest pose and all: the walk is the same, upright, but for its way over the ground."""
    walk = foreign("mixamo")
    turn = rotations.about(axis, degrees)
    offsets = rotations.rotate(turn, walk.skeleton.offsets)
    local = rotations.mul(rotations.mul(turn, walk.rotations), rotations.inv(turn))
    there = Motion(local, rotations.rotate(turn, walk.root), walk.fps, replace(walk.skeleton, offsets=offsets))
    result = retarget(there, "hml22").canonical()
    assert (result.joints - retarget(walk, "hml22").canonical().joints).abs().max() < 1e-4
    body = upright(there)
    assert torch.allclose(body.skeleton.rest_positions, walk.skeleton.rest_positions, atol=1e-5)
    back = retarget(retarget(walk, "hml22"), there.skeleton)
    assert (back.joints - retarget(walk, there.skeleton).joints).abs().max() < 1e-4


@pytest.mark.parametrize("turn", [("x", 90.0), ("x", -90.0), ("z", 90.0)])
def test_a_world_turned_over_below_an_upright_rest_pose_is_seen(turn):
    walk = foreign("mixamo")
    over = walk.transformed(rotations.about(*turn), torch.zeros(3))
    assert (retarget(over, "hml22").canonical().joints - retarget(walk, "hml22").canonical().joints).abs().max() < 1e-4


@pytest.mark.parametrize("place", [(3.0, 0.1, 0.0), (-1.7, 0.1, 2.0)])
def test_who_lies_all_the_time_is_left_lying(place):
    walk = foreign("mixamo")
    lying = walk.transformed(rotations.about("z", 90.0), torch.zeros(3))
    lying = replace(lying, root=0.02 * (lying.root - lying.root[:1]) + torch.tensor(place))
    assert upright(lying) is lying
    assert upright(other := with_other_axes(lying, 1)) is other


def test_a_frame_that_shows_a_t_pose_is_found_and_made_the_rest_pose():
    walk = with_other_axes(with_rest_first(foreign("mixamo")), 5)
    assert find_reference(walk).how == "T-pose"
    assert find_reference(walk[1:]).how == "derived"
    with pytest.warns(UserWarning, match="stands neither at rest nor in any frame"):
        retarget(walk[1:], "hml22")


@pytest.mark.parametrize("scale", [0.3, 2.5])
def test_size_does_not_matter(scale):
    walk = foreign("mixamo")
    other = replace(
        walk, root=scale * walk.root, skeleton=replace(walk.skeleton, offsets=scale * walk.skeleton.offsets)
    )
    assert (retarget(other, "hml22").joints - retarget(walk, "hml22").joints).abs().max() < 1e-4


def test_up_and_facing_overrule():
    walk = foreign("mixamo")
    lying = upright(walk, up="z")
    assert torch.allclose(lying.root[:, 1], walk.root[:, 2], atol=1e-6)
    back = upright(walk, facing="-z")
    assert torch.allclose(back.root[:, 2], -walk.root[:, 2], atol=1e-6)
    with pytest.raises(InputError, match="axis 'q' is not one of"):
        upright(walk, up="q")
    with pytest.raises(InputError, match="lie along one axis"):
        upright(walk, up="z", facing="-z")


def test_a_facing_goes_with_the_up_axis_that_is_found():
    """Also for a body that does not stand at rest: its world is turned."""
    for walk in (foreign("mixamo"), with_other_axes(foreign("mixamo"), 3)):
        z_up = walk.transformed(rotations.about("x", 90.0), torch.zeros(3))
        back = upright(z_up, facing="-y")
        assert torch.allclose(back.joints, walk.joints, atol=1e-5)


def test_onto_a_skeleton_with_other_axes_and_back():
    """A target without a standing rest pose is stood up by its bones alone."""
    walk = retarget(gait(40), "mixamo")
    along_x = with_other_axes(replace(walk, skeleton=replace(walk.skeleton, name="foreign")), 3)
    there = retarget(gait(40), along_x.skeleton)
    toes = there.joints[:, [j for j, n in enumerate(there.skeleton.joints) if n.endswith("ToeBase")]]
    hips = there.joints[:, 0]
    assert (hips[:, 1:2] - toes[..., 1]).min() > 0.5
    assert get_rig("mixamo").joints == there.skeleton.joints
