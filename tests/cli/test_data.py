"""``moveset data``: what it prints, what it refuses."""

import json
from dataclasses import replace

import pytest

from moveset.cli.__main__ import main
from moveset.data.corpus import Corpus
from moveset.data.summary import write_sheets
from tests.synthetic import synthetic_corpus


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    return synthetic_corpus(tmp_path_factory.mktemp("data") / "corpus.safetensors", clips=12)


def test_info_shows_counts_labels_and_sentences(corpus, capsys):
    assert main(["data", "info", str(corpus)]) == 0
    out = capsys.readouterr().out
    assert "12 clips" in out
    assert "synthetic" in out
    assert "wave 3" in out
    assert "a person walks forward" in out


def test_info_as_json_is_one_object(corpus, capsys):
    assert main(["data", "info", str(corpus), "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["clips"] == 12
    assert sum(summary["lengths"].values()) == sum(row["told"] for row in summary["sources"].values()) == 12
    assert sum(row["clips"] for row in summary["splits"].values()) == 12


def test_sheets_are_drawn_of_every_source(corpus, tmp_path, capsys):
    assert main(["data", "info", str(corpus), "--sheets", str(tmp_path)]) == 0
    names = {path.name for path in tmp_path.iterdir()}
    assert {"synthetic-0.png", "synthetic-1.png"} <= names
    assert (tmp_path / "synthetic-0.png").read_bytes().startswith(b"\x89PNG")


def test_sources_are_called_as_one_likes(corpus, tmp_path):
    opened = Corpus.open(corpus)
    opened.records = tuple(replace(record, source="a/b") for record in opened.records)
    assert "a-b-0.png" in {path.name for path in write_sheets(opened, tmp_path / "sheets", count=1)}


def test_a_folder_says_what_it_holds_and_lacks(corpus, tmp_path, capsys):
    assert main(["data", "export", str(corpus), str(tmp_path / "data"), "--json"]) == 0
    made = json.loads(capsys.readouterr().out)
    info = ["data", "info", str(tmp_path / "data")]
    assert main([*info, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {**made, "missing": []}
    (tmp_path / "data" / "Std.npy").unlink()
    assert main([*info, "--captions", "1"]) == 0
    out = capsys.readouterr().out
    assert f"{made['clips']} motions of the {made['layout']} kind" in out
    assert "Std.npy missing; restore what trainings and evaluations need" in out


def test_a_damaged_report_is_said(corpus, tmp_path, capsys):
    (tmp_path / corpus.name).symlink_to(corpus)
    (tmp_path / f"{corpus.name}.report.json").write_text("{")
    assert main(["data", "info", str(tmp_path / corpus.name)]) == 2
    assert "corpus.safetensors.report.json is not JSON" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [("info", "--sheets"), ("export",)])
def test_folders_that_cannot_be_made_are_said(corpus, tmp_path, capsys, arguments):
    (tmp_path / "file").touch()
    verb, *flag = arguments
    assert main(["data", verb, str(corpus), *flag, str(tmp_path / "file" / "folder")]) == 2
    assert "cannot make the folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["info", "nothing.safetensors"], "moveset data build"),
        (["info", "{corpus}", "--captions", "-1"], "-1 sentences of each source cannot be shown; give 0 or more"),
        (["info", "README.md"], "corpus"),
        (["info", "{folder}"], "new_joint_vecs"),
        (["export", "{folder}", "{folder}/made"], "is a folder; give the file that 'moveset data build' wrote"),
        (["build", "--raw", "{folder}"], "raw data"),
        (["build", "--workers", "0"], "0 workers"),
        (["build", "--compositions", "-1"], "-1 compositions"),
        (["build", "--sources", "cmu,octopus"], "octopus"),
        (["build", "-o", "corpus.npz"], "corpus.npz"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(corpus, tmp_path, capsys, arguments, words):
    (tmp_path / "empty").mkdir()
    filled = [a.format(corpus=corpus, folder=tmp_path / "empty") for a in arguments]
    if filled[0] == "build" and "-o" not in filled:
        filled += ["-o", str(tmp_path / "out" / "corpus.safetensors")]
    assert main(["data", *filled]) == 2
    heard = capsys.readouterr()
    assert words in heard.err
    assert heard.err.count("\n") == 1
    assert heard.out == ""
    assert not (tmp_path / "out" / "corpus.safetensors").exists()
