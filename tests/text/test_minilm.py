"""MiniLM against its oracle, ``transformers``, and the promises of the encoder protocol."""

import pytest
import torch
from safetensors.torch import load_file

from moveset.errors import InputError
from moveset.io.quantization import restored
from moveset.text import minilm
from moveset.text.encoder import get_text_encoder, stack
from moveset.text.minilm import PACKAGED, MiniLM

SENTENCES = [
    "a person walks forward and waves",
    "",
    "kick!",
    "A man slowly raises his left hand to his face, then continues walking in a circle; café naïve 走る",
]


@pytest.fixture(scope="module")
def encoder():
    return MiniLM()


@pytest.mark.parametrize("pack", [True, False])
def test_token_states_equal_transformers(pack, monkeypatch):
    monkeypatch.setattr(minilm, "can_pack", lambda device: pack)
    transformers = pytest.importorskip("transformers")
    sizes = {"hidden_size": 384, "num_hidden_layers": 6, "num_attention_heads": 12, "intermediate_size": 1536}
    bert = transformers.BertModel(transformers.BertConfig(**sizes), add_pooling_layer=False).eval()
    bert.load_state_dict(restored(load_file(PACKAGED / "model.safetensors")))
    tokenizer = transformers.PreTrainedTokenizerFast(tokenizer_file=str(PACKAGED / "tokenizer.json"), pad_token="[PAD]")
    inputs = tokenizer(SENTENCES, padding=True, return_tensors="pt")
    with torch.no_grad():
        expected = bert(**inputs).last_hidden_state
    ours = MiniLM().encode(SENTENCES)
    assert torch.equal(ours.mask, inputs["attention_mask"].bool())
    assert (ours.tokens - expected)[ours.mask].abs().max() <= 1e-5
    weights = ours.mask[..., None].float()
    pooled = torch.nn.functional.normalize((expected * weights).sum(1) / weights.sum(1), dim=-1)
    torch.testing.assert_close(ours.pooled, pooled, atol=1e-5, rtol=0)


def test_a_sentence_does_not_depend_on_its_batch(encoder):
    together = encoder.encode(SENTENCES)
    for row, sentence in enumerate(SENTENCES):
        alone = encoder.encode([sentence])
        count = alone.tokens.shape[1]
        assert together.mask[row].sum() == count
        torch.testing.assert_close(together.tokens[row, :count], alone.tokens[0], atol=1e-5, rtol=0)
        torch.testing.assert_close(together.pooled[row], alone.pooled[0], atol=1e-5, rtol=0)
        assert not together.tokens[row, count:].any()


def test_the_empty_sentence_is_cls_and_sep(encoder):
    assert encoder.encode([""]).tokens.shape == (1, 2, 384)


def test_left_and_right_differ_in_token_states_far_more_than_pooled(encoder):
    pair = encoder.encode(["kick with the left leg", "kick with the right leg"])
    cosine = torch.nn.functional.cosine_similarity(pair.tokens[0], pair.tokens[1], dim=-1)
    assert pair.pooled[0] @ pair.pooled[1] > 0.97
    assert cosine.min() < 0.9


def test_long_sentences_keep_their_beginning_and_the_closing_token():
    short = MiniLM(max_tokens=8)
    long = "walk " * 40
    assert short.token_count(long) == 42
    cut = short.encode([long])
    assert cut.tokens.shape == (1, 8, 384)
    torch.testing.assert_close(cut.tokens, short.encode(["walk " * 6]).tokens)


def test_results_can_enter_a_training_graph(encoder):
    layer = torch.nn.Linear(384, 1)
    layer(encoder.encode(["run"]).tokens).sum().backward()
    assert layer.weight.grad is not None


def test_stack_pads_to_the_longest(encoder):
    joined = stack([encoder.encode(["run"]), encoder.encode(SENTENCES)])
    assert joined.tokens.shape[:2] == joined.mask.shape
    assert len(joined) == 1 + len(SENTENCES)
    assert joined.mask[0].sum() == 3


@pytest.mark.parametrize("sentences", [[], "a person walks", ["walk \udcff"]])
def test_bad_text_is_refused(encoder, sentences):
    with pytest.raises(InputError):
        encoder.encode(sentences)


def test_damaged_or_missing_files_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"tokenizer\.json"):
        MiniLM(tmp_path)
    (tmp_path / "tokenizer.json").write_bytes((PACKAGED / "tokenizer.json").read_bytes())
    with pytest.raises(InputError, match="cannot be read"):
        MiniLM(tmp_path)
    (tmp_path / "model.safetensors").write_bytes(b"\x08\0\0\0\0\0\0\0nonsense" * 9)
    with pytest.raises(InputError, match="cannot be read"):
        MiniLM(tmp_path)


def test_names():
    assert get_text_encoder("minilm").name == "minilm"
    for name in ("bert", "clip", "clip:", "minilm:x"):
        with pytest.raises(InputError, match="unknown"):
            get_text_encoder(name)
