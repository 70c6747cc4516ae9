"""All of it at the tiny size: corpus, autoencoder, teacher, students, model folder, and a motion from a sentence."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from moveset.data.dataset import open_for_training
from moveset.data.synthetic import synthetic_corpus
from moveset.errors import InputError
from moveset.recipes import tiny
from moveset.training import checkpoint
from moveset.training.distillation import DistillationConfig
from moveset.training.engine import run
from moveset.training.export import ClipExport, export
from moveset.training.tasks import Sources, task_maker, with_settings


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    synthetic_corpus(folder / "corpus.safetensors", clips=24, seed=0)
    for what in ("vae", "decoder", "teacher", "length", "lcm-1", "pcm-1"):
        recipe = tiny.TRAINING[what]()
        run(task_maker(what, recipe.task, sources(folder)), recipe.engine, folder / what)
    return folder


def sources(folder: Path) -> Sources:
    return Sources(
        corpus=folder / "corpus.safetensors", vae=folder / "vae", teacher=folder / "teacher", cache=folder / "cache"
    )


def test_students_are_not_the_teacher_any_more_and_the_decoder_keeps_its_encoder(trained: Path) -> None:
    teacher = checkpoint.read_tensors(checkpoint.resolve(trained / "teacher"), "teacher_ema")
    for student in ("lcm-1", "pcm-1"):
        learned = checkpoint.read_tensors(checkpoint.resolve(trained / student), "student")
        assert any(not torch.equal(teacher[name], learned[name]) for name in teacher)
        assert learned["guidance.weight"].abs().sum() > 0
    before = checkpoint.read_tensors(checkpoint.resolve(trained / "vae"), "vae_ema")
    after = checkpoint.read_tensors(checkpoint.resolve(trained / "decoder"), "vae_ema")
    changed = {name for name in before if not torch.equal(before[name], after[name])}
    assert changed
    assert not any(name.startswith(("patch_in", "length_in", "encoder", "merge", "to_latent")) for name in changed)


def test_a_resumed_distillation_equals_one_that_never_stopped(trained: Path, tmp_path: Path) -> None:
    recipe = tiny.TRAINING["pcm-1"]()

    maker = task_maker("pcm-1", recipe.task, sources(trained))
    run(maker, replace(recipe.engine, steps=2), tmp_path / "run")
    # The learning rate is a cosine over the run, so the first half must know of the second.
    whole = checkpoint.read_tensors(trained / "pcm-1" / "step_2", "student")
    half = checkpoint.read_tensors(tmp_path / "run" / "step_2", "student")
    assert whole.keys() == half.keys()
    (tmp_path / "copy").mkdir()
    subprocess.run(["cp", "-r", str(trained / "pcm-1" / "step_2"), str(tmp_path / "copy")], check=True)
    run(maker, recipe.engine, tmp_path / "copy", True)
    for name in ("student", "student_ema", "discriminator", "optimizer_student"):
        if (trained / "pcm-1" / "step_4" / f"{name}.safetensors").is_file():
            one = checkpoint.read_tensors(trained / "pcm-1" / "step_4", name)
            two = checkpoint.read_tensors(tmp_path / "copy" / "step_4", name)
            assert all(torch.equal(one[key], two[key]) for key in one)


def test_a_student_goes_on_with_a_discriminator_that_reads(trained: Path, tmp_path: Path) -> None:
    recipe = tiny.TRAINING["pcm-1"]()
    task = replace(recipe.task, inference_points=0.5, mismatched_text=0.5, discriminator_max_noise=0.4)
    shutil.copytree(trained / "pcm-1", tmp_path / "pcm-1")
    last = checkpoint.resolve(trained / "pcm-1")
    steps = int(last.name.removeprefix("step_")) + 2
    with pytest.warns(UserWarning, match="mismatched_text 0.0 -> 0.5"):
        run(task_maker("pcm-1", task, sources(trained)), replace(recipe.engine, steps=steps), tmp_path / "pcm-1", True)
    rows = [json.loads(line) for line in (tmp_path / "pcm-1" / "metrics.jsonl").read_text().splitlines()]
    assert all("mismatched_logit" in row for row in rows if row["split"] == "train" and row["step"] > steps - 2)
    before = checkpoint.read_tensors(last, "discriminator")
    after = checkpoint.read_tensors(tmp_path / "pcm-1" / f"step_{steps}", "discriminator")
    assert any(not torch.equal(before[name], after[name]) for name in before)


def test_a_student_waits_while_the_discriminator_learns_alone(trained: Path, tmp_path: Path) -> None:
    recipe = tiny.TRAINING["pcm-1"]()
    task = replace(recipe.task, discriminator_warmup=2)
    engine = replace(recipe.engine, steps=4, save_every=1, log_every=1)
    run(
        task_maker("pcm-1", task, sources(trained)),
        replace(engine, keep_last=4),
        tmp_path / "pcm-1",
        False,
        trained / "pcm-1",
    )
    start = checkpoint.resolve(trained / "pcm-1")

    def kept(name: str, step: int) -> bool:
        before, after = (checkpoint.read_tensors(at, name) for at in (start, tmp_path / "pcm-1" / f"step_{step}"))
        return all(torch.equal(before[key], after[key]) for key in before)

    assert [kept("student", step) for step in (1, 2, 3)] == [True, True, False]
    assert [kept("student_ema", step) for step in (1, 2, 3)] == [True, True, False]
    assert not kept("discriminator", 1)
    rows = [json.loads(line) for line in (tmp_path / "pcm-1" / "metrics.jsonl").read_text().splitlines()]
    rates = [row["lr_student"] for row in rows if row["split"] == "train"]
    assert rates[:2] == [0.0, 0.0]
    assert rates[2] > 0.0


@pytest.mark.parametrize("wrong", [{"discriminator_warmup": -1}, {"discriminator_warmup": 5, "adversarial": 0.0}])
def test_a_discriminator_alone_must_exist(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="discriminator_warmup"):
        DistillationConfig(**wrong)


@pytest.mark.parametrize("what", ["lcm-1", "pcm-1"])
def test_a_student_may_be_asked_for_all_of_its_teachers_steps(trained: Path, tmp_path: Path, what: str) -> None:
    recipe = tiny.TRAINING[what]()
    learned = []
    for trajectory_rows in (0, 2):
        task, folder = replace(recipe.task, trajectory_rows=trajectory_rows), tmp_path / f"{what}-{trajectory_rows}"
        run(task_maker(what, task, sources(trained)), replace(recipe.engine, steps=2), folder)
        rows = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
        assert all(("trajectory" in row) == bool(trajectory_rows) for row in rows if row["split"] == "train")
        learned.append(checkpoint.read_tensors(folder / "step_2", "student"))
    assert any(not torch.equal(learned[0][name], learned[1][name]) for name in learned[0])


@pytest.mark.parametrize(
    "wrong", [{"inference_points": 1.5}, {"mismatched_text": -0.1}, {"discriminator_max_noise": 2.0}]
)
def test_shares_beyond_one_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="is outside 0"):
        DistillationConfig(**wrong)


@pytest.mark.parametrize("settings", [("batch=8", "trajectory_rows=6"), ("trajectory_rows=6", "batch=8")])
def test_settings_come_in_any_order(trained: Path, tmp_path: Path, settings: tuple[str, ...]) -> None:
    recipe = tiny.TRAINING["pcm-1"]()
    task = with_settings(recipe.task, settings)
    run(task_maker("pcm-1", task, sources(trained)), replace(recipe.engine, steps=1), tmp_path / "run")


@pytest.mark.parametrize(
    ("what", "settings", "message"),
    [
        ("pcm-1", ("trajectory_rows=9", "batch=8"), "rows that are trajectory_rows = 9 is outside 0"),
        ("pcm-1", ("trajectory_rows=-1",), "rows that are trajectory_rows = -1 is outside 0"),
        ("lcm-1", ("phases=2",), "phases=2 is for pcm"),
    ],
)
def test_what_a_student_cannot_learn_is_refused(
    trained: Path, tmp_path: Path, what: str, settings: tuple[str, ...], message: str
) -> None:
    task = with_settings(tiny.TRAINING[what]().task, settings)
    with pytest.raises(InputError, match=message):
        run(task_maker(what, task, sources(trained)), tiny.TRAINING[what]().engine, tmp_path / "run")


def exported(folder: Path, out: Path, students: dict[str, str], **more: str) -> Path:
    runs = {"vae": "vae", "teacher": "teacher", **students, **more}
    scales = dict.fromkeys(("teacher", *students), 2.0)
    dataset = open_for_training(folder / "corpus.safetensors")
    return export(ClipExport(name="tiny", runs=runs, guidance=scales), dataset, folder, folder / "cache", out)


def test_an_exported_model_generates_by_every_method(trained: Path, tmp_path: Path) -> None:
    from moveset.pipelines.text_to_motion import TextToMotion

    students = {"lcm-1": "lcm-1", "pcm-1": "pcm-1"}
    out = exported(trained, tmp_path / "tiny", students, decoder="decoder", length="length")
    t2m = TextToMotion.from_pretrained(out, device="cpu")
    for solver, steps in (("pcm", 1), ("lcm", 1), ("teacher", 3)):
        made = t2m("a person walks forward", seconds=2.0, steps=steps, solver=solver, seed=3)
        assert len(made.motion) == 40
    assert t2m("a person walks").motion.seconds > 0.9


def test_a_student_must_fit_its_name(trained: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a student of 1 phases"):
        exported(trained, tmp_path / "wrong", {"pcm-2": "pcm-1"})


def test_a_latent_of_one_token_is_learned_packed_and_sampled(tmp_path: Path) -> None:
    from moveset.pipelines.text_to_motion import TextToMotion

    synthetic_corpus(tmp_path / "corpus.safetensors", clips=12, seed=0)
    sizes = {"tokens": 1, "token_dim": 24}
    for what, more in (("vae", {"slots": 6}), ("teacher", {})):
        recipe = tiny.TRAINING[what]()
        task = replace(recipe.task, model=replace(recipe.task.model, **sizes, **more))
        run(task_maker(what, task, sources(tmp_path)), recipe.engine, tmp_path / what)
    out = exported(tmp_path, tmp_path / "one", {})
    made = TextToMotion.from_pretrained(out, device="cpu")("a person walks", seconds=2.0, steps=3, solver="teacher")
    assert len(made.motion) == 40


def test_the_command_line_trains(tmp_path: Path) -> None:
    synthetic_corpus(tmp_path / "corpus.safetensors", clips=12, seed=0)
    command = [
        sys.executable,
        "-m",
        "moveset.cli",
        "train",
        "vae",
        "--recipe",
        "tiny",
        "--corpus",
        "corpus.safetensors",
    ]
    done = subprocess.run([*command, "--threads", "1"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "runs" / "tiny" / "vae" / "step_4" / "manifest.json").is_file()
