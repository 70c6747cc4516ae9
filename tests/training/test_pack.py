"""What a packed model has that no training makes: how long sentences last."""

import torch

from moveset.data.rewordings import reword
from moveset.text.encoder import get_text_encoder
from moveset.training.pack import length_of_rewordings


def test_what_is_said_in_words_that_no_caption_has_lasts_as_long():
    written = ["a person walks forward", "a person waves with the left hand"]
    captions, frames = written * 150, torch.tensor([160, 40] * 150)
    held_out = torch.arange(len(captions)) >= 290
    encoder = get_text_encoder("minilm")
    pooled = encoder.encode(written).pooled.repeat(150, 1)
    found = length_of_rewordings(captions, pooled, frames, held_out, "minilm")
    seen = {reword(text, k) for k, text in enumerate(captions)}
    for text, lasts in zip(written, (160, 40), strict=True):
        new = sorted({reword(text, 10_000 + k) for k in range(200)} - seen - {text})
        assert len(new) >= 8
        assert (found.model.predict(encoder.encode(new).pooled) - lasts).abs().median() <= 8
    # Measured on captions as they are written, of what was held out.
    assert found.median_error <= 4
