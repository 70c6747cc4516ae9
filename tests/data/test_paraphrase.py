"""Paraphrases: the sides stay, and mirroring commutes where it must."""

import re

from moveset.data import paraphrase
from moveset.data.captions import train_captions


def words(x: object) -> set[str]:
    return set(re.findall("[a-z]+", str(x).lower()))


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
