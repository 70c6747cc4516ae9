"""The floor of a take: under the feet of who stands, under the body of who does not."""

import math

import pytest
import torch

from moveset.data import posture
from moveset.motion import rotations
from moveset.motion.kinematics import fk
from moveset.motion.skeleton import HML22


def crouched(frames, degrees):
    """Local rotations (frames, 22, 4) with so much of a bend in both knees, soles level, and height of hips above."""
    local = rotations.identity(frames, 22).double()
    for joint, share in (("hip", -0.5), ("knee", 1.0), ("ankle", -0.5)):
        for side in ("left", "right"):
            turn = rotations.from_axis_angle(torch.tensor([1.0, 0.0, 0.0]), torch.tensor(math.radians(share * degrees)))
            local[:, HML22.index(f"{side}_{joint}")] = turn.double()
    feet = fk(local, torch.zeros(frames, 3, dtype=torch.float64), HML22)[1][0, list(HML22.feet), 1]
    return local, -float(feet.min())


@pytest.mark.parametrize("degrees", [0.0, 45.0])
def test_who_stands_on_it_tells_the_floor_and_not_hands_that_go_below(degrees):
    local, height = crouched(60, degrees)
    root = torch.tensor([0.0, height, 0.0], dtype=torch.float64).repeat(60, 1)
    # Upside down for half a second, with the head 12 cm under where the feet stood.
    local[40:50, 0] = rotations.from_axis_angle(torch.tensor([0.0, 0.0, 1.0]), torch.tensor(math.pi)).double()
    lowest = fk(local, root, HML22)[1][45, :, 1].min()
    root[40:50, 1] -= lowest + 0.12
    assert posture.floor_of(local, root) == pytest.approx(0.0, abs=1e-3)
    # Of who only is upside down it is the body that tells the floor, with its skin.
    assert posture.floor_of(local[40:50], root[40:50]) == pytest.approx(-0.16, abs=1e-3)
