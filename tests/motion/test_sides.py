"""Which side a motion favours."""

import pytest
import torch

from moveset.motion.sides import SIDED, favoured
from moveset.motion.skeleton import HML22
from tests.evaluation.test_sides import moving


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("what", SIDED)
def test_a_motion_favours_what_moves_and_its_mirror_image_the_other_side(what, side):
    motion = moving(what, side)
    found, image = favoured(motion.joints, HML22), favoured(motion.mirrored().joints, HML22)
    assert found[SIDED.index(what)] == (1 if side == "left" else -1)
    assert torch.equal(found, -image)


def test_who_stands_favours_none():
    assert not favoured(moving("turn", "left")[:1].joints.expand(30, -1, -1), HML22).any()
