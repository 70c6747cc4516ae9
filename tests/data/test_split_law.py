"""No second of a performance is on two sides of the split, whoever performs and whatever the spans."""

from itertools import combinations
from pathlib import Path

import pytest
import torch

from moveset.data.build import _pieces, _Spans
from moveset.data.raw import find_spans, find_takes
from moveset.data.spans import Span
from moveset.data.splits import overlap
from moveset.data.takes import TakeRef
from moveset.motion import rotations
from moveset.motion.clip import Motion


def take(name: str, group: str) -> TakeRef:
    return TakeRef(name, "cmu-more", Path(name), name.split("_")[0], group, description="walk")


def still(frames: int) -> Motion:
    return Motion(rotations.identity(frames, 22), torch.zeros(frames, 3), 20.0)


def check(refs: list[TakeRef], spans: dict[str, list[Span]], frames: int) -> int:
    """Cut takes of so many frames, and look at what overlaps in time; returns how many clips there are."""
    told = _Spans(refs, spans)
    by_group: dict[str, list] = {}
    for ref in refs:
        pieces = [piece for _, piece in _pieces(ref, [(0, still(frames))], told)]
        by_group.setdefault(ref.group, []).extend(pieces)
    for pieces in by_group.values():
        for a, b in combinations(pieces, 2):
            assert a.split == b.split or not overlap((a.start, a.stop), (b.start, b.stop)), (a.name, b.name)
    return sum(map(len, by_group.values()))


def test_partners_and_overlapping_spans_are_on_one_side():
    refs = [take("18_01", "18-19_01"), take("19_01", "18-19_01"), take("20_01", "20_01")]
    spans = {
        "18_01": [Span("a", 0.0, 5.0, "test", ("one",)), Span("b", 6.0, 10.0, "train", ("two",))],
        "19_01": [Span("c", 4.0, 8.0, "train", ("three",)), Span("d", 9.0, 14.0, "val", ("four",))],
        "20_01": [Span("e", 2.0, 6.0, None, ("five",))],
    }
    assert check(refs, spans, 400) > 5
    told = _Spans(refs, spans)
    assert [span.name for *_, span in told.told(refs[1])] == ["d"]
    assert [span.name for *_, span in told.told(refs[0])] == ["a"]
    assert told.failed == {"b": "its seconds are held out", "c": "its seconds are held out"}


def test_scenes_of_the_archives_keep_the_law(real_data):
    spans = find_spans(real_data)
    if not spans:
        pytest.skip("no sentences of spans here")
    refs = [ref for ref in find_takes(real_data) if ref.source.startswith("cmu")]
    scenes = [ref for ref in refs if "-" in ref.group][:60]
    assert check([*scenes, *refs[::40]], spans, 300) > 100
