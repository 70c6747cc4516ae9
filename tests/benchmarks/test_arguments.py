"""Benchmarks say what is wrong as the command line does: one line, exit code 2, before anything is measured."""

import runpy
import sys
from pathlib import Path

import pytest

from moveset.errors import exit_code_of
from tests.evaluation.corpora import content_corpus

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with a corpus, a stream, and things that are in the way."""
    folder = tmp_path_factory.mktemp("place")
    content_corpus(folder / "corpus.safetensors")
    (folder / "file").write_text("")
    (folder / "runs/vae").mkdir(parents=True)
    (folder / "runs/vae/metrics.jsonl").write_text("nonsense\n")
    (folder / "old.json").write_text("nonsense")
    return folder


@pytest.mark.parametrize(
    ("program", "arguments", "message"),
    [
        ("curves", ["--runs", "nowhere"], "nowhere holds no run"),
        ("curves", ["--runs", "runs"], "metrics.jsonl is no log of a training"),
        (
            "efficiency",
            ["--out", "old"],
            "line 1 column 1 (char 0); delete it, or give",
        ),
        ("efficiency", ["--size", "huge"], "invalid choice: 'huge'"),
        ("physical_reference", ["--corpus", "nowhere"], "no corpus at nowhere"),
        ("physical_reference", ["--corpus", "corpus.safetensors", "--splits", "val"], "has no val takes"),
        ("reconstruction", ["--model", "nobody"], "nobody"),
        ("familiarity", ["--model", "nobody", "--out", "made.json"], "nobody"),
        ("copying", ["real", "--data", "corpus.safetensors", "--out", "made.json"], "has no train clips"),
        ("server", ["--streams", "0"], "--streams: 0 is less than 1"),
        ("in_turn", ["rdm-small:rdm:two"], "'two', which is no number of steps; give such as rdm-small:rdm:2"),
        ("in_turn", ["rdm-small:pcm-1:2"], "2 steps does not go with network 'pcm-1'"),
        ("training", ["--corpus", "corpus.safetensors", "--stages", "nobody"], "has no 'nobody'"),
        ("viewer", ["--sizes", "wide"], "size 'wide' is not WIDTHxHEIGHT"),
        ("viewer", ["--page", "nowhere.html"], "no page nowhere.html"),
    ],
)
def test_a_benchmark_says_in_one_line_what_is_wrong(program, arguments, message, place, monkeypatch, capsys):
    monkeypatch.chdir(place)
    monkeypatch.setattr(sys, "argv", [program, *arguments])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(FOLDER / f"{program}.py"), run_name="__main__")
    out, said = capsys.readouterr()
    assert (ended.value.code, out, said.count("\n"), message in said) == (2, "", 1, True), said


def test_a_module_that_python_starts_says_it_so_too(place, monkeypatch, capsys):
    monkeypatch.chdir(place)
    monkeypatch.setattr(sys, "argv", ["report", "rdm"])
    monkeypatch.delitem(sys.modules, "moveset.evaluation.report", raising=False)
    with pytest.raises(SystemExit) as ended:
        runpy.run_module("moveset.evaluation.report", run_name="__main__")
    said = capsys.readouterr().err
    assert (ended.value.code, said.count("\n"), "there is no folder rdm" in said) == (2, 1, True), said


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [(KeyboardInterrupt(), 130, "interrupted"), (OSError(28, "No space left"), 1, "OSError: [Errno 28] No space left")],
)
def test_what_nobody_thought_of_is_one_line_too(error, code, message, capsys):
    def main():
        raise error

    assert exit_code_of(main) == code
    said = capsys.readouterr().err
    assert (said.count("\n"), message in said) == (1, True), said


def test_a_report_is_written_where_no_folder_was(tmp_path):
    from arguments import report_path, write_report

    path = report_path(str(tmp_path / "new/folder/report.json"))
    write_report(path, {"rows": []})
    assert path.read_text() == '{\n "rows": []\n}\n'


@pytest.mark.parametrize(("program", "module", "named"), [
    ("server.py", "websockets", "websockets; install it with pip install 'moveset[serve]'"),
    ("viewer.py", "playwright.sync_api", "playwright; install it with pip install playwright"),
])  # fmt: skip
def test_a_missing_library_is_one_line(program, module, named, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setattr(sys, "argv", [program])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(FOLDER / program), run_name="__main__")
    assert ended.value.code == 2
    assert capsys.readouterr().err == f"moveset: this needs {named}\n"


def test_a_model_may_be_named_with_its_network_and_steps():
    from arguments import sampled

    assert sampled("rdm-small") == ("rdm-small", None, None)
    assert sampled("runs/mine:pcm-1") == ("runs/mine", "pcm-1", None)
    assert sampled("rdm-small:rdm:2") == ("rdm-small", "rdm", 2)
