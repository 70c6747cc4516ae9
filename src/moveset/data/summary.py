"""What is in a corpus: numbers, a picture of its clips, and why takes are not in it."""

import random
import re
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from moveset.data.corpus import Corpus
from moveset.data.verbs import count_verbs
from moveset.io.limits import make_folder
from moveset.io.manifest import json_object

if TYPE_CHECKING:
    from PIL import Image

_EDGES = (24, 40, 60, 80, 100, 120, 140, 160, 180, 197)
_STRIPS = 5  # on a sheet
_WIDTH = 1400  # of a sheet


def summarize(corpus: Corpus) -> dict[str, Any]:
    """Clips, hours and sentences by split and source, clips that say each verb, lengths; plain JSON values.

    Seconds that several clips share count once in the hours of all, and with each of them elsewhere.
    """
    takes = [record for record in corpus.records if record.kind == "take"]

    def row(**chosen: str) -> dict[str, Any]:
        found = [r for r in takes if all(getattr(r, name) == value for name, value in chosen.items())]
        told = [r for r in found if r.captions]
        return {
            "clips": len(found),
            "hours": round(sum(r.frames / r.fps for r in found) / 3600, 3),
            "told": len(told),
            "told_hours": round(sum(r.frames / r.fps for r in told) / 3600, 3),
            "sentences": sum(len(r.captions) for r in told),
        }

    told = [[corpus.strings[k] for k in record.captions] for record in takes if record.captions]
    return {
        "clips": len(takes),
        "compositions": len(corpus) - len(takes),
        "hours": round(corpus.seconds / 3600, 3),
        "sentences": len(corpus.strings),
        "splits": {split: row(split=split) for split in ("train", "val", "test")},
        "sources": {source: row(source=source) for source in dict.fromkeys(record.source for record in takes)},
        "composed": dict(Counter(record.kind for record in corpus.records if record.kind != "take")),
        "verbs": dict(count_verbs(told).most_common(100)),
        "lengths": {
            f"{low}-{high - 1}": sum(low <= record.frames < high for record in takes) for low, high in pairwise(_EDGES)
        },
    }


def rejections(corpus: Path) -> dict[str, int]:
    """Why takes and spans are not in a corpus, with how many, from the report beside it; empty where there is none.

    Raises:
        FormatError: the report is damaged.
    """
    path = corpus.with_name(f"{corpus.name}.report.json")
    if not path.is_file():
        return {}
    report = json_object(path.read_bytes(), path, "build the corpus again, or remove the report")
    rejected = report.get("rejected", {}).values()
    reasons = Counter(re.sub(r"\d+", "N", str(reason).split(": ")[-1]) for reason in rejected)
    reasons.update(f"span: {reason}" for reason in report.get("spans", {}).values())
    return dict(reasons.most_common())


def write_sheets(corpus: Corpus, folder: Path, count: int = 10, seed: int = 0) -> list[Path]:
    """Filmstrips of ``count`` clips with sentences of every source and kind of composition, five on each picture.

    Raises:
        InputError: a picture cannot be written.
    """
    from moveset.io.filmstrip import filmstrip

    by_source: dict[str, list[int]] = {}
    for number, record in enumerate(corpus.records):
        if record.captions:
            by_source.setdefault(record.source if record.kind == "take" else record.kind, []).append(number)
    make_folder(folder)
    paths = []
    for source, clips in by_source.items():
        chosen = sorted(random.Random(f"{source} {seed}").sample(clips, min(count, len(clips))))
        for start in range(0, len(chosen), _STRIPS):
            strips = []
            for number in chosen[start : start + _STRIPS]:
                record, sentences = corpus.records[number], corpus.captions(number)
                strips.append(filmstrip(corpus.motion(number), f"{record.name} {record.split}: {sentences[0]}"))
            paths.append(folder / f"{source.replace('/', '-')}-{start // _STRIPS}.png")
            _write_sheet(strips, paths[-1])
    return paths


def _write_sheet(strips: "list[Image.Image]", path: Path) -> None:
    from PIL import Image

    from moveset.io.limits import atomic_write

    sized = [strip.resize((_WIDTH, round(strip.height * _WIDTH / strip.width))) for strip in strips]
    sheet = Image.new("RGB", (_WIDTH, sum(strip.height for strip in sized)))
    top = 0
    for strip in sized:
        sheet.paste(strip, (0, top))
        top += strip.height
    with atomic_write(path) as file:
        sheet.save(file, format="PNG")
