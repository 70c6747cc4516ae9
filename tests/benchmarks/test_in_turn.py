"""What counts as done, of motions that are known to do it or not, and the counting."""

import pytest
import torch

from moveset.motion.skeleton import HML22
from tests.motions import seated, standing
from tests.synthetic import synthetic_motion


@pytest.fixture
def in_turn():
    import in_turn

    return in_turn


def leaping(height: float) -> torch.Tensor:
    joints = standing(28).joints.clone()
    joints[10:18, :, 1] += height
    return joints


SHOWN = {
    "a person sits down": seated(torch.full((28,), 95.0)).joints,
    "a person stands up": standing(28).joints,
    "a person walks forward": synthetic_motion("walk", 28, speed=1.2).joints,
    "a person waves with the right hand": synthetic_motion("wave-right-hand", 28).joints,
    "a person jumps": leaping(0.3),
    "a person stands still": standing(28).joints,
}


# Of which others it is true, too.
ALSO = {"a person stands up": {*SHOWN} - {"a person sits down"}, "a person stands still": {"a person stands up"}}


@pytest.mark.parametrize("sentence", SHOWN)
def test_only_what_does_it_has_done_it(in_turn, sentence):
    assert set(in_turn.DONE) == set(SHOWN)
    done = {shown for shown, joints in SHOWN.items() if in_turn.DONE[sentence](joints.float())}
    assert done == {sentence} | ALSO.get(sentence, set())


def test_a_wave_is_of_the_named_hand_and_a_low_one_is_none(in_turn):
    done = in_turn.DONE["a person waves with the right hand"]
    assert not done(synthetic_motion("wave-left-hand", 28).joints.float())
    low = synthetic_motion("wave-right-hand", 28).joints.float()
    low[:, HML22.index("right_wrist"), 1] -= 0.8
    assert not done(low)


def test_shares_count_who_has_done_it_by_then_and_who_does_it_at_last(in_turn):
    class Shown:
        def __init__(self, right):
            self.joints = torch.full((1,), float(right))

    made = [[Shown(x) for x in row] for row in ((0, 1, 0, 0), (1, 0, 0, 0), (0, 1, 0, 1))]
    found = in_turn.shares(lambda joints: float(joints[0]) > 0, made)
    assert found == {"within": [0.25, 0.5, 0.75], "last": 0.5}
