"""Corpora and folders of motion with known items, for tests of evaluation."""

import json
from pathlib import Path

import numpy as np

from moveset.data.corpus import CorpusWriter
from moveset.data.descriptions import said_otherwise
from moveset.data.english import inflect
from moveset.data.records import ClipRecord, Part, Recipe
from moveset.data.verbs import VERBS
from tests.synthetic import KINDS, TakeEntry, add_take, synthetic_motion

FRAMES = 40
CONTENTS = (*VERBS[:10], "wave-left-hand", *VERBS[13:41])


def content_corpus(path: Path, *, frames: int = FRAMES, short: int = 0, split: str = "test") -> Path:
    """A take of every content, the k-th ``frames + k % 5`` long, and one composition in time.

    Args:
        path: the file.
        frames: of the shortest take.
        short: as many more takes have only 20 frames.
        split: of all of them.
    """
    writer = CorpusWriter()
    contents = CONTENTS
    for k, content in enumerate([*contents, *contents[:short]]):
        length = frames + k % 5 if k < len(contents) else 20
        add_take(writer,
            TakeEntry(
                name=f"take{k}", take=f"take{k}", source="synthetic", content=content, style=None,
                captions=own_captions(content), split=split, subject="s",
                motion=synthetic_motion(KINDS[k % len(KINDS)], length, seed=k),
            )
        )  # fmt: skip
    writer.add_clip(
        ClipRecord(
            name="both", take="take0", source="synthetic", subject="s", group="take0", kind="in_time",
            contents=(contents[0], contents[10]), style=None, split=split, fps=20.0, frames=frames + frames - 10,
            captions=(), recipe=Recipe((Part(0, 0, frames), Part(10, 0, frames)), blend=10),
        ),
        ("a person walks and then waves with the left hand",),
    )  # fmt: skip
    return writer.write(path)


def own_captions(content: str) -> tuple[str, ...]:
    """Three sentences of a content that no other content has."""
    verb, _, hand = content.partition("-left-")
    return said_otherwise(f"a person {inflect(verb, 'present')}{hand and f' with the left {hand}'}")[:3]


def motion_folder(path: Path, count: int = 40, frames: int = 40) -> Path:
    """Joint positions with a list of distinct prompts."""
    path.mkdir(parents=True)
    lines = []
    for k in range(count):
        motion = synthetic_motion(KINDS[k % len(KINDS)], frames, seed=100 + k)
        np.save(path / f"m-{k:03d}.npy", motion.joints.numpy())
        prompt = own_captions(CONTENTS[k % len(CONTENTS)])[k // len(CONTENTS)]
        lines.append(json.dumps({"name": f"{k:03d}", "prompt": prompt}))
    (path / "prompts.jsonl").write_text("\n".join(lines) + "\n")
    return path
