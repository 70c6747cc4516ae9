"""BVH files of programs that keep to no rule: what is read, what is read with a warning, and what is said."""

import warnings

import numpy as np
import pytest
import torch

from moveset.cli.__main__ import main
from moveset.errors import FormatError, InputError
from moveset.io import load
from moveset.io.bvh import write_bvh
from moveset.io.bvh_parser import read_bvh
from tests.motions import gait


@pytest.fixture(scope="module")
def text(tmp_path_factory):
    """Four frames at 30 fps."""
    return write_bvh(gait(4, fps=30.0), tmp_path_factory.mktemp("bvh") / "a.bvh").read_bytes()


@pytest.fixture
def reading(tmp_path):
    def read(data, **options):
        path = tmp_path / "a.bvh"
        path.write_bytes(data)
        return load(path, **options)

    return read


TIMING = b"Frames: 4\nFrame Time: 0.033333333\n"
SAME = {
    "no blanks": (TIMING, b"Frames:4\nFrame Time:0.033333333\n"),
    "blanks before colons": (TIMING, b"Frames : 4\nFrame Time : 0.033333333\n"),
    "plural": (TIMING, b"Frames: 4\nFrames Time: 0.033333333\n"),
    "one word": (TIMING, b"Frames: 4\nFrameTime: 0.033333333\n"),
    "no colons": (TIMING, b"FRAMES 4\nFRAME TIME 0.033333333\n"),
    "capitals": (TIMING, b"FRAMES:\t4\nFRAME TIME:\t0.033333333\n"),
    "remarks": (TIMING, b"Frames: 4 in all\nFrame Time: 0.033333333 s\n"),
    "blank lines": (TIMING, b"\n\nFrames: 4\n\nFrame Time: 0.033333333\n\n\n"),
    "small letters": (b"HIERARCHY\nROOT", b"hierarchy\nroot"),
    "named ends": (b"End Site", b"End Site left_foot_end"),
    "end in small letters": (b"End Site", b"end site"),
    "byte order mark": (b"HIERARCHY", b"\xef\xbb\xbfHIERARCHY"),
    "newlines of Windows": (b"\n", b"\r\n"),
    "newlines of old": (b"\n", b"\r"),
}


@pytest.mark.parametrize("variant", SAME)
def test_spellings_of_the_header_make_no_difference(text, reading, variant):
    old, new = SAME[variant]
    assert old in text
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found, wanted = reading(text.replace(old, new)), reading(text)
    assert found.fps == wanted.fps == 30.0
    assert torch.equal(found.joints, wanted.joints)


@pytest.mark.parametrize("declared", [1, 2, 3, 5])
def test_rows_that_are_not_as_many_as_declared_are_read_with_a_warning(text, reading, declared):
    with pytest.warns(UserWarning, match=f"{declared} frames are declared and 4 are there"):
        found = reading(text.replace(b"Frames: 4", b"Frames: %d" % declared))
    assert torch.equal(found.joints, reading(text).joints)


REFUSED = {
    "cut off": (b"Frames: 4", b"Frames: 6", "6 frames are declared and 4 are there"),
    "decimal comma": (b"0.033333333", b"0,033333333", r"line \d+: '0,033333333' has a decimal comma"),
    "no time": (b"Frame Time: 0.033333333\n", b"", "expected 'FRAME'"),
    "no frame rate": (b"0.033333333", b"0", "--source-fps"),
    "microseconds": (b"0.033333333", b"33333", "--source-fps"),
    "UTF-16": (None, lambda text: text.decode().encode("utf-16"), "line 1: .*UTF-16.*UTF-8"),
    "UTF-16 without mark": (None, lambda text: text.decode().encode("utf-16-le"), "line 1: .*UTF-16.*UTF-8"),
    "Ctrl-Z": (None, lambda text: text + b"\x1a", r"line \d+: '\\x1a' after the last frame .* delete"),
    "Ctrl-Z in the last row": (None, lambda text: text.rstrip() + b"\x1a", r"line \d+: NUL or Ctrl-Z .* delete"),
    "NULs": (None, lambda text: text + bytes(20), r"line \d+: .* after the last frame .* delete"),
    "a remark": (None, lambda text: text + b"exported by hand\n", r"line \d+: 'exported by hand' after .* delete"),
}


@pytest.mark.parametrize("wrong", REFUSED)
def test_what_cannot_be_read_is_said_with_line_and_remedy(text, reading, wrong):
    old, new, message = REFUSED[wrong]
    with pytest.raises(FormatError, match=message) as caught:
        reading(new(text) if old is None else text.replace(old, new))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("names", "encoding"),
    [(("腕", "首"), "cp932"), (("左臂", "右臂"), "gb18030"), (("Hüfte", "Fuß"), "latin-1"), (("Hüfte", "腕"), "utf-8")],
)
def test_names_in_any_encoding_stay_apart(text, reading, names, encoding):
    for old, new in zip((b"ROOT pelvis", b"JOINT spine1"), names, strict=True):
        text = text.replace(old, old.split()[0] + b" " + new.encode(encoding))
    found = reading(text).skeleton.joints
    assert len(set(found)) == 22
    if encoding in ("utf-8", "cp932"):  # which takes others' bytes for its own
        assert set(names) <= set(found)


def test_a_rate_that_no_motion_has_is_warned_of_and_can_be_given(text, reading, tmp_path, capsys):
    in_milliseconds = text.replace(b"0.033333333", b"33.33")
    with pytest.warns(UserWarning, match="0.03 frames a second are unusual.*--source-fps, 30 for milliseconds"):
        assert reading(in_milliseconds).fps == pytest.approx(0.030003)
    for data in (in_milliseconds, text.replace(b"0.033333333", b"0")):
        found = reading(data, source_fps=30.0)
        assert found.fps == 30.0
        assert torch.equal(found.joints, reading(text).joints)
    assert main(["convert", str(tmp_path / "a.bvh"), str(tmp_path / "b.npz"), "--source-fps", "24"]) == 0
    assert capsys.readouterr().err == ""
    assert load(tmp_path / "b.npz").fps == 24.0
    with pytest.raises(InputError, match="source of 0 frames"):
        reading(text, source_fps=0.0)


def test_a_file_of_half_an_hour_is_read(tmp_path):
    """80 MB: as long as takes of 120 fps get, and more than an older limit."""
    path = write_bvh(gait(2, fps=120.0), tmp_path / "a.bvh")
    head, rows = path.read_bytes().split(b"0.008333333\n")
    count = 20_000
    rows = rows.replace(b"\n", b" " * 3500 + b"\n")  # blanks are quick to read
    path.write_bytes(head.replace(b"Frames: 2", b"Frames: %d" % count) + b"0.008333333\n" + rows * (count // 2))
    assert path.stat().st_size > 64 * 2**20
    found = read_bvh(path)
    assert found.values.shape == (count, 69)
    assert np.array_equal(found.values[-1], found.values[1])
