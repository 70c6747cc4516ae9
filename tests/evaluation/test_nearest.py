"""Rows to read others beside: motion of the training, and of it the clip with the most similar sentence."""

import torch

from moveset.data.dataset import open_dataset
from moveset.evaluation.generators import Given, Wanted
from moveset.evaluation.nearest import NearestClip
from moveset.evaluation.run import EvaluationConfig, open_source
from tests.evaluation.corpora import content_corpus


def test_a_sentence_of_the_training_gives_a_clip_of_it(tmp_path):
    dataset = open_dataset(content_corpus(tmp_path / "corpus.safetensors", split="train"))
    row = NearestClip(dataset)
    clips = [dataset.clip(number) for number in dataset.split("train")]
    sentences = sorted({caption for clip in clips for caption in clip.captions})[:5]
    made = row.generate([Wanted(((sentence, 30),), 0) for sentence in sentences], 20.0)
    for sentence, joints in zip(sentences, made, strict=True):
        own = [clip.joints()[:30] for clip in clips if sentence in clip.captions]
        assert any(joints.shape == x.shape and torch.equal(joints, x) for x in own)


def test_training_motion_is_that_of_the_training_split(tmp_path):
    path = content_corpus(tmp_path / "corpus.safetensors", split="train")
    row = open_source(EvaluationConfig(model="training", data=path, device="cpu"))
    assert isinstance(row, Given)
    assert row.items is not None
    assert {item.name for item in row.items.items} == {
        clip.name for clip in map(open_dataset(path).clip, open_dataset(path).split("train"))
    }
    assert (row.slug, row.random) == ("training", False)
