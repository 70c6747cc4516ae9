"""The embedding cache gives back what the encoder said and refuses files that were touched."""

import threading

import pytest
import torch

from moveset.errors import FormatError, InputError
from moveset.text.cache import CachedEncoder, EmbeddingCache
from moveset.text.encoder import TextEmbedding

WORDS = ("a", "person", "walks", "jumps", "waves", "slowly", "forward", "left", "right", "hand", "then", "and")


class LetterEncoder:
    """Stands in for a real encoder: every word becomes a vector made of its letters."""

    name, dim, max_tokens, device = "letters", 6, 8, torch.device("cpu")

    def __init__(self):
        self.calls = 0

    def encode(self, sentences):
        self.calls += 1
        ids = [[" ", *s.split()][: self.max_tokens] for s in sentences]
        width = max(map(len, ids))
        tokens = torch.zeros(len(ids), width, self.dim)
        for b, words in enumerate(ids):
            for n, word in enumerate(words):
                tokens[b, n] = torch.tensor([float(len(word)), *(ord(c) / 7 for c in f"{word}~~~~~"[:5])])
        mask = torch.arange(width) < torch.tensor([len(w) for w in ids])[:, None]
        pooled = torch.nn.functional.normalize(tokens.sum(1) + 1, dim=-1)
        return TextEmbedding(tokens, mask, pooled)

    def token_count(self, sentence):
        return 1 + len(sentence.split())


@pytest.fixture
def sentences():
    generator = torch.Generator().manual_seed(3)
    counts = torch.randint(1, 12, (150,), generator=generator).tolist()
    return [" ".join(WORDS[k] for k in torch.randint(len(WORDS), (n,), generator=generator)) for n in counts]


def same(a, b):
    torch.testing.assert_close(a.tokens, b.tokens, atol=0.02, rtol=1e-3)
    torch.testing.assert_close(a.pooled, b.pooled, atol=1e-3, rtol=0)
    assert torch.equal(a.mask, b.mask)


def test_lookup_equals_encoding(sentences, tmp_path):
    encoder = LetterEncoder()
    cache = EmbeddingCache.build(encoder, sentences, tmp_path / "deep" / "text.safetensors")
    picked = [sentences[7], "", sentences[90], sentences[7]]
    same(cache.lookup(picked), encoder.encode(picked))
    assert cache.rows(picked)[1] == 0
    cut = cache.lookup(picked, max_tokens=3)
    assert cut.tokens.shape[1] == 3
    same(cut, TextEmbedding(cache.lookup(picked).tokens[:, :3], cache.lookup(picked).mask[:, :3], cut.pooled))


def test_a_file_grows_by_what_it_does_not_hold(sentences, tmp_path):
    path = tmp_path / "text.safetensors"
    encoder = LetterEncoder()
    EmbeddingCache.build(encoder, sentences, path)
    calls, first = encoder.calls, path.read_bytes()
    EmbeddingCache.build(encoder, sentences * 2, path)
    EmbeddingCache.build(encoder, sentences[:3], path)
    assert encoder.calls == calls
    assert path.read_bytes() == first
    grown = EmbeddingCache.build(encoder, ["new words", *sentences[:5], "and others"], path)
    assert encoder.calls == calls + 1
    assert len(grown) == len(set(sentences)) + 3
    picked = ["and others", "", sentences[40], "new words"]
    same(grown.lookup(picked), encoder.encode(picked))
    same(EmbeddingCache.open(path).lookup(picked), encoder.encode(picked))


def test_a_file_of_another_encoder_or_of_none_is_made_anew(sentences, tmp_path):
    path = tmp_path / "text.safetensors"
    encoder = LetterEncoder()
    EmbeddingCache.build(encoder, sentences, path)
    other = LetterEncoder()
    other.name = "other letters"
    assert EmbeddingCache.build(other, sentences[:2], path).encoder == "other letters"
    assert len(EmbeddingCache.open(path)) == 3
    path.write_bytes(b"nonsense")
    assert len(EmbeddingCache.build(encoder, sentences, path)) == len(set(sentences)) + 1
    assert {p.name for p in tmp_path.iterdir()} == {"text.safetensors", ".lock"}


def test_unknown_sentences_encoders_and_files_are_named(sentences, tmp_path):
    path = tmp_path / "text.safetensors"
    cache = EmbeddingCache.build(LetterEncoder(), sentences, path)
    with pytest.raises(InputError, match="swims"):
        cache.lookup(["a person swims"])
    with pytest.raises(InputError, match="no text cache"):
        EmbeddingCache.open(tmp_path / "other")
    with pytest.raises(InputError):
        EmbeddingCache.build(LetterEncoder(), [], path)


@pytest.mark.parametrize("where", [0.1, 0.5, 0.8, 0.999])
def test_a_changed_byte_is_found(sentences, tmp_path, where):
    path = tmp_path / "text.safetensors"
    EmbeddingCache.build(LetterEncoder(), sentences, path)
    data = bytearray(path.read_bytes())
    data[int(len(data) * where)] ^= 0x10
    path.write_bytes(data)
    with pytest.raises(FormatError):
        EmbeddingCache.open(path)
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(FormatError):
        EmbeddingCache.open(path)


def test_of_two_that_add_to_a_cache_at_once_none_loses_its_sentences(tmp_path):
    path, inside, go_on = tmp_path / "text.safetensors", threading.Event(), threading.Event()

    class Slow(LetterEncoder):
        def encode(self, sentences):
            inside.set()
            assert go_on.wait(30)
            return super().encode(sentences)

    first = threading.Thread(target=EmbeddingCache.build, args=(Slow(), ["a person walks"], path))
    second = threading.Thread(target=EmbeddingCache.build, args=(LetterEncoder(), ["a person jumps"], path))
    first.start()
    assert inside.wait(30)
    second.start()
    second.join(0.3)  # it waits, unless it goes about it at once
    go_on.set()
    first.join(30)
    second.join(30)
    assert set(EmbeddingCache.open(path).sentences) == {"", "a person walks", "a person jumps"}


def test_a_sentence_is_encoded_once_and_alone_while_it_is_remembered():
    encoder = LetterEncoder()
    cached = CachedEncoder(encoder, limit=2)
    first = cached.encode(["walk"])
    assert cached.encode(["walk"]) is first
    both = cached.encode(["walk", "a person bows", "walk"])
    assert encoder.calls == 2
    same(both, encoder.encode(["walk", "a person bows", "walk"]))
    for sentence in ("walk", "kick", "walk"):
        cached.encode([sentence])
    assert cached.encode(["walk"]) is first
    calls = encoder.calls
    cached.encode(["a person bows"])
    assert encoder.calls == calls + 1
    assert (cached.name, cached.dim, cached.max_tokens) == (encoder.name, encoder.dim, encoder.max_tokens)
