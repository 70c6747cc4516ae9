"""One command from data to models: stages in order, skipped when done, refused when something else made them."""

import json
import os
import shutil
import signal
import time
from contextlib import suppress
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace

import pytest

from moveset import MotionStream, TextToMotion
from moveset.cli import tables
from moveset.cli.__main__ import main
from moveset.data.dataset import CorpusDataset
from moveset.errors import InputError
from moveset.evaluation import report
from moveset.evaluation.evaluator import Evaluator
from moveset.evaluation.suites import get_suite
from moveset.io.process import LOCKS, locked
from moveset.training import checkpoint, engine, pipeline
from moveset.training.pipeline import Report, Stage, stages, train_all


def again(folder: Path, **options) -> Report:
    return train_all("tiny", folder / "corpus.safetensors", folder, say=lambda line: None, **options)


def test_every_training_and_every_model_of_the_recipe_is_made(tiny_run):
    every, lines = stages("tiny"), list(tiny_run.lines)
    assert set(tiny_run.report.trained) == {stage.name for stage in every if stage.model is None}
    assert [path.name for path in tiny_run.report.models] == [stage.model.name for stage in every if stage.model]
    assert tiny_run.report.skipped == ()
    t2m = TextToMotion.from_pretrained(tiny_run.model("motionpcm"), device="cpu")
    for solver, steps in (("pcm", 1), ("lcm", 1), ("teacher", 3)):
        assert len(t2m("a person walks", seconds=2.0, steps=steps, solver=solver).motion) == 40
    assert t2m("a person walks").motion.seconds > 0.9
    stream = MotionStream.from_pretrained(tiny_run.model("rdm"), prompt="a person walks", device="cpu")
    assert len(next(stream).motion) == 28
    assert Evaluator.open(str(tiny_run.model("t2m"))).card.name == "t2m-tiny"
    log = (tiny_run.folder / "train.log").read_text().splitlines()
    assert [line.split(" ", 2)[2] for line in log][: len(lines)] == lines
    order = [line.split(":")[0] for line in lines if line.endswith("begins")]
    for stage in every:
        assert all(order.index(name) < order.index(stage.name) for name in stage.needs)


def test_what_is_done_is_not_done_again(tiny_run):
    before = {path: path.stat().st_mtime_ns for path in tiny_run.folder.rglob("*.safetensors")}
    second = again(tiny_run.folder)
    assert second.trained == second.models == ()
    assert len(second.skipped) == len(stages("tiny"))
    assert before == {path: path.stat().st_mtime_ns for path in tiny_run.folder.rglob("*.safetensors")}


def test_what_was_cut_off_goes_on_and_only_that(tiny_run, tmp_path):
    for part in ("stages", "length", "cache"):
        shutil.copytree(tiny_run.folder / part, tmp_path / part)
    shutil.copy(tiny_run.corpus, tmp_path)
    run, note = tmp_path / "length", tmp_path / "stages" / "length.json"
    whole = checkpoint.read_tensors(checkpoint.resolve(run), "length")
    shutil.rmtree(run / "step_4")
    note.write_text(json.dumps({"key": json.loads(note.read_text())["key"]}))
    assert again(tmp_path, only=["length"]).trained == ("length",)
    resumed = checkpoint.read_tensors(run / "step_4", "length")
    assert all(whole[name].equal(resumed[name]) for name in whole)


def test_what_other_settings_made_is_refused_with_all_that_stands_on_it(tiny_run, monkeypatch):
    folder, every = tiny_run.folder, stages("tiny")

    def changed(recipe, device="auto", share=1.0):
        return tuple(
            replace(stage, task=replace(stage.task, lr=1e-2)) if stage.name == "vae" else stage for stage in every
        )

    monkeypatch.setattr(pipeline, "stages", changed)
    for name in ("vae", "teacher", "pcm-1"):
        with pytest.raises(InputError, match=f"{name} was trained by other settings"):
            again(folder, only=[name])
    assert again(folder, only=["movement", "rdm-7"]).trained == ()


def test_other_sentences_are_other_data_for_what_reads_or_draws_by_them(tiny_run, tmp_path, monkeypatch):
    clip = CorpusDataset.clip
    monkeypatch.setattr(CorpusDataset, "clip", lambda *given: replace(clip(*given), captions=("another sentence",)))
    assert again(tiny_run.folder, only=["movement"]).trained == ()
    for name in ("vae", "length", "teacher", "evaluator"):
        with pytest.raises(InputError, match=f"{name} was trained by other settings, on other data"):
            again(tiny_run.folder, only=[name])


def test_a_training_begun_by_itself_is_not_taken_over(tiny_run, tmp_path):
    shutil.copytree(tiny_run.folder / "length", tmp_path / "length")
    with pytest.raises(InputError, match="length holds a training that was begun by itself"):
        train_all("tiny", tiny_run.corpus, tmp_path, only=["length"])


def test_words_that_are_not_here_are_missed_before_anything_is_trained(tiny_run, tmp_path, monkeypatch):
    every = tuple(
        replace(stage, task=replace(stage.task, words="glove:nowhere")) if stage.name == "evaluator" else stage
        for stage in stages("tiny")
    )
    monkeypatch.setattr(pipeline, "stages", lambda *_: every)
    with pytest.raises(InputError, match="nowhere"):
        train_all("tiny", tiny_run.corpus, tmp_path, only=["movement", "evaluator"])
    assert not (tmp_path / "movement").exists()


def test_a_stage_needs_what_it_stands_on(tiny_run, tmp_path):
    for only, words in (
        (["pcm-1"], "pcm-1 needs vae, which is not done"),
        (["pcm-3"], "there is no stage or model 'pcm-3'; .* rdm-1, .*, motionpcm-tiny"),
    ):
        with pytest.raises(InputError, match=words):
            train_all("tiny", tiny_run.corpus, tmp_path, only=only)


def test_a_model_is_asked_for_with_all_that_it_needs_and_a_stage_by_its_name_is_no_other(tiny_run):
    needed = {"export motionpcm-tiny", "vae", "decoder", "teacher", "length", "sides", "lcm-1"}
    needed |= {f"pcm-{phases}" for phases in (1, 2, 4)}
    assert set(again(tiny_run.folder, only=["motionpcm-tiny"]).skipped) == needed
    assert again(tiny_run.folder, only=["pcm-1"]).skipped == ("pcm-1",)
    assert set(again(tiny_run.folder, only=["movement", "export rdm-1"]).skipped) == {"movement", "export rdm-1-tiny"}


def test_a_share_of_all_steps_has_that_share_of_the_warm_up_and_is_another_training(tiny_run):
    for whole, half in zip(stages("small"), stages("small", share=0.5), strict=True):
        if whole.engine is not None:
            assert half.engine.steps == round(whole.engine.steps / 2)
            assert getattr(half.task, "warmup", 0) == round(getattr(whole.task, "warmup", 0) / 2)
    assert stages("small", share=1.0) == stages("small")
    for share in (0.0, 1.5, float("nan")):
        with pytest.raises(InputError, match="above 0 and at most 1"):
            stages("small", share=share)
    with pytest.raises(InputError, match="length was trained by other settings"):
        again(tiny_run.folder, only=["length"], share=0.5)


def test_tables_are_of_the_models_that_were_made_each_in_its_suite(tiny_run, monkeypatch, capsys):
    asked = []
    monkeypatch.setattr(tables, "run_one", lambda config, how: asked.append((how.out.name, config)))
    monkeypatch.setattr(report, "write_report", lambda folder: tiny_run.folder / "train.log")
    given = ["train", "all", "--recipe", "tiny", "--corpus", str(tiny_run.corpus), "--out", str(tiny_run.folder)]
    assert main([*given, "--device", "cpu", "--tables"]) == 0
    for suite in ("motionpcm", "rdm"):
        rows = [row for row in get_suite(suite).rows if row.steps is not None]
        made = [config for name, config in asked if name == suite and config.steps is not None]
        assert {config.name for config in made} <= {row.key for row in rows}
        assert {Path(config.model).parent for config in made} == {tiny_run.folder / "models"}
    assert {config.evaluator for _, config in asked} == {str(tiny_run.model("t2m"))}


def test_a_run_that_saved_nothing_keeps_its_model_alone_from_being_exported(tiny_run, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    runs = tmp_path / "runs" / "tiny"
    (runs / "rdm-1").mkdir(parents=True)
    shutil.copytree(tiny_run.runs / "evaluator", runs / "evaluator")
    assert main(["train", "export", "--recipe", "tiny", "--corpus", str(tiny_run.corpus)]) == 0
    said, complained = capsys.readouterr()
    assert Path(said.strip()) == Path("runs/tiny/models/t2m-tiny")
    assert "rdm-1-tiny: not made, for nothing is trained in runs/tiny/rdm-1" in complained


@pytest.mark.parametrize(("said", "lines"), [({}, 1), ({"LOCAL_RANK": "1"}, 0), ({"RANK": "1", "LOCAL_RANK": "0"}, 0)])
def test_of_several_processes_the_first_says_how_it_went(said, lines, monkeypatch, capsys):
    for name in ("RANK", "LOCAL_RANK"):
        monkeypatch.delenv(name, raising=False)
    for name, value in said.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(engine, "run", lambda *given: engine.TrainResult(4, None, None, {}))
    assert main(["train", "length", "--recipe", "tiny"]) == 0
    assert len(capsys.readouterr().err.splitlines()) == lines


def test_tables_without_a_judge_are_refused_before_anything_is_trained(tmp_path, capsys):
    given = ["train", "all", "--recipe", "tiny", "--corpus", "nowhere", "--out", str(tmp_path / "runs")]
    assert main([*given, "--only", "rdm-tiny", "--tables"]) == 2
    assert "give --only t2m-tiny, too" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_a_device_that_cannot_train_is_refused_before_data_is_built(tmp_path, capsys):
    given = ["train", "all", "--raw", "nowhere", "--corpus", str(tmp_path / "corpus"), "--out", str(tmp_path / "runs")]
    assert main([*given, "--device", "mps"]) == 2
    assert "give --device cpu" in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


def test_trainings_side_by_side_are_those_alone(forks, tiny_run, tmp_path):
    only = ["movement", "length"]
    shutil.copytree(tiny_run.folder / "cache", tmp_path / "cache")
    given = str(tiny_run.corpus), str(tmp_path), only
    assert forks.run("tests.tiny_run:side_by_side", *given) == 0, forks.said
    for name in only:
        one, other = (checkpoint.read_tensors(x / name / "step_4", name) for x in (tiny_run.folder, tmp_path))
        assert all(one[key].equal(other[key]) for key in one)


def test_a_signal_to_the_command_alone_stops_trainings_side_by_side(forks, tiny_run, tmp_path):
    given = str(tiny_run.corpus), str(tmp_path), ["movement", "length"]
    assert forks.run("tests.tiny_run:side_by_side_until_a_signal", *given) == 0, forks.said


def until(happened, seconds=100):
    deadline = time.monotonic() + seconds
    while not happened() and time.monotonic() < deadline:
        time.sleep(0.02)
    return happened()


def nobody_trains_in(folder):
    with suppress(InputError), locked(folder, "somebody does"):
        return True
    return False


@pytest.mark.skipif(not LOCKS, reason="there are no locks")
def test_trainings_side_by_side_end_with_a_command_that_is_killed(forks, tiny_run, tmp_path):
    only = ["movement", "length"]
    process = forks.start("tests.tiny_run:side_by_side_without_end", str(tiny_run.corpus), str(tmp_path), only)
    begun = until(lambda: not forks.running or all((tmp_path / f"{name}.begun").exists() for name in only))
    os.kill(process, signal.SIGKILL)
    assert (begun, forks.end()) == (True, -signal.SIGKILL), forks.said
    assert until(lambda: all(nobody_trains_in(tmp_path / name) for name in only), seconds=20)


@pytest.mark.skipif(os.name == "nt", reason="forks")
def test_a_training_that_ends_by_the_signal_that_all_were_sent_has_not_failed(tmp_path, monkeypatch):
    """It may still have been preparing its data, and not have noted it."""
    received = []
    monkeypatch.setattr(pipeline, "get_context", lambda _: get_context("fork"))
    monkeypatch.setattr(pipeline, "_in_a_process", lambda *given: os._exit(1))
    log = SimpleNamespace(begin=lambda stage: received.append(signal.SIGINT))
    place = pipeline.Place(data=tmp_path, out=tmp_path)
    assert pipeline._side_by_side([Stage(name="a", needs=())], {"a": ""}, place, log, 2, received) == ([], "SIGINT")


def test_the_log_says_how_much_is_left_by_the_pace_so_far_and_less_what_has_run(tmp_path, monkeypatch):
    now, lines = [0.0], list[str]()
    monkeypatch.setattr(pipeline.time, "monotonic", lambda: now[0])
    one, two, three = (Stage(name=name, needs=(), hours=hours) for name, hours in (("a", 1.5), ("b", 2), ("c", 1)))
    log = pipeline._Log(tmp_path / "train.log", (one, two, three), lines.append)
    log.begin(one)
    log.begin(two)
    now[0] = 3.5 * 3600.0  # two hours more than was expected
    log.end(one)
    log.begin(three)
    assert lines[0] == "a: begins, about 4 h 30 min of one core left"
    assert lines[2:] == ["a: done in 3 h 30 min", "c: begins, about 2 h 30 min of one core left"]


def test_a_stage_of_a_minute_says_little_of_how_long_hours_take(tmp_path, monkeypatch):
    now, lines = [0.0], list[str]()
    monkeypatch.setattr(pipeline.time, "monotonic", lambda: now[0])
    short, long = Stage(name="short", needs=(), hours=0.05), Stage(name="long", needs=(), hours=5.0)
    log = pipeline._Log(tmp_path / "train.log", (short, long), lines.append)
    log.begin(short)
    now[0] = 10.0  # of three minutes
    log.end(short)
    log.begin(long)
    assert lines[2] == "long: begins, about 4 h 34 min of one core left"
