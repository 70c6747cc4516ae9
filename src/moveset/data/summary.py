"""What is in a corpus, as numbers and as a picture."""

from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

from moveset.data.corpus import Corpus

_EDGES = (24, 40, 60, 80, 100, 120, 140, 160, 180, 197)


def summarize(corpus: Corpus) -> dict[str, Any]:
    """Counts and hours by split, source, style, content and length; plain JSON values."""
    takes = [r for r in corpus.records if r.kind == "take"]
    splits = {}
    for split in ("train", "val", "test"):
        of_split = [r for r in corpus.records if r.split == split]
        splits[split] = {
            "clips": sum(r.kind == "take" for r in of_split),
            "hours": round(sum(r.frames / r.fps for r in of_split if r.kind == "take") / 3600, 3),
            "in_time": sum(r.kind == "in_time" for r in of_split),
            "body": sum(r.kind == "body" for r in of_split),
        }
    lengths = {f"{low}-{high - 1}": sum(low <= r.frames < high for r in takes) for low, high in pairwise(_EDGES)}
    return {
        "clips": len(takes),
        "compositions": len(corpus) - len(takes),
        "hours": round(corpus.seconds / 3600, 3),
        "sentences": len(corpus.strings),
        "splits": splits,
        "sources": dict(Counter(r.source for r in takes).most_common()),
        "styles": dict(Counter(r.style for r in takes if r.style is not None).most_common()),
        "contents": dict(Counter(r.contents[0] for r in takes).most_common()),
        "lengths": lengths,
    }


def draw(corpus: Corpus, path: Path) -> None:
    """Draw lengths, contents and styles into a PNG file.

    Raises:
        InputError: the file cannot be written.
    """
    from io import BytesIO

    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from moveset.io.limits import atomic_write

    summary = summarize(corpus)
    figure = Figure(figsize=(12, 8), layout="constrained")
    FigureCanvasAgg(figure)
    length, contents, styles = figure.subplot_mosaic("AB\nCB").values()
    length.set_title(f"{summary['clips']} takes ({summary['hours']:.2f} h), {summary['compositions']} compositions")
    for kind, label in (("take", "takes"), ("in_time", "one after the other"), ("body", "arms on legs")):
        seconds = [r.frames / r.fps for r in corpus.records if r.kind == kind]
        length.hist(seconds, bins=40, range=(0, 10), alpha=0.6, label=label)
    length.set_xlabel("seconds")
    length.set_ylabel("clips")
    length.legend()
    for axes, title, counts in ((contents, "content", summary["contents"]), (styles, "style", summary["styles"])):
        names = list(counts)[::-1]
        axes.barh(names, [counts[n] for n in names], log=True)
        axes.set_title(f"clips by {title}")
        axes.tick_params(axis="y", labelsize=7)
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    with atomic_write(path) as file:
        file.write(buffer.getvalue())
