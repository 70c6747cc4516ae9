"""Obvious typos: what is mended, and what is left as it was typed."""

from collections import Counter

import pytest

from moveset.data.typos import mend

WORDS = Counter({"person": 900, "throwing": 90, "walking": 400, "waling": 1})


@pytest.mark.parametrize("sentence", ["Throwing", "Walking, he is", "WALKING", "éwaling", "walkinG", "2waling", ""])
def test_only_whole_words_in_small_letters_are_mended(sentence):
    assert mend(sentence, WORDS) == sentence


@pytest.mark.parametrize("around", ["{}", "A {}.", "he's {}, x", "({})", "half-{}"])
def test_a_slip_is_mended_whatever_stands_around_it(around):
    assert mend(around.format("waling"), WORDS) == around.format("walking")
