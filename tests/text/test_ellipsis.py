"""What a sentence leaves out is said of every limb; whatever leaves nothing out stays as it is, to the letter."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from moveset.data.captions import composed_captions
from moveset.data.labels import mirror_label
from moveset.text.ellipsis import in_full
from moveset.text.stages import split_stages


@pytest.mark.parametrize(
    ("short", "full"),
    [
        (
            "a person raises his right hand, then his left",
            "a person raises his right hand, then raises his left hand",
        ),
        (
            "she lifts her left arm, then her right, then both.",
            "she lifts her left arm, then lifts her right arm, then lifts both arms.",
        ),
        ("raise both arms, then the left", "raise both arms, then raise the left arm"),
        ("kick with the right foot, next the left foot", "kick with the right foot, next kick with the left foot"),
        (
            "a man first waves with his left hand and then with the other one",
            "a man first waves with his left hand and then waves with his right hand",
        ),
        ("his left arm goes up, then his right", "his left arm goes up, then his right arm goes up"),
        ("He raises a flag. Then his left", "He raises a flag. Then his left"),
        (
            "a man walks and raises his right hand, then the other",
            "a man walks and raises his right hand, then raises his left hand",
        ),
        (
            "a person waves the left hand, then the right one while walking",
            "a person waves the left hand, then waves the right hand while walking",
        ),
        (
            "raise the left arm, then the right, then the left again",
            "raise the left arm, then raise the right arm, then raise the left arm again",
        ),
    ],
)
def test_what_was_left_out_is_said(short: str, full: str) -> None:
    assert in_full(short) == full
    assert in_full(full) == full


@pytest.mark.parametrize(
    "sentence",
    [
        "a person walks forward, then turns left",
        "a person raises his right hand, then turns left",
        "a person raises the right hand, then left",  # a turn, for all that we know
        "a person raises one hand, then the other",  # nobody knows which
        "a person raises both hands, then the other",
        "a person raises his right hand, then his left hand waves",
        "a person raises the left arm, then the right and left arm",
        "a person raises the left and then walks to the other side",
        "a person walks, then the left",
        "",
        "then his left",
    ],
)
def test_what_leaves_nothing_out_stays(sentence: str) -> None:
    assert in_full(sentence) == sentence


@pytest.mark.parametrize("kind", ["in_time", "body"])
@pytest.mark.parametrize("upper", ["raise-up-right-hand", "wave-left-hand"])
def test_written_captions_leave_nothing_out(kind: str, upper: str) -> None:
    """So nothing that was learned or measured reads otherwise."""
    for key in range(50):
        for caption in composed_captions(kind, (upper, mirror_label(upper)), str(key)):
            assert in_full(caption) == caption


def test_a_stage_is_a_sentence_of_its_own() -> None:
    assert split_stages("a person raises his right hand, then his left") == (
        "a person raises his right hand",
        "a person raises his left hand",
    )


_WORDS = (
    "a", "person", "raises", "his", "the", "left", "right", "hand", "arms", "both", "then", ",", "and", "with", "one",
    "other", "next", "while", ".", "first",
)  # fmt: skip


@given(st.lists(st.sampled_from(_WORDS), max_size=14))
def test_it_ends_and_says_it_once(words: list[str]) -> None:
    full = in_full(" ".join(words))
    assert in_full(full) == full
