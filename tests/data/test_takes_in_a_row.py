"""Clips of one take in a row, in features that have a row for each frame and in those that lack the last one's."""

from itertools import pairwise

import numpy as np
import pytest

from moveset.data.corpus import CorpusWriter
from moveset.data.dataset import open_for_training
from moveset.data.feature_store import FeatureStore
from moveset.data.records import ClipRecord
from moveset.data.segments import ClipSet, CuttingConfig
from moveset.motion.features import get_codec
from tests.synthetic import synthetic_motion

SPANS = {"val": (0, 300), "a": (0, 100), "b": (100, 180), "c": (160, 240), "d": (239, 300)}


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    """One run; b begins where a ends, c overlaps b, d shares one frame with c."""
    writer, folder = CorpusWriter(), tmp_path_factory.mktemp("run")
    run = writer.add_run("take", synthetic_motion("walk", 300, seed=1))
    for name, (start, stop) in SPANS.items():
        record = ClipRecord(
            name=name, take="take", source="synthetic", subject="s", group="take", kind="take", contents=("walk",),
            style=None, split="val" if name == "val" else "train", fps=20.0, frames=stop - start, captions=(),
            first_frame=start, run=run,
        )  # fmt: skip
        writer.add_clip(record, (f"a person does {name}",))
    return writer.write(folder / "corpus.safetensors")


@pytest.mark.parametrize(
    ("name", "told", "ends"), [("native", "abcd", (100, 170, 239, 300)), ("hml", "bcd", (69, 139, 199))]
)
def test_rows_of_a_take_follow_each_other(corpus, tmp_path, name, told, ends):
    codec, opened = get_codec(name), open_for_training(corpus)
    store = FeatureStore.of(opened, codec, tmp_path / name)
    # Features that are nothing but the number of their frame in the run.
    begins = [begin for begin, _ in SPANS.values() for _ in range(2)]
    store.features = np.concatenate(
        [np.arange(begin, begin + row.frames)[:, None] for begin, row in zip(begins, store.clips, strict=True)]
    ).astype(np.float32)
    taken = ClipSet(opened, "train", store, codec, CuttingConfig(take_share=0.5)).rows[len(opened.split("train")) :]
    assert len(taken) == 2  # and its mirror image
    for row in taken:
        assert "".join(said[0].split()[-1] for said in row.said) == told
        assert row.ends == ends
        assert [len(piece) for piece in row.pieces] == [b - a for a, b in pairwise((0, *ends))]
        first = SPANS[told[0]][0]
        assert row.cut(0, len(row))[:, 0].tolist() == list(range(first, first + ends[-1]))
