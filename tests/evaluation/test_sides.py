"""Sides that sentences name: whose motion shows them, and mirror images."""

import pytest
import torch

from moveset.data.captions import mirror_text
from moveset.evaluation.sides import Named, named_side, on_named_side
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.skeleton import HML22

SENTENCES = (
    "a person waves with the left hand",
    "someone kicks with their right leg",
    "a man walks and turns left",
    "she turns to her right, then stops",
    "he raises his left upper arm",
)


def moving(what: str, side: str) -> Motion:
    """Stands, and moves one limb, or turns there."""
    frames = 60
    turns = torch.zeros(frames, 22, 4)
    turns[..., 3] = 1.0
    if what == "turn":
        turns[:, 0] = rotations.yaw(torch.linspace(0, 1.5 if side == "left" else -1.5, frames))
    else:
        joint = HML22.index(f"{side}_{'shoulder' if what == 'arm' else 'hip'}")
        swing = torch.linspace(0, 3.0, frames).sin() / 2
        turns[:, joint, 2 if what == "arm" else 0], turns[:, joint, 3] = swing.sin(), swing.cos()
    root = torch.tensor([0.0, 0.9, 0.0]).expand(frames, 3).clone()
    return Motion(turns, root, 20.0, HML22)


@pytest.mark.parametrize("sentence", SENTENCES)
def test_a_motion_shows_the_side_that_its_sentence_names_and_its_mirror_image_the_other(sentence):
    named, other = named_side(sentence), named_side(mirror_text(sentence))
    assert named is not None
    assert other == Named(named.what, "right" if named.side == "left" else "left")
    motion = moving(named.what, named.side)
    for shown in (motion, motion.mirrored()):
        verdicts = [on_named_side(side, shown.joints, HML22) for side in (named, other)]
        assert verdicts == ([True, False] if shown is motion else [False, True])


@pytest.mark.parametrize(
    "sentence",
    [
        "a person walks to the left of a table",
        "a person waves with the left hand and then with the right hand",
        "a person jumps",
        "someone leans left",
        "a person turns left and lifts the right arm",
    ],
)
def test_what_names_no_side_or_several_is_not_judged(sentence):
    assert named_side(sentence) is None
