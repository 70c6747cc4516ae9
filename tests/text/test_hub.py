"""Hub encoders on tiny randomly initialised models that the test writes to disk, tokenizers included."""

import sys

import pytest
import torch
from safetensors.torch import save_file

from moveset.errors import InputError
from moveset.text.encoder import get_text_encoder

transformers = pytest.importorskip("transformers")

SENTENCES = ["a person walks forward and then waves", "", "kick"]
WORDS = ["a", "person", "walks", "forward", "and", "then", "waves", "kick"]


def save_tokenizer(folder, special, template):
    """A word-level tokenizer; T5 closes a sentence, CLIP opens and closes it."""
    from tokenizers import Tokenizer, models, pre_tokenizers, processors

    vocabulary = {word: n for n, word in enumerate([*special.values(), *WORDS])}
    tokenizer = Tokenizer(models.WordLevel(vocabulary, unk_token=special["unk_token"]))
    tokenizer.pre_tokenizer = pre_tokenizers.Whitespace()
    tokenizer.post_processor = processors.TemplateProcessing(
        single=template, special_tokens=[(t, vocabulary[t]) for t in special.values() if t in template]
    )
    transformers.PreTrainedTokenizerFast(tokenizer_object=tokenizer, **special).save_pretrained(folder)


@pytest.fixture(scope="module")
def t5_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("t5")
    torch.manual_seed(0)
    config = transformers.T5Config(
        vocab_size=32, d_model=24, d_kv=6, num_heads=4, num_layers=2, d_ff=32, pad_token_id=0, eos_token_id=1
    )
    transformers.T5EncoderModel(config).save_pretrained(folder)
    save_tokenizer(folder, {"pad_token": "<pad>", "eos_token": "</s>", "unk_token": "<unk>"}, "$A </s>")
    (folder / "2_Dense").mkdir()
    save_file({"linear.weight": torch.randn(10, 24)}, folder / "2_Dense" / "model.safetensors")
    return folder


@pytest.fixture(scope="module")
def clip_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clip")
    torch.manual_seed(0)
    special = {"bos_token": "<s>", "eos_token": "</s>", "unk_token": "<unk>", "pad_token": "<pad>"}
    config = transformers.CLIPTextConfig(
        vocab_size=32,
        hidden_size=24,
        projection_dim=24,
        intermediate_size=32,
        num_attention_heads=4,
        num_hidden_layers=2,
        max_position_embeddings=9,
        bos_token_id=0,
        eos_token_id=1,
        pad_token_id=3,
    )
    transformers.CLIPTextModelWithProjection(config).save_pretrained(folder)
    save_tokenizer(folder, special, "<s> $A </s>")
    return folder


@pytest.fixture(params=["clip", "t5", "sentence-t5"])
def encoder(request, t5_folder, clip_folder):
    return get_text_encoder(f"{request.param}:{clip_folder if request.param == 'clip' else t5_folder}")


def test_protocol(encoder):
    out = encoder.encode(SENTENCES)
    assert out.tokens.shape == (3, out.mask.shape[1], encoder.dim)
    assert out.tokens.dtype == torch.float32
    assert out.mask.dtype == torch.bool
    assert out.mask.any(dim=1).all()
    assert not out.tokens[~out.mask].any()
    torch.testing.assert_close(out.pooled.norm(dim=-1), torch.ones(3))
    for row, sentence in enumerate(SENTENCES):
        alone = encoder.encode([sentence])
        count = alone.tokens.shape[1]
        assert out.mask[row].sum() == count
        torch.testing.assert_close(out.tokens[row, :count], alone.tokens[0], atol=1e-5, rtol=0)
        torch.testing.assert_close(out.pooled[row], alone.pooled[0], atol=1e-5, rtol=0)
    torch.nn.Linear(encoder.dim, 1)(out.tokens).sum().backward()
    with pytest.raises(InputError):
        encoder.encode([])


def test_token_states_and_lengths(t5_folder, clip_folder):
    t5, clip = get_text_encoder(f"t5:{t5_folder}"), get_text_encoder(f"clip:{clip_folder}")
    assert t5.encode(SENTENCES).mask.sum(1).tolist() == [8, 1, 2]
    assert clip.encode(SENTENCES).mask.sum(1).tolist() == [9, 2, 3]
    assert clip.max_tokens == 9
    long = "walks " * 30
    assert (t5.token_count(long), clip.token_count(long)) == (31, 32)
    cut = clip.encode([long])
    assert cut.tokens.shape[1] == 9
    torch.testing.assert_close(cut.pooled, clip.encode(["walks " * 7]).pooled)


def test_sentence_t5_is_one_projected_token(t5_folder):
    out = get_text_encoder(f"sentence-t5:{t5_folder}").encode(SENTENCES)
    assert out.tokens.shape == (3, 1, 10)
    torch.testing.assert_close(out.tokens[:, 0], out.pooled)
    states = get_text_encoder(f"t5:{t5_folder}").encode(SENTENCES)
    mean = states.tokens.sum(1) / states.mask.sum(1, keepdim=True)
    from safetensors.torch import load_file

    weight = load_file(t5_folder / "2_Dense" / "model.safetensors")["linear.weight"]
    torch.testing.assert_close(out.pooled, torch.nn.functional.normalize(mean @ weight.T, dim=-1))


@pytest.mark.parametrize("family", ["clip", "t5", "sentence-t5"])
def test_a_model_that_is_not_here_is_named_with_the_remedy(family, tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    for where in (str(tmp_path), "nobody/has-this-model"):
        with pytest.raises(InputError, match="hf download"):
            get_text_encoder(f"{family}:{where}")


def test_a_missing_projection_is_named(t5_folder, tmp_path):
    for file in t5_folder.iterdir():
        if file.is_file():
            (tmp_path / file.name).write_bytes(file.read_bytes())
    with pytest.raises(InputError, match="2_Dense"):
        get_text_encoder(f"sentence-t5:{tmp_path}")


def test_missing_transformers_is_named_with_the_remedy(monkeypatch):
    for module in [name for name in sys.modules if name.startswith("transformers.")]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "transformers", None)
    for family in ("clip", "t5", "sentence-t5"):
        with pytest.raises(InputError, match=r"moveset\[hub\]"):
            get_text_encoder(f"{family}:anything")
