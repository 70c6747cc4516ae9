"""The sheets of the documents show the end of streams, whole, below one another."""

from functools import partial
from itertools import islice

import pytest
import torch
from PIL import Image

from moveset import MotionStream
from tests.streams import tiny_stream


@pytest.mark.parametrize("segments", [2, 8])
def test_the_last_seconds_are_the_streams_own(segments, tiny_streams):
    from pictures import SHOWN, last_seconds

    opened = partial(MotionStream.from_pretrained, tiny_streams, "a person walks", seed=3, device="cpu")
    pieces = [segment.motion for segment in islice(opened(), segments)]
    frames = len(pieces[0])
    found = last_seconds(opened(), (segments - 1) * frames / 20.0 / 60.0)
    assert len(found) == min(segments * frames, int(SHOWN * 20.0))
    assert torch.equal(found.root, torch.cat([piece.root for piece in pieces])[-len(found) :])


def test_strips_lie_below_one_another():
    from pictures import WIDTH, sheet

    joined = sheet([Image.new("RGB", (2 * WIDTH, 100), "red"), Image.new("RGB", (2 * WIDTH, 60), "blue")])
    assert joined.size == (WIDTH, 80)
    assert joined.getpixel((5, 20))[0] > 200 < joined.getpixel((5, 70))[2]


def test_a_figure_has_a_strip_for_every_sentence_and_model(tmp_path, monkeypatch, capsys):
    import pictures

    folders = [tiny_stream(tmp_path / name) for name in ("rdm-tiny", "md-7-tiny")]
    monkeypatch.setitem(pictures.FIGURES, "one", ("rdm", ("md-7", "rdm-7", "md-4"), ("a person walks", "waves"), 3.0))
    seen = []
    monkeypatch.setattr(pictures, "sheet", lambda strips: seen.extend(strips) or strips[0])
    assert pictures.figure("one", folders) is not None
    assert len(seen) == 4
    assert "one: MD-4: no weights given" in capsys.readouterr().err
    monkeypatch.setitem(pictures.FIGURES, "none", ("rdm", ("md-4",), ("a person walks",), 3.0))
    assert pictures.figure("none", []) is None


def test_sheets_make_their_folder(tmp_path, tiny_clips, monkeypatch):
    import everyday
    import pictures

    (tmp_path / "said.txt").write_text("a person walks\n")
    out, said = tmp_path / "new" / "sheets", tmp_path / "said.txt"
    arguments = ["--out", out, "--model", tiny_clips, "--sentences", said, "--seconds", 1]
    monkeypatch.setattr("sys.argv", ["everyday.py", *map(str, arguments)])
    everyday.main()
    assert [path.name for path in out.iterdir()] == ["pcm-1-0.png"]
    monkeypatch.setattr(pictures, "figure", lambda name, folders: Image.new("RGB", (8, 8)))
    monkeypatch.setattr("sys.argv", ["pictures.py", "--figures", "--out", str(tmp_path / "figures")])
    pictures.main()
    assert {path.stem for path in (tmp_path / "figures").iterdir()} == set(pictures.FIGURES)
