"""Lists of takes as people write them: what is no matter is passed over, what is wrong is said with its line."""

import json
from pathlib import Path
from typing import Any

import pytest

from moveset.data import more_mocap
from moveset.data.takes import RejectedTake, TakeRef
from moveset.errors import FormatError
from tests.synthetic import synthetic_motion


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
    lines = line("a", sentence=None), line("b"), line("c", sentence=" \n"), line("d", sentence="a person\nwalks ")
    assert [take.sentence for take in listed(tmp_path, *lines)] == [None, "a person walks", None, "a person walks"]


def test_a_take_without_a_frame_between_poses_for_calibration_is_left_out(tmp_path, monkeypatch):
    synthetic_motion("walk", 60).resampled(120).save(tmp_path / "a.bvh")
    (ref,) = listed(tmp_path, line("a", file="a.bvh"))
    assert more_mocap.read_take(ref).runs
    # Between a tenth of a second and the frame after it, of 20 a second.
    monkeypatch.setattr(more_mocap, "without_calibration", lambda joints, fps: (13, 17))
    with pytest.raises(RejectedTake, match="nothing but poses for calibration"):
        more_mocap.read_take(ref)


def test_what_is_no_humanoid_is_left_out_with_its_reason(tmp_path):
    rod = "{joint} {name}\n{{\nOFFSET 0 1 0\nCHANNELS 3 Zrotation Xrotation Yrotation\n{below}\n}}".format
    tree = rod(joint="ROOT", name="a", below=rod(joint="JOINT", name="b", below="End Site\n{\nOFFSET 0 1 0\n}"))
    frames = "0 0 0 0 0 0\n" * 20
    (tmp_path / "a.bvh").write_text(f"HIERARCHY\n{tree}\nMOTION\nFrames: 20\nFrame Time: 0.05\n{frames}")
    (ref,) = listed(tmp_path, line("a", file="a.bvh"))
    with pytest.raises(RejectedTake, match=r"a: .* no joint recognisable as pelvis"):
        more_mocap.read_take(ref)


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
        (line("b", unit_m=0), "a unit of 0 metres"),
        (line("b", unit_m=-0.01), "a unit of -0.01 metres"),
        (line("b", unit_m=float("nan")), "a unit of nan metres"),
        ('{"take": "b"}', "it has no source"),
        (json.dumps({key: held for key, held in json.loads(line("b")).items() if key != "unit_m"}), "it has no unit_m"),
        ("5", "it is no JSON object"),
        ('{"take"', "Expecting"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(tmp_path, wrong, reason):
    with pytest.raises(FormatError, match=rf"takes\.jsonl, line 3: .*{reason}.*; mend the line"):
        listed(tmp_path, line("a"), "", wrong)


def test_another_encoding_is_said(tmp_path):
    with pytest.raises(FormatError, match="is not UTF-8"):
        listed(tmp_path, line("a"), mark=b"\xe9")
