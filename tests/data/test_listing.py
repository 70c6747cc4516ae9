"""Lists of objects, one a line: all are read alike, whatever they list."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from moveset.data import cmu, more_mocap
from moveset.data.spans import read_spans
from moveset.errors import FormatError

SAID = "a person\u2028walks"
SPAN = {"id": "1", "trial": "07_01", "start": 0, "end": 2.0, "use": "train", "sentences": [SAID]}
TRIAL = {"trial": "07_01", "files": ["subjects/07/07_01.bvh"], "fps": 120, "description": SAID}
TAKE = {"take": "a", "source": "studio", "file": "a.bvh", "unit_m": 1, "sentence": "a person walks"}
LISTS: list[tuple[str, dict[str, Any], Callable[[Path], Any]]] = [
    ("spans.jsonl", SPAN, read_spans),
    ("trials.jsonl", TRIAL, lambda path: cmu.list_takes(path.parent)),
    ("takes.jsonl", TAKE, lambda path: more_mocap.list_takes(path.parent)),
]
every_list = pytest.mark.parametrize(("name", "about", "read"), LISTS)


@every_list
def test_empty_lines_and_a_byte_order_mark_count_for_nothing(tmp_path, name, about, read):
    line = json.dumps(about, ensure_ascii=False).encode()
    (tmp_path / name).write_bytes(line)
    plain = read(tmp_path / name)
    assert plain
    (tmp_path / name).write_bytes(b"\xef\xbb\xbf\n" + line + b"\r\n \n\n")
    assert read(tmp_path / name) == plain


@every_list
def test_what_is_wrong_is_said_with_its_line(tmp_path, name, about, read):
    first = next(iter(about))
    for wrong, reason in (("{", "Expecting"), ("[1]", "no JSON object"), ({**about, first: None}, None)):
        if reason is None:
            del wrong[first]
        line = wrong if isinstance(wrong, str) else json.dumps(wrong)
        (tmp_path / name).write_text(f"\n{line}\n")
        with pytest.raises(FormatError, match=rf"{name}, line 2: not a .*{reason or f'it has no {first}'}"):
            read(tmp_path / name)


@every_list
def test_another_encoding_is_said(tmp_path, name, about, read):
    (tmp_path / name).write_bytes(json.dumps(about).encode() + b"\xe9")
    with pytest.raises(FormatError, match="is not UTF-8"):
        read(tmp_path / name)


@pytest.mark.parametrize("wrong", [{"sentences": "walks"}, {"sentences": [None]}, {"end": float("inf")}, {"end": 0}])
def test_spans_have_an_end_and_sentences(tmp_path, wrong):
    (tmp_path / "spans.jsonl").write_text(json.dumps(SPAN | wrong))
    with pytest.raises(FormatError, match="line 1: not a span"):
        read_spans(tmp_path / "spans.jsonl")


@pytest.mark.parametrize("wrong", [{"files": []}, {"fps": 0}, {"fps": "fast"}])
def test_trials_have_files_and_a_rate(tmp_path, wrong):
    (tmp_path / "trials.jsonl").write_text(json.dumps(TRIAL | wrong))
    with pytest.raises(FormatError, match="line 1: not a trial"):
        cmu.list_takes(tmp_path)
