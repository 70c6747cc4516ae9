"""From model folders to a page: a suite by the command line, on tiny models, resumed and rewritten."""

import json
import re
from pathlib import Path

import pytest

from moveset.cli.evaluate import evaluate
from moveset.evaluation.report import page
from moveset.evaluation.suites import CLIPS
from moveset.evaluation.table import load_table
from tests.bundles import tiny_bundle
from tests.evaluation.corpora import content_corpus
from tests.evaluators import tiny_evaluator


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tables")
    content_corpus(path / "corpus.safetensors")
    tiny_evaluator(path / "judge")
    tiny_bundle(path / CLIPS)
    tiny_bundle(path / "mine", seed=1)
    return path


def run(place: Path, *rows: str) -> None:
    evaluate(
        (str(place / CLIPS), str(place / "mine")), suite="motionpcm", row=rows, repeats=2, items=32, multimodality=0,
        data=place / "corpus.safetensors", evaluator=str(place / "judge"), out=place / "results", processes=1,
        device="cpu", mirrored=False,
    )  # fmt: skip


def test_a_suite_becomes_a_page(place: Path, capsys: pytest.CaptureFixture[str]):
    run(place, "real", "pcm-1", "no-ema", "mine-pcm-1")
    printed = capsys.readouterr()
    folder = place / "results" / "motionpcm"
    table = load_table(folder)
    assert printed.out.rstrip("\n") == (folder / "table.md").read_text().rstrip("\n")
    assert "PCM, 1 step, without EMA: no weights given" in printed.err
    assert (folder / "pcm-1.json").is_file()
    assert {key: found.repeats for key, found in table.measured.items()} == dict.fromkeys(
        ("real", "pcm-1", "mine-pcm-1"), 2
    )
    assert table.state().items == 32
    # Other weights, other numbers: nothing was mixed up on the way.
    assert table.value("pcm-1", "fid") != table.value("mine-pcm-1", "fid")
    assert table.measured["pcm-1"].weights != table.measured["mine-pcm-1"].weights

    before = {path: path.stat().st_mtime_ns for path in (folder / "repeats").rglob("[0-9]*.json")}
    run(place, "lcm-2")
    assert set(load_table(folder).measured) == {*table.measured, "lcm-2"}
    assert all(path.stat().st_mtime_ns == when for path, when in before.items())

    page([folder], place / "results.md")
    text = (place / "results.md").read_text()
    assert all((place / name).is_file() for name in re.findall(r"!\[.*?\]\((.*?)\)", text))
    assert json.loads((folder / "table.json").read_text())["suite"] == "motionpcm"
