"""Captions: English, deterministic, mirrored."""

import itertools
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from moveset.data import phrases, styles
from moveset.data.captions import (
    composed_captions,
    mirror_text,
    normal_form,
    train_captions,
)
from moveset.data.labels import canonical_style, mirror_label
from moveset.errors import InputError
from moveset.text.english import inflect

SIDED = ("walk-turn-left", "walk-left", "wave-left-hand", "raise-up-left-hand")
CONTENTS = (*phrases.TRAIN, *(mirror_label(c) for c in SIDED))
BANDAI = CONTENTS[: list(phrases.TRAIN).index("jump")]
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
        ("both hands", "both hands"),
    ],
)
def test_mirror_text(text, mirrored):
    assert mirror_text(text) == mirrored


def test_mirrored_labels_have_mirrored_captions():
    for content in SIDED:
        assert train_captions(mirror_label(content), "happy") == tuple(
            mirror_text(s) for s in train_captions(content, "happy")
        )
        assert not any("right" in s for s in train_captions(content))


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
    ],
)
def test_inflection(verb, forms):
    assert [inflect(verb, f) for f in ("base", "present", "past", "ing")] == forms.split()


def every_training_sentence():
    for content in CONTENTS:
        for style in (None, *styles.STYLES):
            yield from train_captions(content, style)
    for kind in ("in_time", "body"):
        for k, pair in enumerate(itertools.islice(itertools.permutations(CONTENTS, 2), 0, None, 3)):
            yield from composed_captions(kind, pair, f"clip {k % 7}")


@pytest.fixture(scope="module")
def trained() -> frozenset[str]:
    return frozenset(every_training_sentence())


def test_sentences_are_well_formed(trained):
    for sentence in trained:
        assert not re.search(r"[\[\]{}<>_]|  | ,|^ | $|\.\.", sentence), sentence
        assert not re.search(r"\ba [aeio]", sentence), sentence
        assert not re.search(r"\ban [^aeiou]", sentence), sentence
        assert not re.search(r"\b(\w+) \1\b", sentence), sentence
        assert not re.search(r"\b(he|she) \w+ing\b", sentence), sentence
        assert sentence.endswith(".") or not sentence[0].isupper(), sentence


def test_there_are_enough_sentences():
    for content in CONTENTS:
        assert len(set(train_captions(content))) >= 40
        for style in styles.STYLES:
            sentences = train_captions(content, style)
            assert len({normal_form(s) for s in sentences}) >= 50
            assert sentences[: len(train_captions(content))] == train_captions(content)


def test_what_people_type_is_there():
    assert "a person walks forward" in train_captions("walk")
    assert "raises both arms" in train_captions("raise-up-both-hands")
    assert "hello wave" in train_captions("wave-left-hand")
    assert "someone jogs" in train_captions("run")


def test_the_choice_of_sentences_is_forever():
    # Golden: trained models and cached text embeddings depend on these staying as they are.
    assert train_captions("walk", "elderly")[44:47] == GOLDEN_STYLED
    assert composed_captions("in_time", ("walk", "wave-left-hand"), "x", 2) == GOLDEN_COMPOSED


GOLDEN_STYLED = (
    "go for a walk like someone very old",
    "An old man striding forward.",
    "An elderly person is walking straight forward.",
)
GOLDEN_COMPOSED = (
    "the person walks in a straight line, then waves their left arm",
    "A person strolls forward. Then they wave with the left hand.",
)


def test_composed_sentences_name_both_and_agree_with_their_subject():
    for k in range(300):
        for sentence in composed_captions("in_time", ("walk", "wave-left-hand"), str(k)):
            assert "left" in sentence
            assert not ("man" in sentence.split() and re.search(r"\b(their|they)\b", sentence)), sentence
            assert not ("woman" in sentence.split() and re.search(r"\b(their|his|he)\b", sentence)), sentence


def test_unknown_labels_are_refused():
    for call in (
        lambda: train_captions("fly"),
        lambda: train_captions("walk", "purple"),
        lambda: composed_captions("sideways", ("walk", "run"), "x"),
        lambda: composed_captions("body", ("walk", "fly"), "x"),
    ):
        with pytest.raises(InputError):
            call()


def test_labels():
    assert canonical_style("masculinity") == "masculine"
    for content in CONTENTS:
        assert mirror_label(mirror_label(content)) == content
