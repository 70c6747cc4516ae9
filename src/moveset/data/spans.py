"""Human-written sentences about spans of captures, and which side of the split each span is on."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from moveset.data.listing import read_listing
from moveset.data.splits import Split

#: "drop": the official split has it in training, though it shares seconds with a test or validation span.
Use = Literal["train", "val", "test", "drop"]


@dataclass(frozen=True)
class Span:
    """Part of a take that sentences tell of.

    Args:
        name: of the clip in its data set.
        start, end: seconds from the beginning of the capture.
        use: the side it is on.
        sentences: as typed.
    """

    name: str
    start: float
    end: float
    use: Use
    sentences: tuple[str, ...]

    @property
    def split(self) -> Split | None:
        """The side; None for one that is dropped."""
        return None if self.use == "drop" else self.use


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
    span = Span(str(clip["id"]), float(clip["start"]), float(clip["end"]), clip["use"], tuple(sentences))
    if not 0 <= span.start < span.end < math.inf or span.use not in ("train", "val", "test", "drop"):
        raise ValueError(f"{span.start} to {span.end} s for {span.use!r}")
    return str(clip["trial"]), span
