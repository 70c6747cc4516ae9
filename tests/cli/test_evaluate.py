"""``moveset evaluate``: a table to paste, JSON for programs, and one sentence for whatever cannot be judged."""

import importlib.util
import json
import re
import shutil

import numpy as np
import pytest

from moveset.cli import tables
from moveset.cli.__main__ import main
from moveset.cli.tables import notes, title
from moveset.evaluation.run import open_source
from tests.evaluation.corpora import content_corpus, motion_folder
from tests.evaluators import tiny_evaluator
from tests.streams import tiny_stream


@pytest.fixture(scope="module")
def place(tmp_path_factory, tiny_clips, tiny_streams):
    """A folder with data, a judge, and two tiny models."""
    folder = tmp_path_factory.mktemp("place")
    content_corpus(folder / "corpus.safetensors")
    tiny_evaluator(folder / "judge")
    shutil.copytree(tiny_clips, folder / "tiny")
    shutil.copytree(tiny_streams, folder / "flow")
    return folder


@pytest.fixture
def evaluate(place, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(place)

    def run(*arguments):
        usual = {"--data": "corpus.safetensors", "--evaluator": "judge", "--out": str(tmp_path / "results")}
        usual |= {"--device": "cpu", "--processes": "1"}
        given = [a for pair in usual.items() if pair[0] not in arguments for a in pair]
        code = main(["evaluate", *arguments, *given])
        return code, *capsys.readouterr()

    return run


def test_a_table_to_paste(evaluate, tmp_path):
    code, out, err = evaluate("real", "tiny", "--repeats", "2", "--multimodality", "0")
    assert code == 0, err
    lines = out.splitlines()
    assert lines[0].startswith("| model | R@1 ↑ | R@2 ↑ | R@3 ↑ | FID ↓ |")
    assert [line.split(" | ")[0] for line in lines[2:4]] == ["| real", "| tiny pcm-1, 1 step"]
    assert "±" in lines[3]
    assert re.search(r"80 items of \d\d kinds with \d+ distinct texts of corpus", out)
    assert "2 groups of 32; mean ± 95 % interval of 2 repeats; judged by judge" in out
    assert "Diversity over 80 pairs, for want of items." in out
    assert sorted(path.name for path in (tmp_path / "results").glob("*.json")) == [
        "real-test.json",
        "tiny-pcm-1-test.json",
    ]


def test_the_judge_itself_is_checked(evaluate, tmp_path):
    code, out, err = evaluate("--sanity", "--json")
    assert code == 0, err
    report = json.loads(out)
    # A judge that was never trained tells nothing apart, and the report must say so.
    assert not report["passed"]
    assert (report["evaluator"], report["items"]) == ("judge", 80)
    assert json.loads((tmp_path / "results/sanity-judge-test.json").read_text())["checks"] == report["checks"]
    few = json.loads(evaluate("--sanity", "--json", "--items", "70")[1])
    assert (few["items"], few["file"].endswith("sanity-judge-test-70-items.json")) == (70, True)
    for wrong, message in (
        (["real"], "leave models"),
        (["--steps", "4"], "leave models"),
        (["--set", "start=7"], "leave models"),
        (["--split", "rollout"], "--split test or val"),
        (["--device", "abacus"], "unknown device"),
        (["--items", "0"], "0 items are fewer than 1"),
        (["--out", "corpus.safetensors"], "choose another --out"),
    ):
        code, _, err = evaluate("--sanity", *wrong)
        assert (code, message in err) == (2, True), err


def test_json_for_programs(evaluate):
    code, out, _ = evaluate("flow", "--repeats", "1", "--multimodality", "0", "--items", "70", "--json")
    assert code == 0
    result = json.loads(out)["results"][0]
    assert (result["model"], result["network"], result["items"]) == ("tiny-stream", "pcm-1", 70)
    assert result["metrics"]["boundary_jerk"]["mean"] > 0
    assert result["metrics"]["fid"]["interval"] is None


def test_a_folder_of_ones_own(evaluate, tmp_path):
    folder = motion_folder(tmp_path / "mine")
    code, out, err = evaluate("--motions", str(folder), "--repeats", "1")
    assert code == 0, err
    assert "| mine | " in out
    assert "40 items of 40 kinds with 40 distinct texts of mine; FID to 80 items of corpus.safetensors, test; " in out
    assert "; 1 group of 32;" in out


def test_what_the_evaluator_does_not_read_of_long_motions_is_said(evaluate, tmp_path):
    folder = motion_folder(tmp_path / "mine")
    np.save(folder / "m-007.npy", np.tile(np.load(folder / "m-007.npy"), (6, 1, 1)))
    code, out, err = evaluate("--motions", str(folder), "--repeats", "1")
    assert code == 0, err
    assert "Left out: 1 (what lies behind frame 196 of a motion, which the evaluator does not read)." in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["mine", "--split", "rollout"], "mine cannot be rolled out"),
        ([None, "tiny", "--network", "vae", "--split", "rollout"], "tiny-vae cannot be rolled out"),
        # Not after hours of what comes before it.
        ([None, "real", "vae", "--split", "rollout"], "motionpcm-small-vae cannot be rolled out"),
        ([None, "--suite", "motionpcm", "--split", "rollout", "--row", "real", "--row", "vae"], "vae cannot be rolled"),
    ],
)
def test_what_no_repeat_could_judge_is_refused_before_anything_is_written(evaluate, tmp_path, arguments, message):
    folder, *rest = arguments
    code, out, err = evaluate(*(["--motions", str(motion_folder(tmp_path / folder))] if folder else []), *rest)
    assert (code, out, message in err) == (2, "", True), err
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize(("given", "name"), [(".", "mine"), ("../real/", "real-motions")])
def test_a_folder_of_ones_own_has_a_name_of_its_own(evaluate, tmp_path, monkeypatch, place, given, name):
    folder = motion_folder(tmp_path / ("real" if "real" in given else "mine"))
    (tmp_path / "mine").mkdir(exist_ok=True)
    monkeypatch.chdir(tmp_path / "mine")
    data = ["--data", str(place / "corpus.safetensors"), "--evaluator", str(place / "judge")]
    code, _, err = evaluate("--motions", given, "--repeats", "1", *data)
    assert code == 0, err
    assert [path.name for path in (tmp_path / "results").glob("*.json")] == [f"{name}-test.json"]
    # Other motions by the same name do not take the place of these.
    (folder / "m-000.npy").unlink()
    code, _, err = evaluate("--motions", given, "--repeats", "1", *data)
    assert (code, "give another --out" in err) == (2, True)


def test_only_the_last_process_of_torchrun_tells(evaluate, monkeypatch):
    arguments = ["real", "--repeats", "2", "--json"]
    monkeypatch.setenv("WORLD_SIZE", "2")
    monkeypatch.setenv("RANK", "1")
    code, out, err = evaluate(*arguments)
    assert (code, out) == (0, "")
    assert "other processes are still at work" in err
    monkeypatch.setenv("RANK", "0")
    assert len(json.loads(evaluate(*arguments)[1])["results"]) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "no model was given"),
        (["nothing"], "unknown model 'nothing'"),
        (["flow", "--set", "shape=round"], "shape 'round' is not one of"),
        (["flow", "--network", "rdm", "--set", "init_noise=share"], "init_noise 'share' is not one of shared, indep"),
        (["flow", "--set", "stages=False"], "stages 'False' is neither true nor false"),
        (["flow", "--set", "pace=2"], "Sampler has no setting 'pace'"),
        (["real", "--repeats", "0"], "repeats 0 is not in 1"),
        (["real", "--split", "train"], "train"),
        (["real", "--split", "val"], "no val clips"),
        (["real", "--items", "-5"], "-5 items are fewer than 1"),
        (["real", "--items", "36"], "groups of 32 items of different labels"),
        (["real", "--data", "nowhere"], "no corpus at nowhere"),
        (["real", "--evaluator", "tiny"], "describes no evaluator"),
        (["real", "--motions", "tiny"], "takes the place of a model"),
        (["real", "--device", "abacus"], "unknown device"),
        (["--motions", "tiny", "--steps", "2"], "leave --network, --steps and settings of models out"),
        (["real", "--prompts", "list.jsonl"], "add --motions DIR"),
        (["real", "--motions-fps", "30"], "add --motions DIR"),
        (["real", "--network", "pcm-1"], "real motion has no network 'pcm-1'"),
        (["real", "tiny", "--network", "vae", "--steps", "3"], "nothing is sampled for real and tiny"),
        (["real", "--guidance", "2"], "nothing is sampled for real;"),
        (["tiny", "--row", "real"], "add --suite motionpcm or --suite rdm"),
        (["--sanity", "--suite", "rdm"], "leave --suite out"),
        (["tiny", "--suite", "motionpcm", "--steps", "1"], "a suite says itself"),
        (["--suite", "motionpcm", "--steps", "0"], "a suite says itself"),
        (["--suite", "motionpcm", "--row", "nothing"], "no row 'nothing'"),
    ],
)
def test_what_cannot_be_judged_is_one_sentence(evaluate, arguments, message):
    code, out, err = evaluate(*arguments)
    assert (code, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(("suite", "seams"), [("motionpcm", 0.0), ("rdm", 1.4)])
def test_a_suite_writes_its_tables(evaluate, tmp_path, suite, seams):
    code, out, err = evaluate("--suite", suite, "--row", "real", "--repeats", "1")
    assert code == 0, err
    assert "Real" in out
    folder = tmp_path / "results" / suite
    # Jerk at the seams of streams needs real motion's, as far apart, beside it.
    result = json.loads((folder / "real.json").read_text())
    assert (result["protocol"]["seams"], "boundary_jerk" in result["metrics"]) == (seams, seams > 0)


def test_a_row_that_no_table_could_hold_is_refused_before_it_is_made(evaluate, tmp_path):
    usual = ["--suite", "motionpcm", "--repeats", "1", "--multimodality", "0"]
    assert evaluate(*usual, "--row", "real")[0] == 0
    folder = tmp_path / "results/motionpcm"
    before = {path: path.read_bytes() for path in folder.rglob("*.*") if path.is_file()}
    for arguments, message in (
        (["--seed", "1"], "such as Real, have seed 0 instead of 1"),
        (["--items", "70"], "have items 80 instead of 70"),
        (["--no-mirrored"], "instead of"),
    ):
        code, out, err = evaluate(*usual, "--row", "vae", *arguments)
        assert (code, out, err.count("\n"), message in err) == (2, "", 1, True), err
        assert {path: path.read_bytes() for path in folder.rglob("*.*") if path.is_file()} == before


def test_a_suite_of_rows_without_weights(evaluate):
    code, out, err = evaluate("--suite", "rdm", "--row", "md-4")
    assert code == 0, err
    assert "MD-4: no weights given" in err
    assert "No row has been evaluated yet." in out


def test_a_suite_goes_on_past_a_row_that_cannot_be_evaluated(evaluate, tmp_path, monkeypatch):
    folder = tiny_stream(tmp_path / "rdm-tiny")
    monkeypatch.setattr(tables, "run_one", lambda config, how: open_source(config))
    given = [str(folder), "--suite", "rdm", "--split", "rollout"]
    code, _, err = evaluate(*given)
    assert code == 0, err
    assert "Nearest training clip: corpus.safetensors has no training clips" in err
    assert "told a noisy past: 5 repeats" in err  # whatever lag the folder has
    assert "R = 2, triangle: 3 repeats" in err
    code, _, err = evaluate(*given, "--row", "nearest")
    assert (code, "has no training clips" in err, err.count("\n")) == (2, True, 1)


def test_what_draws_the_pictures_is_missed_before_anything_is_made(evaluate, tmp_path, monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name == "matplotlib" else found(name, *a))
    code, _, err = evaluate("--suite", "motionpcm", "--row", "real", "--repeats", "1")
    assert (code, "pip install 'moveset[train]'" in err) == (2, True)
    assert not (tmp_path / "results").exists()


def test_notes_say_what_was_not_as_asked_for():
    result = {
        "model": "m", "network": "pcm-4", "steps": 4, "items": 100, "labels": None, "distinct_texts": 90, "groups": 3,
        "data": {"name": "d"}, "evaluator": {"name": "e"}, "shortened": 2, "dropped": {"too short": 5},
        "metrics": {"multimodality": {}}, "repeats": [{}], "rollouts": 6, "windows": 30,
        "protocol": {"split": "test", "group": 32, "multimodality": 90, "samples": 30,
                     "diversity": 100},
    }  # fmt: skip
    said = " ".join(notes(result))
    for part in (
        "100 items with 90",
        "1 repeat;",
        "5 (too short)",
        "2 motions are shorter",
        "6 rollouts",
        "30 windows",
        "90 texts with 30",
        "100 pairs",
    ):
        assert part in said
    assert title(result) == "m pcm-4, 4 steps"
