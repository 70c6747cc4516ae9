"""A corpus that is written as a HumanML3D or KIT-ML folder reads as one."""

import numpy as np
import pytest
import torch

from moveset.data.corpus import Corpus
from moveset.data.dataset import CorpusDataset, open_for_training
from moveset.data.humanml3d import HUMANML3D, KIT, HumanML3D
from moveset.data.humanml3d_writer import write_humanml3d
from moveset.errors import InputError
from moveset.motion.features import Normalizer, get_codec
from tests.synthetic import synthetic_corpus


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
        spans = {(caption.start, caption.end) for caption in read.captions(name)} - {(0.0, 0.0)}
        assert len(spans) == len(clip.parts)
        assert all(
            end * 20 == pytest.approx(part.stop, abs=0.2)
            for (_, end), part in zip(sorted(spans), clip.parts, strict=True)
        )
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
