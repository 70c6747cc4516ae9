"""Human-written sentences about spans of captures, and which side of the split each span is on."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from moveset.data.listing import read_listing
from moveset.data.splits import Split


@dataclass(frozen=True)
class Span:
    """Part of a take that sentences tell of.

    Args:
        name: of the clip in its data set.
        start, end: seconds from the beginning of the capture.
        split: the side it is on; None for one that the official split has in training, though it shares seconds with a
            test or validation span.
        sentences: as typed.
    """

    name: str
    start: float
    end: float
    split: Split | None
    sentences: tuple[str, ...]


def read_spans(path: Path) -> dict[str, list[Span]]:
    """Spans by the take they are of, from JSON lines with id, trial, start, end, use and sentences.

    Raises:
        InputError: the file cannot be read.
        FormatError: it is not UTF-8, or a line is damaged.
    """
    spans: dict[str, list[Span]] = {}
    for trial, span in read_listing(path, _listed, "a span"):
        spans.setdefault(trial, []).append(span)
    return spans


def _listed(number: int, clip: dict[str, Any]) -> tuple[str, Span]:
    """A line's span, and the take that it is of."""
    sentences = clip["sentences"]
    if not isinstance(sentences, list) or not all(isinstance(sentence, str) for sentence in sentences):
        raise TypeError("its sentences are no list of texts")
    start, end, use = float(clip["start"]), float(clip["end"]), clip["use"]
    if not 0 <= start < end < math.inf or use not in ("train", "val", "test", "drop"):
        raise ValueError(f"{start} to {end} s for {use!r}")
    return str(clip["trial"]), Span(str(clip["id"]), start, end, None if use == "drop" else use, tuple(sentences))
