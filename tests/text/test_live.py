"""Live embeddings say of any sentence what the encoder says, wherever they have it from."""

import pytest
import torch

from moveset.text.cache import EmbeddingCache
from moveset.text.live import LiveEmbeddings
from tests.text.test_cache import LetterEncoder, same

CACHED = ["a person walks", "a person jumps slowly", "left"]
OTHER = ["right hand", "a person waves and then walks", "hand then hand then hand then hand then hand"]


@pytest.fixture(params=["cache", "none"])
def live(request, tmp_path):
    encoder = LetterEncoder()
    cache = EmbeddingCache.build(encoder, CACHED, tmp_path / "text.safetensors") if request.param == "cache" else None
    return LiveEmbeddings(encoder, cache)


@pytest.mark.parametrize("prepared", [[], OTHER[:1], CACHED[:2] + OTHER])
def test_a_lookup_is_what_the_encoder_says_whatever_was_prepared(live, prepared):
    live.prepare(prepared)
    for said in (OTHER + CACHED, CACHED, ["", *OTHER, ""], [OTHER[0]] * 3, [""]):
        same(live.lookup(said), live.encoder.encode(said))
        torch.testing.assert_close(live.pooled_of(said), live.encoder.encode(said).pooled, atol=1e-3, rtol=0)


def test_sentences_are_cut(live):
    said = [OTHER[2], "", CACHED[0]]
    whole, cut = live.lookup(said), live.lookup(said, max_tokens=3)
    assert cut.tokens.shape[1] == 3
    assert torch.equal(cut.tokens, whole.tokens[:, :3])
    assert torch.equal(cut.mask, whole.mask[:, :3])
    assert torch.equal(cut.pooled, whole.pooled)


def test_what_is_prepared_is_encoded_once(live):
    live.prepare(CACHED + OTHER)
    calls = live.encoder.calls
    live.lookup(CACHED + OTHER)
    live.pooled_of(OTHER)
    assert live.encoder.calls == calls
    live.lookup(["quite another sentence"])
    assert live.encoder.calls == calls + 1


def test_widths_are_those_of_a_cache(tmp_path):
    encoder = LetterEncoder()
    cache = EmbeddingCache.build(encoder, CACHED, tmp_path / "text.safetensors")
    assert LiveEmbeddings(encoder).widths == cache.widths == (6, 6)
