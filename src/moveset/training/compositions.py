"""Clips that a recurrent model learns from besides those of the corpus: takes joined in time or by body part.

They are made once, and kept in half precision. F frames, D features.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np
from tqdm import tqdm

from moveset.data.captions import composed_captions
from moveset.data.compose import plan_bodies, plan_continuations
from moveset.data.corpus import Corpus, compose
from moveset.data.feature_store import FeatureStore
from moveset.data.records import Recipe
from moveset.data.segments import Row
from moveset.data.splits import Split
from moveset.io.limits import atomic_write
from moveset.motion.clip import Motion
from moveset.motion.features import FeatureCodec


def composed_rows(
    kind: Literal["continuations", "bodies"],
    corpus: Corpus,
    split: Split,
    store: FeatureStore,
    codec: FeatureCodec,
    count: int,
    folder: Path,
) -> list[Row]:
    """Up to ``count`` compositions of one split, made where ``folder`` does not hold them yet.

    "continuations" are told by the first part's sentences as a whole, "bodies" have one part.
    """
    path = folder / f"composed-{kind}-{split}-{count}.npz"
    if not path.is_file():
        planned = {"continuations": _continuations, "bodies": _bodies}[kind](corpus, split, count)
        made, table = [], []
        for recipe, motion, said in tqdm(planned, desc=kind, total=count, disable=None):
            made.append(store.normalizer.normalize(codec.encode(motion)).half().numpy())
            frames = len(made[-1])
            table.append([frames, [recipe.seam, frames] if len(said) == 2 else [frames], said])
        features = np.concatenate(made) if made else np.zeros((0, codec.dim), np.float16)
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as file:
            np.savez(file, features=features, table=np.array(json.dumps(table)))
    with np.load(path) as stored:
        features, table = stored["features"], json.loads(str(stored["table"]))
    rows, start = [], 0
    for frames, ends, said in table:
        parts = tuple(map(tuple, said))
        rows.append(Row(features[start : start + frames], tuple(ends), parts, parts[0], kind == "continuations"))
        start += frames
    return rows


_Composed = Iterator[tuple[Recipe, Motion, list[tuple[str, ...]]]]


def _continuations(corpus: Corpus, split: Split, count: int) -> _Composed:
    for _, recipe in plan_continuations(corpus, split, count):
        said = [corpus.captions(part.clip, part.mirrored) for part in recipe.parts]
        yield recipe, _composed(corpus, "in_time", recipe), said


def _bodies(corpus: Corpus, split: Split, count: int) -> _Composed:
    for number, (contents, recipe) in enumerate(plan_bodies(corpus, split, count)):
        said = composed_captions("body", contents, f"added_{split}_{number:04d}")
        yield recipe, _composed(corpus, "body", recipe), [said]


def _composed(corpus: Corpus, kind: str, recipe: Recipe) -> Motion:
    parts = [corpus.motion(part.clip)[part.start : part.stop] for part in recipe.parts]
    return compose(kind, recipe, [m.mirrored() if p.mirrored else m for m, p in zip(parts, recipe.parts, strict=True)])
