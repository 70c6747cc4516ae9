"""Human-written sentences about spans of captures, and which side of the split each span is on."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from moveset.data.splits import Split
from moveset.errors import FormatError

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
        FormatError: a line is damaged.
    """
    spans: dict[str, list[Span]] = {}
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        try:
            clip = json.loads(line)
            sentences = tuple(str(sentence) for sentence in clip["sentences"])
            span = Span(str(clip["id"]), float(clip["start"]), float(clip["end"]), clip["use"], sentences)
            if not 0 <= span.start < span.end or span.use not in ("train", "val", "test", "drop"):
                raise ValueError(f"{span.start} to {span.end} s for {span.use!r}")
            spans.setdefault(str(clip["trial"]), []).append(span)
        except (ValueError, KeyError, TypeError) as error:
            raise FormatError(f"{path}, line {number}: not a span ({error}); restore the original file") from error
    return spans
