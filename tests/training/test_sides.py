"""The side predictor learns which sides sentences name, and says none of those that name none."""

import torch

from moveset.models.sides import SidePredictorConfig
from moveset.text.encoder import get_text_encoder
from moveset.training.sides import _named


def test_sides_are_learned(tiny_run, tmp_path):
    settings = ("model.width=32", "lr=0.01", "batch=32")
    result = tiny_run.train("sides", tmp_path, *settings, steps=150, validate_every=150)[1]
    assert 0 < result.validation["said"] < 1
    assert result.validation["right"] > 0.9


def test_short_sentences_that_name_no_side_are_told_with_the_one_that_a_motion_favours():
    said = list(_named(("a person waves.", "someone waves the left hand"), torch.tensor([-1.0, 0.0, 1.0])))
    assert said == ["a person waves with the right hand", "a person waves with the right arm"]


def test_sentences_are_read_alike_whatever_is_read_with_them():
    predictor = SidePredictorConfig(dropout=0.0).build().eval()
    encoder = get_text_encoder("minilm")
    one, longer = "turn left", "a person walks forward slowly and then turns to the left and waves"
    together = predictor(encoder.encode([one, longer]))
    torch.testing.assert_close(together[:1], predictor(encoder.encode([one])), atol=1e-5, rtol=1e-4)
