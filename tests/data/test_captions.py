"""Captions: English, deterministic, mirrored."""

import itertools
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from moveset.data.bandai_captions import CONTENTS, STYLES, bandai_captions
from moveset.data.captions import mirror_text
from moveset.data.english import inflect
from moveset.errors import InputError

WORDS = st.sampled_from(
    ["left", "Right", "LEFT", "leftward", "rightmost", "left-handed", "clockwise", "counterclockwise", "upright", "a",
     "cleft", "bright", "walks", "right-hander", "lefty", "to", "Counterclockwise", "anticlockwise", "theft", "turns"]
)  # fmt: skip


@given(st.lists(WORDS, max_size=12).map(" ".join))
def test_mirroring_twice_changes_nothing_but_the_spelling_of_counterclockwise(text):
    assert mirror_text(mirror_text(text)) == re.sub("anticlockwise", "counterclockwise", text)


@pytest.mark.parametrize(
    ("text", "mirrored"),
    [
        ("a person turns left", "a person turns right"),
        ("Left leg, RIGHT arm", "Right leg, LEFT arm"),
        ("the left-handed man leans leftwards", "the right-handed man leans rightwards"),
        ("he stands upright in bright light", "he stands upright in bright light"),
        ("walks clockwise", "walks counterclockwise"),
        ("walks counter-clockwise", "walks clockwise"),
        ("anti clockwise turn", "clockwise turn"),
        ("turns counter clock wise", "turns clockwise"),
        ("in a clock-wise motion", "in a counterclockwise motion"),
        ("both hands", "both hands"),
    ],
)
def test_mirror_text(text, mirrored):
    assert mirror_text(text) == mirrored


@pytest.mark.parametrize(
    ("verb", "forms"),
    [
        ("walk", "walk walks walked walking"),
        ("jog", "jog jogs jogged jogging"),
        ("run", "run runs ran running"),
        ("wave", "wave waves waved waving"),
        ("try", "try tries tried trying"),
        ("reach", "reach reaches reached reaching"),
        ("go", "go goes went going"),
        ("box", "box boxes boxed boxing"),
        ("bow", "bow bows bowed bowing"),
        ("pass", "pass passes passed passing"),
        ("veer", "veer veers veered veering"),
        ("show", "show shows showed showing"),
        ("dribble", "dribble dribbles dribbled dribbling"),
        ("sway", "sway sways swayed swaying"),
        ("sleep", "sleep sleeps slept sleeping"),
        ("set", "set sets set setting"),
    ],
)
def test_inflection(verb, forms):
    assert [inflect(verb, f) for f in ("base", "present", "past", "ing")] == forms.split()


def test_sentences_are_well_formed():
    for content, style in itertools.product(CONTENTS, (None, *STYLES)):
        sentences = bandai_captions(content, style)
        assert len(set(sentences)) == len(sentences) == (12 if style is None else 36)
        for sentence in sentences:
            assert not re.search(r"  |\ba [aeio]|\ban [^aeiou]|\b(\w+) \1\b|\bright\b(?! hand)", sentence), sentence


def test_contents_of_the_right_are_told_by_mirror_images():
    assert "a person raises the right arm sadly" in bandai_captions("raise-up-right-hand", "sad")
    for content in CONTENTS:
        if "left" in content:
            mirrored = tuple(mirror_text(sentence) for sentence in bandai_captions(content, "elderly"))
            assert bandai_captions(mirror_text(content), "elderly") == mirrored


@pytest.mark.parametrize("name", [("fly", None), ("walk", "purple"), ("fly-right", "happy")])
def test_unknown_contents_and_styles_are_refused(name):
    with pytest.raises(InputError, match="no captions are written for the"):
        bandai_captions(*name)
