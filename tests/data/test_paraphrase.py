"""Paraphrases: no word of the held-out phrases, the sides stay, and mirroring commutes where it must."""

import re

from moveset.data import captions, held_out_phrases, paraphrase
from moveset.data.captions import train_captions

COMMON = set(
    [
        "a",
        "an",
        "the",
        "in",
        "at",
        "on",
        "to",
        "by",
        "as",
        "it",
        "up",
        "one",
        "which",
        "here",
        "show",
        "then",
        "ahead",
        "forward",
        "backwards",
        "straight",
        "walk",
        "run",
        "jog",
        "stroll",
        "turn",
        "wave",
        "raise",
        "go",
        "body",
    ]
)


def words(x: object) -> set[str]:
    return set(re.findall("[a-z]+", str(x).lower()))


def test_no_held_out_word_is_used() -> None:
    mine = words(paraphrase._PEOPLE) | words(paraphrase._FRAMES) | words(paraphrase._VERBS) | words(paraphrase._WORDS)
    held = words(held_out_phrases.HELD_OUT) | words(held_out_phrases.HELD_OUT_STYLES) | words(captions._HELD_OUT_FORMS)
    assert not (mine & held) - COMMON


def test_sides_are_never_touched() -> None:
    for content in ("walk-turn-left", "wave-right-hand", "raise-up-both-hands", "wave-left-hand"):
        for caption in train_captions(content):
            said = paraphrase.paraphrase(caption)
            for side in ("left", "right", "both"):
                assert words(said) & {side} == words(caption) & {side}


def test_it_is_a_function_that_mostly_changes_something() -> None:
    known = [c for content in ("walk", "run", "wave-left-hand") for c in train_captions(content)]
    changed = [paraphrase.paraphrase(c) != c for c in known]
    assert sum(changed) > 0.6 * len(known)
    assert [paraphrase.paraphrase(c) for c in known] == [paraphrase.paraphrase(c) for c in known]
