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


def test_the_nearest_caption_and_how_near_it_is(encoder):
    known = KnownPrompts(KNOWN, encoder.encode(KNOWN).pooled.half())
    said = ["a person is walking straight ahead", KNOWN[4]]
    cosines, where = known.similarity(encoder.encode(said).pooled)
    assert [known.sentences[k] for k in where] == ["a person walks forward", KNOWN[4]]
    assert 0.6 < cosines[0] < 1
    assert cosines[1] == pytest.approx(1, abs=1e-3)


def test_bad_material_is_refused():
    with pytest.raises(InputError):
        KnownPrompts((), torch.zeros(0, 4))
    with pytest.raises(InputError):
        KnownPrompts(("a",), torch.zeros(2, 4))
