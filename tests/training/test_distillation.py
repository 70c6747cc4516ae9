"""Students of a text-to-motion teacher: LCM and MotionPCM, their discriminator, and what is exported of them."""

import json
import shutil

import pytest
import torch

from moveset.data.dataset import open_for_training
from moveset.errors import InputError
from moveset.pipelines.model_folder import ModelFolder
from moveset.pipelines.text_to_motion import TextToMotion
from moveset.training import checkpoint
from moveset.training.distillation import DistillationConfig
from moveset.training.export import ClipExport, export


def rows_of(folder):
    rows = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    return [row for row in rows if row["split"] == "train"]


def differs(name, one, other):
    before, after = (checkpoint.read_tensors(at, name) for at in (one, other))
    return any(not torch.equal(before[key], after[key]) for key in before)


def test_students_are_not_the_teacher_any_more_and_the_decoder_keeps_its_encoder(tiny_run):
    teacher = checkpoint.read_tensors(checkpoint.resolve(tiny_run.runs / "teacher"), "teacher_ema")
    for student in ("lcm-1", "pcm-1"):
        learned = checkpoint.read_tensors(checkpoint.resolve(tiny_run.runs / student), "student")
        assert any(not torch.equal(teacher[name], learned[name]) for name in teacher)
        assert learned["guidance.weight"].abs().sum() > 0
    before, after = (
        checkpoint.read_tensors(checkpoint.resolve(tiny_run.runs / run), "vae_ema") for run in ("vae", "decoder")
    )
    changed = {name for name in before if not torch.equal(before[name], after[name])}
    assert changed
    assert not any(name.startswith(("patch_in", "length_in", "encoder", "merge", "to_latent")) for name in changed)


def test_a_resumed_distillation_equals_one_that_never_stopped(tiny_run, tmp_path):
    whole, copy = tiny_run.runs / "pcm-1", tmp_path / "copy"
    shutil.copytree(whole / "step_2", copy / "step_2")
    tiny_run.train("pcm-1", copy, steps=4, resume=True)
    files = {file.name for file in (whole / "step_4").glob("*.safetensors")}
    assert {"student.safetensors", "student_ema.safetensors", "discriminator.safetensors"} <= files
    for name in sorted(file.removesuffix(".safetensors") for file in files):
        assert not differs(name, whole / "step_4", copy / "step_4"), name


def test_a_student_goes_on_with_a_discriminator_that_reads(tiny_run, tmp_path):
    settings = ("inference_points=0.5", "mismatched_text=0.5", "discriminator_max_noise=0.4")
    shutil.copytree(tiny_run.runs / "pcm-1", tmp_path / "pcm-1")
    with pytest.warns(UserWarning, match="mismatched_text 0.0 -> 0.5"):
        _, result = tiny_run.train("pcm-1", tmp_path / "pcm-1", *settings, steps=5, resume=True)
    assert "mismatched_logit" in rows_of(tmp_path / "pcm-1")[-1]
    assert differs("discriminator", tmp_path / "pcm-1" / "step_4", result.checkpoint)


@pytest.mark.parametrize("what", ["lcm-1", "pcm-1"])
@pytest.mark.parametrize(
    ("setting", "name", "batch"), [("trajectory_rows", "trajectory", 4), ("side_rows", "sides", 32)]
)
def test_a_student_may_be_asked_for_more(tiny_run, tmp_path, what, setting, name, batch):
    """For all of its teacher's steps; for the limb that is told. Settings come in any order."""
    for rows in (0, 2):
        _, result = tiny_run.train(what, tmp_path / f"{rows}", f"{setting}={rows}", f"batch={batch}", steps=1)
        assert all((name in row) == bool(rows) for row in rows_of(tmp_path / f"{rows}"))
    assert differs("student", tmp_path / "0" / "step_1", result.checkpoint)


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"inference_points": 1.5}, "is outside 0"),
        ({"mismatched_text": -0.1}, "is outside 0"),
        ({"discriminator_max_noise": 2.0}, "is outside 0"),
    ],
)
def test_what_no_student_can_learn_is_refused(config, message):
    with pytest.raises(InputError, match=message):
        DistillationConfig(**config)


@pytest.mark.parametrize(
    ("what", "settings", "message"),
    [
        ("pcm-1", ["trajectory_rows=9", "batch=8"], "rows that are trajectory_rows = 9 is outside 0"),
        ("pcm-1", ["trajectory_rows=-1"], "trajectory_rows = -1 is below 0"),
        ("pcm-1", ["side_rows=9", "batch=8"], "rows that are side_rows = 9 is outside 0"),
        ("lcm-1", ["phases=2"], "phases=2 is for pcm"),
        ("pcm-1", ["text_encoder=t5:here"], "knows sentences as 'minilm' encodes them; set text_encoder to that"),
        ("rdm-student", ["text_encoder=t5:here"], "knows sentences as 'minilm' encodes them; set text_encoder to that"),
    ],
)
def test_what_a_student_cannot_learn_is_refused(tiny_run, tmp_path, what, settings, message):
    with pytest.raises(InputError, match=message):
        tiny_run.train(what, tmp_path / "run", *settings)


def test_a_teacher_knows_the_latents_of_its_own_autoencoder(tiny_run, tmp_path):
    """Whatever sizes its settings say; and its students are of the same."""
    sources = {"vae": tiny_run.runs / "mld-vae"}
    task, _ = tiny_run.train("teacher", tmp_path / "teacher", "model.text_dim=7", steps=1, sources=sources)
    config = task.config.model
    assert (config.tokens, config.token_dim, config.text_dim) == (1, 24, 384)
    with pytest.raises(InputError, match=r"mld.* was trained with another vae; give the --vae .* not .*vae"):
        tiny_run.train("lcm-1", tmp_path / "lcm-1", sources={"teacher": tiny_run.runs / "mld"})
    networks = {"teacher": "mld", "lcm-1": "lcm-1"}
    with pytest.raises(InputError, match=r"mld.* was trained with another vae; export it with that one"):
        exported(open_for_training(tiny_run.corpus), tiny_run.runs, tmp_path / "wrong", **networks)


def exported(dataset, runs, out, **networks):
    named = {"vae": "vae", "teacher": "teacher", **networks}
    scales = dict.fromkeys(("teacher", *networks), 2.0)
    return export(ClipExport(name="tiny", runs=named, guidance=scales), dataset, runs, out.parent / "cache", out)


def test_a_student_must_fit_its_name(tiny_run, tmp_path):
    with pytest.raises(InputError, match="a student of 1 phases"):
        exported(open_for_training(tiny_run.corpus), tiny_run.runs, tmp_path / "wrong", **{"pcm-2": "pcm-1"})


def test_a_latent_of_one_token_is_learned_distilled_exported_and_sampled(tiny_run, tmp_path):
    shutil.copytree(tiny_run.runs / "mld-vae", tmp_path / "vae")
    sources = {"cache": tmp_path / "cache"}
    tiny_run.train("mld", tmp_path / "teacher", "normalised_latents=false", steps=1, sources=sources)
    sources |= {"vae": tmp_path / "vae", "teacher": tmp_path / "teacher"}
    tiny_run.train("lcm-1", tmp_path / "lcm-1", steps=1, sources=sources)  # MotionLCM-V1
    out = exported(open_for_training(tiny_run.corpus), tmp_path, tmp_path / "one", **{"lcm-1": "lcm-1"})
    sampled = TextToMotion.from_pretrained(out, device="cpu")
    for solver, steps in (("teacher", 3), ("lcm", 1)):
        assert len(sampled("a person walks", seconds=2.0, steps=steps, solver=solver).motion) == 40
    statistics = ModelFolder.open(out).normalizer
    assert not statistics["latent_mean"].any()
    assert (statistics["latent_std"] == 1).all()
