"""Rows to read others beside: motion of the training, and of it the clip with the most similar sentence."""

import numpy as np
import pytest
import torch

from moveset.data.dataset import open_dataset
from moveset.errors import InputError
from moveset.evaluation.generators import Given, Wanted
from moveset.evaluation.nearest import NearestClip
from moveset.evaluation.protocol import Protocol
from moveset.evaluation.run import EvaluationConfig, open_source
from tests.evaluation.corpora import content_corpus
from tests.training.hml_folder import PART, write_folder


def test_a_sentence_of_the_training_gives_a_clip_of_it(tmp_path):
    dataset = open_dataset(content_corpus(tmp_path / "corpus.safetensors", split="train"))
    row = NearestClip(dataset)
    clips = [dataset.clip(number) for number in dataset.split("train")]
    sentences = sorted({caption for clip in clips for caption in clip.captions})[:5]
    made = row.generate([Wanted(((sentence, 30),), 0) for sentence in sentences], 20.0)
    for sentence, joints in zip(sentences, made, strict=True):
        own = [clip.joints()[:30] for clip in clips if sentence in clip.captions]
        assert any(joints.shape == x.shape and torch.equal(joints, x) for x in own)


def test_repeats_are_of_the_training_motion_they_were_made_from(tmp_path):
    folder = write_folder(tmp_path / "folder")

    def weights() -> dict[str, str]:
        return NearestClip(open_dataset(folder)).weights()

    found = [weights()]
    for path in (folder / "new_joint_vecs" / "e.npy", folder / "texts" / "e.txt", folder / "train.txt"):
        if path.suffix == ".npy":
            np.save(path, np.load(path)[::-1])
        else:
            path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))
        found.append(weights())
    assert len({repr(one) for one in found}) == 4
    (folder / "texts" / "test1.txt").write_text(PART + "\n")  # is told by the hash of the judged split
    assert weights() == found[-1]
    # The hash of a corpus is that of the file, training clips with it.
    assert NearestClip(open_dataset(content_corpus(tmp_path / "corpus.safetensors", split="train"))).weights() == {}


def test_sentences_are_read_when_motion_is_asked_for(tmp_path, monkeypatch):
    """What is opened is checked first, and each process opens it again."""
    path = content_corpus(tmp_path / "corpus.safetensors", split="train")
    monkeypatch.setattr(NearestClip, "_pooled", None)
    assert open_source(EvaluationConfig(model="nearest", data=path)).slug == "nearest"


def test_without_training_clips_nothing_is_nearest(tmp_path):
    path = content_corpus(tmp_path / "corpus.safetensors", split="test")
    with pytest.raises(InputError, match=r"corpus\.safetensors has no training clips, of which 'nearest' is one"):
        open_source(EvaluationConfig(model="nearest", data=path))


@pytest.mark.parametrize("row", ["nearest", "training"])
def test_single_clips_cannot_be_rolled_out(tmp_path, row):
    path = content_corpus(tmp_path / "corpus.safetensors", split="train")
    with pytest.raises(InputError, match=f"^{row} cannot be rolled out"):
        open_source(EvaluationConfig(model=row, data=path, protocol=Protocol(split="rollout")))


def test_training_motion_is_that_of_the_training_split(tmp_path):
    path = content_corpus(tmp_path / "corpus.safetensors", split="train")
    row = open_source(EvaluationConfig(model="training", data=path, device="cpu"))
    assert isinstance(row, Given)
    assert row.items is not None
    assert {item.name for item in row.items.items} == {
        clip.name for clip in map(open_dataset(path).clip, open_dataset(path).split("train"))
    }
    assert (row.slug, row.random) == ("training", False)
