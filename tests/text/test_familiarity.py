"""The nearest known prompt, and how near it is."""

import pytest
import torch

from moveset.errors import InputError
from moveset.text.familiarity import KnownPrompts
from moveset.text.minilm import MiniLM

KNOWN = (
    "a person walks forward",
    "someone waves with the left hand",
    "a man runs quickly",
    "a person kicks with the right leg",
    "she bows politely",
    "a person dances happily",
    "he punches twice",
    "somebody walks backwards slowly",
)


@pytest.fixture(scope="module")
def encoder():
    return MiniLM()


def test_nearest_names_the_caption_and_how_near_it_is(encoder):
    known = KnownPrompts(KNOWN, encoder.encode(KNOWN).pooled.half())
    sentence, cosine = known.nearest(encoder.encode(["a person is walking straight ahead"]).pooled[0])
    assert sentence == "a person walks forward"
    assert 0.6 < cosine < 1
    assert known.nearest(encoder.encode([KNOWN[4]]).pooled[0]) == (KNOWN[4], pytest.approx(1, abs=1e-3))


def test_bad_material_is_refused():
    with pytest.raises(InputError):
        KnownPrompts((), torch.zeros(0, 4))
    with pytest.raises(InputError):
        KnownPrompts(("a",), torch.zeros(2, 4))
