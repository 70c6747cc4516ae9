"""The training clip with the most similar sentence."""

import torch

from moveset.data.dataset import open_dataset
from moveset.evaluation.generators import Wanted
from moveset.evaluation.nearest import NearestClip
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
