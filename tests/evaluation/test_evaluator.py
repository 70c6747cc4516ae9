"""An evaluator's folder: what is saved is what judges, padding and order do not matter, garbage is refused."""

import json

import pytest
import torch

from moveset.data.humanml3d import parse_caption
from moveset.errors import FormatError, InputError
from moveset.evaluation.evaluator import Evaluator, EvaluatorCard
from moveset.io.manifest import json_bytes, write_whole
from moveset.models.evaluator import EvaluatorConfig
from moveset.text.encoder import get_text_encoder
from moveset.text.words import TokenWords


@pytest.fixture
def evaluator():
    return make()


def make(**sizes):
    words = TokenWords(get_text_encoder("minilm"))
    torch.manual_seed(0)
    given = {"movement_width": 12, "movement_latent": 10, "word_width": words.width, "speech_classes": 0,
             "text_hidden": 6, "motion_hidden": 9, "joint": 5}  # fmt: skip
    network = EvaluatorConfig(**given | sizes).build()
    network.mean.copy_(torch.randn(len(network.mean)))
    network.std.copy_(torch.rand(len(network.std)) + 0.5)
    return Evaluator(EvaluatorCard(name="tiny"), network, words)


def clips(*lengths):
    generator = torch.Generator().manual_seed(1)
    return [torch.randn(n, 263, generator=generator) for n in lengths]


def test_what_is_saved_judges_alike(evaluator, tmp_path):
    again = Evaluator.open(evaluator.save(tmp_path / "e"))
    said = ["a person walks", "someone waves", "a person walks"]
    assert torch.equal(evaluator.embed_texts(said), again.embed_texts(said))
    assert torch.equal(evaluator.embed_motions(clips(40, 9)), again.embed_motions(clips(40, 9)))
    assert (
        again.sha256 == json.loads((tmp_path / "e/manifest.json").read_text())["files"]["model.safetensors"]["sha256"]
    )
    half = Evaluator.open(evaluator.save(tmp_path / "h", half=True))
    torch.testing.assert_close(half.embed_motions(clips(40)), evaluator.embed_motions(clips(40)), rtol=0.02, atol=0.02)
    assert torch.equal(half.module.mean, evaluator.module.mean)


def test_words_are_as_many_as_it_was_made_with(evaluator, tmp_path):
    words = TokenWords(evaluator.words.encoder, 48)
    folder = Evaluator(evaluator.card, evaluator.module, words).save(tmp_path / "e")
    assert Evaluator.open(folder).words.most == 48
    # Folders made before say nothing of it, and had 32.
    config = json.loads((folder / "config.json").read_text())
    del config["max_words"]
    blobs = {"config.json": json_bytes(config), "model.safetensors": (folder / "model.safetensors").read_bytes()}
    write_whole(tmp_path / "old", blobs)
    assert Evaluator.open(tmp_path / "old").words.most == 32


def test_a_clip_is_judged_alike_alone_and_among_others(evaluator):
    many = clips(196, 40, 4, 87, 300, 41)
    together = evaluator.embed_motions(many, batch=4)
    for k, clip in enumerate(many):
        torch.testing.assert_close(together[k], evaluator.embed_motions([clip])[0], rtol=1e-5, atol=1e-6)


def test_whole_tokens_and_the_first_196_frames_count(evaluator):
    (clip,) = clips(260)
    assert torch.equal(evaluator.embed_motions([clip]), evaluator.embed_motions([clip[:196]]))
    assert torch.equal(evaluator.embed_motions([clip[:43]]), evaluator.embed_motions([clip[:40]]))
    assert not torch.equal(evaluator.embed_motions([clip[:44]]), evaluator.embed_motions([clip[:40]]))


def test_statistics_are_its_own(evaluator):
    """Features in another unit give the same once mean and deviation are in that unit too."""
    scale, shift = torch.rand(263) + 0.5, torch.randn(263)
    expected = evaluator.embed_motions(clips(32))
    evaluator.module.mean.copy_(evaluator.module.mean * scale + shift)
    evaluator.module.std.mul_(scale)
    torch.testing.assert_close(evaluator.embed_motions([clips(32)[0] * scale + shift]), expected, rtol=1e-4, atol=1e-4)


def test_sentences_are_judged_alike_alone_and_among_others(evaluator):
    said = ["a person walks forward and then waves", "go", "someone waves"]
    together = evaluator.embed_texts(said, batch=2)
    for k, sentence in enumerate(said):
        torch.testing.assert_close(together[k], evaluator.embed_texts([sentence])[0], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    ("motions", "said"),
    [
        ([], "no motions"),
        ([torch.zeros(20, 251)], "263"),
        ([torch.zeros(3, 263)], "at least 4 frames"),
        ([torch.zeros(20, 263), torch.full((20, 263), float("nan"))], "motion 1"),
    ],
)
def test_garbage_is_refused(evaluator, motions, said):
    with pytest.raises(InputError, match=said):
        evaluator.embed_motions(motions)


def test_missing_texts_are_refused(evaluator):
    for captions in ([], "a person walks"):
        with pytest.raises(InputError, match="caption"):
            evaluator.embed_texts(captions)


def test_damaged_folders_are_refused(evaluator, tmp_path):
    folder = evaluator.save(tmp_path / "e")
    weights = folder / "model.safetensors"
    whole = weights.read_bytes()
    weights.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FormatError, match="damaged"):
        Evaluator.open(folder)
    weights.write_bytes(whole)
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(config | {"task": "stream"}))
    with pytest.raises(FormatError, match="damaged"):
        Evaluator.open(folder)
    with pytest.raises(InputError, match="unknown evaluator 'nothing-here'"):
        Evaluator.open("nothing-here")


def test_parts_must_fit(evaluator):
    with pytest.raises(FormatError, match="features"):
        Evaluator(EvaluatorCard(name="x", codec="kit"), evaluator.module, evaluator.words)
    with pytest.raises(FormatError, match="words"):
        make(word_width=9)


def test_captions_of_a_text_file_are_read_by_their_sentence(evaluator):
    said = ["a person walks", "someone waves"]
    captions = [parse_caption(f"{text}.#a/DET#0.0#0.0") for text in said]
    assert torch.equal(evaluator.embed_texts(captions), evaluator.embed_texts([f"{text}." for text in said]))
