"""Sentences that say what comes after what, taken apart."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from moveset.data.bandai_captions import CONTENTS, bandai_captions
from moveset.text.stages import MOST, split_stages


@pytest.mark.parametrize(
    ("sentence", "stages"),
    [
        ("a person walks forward, then waves", ("a person walks forward", "a person waves")),
        ("A person walks. Then they wave.", ("A person walks", "wave")),
        ("a man is running and then waving his left hand", ("a man is running", "a man waving his left hand")),
        ("someone runs before bowing", ("someone runs", "someone bowing")),
        ("a man's left arm waves, then a man's head nods", ("a man's left arm waves", "a man's head nods")),
        ("someone bows after running", ("someone running", "someone bows")),
        ("after walking forward, a person waves", ("a person walking forward", "a person waves")),
        ("the subject walks; finally the subject waves", ("the subject walks", "the subject waves")),
        ("an old man slowly walks, afterwards kicks", ("an old man slowly walks", "an old man kicks")),
        ("she walks, and after that she is waving", ("she walks", "she waving")),
        ("walk, then turn left, then jump", ("walk and then turn left", "jump")),
        ("bow, then turn left, then jump", ("bow", "turn left", "jump")),
        (
            "a man runs, then he makes a right turn. Then he bows.",
            ("a man runs and then he makes a right turn", "a man bows"),
        ),
        ("walks, then turns left, then turns right", ("walks and then turns left", "turns right")),
        ("he saunters on, then turns left, then waves", ("he saunters on and then turns left", "he waves")),
        ("she hurries, then turns right", ("she hurries, then turns right",)),
        ("runs, then turns right and waves", ("runs", "turns right and waves")),
        ("a person walks, then his left hand waves", ("a person walks", "a person waves with his left hand")),
        ("she runs and then her right foot is kicking", ("she runs", "she is kicking with her right foot")),
        ("a man bows, then both arms go up", ("a man bows", "both arms go up")),
        ("a man bows, then the left arm is raised", ("a man bows", "the left arm is raised")),
        ("walk, then the left arm goes up", ("walk", "the left arm goes up")),
        ("a person walks then turns around and walks back", ("a person walks", "a person turns around and walks back")),
    ],
)
def test_stages_in_order_of_time(sentence, stages):
    assert split_stages(sentence) == stages


@pytest.mark.parametrize(
    "sentence",
    [
        "a person walks and waves",
        "a person walks while waving",
        "a person now and then waves",
        "a person walks next to a wall, next to a dog",
        "a person stands before the camera",
        "a person looks after a child",
        "a person walks then",
        "a person walks and then turns to the left",
        "walk forward, then turn right",
        "An old woman jogged slowly. Then she turned to her left like a dancer.",
        "a person turns left after running",
        "a man is walking, then is turning to his left",
        "a person walks, then ",
        "then a person",
        "walk. wave. bow.",
        "later, a person walks",
        "",
        " ",
        "，然后",
    ],
)
def test_sentences_of_one_stage_stay_as_they_are(sentence):
    assert split_stages(sentence) == (sentence,)


def test_what_is_said_of_one_action_has_one_stage():
    for content in CONTENTS:
        for sentence in bandai_captions(content, "not-confident"):
            assert split_stages(sentence) == (sentence,)


def test_a_great_many_stages_end_in_one():
    stages = split_stages("walk" + ", then jump" * 30)
    assert len(stages) == MOST
    assert stages[-1] == ", then ".join(["jump"] * (31 - MOST + 1))


@given(st.text(max_size=300))
def test_nothing_is_invented(text):
    stages = split_stages(text)
    assert stages
    for word in itertools.chain.from_iterable(stage.split() for stage in stages):
        assert word.strip(".,;!") in text


def test_long_texts_take_no_time():
    # Each pattern must look at a word a bounded number of times: a server splits what strangers send.
    for part in ("a ", "and ", "then ", ", ", "after walking ", "a person ", "before "):
        split_stages(part * (10_000 // len(part)))


@pytest.mark.timeout(60)  # searched from every space to the end, and again from each, it takes hours
def test_a_run_of_spaces_is_a_space():
    long = f"a person walks{' ' * 9000}forward"
    assert split_stages(long) == (long,)
    assert split_stages("a person walks, \n then\twaves") == ("a person walks", "a person waves")
