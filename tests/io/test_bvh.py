import warnings

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from moveset.errors import FormatError, InputError
from moveset.io.bvh import bvh_motion, continuous_euler, likely_scale, local_frames, write_bvh
from moveset.io.bvh_parser import read_bvh
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.skeleton import HML22, KIT21, Skeleton
from tests.io.foreign import in_units, reordered

# An arm of two bones; the second joint lists its rotations in another order.
ARM = b"""HIERARCHY
ROOT shoulder
{
\tOFFSET 0 0 0
\tCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
\tJOINT elbow
\t{
\t\tOFFSET 10 0 0
\t\tCHANNELS 3 Yrotation Zrotation Xrotation
\t\tEnd Site
\t\t{
\t\t\tOFFSET 5 0 0
\t\t}
\t}
}
MOTION
Frames: 2
Frame Time: 0.0333333
1 2 3 90 0 0 0 90 0
1 2 3 0 0 90 0 0 0
"""


def load(tmp_path, data):
    path = tmp_path / "a.bvh"
    path.write_bytes(data)
    return read_bvh(path)


def random_motion(skeleton, frames=12, seed=0, spread=0.8):
    generator = torch.Generator().manual_seed(seed)
    turned = torch.randn(frames, len(skeleton), 4, generator=generator) * spread + rotations.identity()
    return Motion(rotations.normalize(turned), torch.randn(frames, 3, generator=generator), 20.0, skeleton)


def by_name(motion):
    return {name: motion.joints[:, j] for j, name in enumerate(motion.skeleton.joints)}


def test_a_hand_written_file(tmp_path):
    bvh = load(tmp_path, ARM)
    assert bvh.joints == ("shoulder", "elbow")
    assert bvh.parents == (-1, 0)
    assert bvh.end_sites == ((1, (5.0, 0.0, 0.0)),)
    assert bvh.channels[1] == ("Yrotation", "Zrotation", "Xrotation")
    assert bvh.fps == 30.0
    motion = bvh_motion(bvh, scale=0.01)
    # Frame 0: 90 degrees about z takes +x to +y; frame 1: 90 degrees about y takes +x to -z.
    expected = torch.tensor([[0.01, 0.12, 0.03], [0.01, 0.02, -0.07]])
    assert torch.allclose(motion.joints[:, 1], expected, atol=1e-6)
    assert torch.allclose(
        rotations.rotate(motion.global_rotations[0, 1], torch.tensor([1.0, 0, 0])),
        torch.tensor([-1.0, 0, 0]),
        atol=1e-6,
    )


@pytest.mark.parametrize("skeleton", [HML22, KIT21])
@pytest.mark.parametrize("order", ["ZXY", "XYZ", "YZX", "ZYX", "XZY", "YXZ"])
def test_written_and_read_back(tmp_path, skeleton, order):
    motion = random_motion(skeleton)
    back = bvh_motion(reordered(read_bvh(write_bvh(motion, tmp_path / "a.bvh")), order))
    assert back.fps == 20.0
    if skeleton is HML22:  # which lists its joints as files do
        assert back.skeleton is skeleton
        assert rotations.angle(rotations.mul(rotations.inv(motion.rotations), back.rotations)).max() < 2e-3
    ours, theirs = by_name(motion), by_name(back)
    assert max((ours[name] - theirs[name]).abs().max().item() for name in ours) < 1e-5


@pytest.mark.parametrize("metres", [1.0, 0.01, 0.001])
def test_the_ends_of_own_files_say_the_unit_also_of_a_scaled_copy(tmp_path, metres):
    motion = random_motion(HML22)
    path = write_bvh(motion, tmp_path / "a.bvh")
    assert np.allclose(read_bvh(path).values[:, :3], 100 * motion.root, atol=1e-4)
    assert likely_scale(read_bvh(in_units(path, metres))) == metres


@pytest.mark.parametrize("order", ["ZXY", "XYZ", "YXZ"])
def test_angles_stay_continuous_through_full_turns_and_the_locked_middle_angle(order):
    # Three turns about each of two axes at once: the middle angle passes 90 degrees again and again.
    time = torch.linspace(0, 1, 400, dtype=torch.float64)
    axes = torch.tensor([[0.6, 0.0, 0.8], [0.36, 0.48, 0.8]], dtype=torch.float64)
    turned = rotations.from_axis_angle(axes, time[:, None] * torch.tensor([18.0, 11.0], dtype=torch.float64))
    turned = rotations.mul(turned[:, 0], turned[:, 1])[:, None]
    angles = continuous_euler(rotations.to_matrix(turned).numpy(), order)
    back = rotations.from_euler(torch.from_numpy(angles), order)
    assert rotations.angle(rotations.mul(rotations.inv(turned), back)).max() < 1e-6
    steps = np.abs(np.diff(angles, axis=0))
    plain = np.abs(np.diff(Rotation.from_quat(turned[:, 0].numpy()).as_euler(order, degrees=True), axis=0))
    assert plain.max() > 150.0
    # No other choice of angles is nearer to the frame before.
    other = np.stack((angles[..., 0] + 180, 180 - angles[..., 1], angles[..., 2] + 180), axis=-1)
    nearest = other[1:] + 360 * np.round((angles[:-1] - other[1:]) / 360)
    assert (steps.sum(-1) <= np.abs(nearest - angles[:-1]).sum(-1) + 1e-9).all()
    assert steps[..., 1].max() < 10.0


def test_a_kick_over_the_locked_angle_is_one_smooth_curve():
    # A thigh that swings forward by 130 degrees: X is the middle angle of ZXY.
    degrees = torch.linspace(0, -130, 40, dtype=torch.float64)
    angles = continuous_euler(rotations.to_matrix(rotations.about("x", degrees))[:, None].numpy(), "ZXY")
    assert np.allclose(angles[:, 0, 1], degrees, atol=1e-5)
    assert np.abs(angles[:, 0, [0, 2]]).max() < 1e-5


def test_exactly_locked_rotations_are_still_right():
    turned = rotations.from_euler(torch.tensor([[30.0, 90.0, 20.0], [-50.0, -90.0, 70.0]]).double(), "ZXY")[:, None]
    back = rotations.from_euler(torch.from_numpy(continuous_euler(rotations.to_matrix(turned).numpy(), "ZXY")), "ZXY")
    assert rotations.angle(rotations.mul(rotations.inv(turned), back)).max() < 1e-6


def pybvh_positions(path):
    pybvh = pytest.importorskip("pybvh")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        bvh = pybvh.Bvh.from_file(path)
    return bvh, dict(zip(bvh.joint_names, np.moveaxis(bvh.joint_positions(), 1, 0), strict=True))


def test_another_reader_sees_the_same_positions(tmp_path):
    motion = random_motion(HML22)
    other, positions = pybvh_positions(write_bvh(motion, tmp_path / "a.bvh"))
    assert other.fps == pytest.approx(20.0)
    for name, place in by_name(motion).items():
        assert np.abs(positions[name] / 100 - place.numpy()).max() < 1e-5


def test_another_reader_agrees_on_a_real_take(real_data):
    path = real_data / "cmu" / "subjects" / "02" / "02_01.bvh"
    _, positions = pybvh_positions(path)
    motion = bvh_motion(read_bvh(path))
    assert motion.fps == 120.0
    for name, place in by_name(motion).items():
        assert np.abs(positions[name] / 100 - place.numpy()).max() < 1e-4


def test_a_moving_child_of_the_root_is_folded_and_a_still_one_becomes_an_offset(tmp_path):
    six = "Xposition Yposition Zposition Zrotation Xrotation Yrotation"
    text = f"""HIERARCHY
ROOT world
{{ OFFSET 7 7 7 CHANNELS 6 {six}
JOINT hips
{{ OFFSET 9 9 9 CHANNELS 6 {six}
JOINT knee
{{ OFFSET 5 5 5 CHANNELS 6 {six}
End Site {{ OFFSET 0 0 0 }} }} }} }}
MOTION
Frames: 2
Frame Time: 0.05
0 0 0 90 0 0   1 0 0 0 0 0   0 -4 0 0 0 0
0 0 0 90 0 0   2 0 0 0 0 0   0 -4 0 0 0 0
"""
    bvh = load(tmp_path, text.encode())
    frames = local_frames(bvh)
    assert frames.joints == ("hips", "knee")
    # The root's turn about z takes the child's x to y; the knee hangs along hips' -y, which the turn takes to +x.
    assert torch.allclose(frames.root, torch.tensor([[0.0, 1, 0], [0, 2, 0]]).double(), atol=1e-9)
    assert torch.allclose(frames.world()[1][:, 1], torch.tensor([[4.0, 1, 0], [4, 2, 0]]).double(), atol=1e-9)
    assert frames.offsets[1].tolist() == [0.0, -4.0, 0.0]
    assert local_frames(bvh, root="knee").root[0].tolist() == pytest.approx([4.0, 1.0, 0.0])
    with pytest.raises(FormatError, match="no joint 'ankle'"):
        local_frames(bvh, root="ankle")
    # Both may move: they are composed.
    both = bvh.values.copy()
    both[1, 2] = 10.0
    moved = local_frames(type(bvh)(**{**vars(bvh), "values": both}))
    assert moved.root[1].tolist() == pytest.approx([0.0, 2.0, 10.0])


def test_a_joint_that_slides_within_its_parent_gets_its_mean_place_with_a_warning(tmp_path):
    text = ARM.replace(b"CHANNELS 3 Yrotation", b"CHANNELS 4 Yposition Yrotation")
    text = text.replace(b"JOINT elbow", b"JOINT spine { OFFSET 0 9 0 CHANNELS 0 }\n\tJOINT elbow")
    still = text.replace(b"0 90 0\n", b"3 0 90 0\n").replace(b"0 0 0\n1 2 3 0 0 90", b"0 0 0\n1 2 3 0 0 90")
    still = still.replace(b"90 0 0 0\n", b"90 3 0 0 0\n")
    motion = bvh_motion(load(tmp_path, still))
    assert motion.skeleton.offsets[2].tolist() == pytest.approx([0.1, 0.03, 0.0])
    with pytest.warns(UserWarning, match=r"joints slide within their parents \('elbow' by 0.015 m\)"):
        motion = bvh_motion(load(tmp_path, still.replace(b"90 3 0 0 0\n", b"90 6 0 0 0\n")))
    assert motion.skeleton.offsets[2].tolist() == pytest.approx([0.1, 0.045, 0.0])


def header(joints, depth=1):
    """A file of a root with a fan of joints, or a chain of ``depth``."""
    joint = "{name} {{ OFFSET 0 1 0 CHANNELS 1 Xrotation"
    parts = ["HIERARCHY\nROOT " + joint.format(name="r")]
    parts += [f"JOINT {joint.format(name=f'f{k}')} }}" for k in range(joints - depth)]
    parts += [f"JOINT {joint.format(name=f'c{k}')}" for k in range(depth - 1)]
    parts.append("}\n" * depth)
    return "\n".join(parts) + f"\nMOTION\nFrames: 1\nFrame Time: 0.05\n{'0 ' * joints}\n"


def test_what_is_at_the_limit_is_read_and_what_is_over_it_is_not(tmp_path):
    assert len(load(tmp_path, header(512).encode()).joints) == 512
    assert len(load(tmp_path, header(128, depth=128).encode()).joints) == 128
    with pytest.raises(FormatError, match="more than 512 joints"):
        load(tmp_path, header(513).encode())
    with pytest.raises(FormatError, match="128 levels"):
        load(tmp_path, header(129, depth=129).encode())


@pytest.mark.parametrize("parents", [[-1] + [0] * 512, list(range(-1, 128))], ids=["wide", "deep"])
def test_what_would_not_be_read_back_is_not_written(tmp_path, parents):
    count, path = len(parents), tmp_path / "far.bvh"
    skeleton = Skeleton("far", tuple(f"j{k}" for k in range(count)), tuple(parents), torch.ones(count, 3))
    motion = Motion(rotations.identity(1, count), torch.zeros(1, 3), 20.0, skeleton)
    with pytest.raises(InputError, match="exceed what is read back"):
        write_bvh(motion, path)
    assert not path.exists()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"HIERARCHY", b"GLB", "line 1: expected 'HIERARCHY' and found 'GLB'"),
        (b"ROOT shoulder", b"JOINT shoulder", "expected 'ROOT'"),
        (b"ROOT shoulder", b"ROOT", "joint name '' is empty"),
        (b"JOINT elbow", b"JOINT shoulder", "line 6: the joint name 'shoulder' is used twice"),
        (b"JOINT elbow", b"JOINT " + b"e" * 129, "exceeds the limit of 128"),
        (b"\tOFFSET 0 0 0\n", b"", "lacks its OFFSET or CHANNELS"),
        (b"\tOFFSET 0 0 0\n", b"\tOFFSET 0 0 0\n\tOFFSET 0 0 0\n", "two OFFSET"),
        (b"\tOFFSET 0 0 0\n", b"\tOFFSET 0 0\n", "'CHANNELS' is not a finite number"),
        (b"OFFSET 10 0 0", b"OFFSET nan 0 0", "line 8: 'nan' is not a finite number"),
        (b"OFFSET 10 0 0", b"OFFSET 1e300 0 0", "beyond the limit"),
        (b"CHANNELS 3", b"CHANNELS 30", "30 channels exceed the limit of 6"),
        (b"CHANNELS 3", b"CHANNELS -3", "'-3' is not a number of channels"),
        (b"CHANNELS 3", b"CHANNELS 4", "'End' is not a channel"),
        (b"CHANNELS 3 Yrotation", b"CHANNELS 3 Zrotation", "listed twice"),
        (b"End Site", b"End Site extra tokens", None),
        (b"OFFSET 5 0 0", b"", "expected 'OFFSET'"),
        (b"\t\t}\n\t}\n}\n", b"\t\t}\n\t}\n", "found 'MOTION'"),
        (b"}\nMOTION", b"}\n}\nMOTION", "expected 'MOTION' and found '}'"),
        (b"}\nMOTION", b"}\nROOT b { }\nMOTION", "a second ROOT: there are several bodies"),
        (b"}\nMOTION", b"}\nFRAMES", "expected 'MOTION' and found 'FRAMES'"),
        (b"Frames: 2", b"Frames: 0", "no frames"),
        (b"Frames: 2", b"Frames: -2", "'-2' is not a number of frames"),
        (b"Frames: 2", b"Frames: 2.0", "'2.0' is not a number of frames"),
        (b"Frames: 2", b"Frames: 4", "cannot hold 4 frames|4 frames are declared and 2 are there"),
        (b"Frames: 2", b"Frames: 100000", "cannot hold 100000 frames"),
        (b"Frames: 2", b"Frames: 2000000000", "2000000000 frames exceed the limit of 100000"),
        (b"Frames: 2", b"Frames: 99999999999999999999", "is not a number of frames"),
        (b"0.0333333", b"-0.05", "a frame time of -0.05 s"),
        (b"0.0333333", b"0", "a frame time of 0 s"),
        (b"0.0333333", b"inf", "'inf' is not a finite number"),
        (b"0.0333333", b"0.05 0.05", "unexpected '0.05' after the frame time"),
        (b"1 2 3 90", b"1 2 90", "line 19: 8 values for 9 channels"),
        (b"1 2 3 90", b"1 2 3 NaN", "line 19: 'NaN' is not a finite number"),
        (b"1 2 3 90", b"1 2 3 inf", "line 19: 'inf' is not a finite number"),
        (b"1 2 3 90", b"1 2 3 9_0", "'9_0' is not a finite number"),
        (b"1 2 3 90", b"1 2 3 9-0", "'9-0' is not a finite number"),
        (b"1 2 3 90", b"1 2 3 1e9", "beyond the limit"),
        (b"1 2 3 90", b"1 2 3 1e999", "beyond the limit"),
        (b"1 2 3 90", b"1 2 3 \xd9\xa3", "is not a finite number"),
        (b"1 2 3 90", b"1 2 3\n90", "line 19: 3 values for 9 channels"),
        (b"1 2 3 90", b"1 2 3 90" + b" " * 70000, "line 19: a line of .* exceeds the limit"),
        (b"HIERARCHY", b" " * 70000 + b"HIERARCHY", "line 1: a line of .* exceeds the limit"),
        (b"HIERARCHY", b"\n" * 100_001 + b"HIERARCHY", "no frames within the first"),
        (b"1 2 3 90", b"\n" * 2000 + b"1 2 3 90", "many more lines"),
    ],
)
def test_damaged_files_are_refused_in_one_sentence(tmp_path, old, new, message):
    assert ARM.count(old) >= 1
    data = ARM.replace(old, new, 1)
    if message is None:
        load(tmp_path, data)
        return
    with pytest.raises(FormatError, match=message) as caught:
        load(tmp_path, data)
    text = str(caught.value)
    assert text.startswith(str(tmp_path / "a.bvh"))
    assert "\n" not in text
    assert len(text) < 400


def test_a_small_file_cannot_ask_for_much_memory(tmp_path):
    bomb = header(512).replace("CHANNELS 1 Xrotation", "CHANNELS 0").replace("CHANNELS 0", "CHANNELS 1 Xrotation", 1)
    rows = "0\n" * 100_000
    data = bomb.split("Frames:")[0] + "Frames: 100000\nFrame Time: 0.05\n" + rows
    with pytest.raises(FormatError, match="poses"):
        load(tmp_path, data.encode())


def test_a_file_over_the_size_limit_is_not_parsed(tmp_path):
    path = tmp_path / "big.bvh"
    with path.open("wb") as file:
        file.truncate(256 * 2**20 + 1)
    with pytest.raises(FormatError, match="larger than the limit of 256 MB"):
        read_bvh(path)
    with pytest.raises(InputError, match="cannot read"):
        read_bvh(tmp_path / "missing.bvh")


def attempt(path, data):
    """Reading gives a motion or a FormatError, and nothing else."""
    path.write_bytes(data)
    try:
        motion = bvh_motion(read_bvh(path))
    except FormatError:
        return False
    assert torch.isfinite(motion.joints).all()
    return True


@pytest.mark.filterwarnings("ignore:.*frames are declared")
def test_truncation_anywhere_is_noticed_or_harmless(tmp_path):
    motion = random_motion(Skeleton("arm", ("a", "b", "c"), (-1, 0, 1), torch.eye(3)), frames=4)
    data = write_bvh(motion, tmp_path / "whole.bvh").read_bytes()
    read = [attempt(tmp_path / "cut.bvh", data[:k]) for k in range(len(data) + 1)]
    # Only a cut inside the very last number can pass for a whole file, or, with a warning, one before the last row.
    assert read[-1]
    row = data.rindex(b"\n", 0, -1)
    assert not any(read[: data.rindex(b" ", 0, row) + 1])
    assert not any(read[row + 2 : data.rindex(b" ") + 1])


TOKENS = [
    b"{",
    b"}",
    b"JOINT x",
    b"End Site",
    b"OFFSET",
    b"CHANNELS 3",
    b"nan",
    b"-1",
    b"1e400",
    b"\n",
    b"\0",
    b"MOTION",
]


@settings(max_examples=300, deadline=5000, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_mutated_files_give_a_motion_or_a_format_error(tmp_path, data):
    text = ARM
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        stop = min(len(text), start + data.draw(st.integers(0, 40)))
        middle = data.draw(st.one_of(st.binary(max_size=4), st.sampled_from(TOKENS), st.just(text[start:stop] * 2)))
        text = text[:start] + middle + text[stop:]
    attempt(tmp_path / "mutant.bvh", text)


def test_a_name_longer_than_can_be_read_is_cut(tmp_path):
    skeleton = Skeleton("s", ("root", 100 * "é"), (-1, 0), torch.eye(3)[:2])
    write_bvh(random_motion(skeleton), tmp_path / "a.bvh")
    assert load(tmp_path, (tmp_path / "a.bvh").read_bytes()).joints == ("root", 64 * "é")


def test_what_cannot_be_written_is_refused(tmp_path):
    motion = random_motion(HML22, frames=2)
    with pytest.raises(InputError, match="cannot write"):
        write_bvh(motion, tmp_path / "missing" / "a.bvh")
    alike = Skeleton("s", ("a b", "a_b"), (-1, 0), torch.eye(3)[:2])
    with pytest.raises(InputError, match="joint names"):
        write_bvh(random_motion(alike), tmp_path / "a.bvh")
    assert list(tmp_path.iterdir()) == []


def test_a_real_take_with_its_motion_in_a_child_of_the_root(real_data, tmp_path):
    path = real_data / "dataset-2" / "data" / "dataset-2_walk_active_002.bvh"
    bvh = read_bvh(path)
    motion = bvh_motion(bvh, scale=likely_scale(bvh))
    assert motion.skeleton.joints[0] == "Hips"
    assert motion.fps == 30.0
    # Walking, upright: 0.9 m high hips, over a metre a second.
    assert 0.85 < motion.root[:, 1].median() < 1.0
    assert (motion.root[-1] - motion.root[0])[[0, 2]].norm() > 1.0 * motion.seconds
    feet = motion.joints[:, [motion.skeleton.index("Toes_L"), motion.skeleton.index("Toes_R")], 1]
    assert -0.02 < feet.min() < 0.05
    back = bvh_motion(read_bvh(write_bvh(motion, tmp_path / "again.bvh")))
    assert (back.joints - motion.joints).abs().max() < 1e-4
