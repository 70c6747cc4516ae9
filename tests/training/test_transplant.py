"""What a teacher learned since, given to its student."""

import json
import sys
from dataclasses import replace

import pytest
import torch

from moveset.errors import InputError
from moveset.models.latent_denoiser import LatentDenoiserConfig
from moveset.models.segment_transformer import SegmentTransformerConfig
from moveset.rdm.grid import GridConfig
from moveset.training import checkpoint, frozen, transplant
from moveset.training.distill import DistillationConfig
from moveset.training.rdm import RDMConfig
from moveset.training.rdm_student import RDMStudentConfig
from moveset.training.teacher import TeacherConfig
from tests.training.run_folders import write_run

MODEL = SegmentTransformerConfig(frames=8, width=32, heads=2, hidden=32, blocks=1)


def moved(module, seed):
    """The same network with other weights."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for weight in module.parameters():
            weight += 0.1 * torch.randn(weight.shape, generator=generator)
    return module


@pytest.fixture
def runs(tmp_path):
    """A teacher at two stages, its student of the first, and teachers of another width and depth."""
    task = RDMConfig(model=MODEL, flow=None, grid=GridConfig(frames=8))
    torch.manual_seed(0)
    before = MODEL.build()
    student = moved(before.student(), 1)
    after = MODEL.build()
    after.load_state_dict(before.state_dict())
    learned = RDMStudentConfig(model=student.config, codec="native", frames=8)
    write_run(tmp_path, "before", task, denoiser_ema=before)
    write_run(tmp_path, "after", task, denoiser_ema=moved(after, 2))
    write_run(tmp_path, "student", learned, student=moved(before.student(), 3), student_ema=student)
    narrow = replace(MODEL, hidden=16)
    write_run(tmp_path, "narrow", replace(task, model=narrow), denoiser_ema=narrow.build())
    deep = replace(MODEL, blocks=2)
    write_run(tmp_path, "deep", replace(task, model=deep), denoiser_ema=deep.build())
    return tmp_path / "runs"


def carried(runs, share, out):
    path = transplant.transplant(runs / "student", runs / "before", runs / "after", share, runs / out)
    return checkpoint.read_tensors(path, "student_ema")


def test_a_share_of_the_teachers_way_is_added_to_what_the_student_shares_with_it(runs):
    student, before, after = (
        checkpoint.read_tensors(runs / run / "step_7", name)
        for run, name in (("student", "student_ema"), ("before", "denoiser_ema"), ("after", "denoiser_ema"))
    )
    for share, out in ((0.0, "none"), (0.5, "half"), (1.0, "all")):
        made = carried(runs, share, out)
        assert made.keys() == student.keys()
        for key, value in made.items():
            step = share * (after[key] - before[key]) if key in before else torch.zeros_like(value)
            torch.testing.assert_close(value, student[key] + step)
    assert torch.equal(made["guidance.weight"], student["guidance.weight"])
    assert not torch.equal(made["out.weight"], student["out.weight"])


def test_what_the_teacher_has_learned_to_read_since_the_student_reads_too(runs, tmp_path):
    placed = replace(MODEL, placed=True)
    after = placed.build()
    after.load_state_dict(frozen.load(runs / "after", "denoiser_ema").module.state_dict(), strict=False)
    task = RDMConfig(model=placed, flow=None, grid=GridConfig(frames=8))
    write_run(tmp_path, "placed", task, denoiser_ema=moved(after, 4))
    transplant.transplant(runs / "student", runs / "before", runs / "placed", 0.5, runs / "given")
    given, teacher = (
        frozen.load(runs / run, f"{name}_ema") for run, name in (("given", "student"), ("placed", "denoiser"))
    )
    assert given.module.config == replace(frozen.load(runs / "student", "student_ema").module.config, placed=True)
    torch.testing.assert_close(given.module.place.weight, teacher.module.place.weight / 2)
    # A student that reads it already moves by the difference, as in everything else.
    transplant.transplant(runs / "given", runs / "placed", runs / "placed", 0.5, runs / "again")
    again = frozen.load(runs / "again", "student_ema")
    torch.testing.assert_close(again.module.place.weight, given.module.place.weight)


def test_a_student_of_clips_is_given_what_its_teacher_learned(tmp_path):
    model = LatentDenoiserConfig(tokens=2, token_dim=4, width=16, heads=2, blocks=1, hidden=16)
    torch.manual_seed(0)
    before = model.build()
    after = model.build()
    student = moved(before.student(), 1)
    write_run(tmp_path, "before", TeacherConfig(model=model), teacher_ema=before)
    write_run(tmp_path, "after", TeacherConfig(model=model), teacher_ema=after)
    write_run(tmp_path, "student", DistillationConfig(model=student.config), student_ema=student)
    made = carried(tmp_path / "runs", 0.5, "given")
    old, new = before.state_dict(), after.state_dict()
    for key, value in student.state_dict().items():
        torch.testing.assert_close(made[key], value + 0.5 * (new[key] - old[key]) if key in old else value)
    assert not torch.equal(made["latent_in.weight"], student.latent_in.weight)


def test_what_is_written_is_a_students_run(runs, monkeypatch, capsys):
    given = [str(runs / "student"), "--before", str(runs / "before"), "--after", str(runs / "after")]
    monkeypatch.setattr(sys, "argv", ["transplant", *given, "--share", "0.25", "--out", str(runs / "given")])
    transplant.main()
    assert capsys.readouterr().out.strip() == str(runs / "given" / "step_7")
    found = frozen.load(runs / "given", "student_ema")
    assert (found.task["phases"], found.module.config.guided) == (1, True)
    assert json.loads((runs / "given" / "step_7" / "origin.json").read_text()) == {"student": "step_7", "share": 0.25}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"share": 1.5}, "share = 1.5 is outside"),
        ({"share": float("nan")}, "share = nan is outside"),
        ({"after": "narrow"}, r"narrow has another blocks.0.*; give stages"),
        ({"after": "deep"}, "deep has another blocks.1.*; give stages"),
        ({"before": "deep"}, "deep has another blocks.1.*; give stages"),
        ({"before": "nowhere"}, "nowhere"),
        ({"student": "before"}, "student_ema"),
        ({"out": "student"}, "already holds a training"),
    ],
)
def test_what_does_not_fit_is_refused(changes, words, runs):
    given = {"student": "student", "before": "before", "after": "after", "out": "new", "share": 0.5} | changes
    paths = [runs / given[name] for name in ("student", "before", "after")]
    with pytest.raises(InputError, match=words):
        transplant.transplant(*paths, given["share"], runs / given["out"])
    assert not (runs / "new").exists()
