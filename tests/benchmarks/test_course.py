"""How far somebody turned: of a body and a way that turn steadily, more than once around."""

import math
from pathlib import Path

import pytest
import torch

from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.skeleton import HML22

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.mark.parametrize("degrees", [90.0, -90.0, 400.0])
def test_turns_are_as_long_as_they_are(degrees, monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    from course import turned, turning

    frames, fps = 201, 20.0
    angle = torch.linspace(0.0, math.radians(degrees), frames)
    turns = rotations.identity(frames, len(HML22))
    turns[:, 0] = rotations.yaw(angle)
    # Towards z at first, and to the left, which is x, as the angle grows.
    steps = torch.stack((angle.sin(), torch.zeros(frames), angle.cos()), dim=1) / fps
    motion = Motion(turns, steps.cumsum(dim=0), fps, HML22)
    assert turned(motion.joints) == pytest.approx(degrees, abs=0.1)
    assert turning(motion.root) == pytest.approx(degrees / 10.0, rel=0.01)
