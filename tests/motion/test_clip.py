"""What ``Motion`` does to a clip."""

import pytest
import torch

from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.skeleton import HML22
from tests.motions import gait, wander


def close(a: Motion, b: Motion, metres=1e-5, radians=2e-3):
    assert (a.root - b.root).norm(dim=-1).max() < metres
    assert rotations.angle(rotations.mul(rotations.inv(a.rotations), b.rotations)).max() < radians
    assert (a.joints - b.joints).norm(dim=-1).max() < 2 * metres


def test_slices_move_nothing():
    motion = wander(30, 0)
    part = motion[10:20]
    assert (len(part), part.seconds) == (10, 0.5)
    assert torch.equal(part.joints, motion.joints[10:20])


@pytest.mark.parametrize("kind", [torch.float64, list, "numpy"])
def test_transforming_takes_numbers_of_any_type(kind):
    motion, turn, shift = wander(5, 1), rotations.about("y", 70.0), torch.tensor([1.0, -2.0, 3.0])
    given = [x.tolist() if kind is list else x.numpy() if kind == "numpy" else x.to(kind) for x in (turn, shift)]
    found = motion.transformed(*given)
    assert found.rotations.dtype == found.root.dtype == torch.float32
    close(found, motion.transformed(turn, shift))


def test_a_motion_made_in_inference_mode_can_be_changed_and_differentiated_by():
    with torch.inference_mode():
        motion = Motion(rotations.identity(3, 22), torch.ones(3, 3))
        motion.joints  # noqa: B018  (kept, so made then)
    weight = torch.ones((), requires_grad=True)
    (weight * (motion.joints.sum() + motion.root.sum() + motion.rotations.sum())).backward()
    motion.root[:, 1] += 1.0
    assert motion.root[0].tolist() == [1.0, 2.0, 1.0]


def test_what_is_shown_of_a_motion_is_one_line():
    assert repr(wander(30, 0)) == "Motion(30 frames at 20 fps on 'hml22', 1.5 s)"
    assert repr(HML22) == "Skeleton('hml22', 22 joints)"


def test_canonical_starts_above_the_origin_and_faces_front():
    motion = wander(20, 2, turn=1.0).transformed(rotations.about("y", -130.0), torch.tensor([4.0, 0.0, 9.0]))
    canonical = motion.canonical()
    assert canonical.root[0, [0, 2]].abs().max() < 1e-6
    assert canonical.root[0, 1] == motion.root[0, 1]
    assert rotations.heading_angle(canonical.rotations[0, 0]).abs() < 1e-6


@pytest.mark.parametrize("fps", [20.0, 24.0, 30.0, 60.0, 7.0])
def test_resampling_keeps_the_duration_and_the_first_frame(fps):
    motion = wander(41, 4)
    out = motion.resampled(fps)
    assert out.fps == fps
    assert 2.0 - 1.0 / fps < (len(out) - 1) / fps <= 2.0
    torch.testing.assert_close(out.root[0], motion.root[0])
    if (2.0 * fps) % 1 == 0:
        torch.testing.assert_close(out.root[-1], motion.root[-1])
        torch.testing.assert_close(out.joints[-1], motion.joints[-1], atol=1e-5, rtol=0)


@pytest.mark.parametrize("fps", [7.0, 24.0, 30.0, 33.0, 59.94])
def test_resampling_keeps_a_steady_speed_to_the_very_end(fps):
    steady = Motion(rotations.identity(30, 22), torch.arange(30.0)[:, None] * torch.tensor([0.0, 0.0, 0.05]))
    steps = torch.diff(steady.resampled(fps).root[:, 2])
    torch.testing.assert_close(steps, torch.full_like(steps, 1.0 / fps), atol=1e-5, rtol=0)


def test_a_single_frame_resamples_to_itself():
    out = wander(1, 5).resampled(60.0)
    assert (len(out), out.fps) == (1, 60.0)


def test_in_place_keeps_height_and_pose():
    motion = gait(30)
    still = motion.in_place()
    assert torch.equal(still.root[:, 1], motion.root[:, 1])
    assert (still.root[:, [0, 2]] - motion.root[0, [0, 2]]).abs().max() == 0.0
    assert torch.equal(still.rotations, motion.rotations)


@pytest.mark.parametrize("fps", [0.0, -1.0, 1001.0, float("nan")])
def test_absurd_frame_rates_are_refused(fps):
    with pytest.raises(InputError, match="frame rate"):
        wander(5, 6).resampled(fps)


@pytest.mark.parametrize(
    ("turned", "root", "fps", "message"),
    [
        (rotations.identity(3, 21), torch.zeros(3, 3), 20.0, r"\(F, 22, 4\)"),
        (rotations.identity(3, 22), torch.zeros(4, 3), 20.0, r"\(4, 3\)"),
        (rotations.identity(0, 22), torch.zeros(0, 3), 20.0, "F >= 1"),
        (rotations.identity(3, 22), torch.full((3, 3), torch.inf), 20.0, "finite"),
        (rotations.identity(3, 22) * torch.nan, torch.zeros(3, 3), 20.0, "finite"),
        (rotations.identity(3, 22) * 2.0, torch.zeros(3, 3), 20.0, "unit quaternions xyzw, not of lengths 2 to 2"),
        (rotations.identity(3, 22).numpy(), torch.zeros(3, 3).numpy(), 20.0, "got ndarray and ndarray; convert them"),
        (rotations.identity(3, 22), torch.zeros(3, 3).long(), 20.0, r"not torch.float32 and torch.int64; convert"),
        (rotations.identity(3, 22), torch.tensor(0.0), 20.0, r"and \(\)"),
        (rotations.identity(3, 22), torch.zeros(3, 3), 0.0, "frame rate 0 is not in 0.01 to 1000"),
        (rotations.identity(3, 22), torch.zeros(3, 3), float("inf"), "frame rate inf"),
    ],
)
def test_broken_motions_are_refused(turned, root, fps, message):
    with pytest.raises(InputError, match=message):
        Motion(turned, root, fps)


def test_one_frame_is_taken_as_a_slice():
    with pytest.raises(InputError, match="frame 3 alone is no motion; take a slice"):
        wander(5, 6)[3]


@pytest.mark.parametrize(
    ("turned", "root", "kind"),
    [(torch.float64, torch.float32, torch.float64), (torch.float32, torch.float64, torch.float64),
     (torch.float16, torch.float32, torch.float32), (torch.float16, torch.bfloat16, torch.float32),
     (torch.bfloat16, torch.bfloat16, torch.float32), (torch.float64, torch.float64, torch.float64)],
)  # fmt: skip
def test_all_numbers_of_a_motion_are_of_one_type_that_files_have(turned, root, kind, tmp_path):
    upright = rotations.identity(3, 22)
    motion = Motion(upright.to(turned), torch.ones(3, 3).to(root))
    assert motion.rotations.dtype == motion.root.dtype == kind
    assert torch.equal(motion.rotations, upright.to(kind))
    assert motion.canonical().root.dtype == kind
    for name in ("a.amass.npz", "a.npz", "a.png"):
        assert motion.save(tmp_path / name).exists()
