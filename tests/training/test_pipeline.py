"""One command from data to models: stages in order, skipped when done, refused when something else made them."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from moveset import MotionStream, TextToMotion
from moveset.data.synthetic import synthetic_corpus
from moveset.errors import InputError
from moveset.evaluation.evaluator import Evaluator
from moveset.training import checkpoint, pipeline
from moveset.training.pipeline import Report, stages, train_all

RUNS = ("length", "vae", "decoder", "teacher", "lcm-1", "pcm-1", "pcm-2", "pcm-4", "rdm-7", "md-7", "rdm-student")


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Report, list[str]]:
    folder, lines = tmp_path_factory.mktemp("all"), list[str]()
    synthetic_corpus(folder / "corpus.safetensors", clips=24, seed=0)
    report = train_all("tiny", folder / "corpus.safetensors", folder, say=lines.append)
    return folder, report, lines


def again(folder: Path, **options) -> Report:
    return train_all("tiny", folder / "corpus.safetensors", folder, say=lambda line: None, **options)


def test_every_training_and_every_model_of_the_recipe_is_made(trained):
    folder, report, lines = trained
    assert set(RUNS) <= set(report.trained)
    assert report.skipped == ()
    clips, stream = (
        next(path for path in report.models if path.name.startswith(name)) for name in ("motionpcm-tiny", "rdm-tiny")
    )
    assert len(TextToMotion.from_pretrained(clips, device="cpu")("a person walks", seconds=2.0).motion) == 40
    assert len(next(MotionStream.from_pretrained(stream, prompt="a person walks", device="cpu")).motion) == 28
    assert Evaluator.open(str(folder / "models" / "t2m-tiny")).card.name == "t2m-tiny"
    log = (folder / "train.log").read_text().splitlines()
    assert [line.split(" ", 2)[2] for line in log] == lines
    order = [line.split(":")[0] for line in lines if line.endswith("begins")]
    for stage in stages("tiny"):
        assert all(order.index(name) < order.index(stage.name) for name in stage.needs)


def test_what_is_done_is_not_done_again(trained):
    folder, report, _ = trained
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*.safetensors")}
    second = again(folder)
    assert second.trained == second.models == ()
    assert len(second.skipped) == len(report.trained) + len(report.models)
    assert before == {path: path.stat().st_mtime_ns for path in folder.rglob("*.safetensors")}


def test_what_was_cut_off_goes_on_and_only_that(trained, tmp_path):
    folder = trained[0]
    run, note = folder / "runs" / "length", folder / "stages" / "length.json"
    whole = checkpoint.read_tensors(checkpoint.resolve(run), "length")
    (run / "step_4").rename(tmp_path / "step_4")
    note.write_text(json.dumps({"key": json.loads(note.read_text())["key"]}))
    report = again(folder, only=["length"])
    assert report.trained == ("length",)
    resumed = checkpoint.read_tensors(run / "step_4", "length")
    assert all(whole[name].equal(resumed[name]) for name in whole)


def test_what_other_settings_made_is_refused_with_all_that_stands_on_it(trained, monkeypatch):
    folder, every = trained[0], stages("tiny")

    def changed(recipe, device="auto"):
        return tuple(
            replace(stage, task=replace(stage.task, lr=1e-2)) if stage.name == "vae" else stage for stage in every
        )

    monkeypatch.setattr(pipeline, "stages", changed)
    for name in ("vae", "teacher", "pcm-1"):
        with pytest.raises(InputError, match=f"{name} was trained by other settings"):
            again(folder, only=[name])
    assert again(folder, only=["movement", "rdm-7"]).trained == ()


def test_a_stage_needs_what_it_stands_on(trained, tmp_path):
    corpus = trained[0] / "corpus.safetensors"
    for only, words in ((["pcm-1"], "pcm-1 needs vae, which is not done"), (["pcm-3"], "there is no stage 'pcm-3'")):
        with pytest.raises(InputError, match=words):
            train_all("tiny", corpus, tmp_path, only=only)


def test_trainings_side_by_side_are_those_alone(trained, tmp_path):
    folder, only = trained[0], ["movement", "length"]
    report = train_all("tiny", folder / "corpus.safetensors", tmp_path, only=only, jobs=2, say=lambda line: None)
    assert sorted(report.trained) == sorted(only)
    for run, name in (("movement", "movement"), ("length", "length")):
        one, other = (checkpoint.read_tensors(root / "runs" / run / "step_4", name) for root in (folder, tmp_path))
        assert all(one[key].equal(other[key]) for key in one)
