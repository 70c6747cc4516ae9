"""Rewordings: a phrase for each content, and the sides stay."""

import re

import pytest

from moveset.data import phrases, reworded_phrases, reworded_styles, styles
from moveset.data.captions import composed_captions, mirror_text, normal_form, train_captions
from moveset.data.labels import mirror_label
from moveset.data.rewordings import all_words, reword


def words(x: object) -> set[str]:
    return set(re.findall("[a-z]+", str(x).lower()))


def test_every_content_and_every_way_of_a_style_has_other_words() -> None:
    assert reworded_phrases.PHRASES.keys() == phrases.TRAIN.keys()
    assert reworded_styles.STYLES.keys() == styles.STYLES.keys()
    for style, ways in reworded_styles.STYLES.items():
        assert ways.keys() <= styles.STYLES[style].keys(), style


@pytest.mark.parametrize("content", ["walk", "walk-turn-left", "wave-right-hand", "raise-up-both-hands", "salsa"])
def test_nearly_every_caption_can_be_said_in_many_ways(content) -> None:
    known = train_captions(content)
    said = [{reword(caption, key) for key in range(8)} for caption in known]
    assert sum(len(ways) >= 4 for ways in said) > 0.85 * len(known)
    assert [reword(caption, 3) for caption in known] == [reword(caption, 3) for caption in known]


@pytest.mark.parametrize("content", ["walk-turn-left", "walk-left", "wave-left-hand", "raise-up-left-hand"])
@pytest.mark.parametrize("right", [False, True])
def test_the_side_stays(content, right) -> None:
    label, side = (mirror_label(content), "right") if right else (content, "left")
    for caption in train_captions(label):
        for key in range(6):
            assert words(reword(caption, key)) & {"left", "right"} <= {side}, (caption, reword(caption, key))
            if {side} & words(caption):
                assert side in words(reword(caption, key)), (caption, reword(caption, key))


def test_both_parts_of_a_composition_are_reworded_in_their_places() -> None:
    changed = 0
    for number in range(40):
        for caption in composed_captions("in_time", ("walk-turn-left", "wave-right-hand"), f"clip{number}"):
            said = reword(caption, number)
            changed += said != caption
            left, right = said.lower().find("left"), said.lower().rfind("right")
            assert min(left, right) >= 0, (caption, said)
            after_first = "after" in normal_form(caption).split() and "after that" not in caption.lower()
            if not after_first:
                assert left < right, (caption, said)
    assert changed > 140


def test_no_marks_are_left_and_articles_agree() -> None:
    for content in phrases.TRAIN:
        for style in (None, "elderly", "childish", "angry"):
            for caption in train_captions(content, style):
                said = reword(caption, 5)
                assert not set(said) & set("[]{}()|"), said
                assert not re.search(r"  |\ba [aeio]|\ban [^aeiou]", said.lower()), said


def test_what_is_not_known_stays() -> None:
    for caption in ("", "xyzzy", "A cow flies over an hourglass!", "a person does something odd"):
        assert reword(caption, 1) == caption


def test_mirrored_captions_are_known_too() -> None:
    caption = mirror_text("a person walks forward and turns left")
    assert reword(caption, 1) != caption


def test_all_words_are_those_that_rewordings_say() -> None:
    known = {word for content in phrases.TRAIN for caption in train_captions(content) for word in words(caption)}
    said = {
        word
        for content in ("walk-turn-left", "salsa", "dash", "bow")
        for caption in train_captions(content, "elderly")
        for key in range(3)
        for word in normal_form(reword(caption, key)).split()
    }
    assert said <= all_words() | known | words(styles.STYLES) | {"a", "an"}
    assert {"swerve", "swerving", "swerved", "mambo", "granny"} <= all_words()
