"""Which side a motion favours."""

import pytest
import torch

from moveset.motion.sides import SIDED, favoured, more_left
from moveset.motion.skeleton import HML22
from tests.evaluation.test_sides import moving


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("what", SIDED)
def test_a_motion_favours_what_moves_and_its_mirror_image_the_other_side(what, side):
    motion = moving(what, side)
    found, image = favoured(motion.joints, HML22), favoured(motion.mirrored().joints, HML22)
    assert found[SIDED.index(what)] == (1 if side == "left" else -1)
    assert torch.equal(found, -image)


def test_what_lies_beyond_a_motion_favours_nothing():
    motions = [moving("arm", "left").joints, moving("leg", "right").joints]
    padded = torch.stack([torch.cat((joints, torch.randn(20, 22, 3))) for joints in motions])
    found = more_left(padded, torch.tensor([len(joints) for joints in motions]), HML22)
    alone = [more_left(joints[None], torch.tensor([len(joints)]), HML22) for joints in motions]
    torch.testing.assert_close(found, torch.cat(alone))
    assert found[0, 0] > 0.9
    assert found[1, 1] < -0.9


def test_who_stands_favours_none():
    assert not favoured(moving("turn", "left")[:1].joints.expand(30, -1, -1), HML22).any()
