"""Lists of takes as people write them: what is no matter is passed over, what is wrong is said with its line."""

import json
from pathlib import Path
from typing import Any

import pytest

from moveset.data import more_mocap
from moveset.data.takes import TakeRef
from moveset.errors import FormatError


def line(name: str, **other: Any) -> str:
    about = {"source": "studio", "file": f"takes/{name}.bvh", "unit_m": 0.01, "sentence": "a person walks"}
    return json.dumps({"take": name, **about, **other})


def listed(folder: Path, *lines: str, mark: bytes = b"") -> list[TakeRef]:
    (folder / "takes.jsonl").write_bytes(mark + "\n".join(lines).encode())
    return more_mocap.list_takes(folder)


def test_empty_lines_and_a_byte_order_mark_count_for_nothing(tmp_path):
    plain = listed(tmp_path, line("a"), line("b"))
    assert [take.name for take in plain] == ["a", "b"]
    assert listed(tmp_path, line("a"), "", " \r", line("b"), "", mark=b"\xef\xbb\xbf") == plain


def test_a_take_may_have_no_sentence(tmp_path):
    assert [take.sentence for take in listed(tmp_path, line("a", sentence=None), line("b"))] == [None, "a person walks"]


@pytest.mark.parametrize("source", ["cmux", "studio-cmu", "ys2010"])
def test_sources_are_called_as_one_likes(tmp_path, source):
    assert [take.source for take in listed(tmp_path, line("b", source=source))] == [source]


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        (line("a", source="other"), "its name 'a' is that of line 1, too"),
        (line("b", sentence=["walks"]), r'its sentence is \["walks"\], neither text nor null'),
        (line("b", source="cmu-studio"), "its source 'cmu-studio' begins like those of other sets"),
        (line("b", source="cmu2"), "its source 'cmu2' begins like"),
        (line("b", source="bandai-studio"), "its source 'bandai-studio' begins like"),
        (line("b", file=None), "its file is null, not text"),
        (line("b", unit_m="cm"), "could not convert string to float: 'cm'"),
        ('{"take": "b"}', "it has no source"),
        ("5", "not a take"),
        ('{"take"', "Expecting"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(tmp_path, wrong, reason):
    with pytest.raises(FormatError, match=rf"takes\.jsonl, line 3: .*{reason}.*; mend the line"):
        listed(tmp_path, line("a"), "", wrong)


def test_another_encoding_is_said(tmp_path):
    with pytest.raises(FormatError, match="is not UTF-8"):
        listed(tmp_path, line("a"), mark=b"\xe9")
