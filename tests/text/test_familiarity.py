"""The nearest known prompt, and a threshold that tells motions from other things."""

import pytest
import torch

from moveset.errors import InputError
from moveset.text.familiarity import KnownPrompts, calibrate
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
INSIDE = [
    "he is walking ahead",
    "waving with the right hand",
    "a woman is running",
    "the person bows",
    "a kick",
    "dance",
]
OUTSIDE = ["what is the capital of France", "a red car in the rain", "import numpy as np", "soup with carrots", "xqzt"]


@pytest.fixture(scope="module")
def encoder():
    return MiniLM()


def test_nearest_names_the_caption_and_calibration_separates(encoder):
    known = KnownPrompts(KNOWN, encoder.encode(KNOWN).pooled.half())
    sentence, cosine = known.nearest(encoder.encode(["a person is walking straight ahead"]).pooled[0])
    assert sentence == "a person walks forward"
    assert 0.6 < cosine < 1
    assert known.nearest(encoder.encode([KNOWN[4]]).pooled[0]) == (KNOWN[4], pytest.approx(1, abs=1e-3))
    inside, outside = (known.similarity(encoder.encode(s).pooled)[0] for s in (INSIDE, OUTSIDE))
    threshold = calibrate(inside, outside)
    assert threshold.false_alarms == 0
    assert threshold.missed == 0
    assert outside.max() < threshold.cosine < inside.min()


@pytest.mark.parametrize("weight", [0.5, 1.0, 2.0, 8.0])
def test_calibration_is_optimal_by_exhaustion(weight):
    generator = torch.Generator().manual_seed(8)
    inside = 0.7 + 0.15 * torch.randn(60, generator=generator)
    outside = 0.4 + 0.15 * torch.randn(40, generator=generator)
    found = calibrate(inside, outside, weight=weight)

    def cost(cut):
        return weight * float((inside < cut).double().mean()) + float((outside >= cut).double().mean())

    assert weight * found.false_alarms + found.missed == pytest.approx(cost(found.cosine))
    assert cost(found.cosine) <= min(cost(cut) for cut in torch.linspace(-0.5, 1.5, 4001)) + 1e-12


def test_bad_material_is_refused():
    with pytest.raises(InputError):
        KnownPrompts((), torch.zeros(0, 4))
    with pytest.raises(InputError):
        KnownPrompts(("a",), torch.zeros(2, 4))
    with pytest.raises(InputError):
        calibrate([], [0.5])
