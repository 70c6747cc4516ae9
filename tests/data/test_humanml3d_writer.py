"""A corpus that is written as a HumanML3D or KIT-ML folder reads as one."""

import errno
import os
from dataclasses import replace

import numpy as np
import pytest
import torch

from moveset.data.corpus import Corpus, CorpusWriter
from moveset.data.dataset import CorpusDataset, open_for_training
from moveset.data.humanml3d import HUMANML3D, KIT, HumanML3D
from moveset.data.humanml3d_writer import write_humanml3d
from moveset.data.records import Part, Recipe
from moveset.errors import InputError, MovesetError
from moveset.motion.features import Normalizer, get_codec
from tests.synthetic import TakeEntry, add_take, synthetic_corpus, synthetic_motion


@pytest.mark.parametrize("layout", [HUMANML3D, KIT], ids=lambda layout: layout.name)
def test_what_is_written_is_what_is_read(layout, tmp_path):
    corpus = Corpus.open(synthetic_corpus(tmp_path / "corpus.safetensors", clips=12, seed=0))
    source, codec = CorpusDataset(corpus), get_codec(layout.codec)
    read = HumanML3D.open(write_humanml3d(corpus, tmp_path / "data", layout))
    assert read.layout == layout
    assert {split: len(names) for split, names in read.splits.items()} == {
        split: len(source.split(split)) for split in read.splits
    }
    for item in source.split("train"):
        clip, name = source.clip(item), f"{'M' * (item % 2)}{item // 2:06d}"
        whole = tuple(caption.text for caption in read.captions(name) if not caption.start and not caption.end)
        assert whole == clip.captions
        assert len({(caption.start, caption.end) for caption in read.captions(name)} - {(0.0, 0.0)}) == len(clip.parts)
        joints, rows = torch.from_numpy(np.load(read.folder / "new_joints" / f"{name}.npy")), read.features(name)
        torch.testing.assert_close(joints * codec.convention.unit, codec.joints(rows), atol=1e-5, rtol=0)
        if layout is HUMANML3D:
            assert torch.equal(rows, clip.features(codec))
        else:
            assert len(rows) == pytest.approx(clip.frames / 20 * 12.5, abs=2)
    fitted = Normalizer.fit((read.features(name) for name in read.splits["train"]), codec.groups)
    assert torch.equal(fitted.std, read.std)
    dataset = open_for_training(tmp_path / "data")
    assert dataset.clip(0).group == "000000"
    with pytest.raises(InputError, match="is there already"):
        write_humanml3d(corpus, tmp_path / "data", layout)


@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))], ids=repr)
def test_a_folder_is_written_whole_or_not_at_all(error, tmp_path, monkeypatch):
    corpus = Corpus.open(synthetic_corpus(tmp_path / "corpus.safetensors", clips=12, seed=0))

    def broken(path, values):
        if path.name == "000002.npy":
            raise error

    monkeypatch.setattr(np, "save", broken)
    with pytest.raises((KeyboardInterrupt, MovesetError), match=r"^$|No space left on device; make room"):
        write_humanml3d(corpus, tmp_path / "data")
    assert [path.name for path in tmp_path.iterdir()] == ["corpus.safetensors"]


@pytest.mark.parametrize("layout", [HUMANML3D, KIT], ids=lambda layout: layout.name)
def test_a_part_is_read_as_the_rows_of_its_seconds(layout, tmp_path):
    writer, said = CorpusWriter(), ("a person walks", "a person bows")
    for number, (kind, caption) in enumerate(zip(("walk", "bow"), said, strict=True)):
        add_take(
            writer,
            TakeEntry(
                name=kind, take=kind, source="synthetic", content=kind, style=None, captions=(caption,), split="train",
                subject="synthetic", motion=synthetic_motion(kind, 90, seed=number),
            ),
        )  # fmt: skip
    recipe = Recipe((Part(0, 0, 90), Part(1, 0, 90)), blend=12)
    record = replace(
        writer.records[0], name="both", group="both", kind="in_time", contents=("walk", "bow"), frames=168,
        recipe=recipe, run=None,
    )  # fmt: skip
    writer.add_clip(record, ("a person walks and then bows",))
    corpus = Corpus.open(writer.write(tmp_path / "corpus.safetensors"))
    items = HumanML3D.open(write_humanml3d(corpus, tmp_path / "data", layout)).items("train")
    found = {item.captions[0].text: item for item in items if item.name == "000002"}
    first, second = (found[caption] for caption in said)
    whole = found["a person walks and then bows"]
    assert (first.start, first.stop, second.stop) == (0, second.start, whole.stop)
    # The first row of the second part is the first that is not before its first frame.
    seam = CorpusDataset(corpus).clip(4).parts[0].stop / 20
    assert (second.start - 1) / layout.fps < seam <= second.start / layout.fps
