"""The HumanML3D / KIT-ML codec against a second implementation that follows the published procedure frame by frame."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch

from moveset.data import bandai_namco, cmu
from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.hml import HmlCodec
from moveset.motion.hml_skeletons import HUMANML3D, KIT_ML
from moveset.motion.skeleton import KIT21
from moveset.motion.smoothing import gaussian_smooth
from tests.hml_oracle import extract, recover
from tests.motions import gait, wander

CODEC, KIT = HmlCodec(HUMANML3D), HmlCodec(KIT_ML)


def described(codec, joints):
    """The positions that features of ``joints`` describe: re-posed, on the floor, canonical; metres, float64."""
    unit_, whole = codec.convention.unit, [len(joints)]
    return codec._on_ground(codec._uniform(joints.double(), whole) / unit_, whole)[:-1] * unit_


def turned(joints, degrees, shift=(3.0, 0.0, -8.0)):
    q = rotations.about("y", torch.tensor(degrees, dtype=torch.float64))
    return rotations.rotate(q, joints.double()) + torch.tensor(shift, dtype=torch.float64)


def columns(codec, *names):
    return [c for name in names for c in range(codec.dim)[codec.groups[name]]]


SYNTHETIC = {
    "wander": lambda: wander(35, 1),
    "bent": lambda: wander(12, 2, bend=0.8),
    "left": lambda: wander(30, 3, turn=1.0),
    "walk": lambda: gait(25),
    "short": lambda: wander(2, 4),
}


def test_widths_and_groups_are_the_published_ones():
    assert (CODEC.dim, KIT.dim) == (263, 251)
    assert CODEC.groups == {
        "root_yaw": slice(0, 1), "root_velocity": slice(1, 3), "root_height": slice(3, 4), "positions": slice(4, 67),
        "rotations": slice(67, 193), "velocities": slice(193, 259), "contacts": slice(259, 263),
    }  # fmt: skip
    assert (KIT.groups["positions"], KIT.groups["rotations"]) == (slice(4, 64), slice(64, 184))
    assert (KIT.groups["velocities"], KIT.groups["contacts"]) == (slice(184, 247), slice(247, 251))


@pytest.mark.parametrize("uniform", [True, False])
@pytest.mark.parametrize("name", SYNTHETIC)
def test_features_equal_the_oracle(name, uniform):
    joints = turned(SYNTHETIC[name]().joints, 200.0)
    expected, _ = extract(HUMANML3D, joints.numpy(), HUMANML3D.lengths.numpy(), uniform)
    features = CODEC.encode_clips([joints], uniform=uniform)[0]
    assert features.dtype == torch.float32
    np.testing.assert_allclose(features.numpy(), expected, atol=2e-6)


def test_kit_features_equal_the_oracle():
    codec = KIT
    motion = wander(40, 5, KIT21, fps=12.5)
    mirrored = motion.joints.double() * torch.tensor([-1.0, 1.0, 1.0])
    expected, _ = extract(KIT_ML, 1000 * mirrored.numpy(), 1000 * KIT_ML.lengths.numpy())
    features = codec.encode(motion).double().numpy()
    scale = np.maximum(np.abs(expected), 1.0)
    np.testing.assert_allclose(features / scale, expected / scale, atol=1e-6)
    np.testing.assert_allclose(
        codec.joints(torch.from_numpy(features)).numpy(), recover(KIT_ML, expected) / 1000, atol=1e-5
    )


def test_recovery_equals_the_oracle():
    features = CODEC.encode(wander(50, 6, turn=0.7))
    np.testing.assert_allclose(CODEC.joints(features).numpy(), recover(HUMANML3D, features.double().numpy()), atol=2e-6)


def joints_from_rotations(codec, features):
    """Joints (F, J, 3) in metres from the root and rotation columns, on the dataset's body.

    The root's rotation is the heading's inverse turn, which is what the encoding divided by.
    """
    convention = codec.convention
    heading, root = codec._root(features)
    local = rotations.matrix_from_6d(features[..., codec.groups["rotations"]].unflatten(-1, (-1, 6)))
    offsets = (convention.directions * convention.lengths[:, None] / convention.unit).to(features)
    placed = {0: root}
    for chain in convention.chains:
        turned = rotations.to_matrix(heading)
        for above, joint in pairwise(chain):
            turned = turned @ local[..., joint - 1, :, :]
            placed[joint] = placed[above] + turned @ offsets[joint]
    return torch.stack([placed[j] for j in range(len(offsets))], dim=-2) * convention.unit


@pytest.mark.parametrize("name", SYNTHETIC)
def test_round_trip_below_a_hundredth_of_a_millimetre(name):
    joints = SYNTHETIC[name]().joints
    features = CODEC.encode_clips([joints])[0]
    truth = described(CODEC, joints)
    assert (CODEC.joints(features) - truth).norm(dim=-1).max() < 1e-5
    assert (joints_from_rotations(CODEC, features) - truth).norm(dim=-1).max() < 1e-5


def test_encoded_clips_have_the_datasets_body():
    joints = CODEC.joints(CODEC.encode(wander(30, 7)))
    parents = list(HUMANML3D.skeleton.parents[1:])
    lengths = (joints[:, 1:] - joints[:, parents]).norm(dim=-1)
    assert (lengths - HUMANML3D.lengths[1:]).abs().max() < 1e-5
    assert joints[..., 1].min().abs() < 1e-5
    assert joints[0, 0, [0, 2]].abs().max() == 0.0


@pytest.mark.parametrize("degrees", [37.0, 90.0, -150.0])
def test_place_and_heading_do_not_show(degrees):
    joints = wander(40, 8).joints
    features, moved = CODEC.encode_clips([joints])[0], CODEC.encode_clips([turned(joints, degrees)])[0]
    torch.testing.assert_close(moved, features, atol=1e-5, rtol=0)


def test_the_yaw_step_is_a_half_angle():
    """90 degrees a second at 20 fps: 4.5 degrees a frame, written as 2.25 degrees = 0.0393."""
    still = wander(1, 11, bend=0.0)
    heading = rotations.about("y", 4.5 * torch.arange(240.0))
    spinning = Motion(still.rotations.repeat(240, 1, 1), still.root.repeat(240, 1)).rotations
    spinning = torch.cat((rotations.mul(heading, spinning[:, 0])[:, None], spinning[:, 1:]), dim=1)
    yaw = CODEC.encode(Motion(spinning, still.root.repeat(240, 1)))[:, 0]
    torch.testing.assert_close(yaw[90:150].abs(), torch.full((60,), math.pi / 80), atol=1e-4, rtol=0)


def test_a_turn_to_the_left_is_negative():
    yaw = CODEC.encode(wander(60, 12, bend=0.0, turn=1.0))[:, 0]
    assert (yaw[1:] < 0).all()


def test_the_first_row_holds_a_jump_that_nobody_made():
    """The heading of frame 0 is overwritten, that of frame 1 works the hips against the shoulders."""
    still = wander(1, 13, bend=0.0)
    local = still.rotations.clone()
    local[:, [3, 6, 9]] = rotations.about("y", 15.0)
    motion = Motion(local.repeat(30, 1, 1), still.root.repeat(30, 1))
    yaw = CODEC.encode(motion)[:, 0]
    assert abs(yaw[0]) > 0.05
    assert yaw[1:].abs().max() < 1e-6


def test_a_heading_that_passes_backward_is_recovered_with_a_wrong_step():
    """Known and kept: arcsin drops the sign of the quaternion's w. Before that instant all is exact."""
    joints = wander(140, 14, bend=0.05, turn=0.9).joints
    features = CODEC.encode_clips([joints])[0]
    error = (CODEC.joints(features) - described(CODEC, joints)).norm(dim=-1).amax(dim=1)
    wrong = torch.nonzero(error > 1e-3)[:, 0]
    assert len(wrong) > 0
    first = int(wrong[0])
    assert error[: first - 1].max() < 1e-5
    assert features[first - 1, 0] > 0  # one step to the right in a turn to the left
    assert (features[1 : first - 1, 0] < 0).all()


@pytest.mark.parametrize(("step", "planted"), [(0.0446, 1.0), (0.0448, 0.0), (0.0, 1.0)])
def test_contacts_ask_for_speed_alone(step, planted):
    joints = wander(1, 15, bend=0.0).joints.double().repeat(12, 1, 1)
    up = torch.arange(12.0, dtype=torch.float64)[:, None]
    joints[:, [7, 8]] += up[..., None] * torch.tensor([0.0, step, 0.0], dtype=torch.float64)
    contacts = CODEC.encode_clips([joints], uniform=False)[0][:, -4:]
    assert (contacts[:, [0, 2]] == planted).all()
    assert (contacts[:, [1, 3]] == 1.0).all()


def test_contact_columns_are_left_ankle_left_toe_right_ankle_right_toe():
    for column, joint in enumerate((7, 10, 8, 11)):
        joints = wander(1, 15, bend=0.0).joints.double().repeat(4, 1, 1)
        joints[:, joint, 2] += 0.1 * torch.arange(4)
        contacts = CODEC.encode_clips([joints], uniform=False)[0][:, -4:]
        assert [c for c in range(4) if (contacts[:, c] == 0).all()] == [column]


@pytest.mark.parametrize(("frames", "sigma"), [(1, 20.0), (3, 20.0), (50, 20.0), (300, 20.0), (40, 1.7)])
def test_smoothing_equals_scipy(frames, sigma):
    from scipy.ndimage import gaussian_filter1d

    x = torch.randn(frames, 3, generator=torch.Generator().manual_seed(17), dtype=torch.float64)
    expected = gaussian_filter1d(x.numpy(), sigma, axis=0, mode="nearest")
    np.testing.assert_allclose(gaussian_smooth(x, sigma).numpy(), expected, atol=1e-14)


def test_joints_take_batches_and_carry_gradient():
    features = torch.stack([CODEC.encode(wander(20, 18)), CODEC.encode(wander(20, 19))])
    batch = features.reshape(2, 1, 19, 263).requires_grad_()
    joints = CODEC.joints(batch)
    assert joints.shape == (2, 1, 19, 22, 3)
    torch.testing.assert_close(joints[1, 0], CODEC.joints(features[1]))
    joints.square().sum().backward()
    used = columns(CODEC, "root_yaw", "root_velocity", "root_height", "positions")
    assert torch.isfinite(batch.grad).all()
    assert (batch.grad[..., used].abs().amax(dim=(0, 1, 2)) > 0).all()


@pytest.mark.parametrize("name", ["wander", "walk"])
def test_decoding_gives_a_motion_close_to_the_positions(name):
    """Joints within 2.5 cm: the dataset's left and right bones differ, the skeleton's do not."""
    features = CODEC.encode(SYNTHETIC[name]())
    motion = CODEC.decode(features)
    assert (len(motion), motion.fps, motion.skeleton.name) == (len(features), 20.0, "hml22")
    assert (motion.joints - CODEC.joints(features)).norm(dim=-1).max() < 0.025


def test_kit_motions_survive_reflection():
    codec = KIT
    motion = wander(30, 20, KIT21, fps=12.5, bend=0.1)
    back = codec.decode(codec.encode(motion))
    truth = motion.canonical().joints
    apart = back.joints - back.root[:, None] - (truth - truth[:, :1])[:-1]
    assert apart.norm(dim=-1).max() < 0.05  # metres; heading by shoulders and hips against heading by pelvis


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: CODEC.encode(wander(5, 0, fps=30.0)), "resample"),
        (lambda: CODEC.encode(wander(5, 0, KIT21)), "retarget"),
        (lambda: CODEC.encode(wander(1, 0)), r"T >= 2"),
        (lambda: CODEC.encode_clips([torch.zeros(5, 21, 3)])[0], r"got \(5, 21, 3\)"),
        (lambda: CODEC.encode_clips([torch.full((5, 22, 3), torch.nan)])[0], "finite"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(InputError, match=message):
        call()


def real_motions(real_data):
    takes = [r for r in bandai_namco.list_takes(real_data) if "wave-left" in r.name or "walk-back" in r.name]
    takes = [bandai_namco.read_take(r) for r in takes[:2]]
    takes += [cmu.read_take(r) for r in cmu.list_takes(real_data / "cmu") if r.name in ("02_01", "07_03")]
    assert len(takes) >= 2
    runs = [take.runs[0] for take in takes]
    return [Motion(run.rotations, run.root)[:40] for run in runs]


def test_real_takes_equal_the_oracle_and_survive_the_round_trip(real_data):
    for motion in real_motions(real_data):
        joints = motion.joints.double()
        features = CODEC.encode(motion)
        expected, described_ = extract(HUMANML3D, joints.numpy(), HUMANML3D.lengths.numpy())
        np.testing.assert_allclose(features.numpy(), expected, atol=2e-6)
        assert np.abs(CODEC.joints(features).numpy() - described_[:-1]).max() < 1e-5
        assert np.abs(joints_from_rotations(CODEC, features).numpy() - described_[:-1]).max() < 1e-5


def test_clips_at_once_are_clips_alone():
    clips = [wander(frames, seed=frames).joints for frames in (2, 31, 90)]
    together = CODEC.encode_clips(clips)
    assert all(torch.equal(a, CODEC.encode_clips([clip])[0]) for a, clip in zip(together, clips, strict=True))
    assert [len(a) for a in together] == [1, 30, 89]
    assert CODEC.encode_clips([]) == []
    with pytest.raises(InputError, match="finite"):
        CODEC.encode_clips([clips[0], torch.full((5, 22, 3), torch.nan)])


@pytest.mark.parametrize("codec", [CODEC, KIT], ids=["hml", "kit"])
def test_world_joints_are_encoded_as_their_motion(codec):
    motions = [wander(40, seed=k, skeleton=codec.skeleton, fps=codec.fps) for k in range(2)]
    features = codec.encode_world([motion.joints for motion in motions])
    assert all(torch.equal(a, codec.encode(motion)) for a, motion in zip(features, motions, strict=True))
