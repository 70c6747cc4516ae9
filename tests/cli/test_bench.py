"""``moveset bench``: what it prints and writes, and what it refuses before anything is measured."""

import json

import pytest
import torch

from moveset.cli.__main__ import main
from moveset.errors import MovesetError


@pytest.fixture
def models(tiny_clips, tiny_streams):
    return ["--clips", str(tiny_clips), "--streams", str(tiny_streams)]


@pytest.fixture(autouse=True)
def threads(monkeypatch):
    before = torch.get_num_threads()
    monkeypatch.setenv("OMP_NUM_THREADS", str(before))  # put back as it was, whatever a bench says
    yield
    torch.set_num_threads(before)


def test_a_report_with_its_page_and_again_from_its_file(models, tmp_path, capsys):
    out = tmp_path / "costs.json"
    command = ["bench", "--quick", "--parts", "clips", "operations", "--threads", "1", "--device", "cpu", *models]
    assert main([*command, "-o", str(out), "--json"]) == 0
    said = capsys.readouterr()
    report = json.loads(said.out)
    assert report == json.loads(out.read_text())
    assert report["machine"]["threads"] == 1
    assert report["plan"]["parts"] == ["clips", "operations"]
    assert "costs.md" in said.err
    assert out.with_suffix(".md").read_text().startswith("# What motion costs")
    assert out.with_suffix(".png").stat().st_size > 5_000


def test_without_an_output_nothing_is_written(models, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["bench", "--quick", "--parts", "streams", "--device", "cpu", *models]) == 0
    assert "| **" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []


def test_a_report_that_cannot_be_written_any_more_is_printed(models, tmp_path, monkeypatch, capsys):
    def full(*_):
        raise MovesetError("no space left")

    monkeypatch.setattr("moveset.bench.page.write_page", full)
    command = ["bench", "--quick", "--parts", "streams", "--device", "cpu", "--json", *models]
    assert main([*command, "-o", str(tmp_path / "costs.json")]) == 1
    assert json.loads(capsys.readouterr().out)["streams"]


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        (["-o", "costs.txt"], "a report is a .json file"),
        (["-o", "nowhere/costs.json"], "folder 'nowhere' does not exist"),
        (["-o", "/proc/costs.json"], "cannot write to folder '/proc'"),
        (["-o", "taken.json"], "'taken.md': it is a folder"),
        (["--threads", "0"], "0 threads"),
        (["--rounds", "0"], "0 rounds"),
        (["--processes", "-1"], "-1 processes"),
        (["--endless", "0"], "0 segments"),
        (["--parts", "sleep"], "sleep"),
        (["--clips", "no-such-model"], "unknown model 'no-such-model'"),
        (["--streams", "motionpcm-small"], "for `moveset generate`"),
        (["--device", "abacus"], "unknown device 'abacus'"),
    ],
)
def test_what_is_refused(wrong, match, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken.md").mkdir()
    assert main(["bench", "--quick", *wrong]) == 2
    said = capsys.readouterr().err
    assert match in said
    assert said.count("\n") == 1
