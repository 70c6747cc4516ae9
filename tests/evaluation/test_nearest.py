"""Rows to read others beside: motion of the training, and of it the clip with the most similar sentence."""

import numpy as np
import torch

from moveset.data.dataset import open_dataset
from moveset.evaluation.generators import Given, Wanted
from moveset.evaluation.nearest import NearestClip
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


def test_training_motion_is_that_of_the_training_split(tmp_path):
    path = content_corpus(tmp_path / "corpus.safetensors", split="train")
    row = open_source(EvaluationConfig(model="training", data=path, device="cpu"))
    assert isinstance(row, Given)
    assert row.items is not None
    assert {item.name for item in row.items.items} == {
        clip.name for clip in map(open_dataset(path).clip, open_dataset(path).split("train"))
    }
    assert (row.slug, row.random) == ("training", False)
