"""Students of a recurrent model: what they, their teacher and their discriminator are told."""

import json
import shutil

import pytest
import torch

from moveset.errors import InputError
from moveset.rdm.staircase import levels
from moveset.training import adversarial, bound_segments, rdm_distillation
from moveset.training.bound_segments import BoundSegments
from moveset.training.rdm_distillation import RDMStudentConfig
from moveset.training.trained import load_trained


def tensors(task):
    return {
        f"{name}.{key}": value.clone()
        for name, module in {**task.modules(), **task.averages()}.items()
        for key, value in module.state_dict().items()
    }


def test_a_students_discriminator_may_be_shown_the_text_of_others(tiny_run, tmp_path, monkeypatch):
    asked, hinge = [], adversarial.hinge_discriminator
    monkeypatch.setattr(adversarial, "hinge_discriminator", lambda *given: asked.append(given) or hinge(*given))
    settings = ("mismatched_text=0.5", "inference_points=1.0", "discriminator_max_noise=0.0")
    tiny_run.train("rdm-student", tmp_path / "run", *settings)
    log = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    assert all("mismatched_logit" in line for line in log)
    for real, _, mismatched, share in asked:
        assert share == 0.5
        assert real.shape == mismatched.shape
        assert not torch.equal(real, mismatched)
    tiny_run.train("rdm-student", tmp_path / "plain")
    assert all(mismatched is None for _, _, mismatched, _ in asked[3:])


def test_what_comes_after_a_clips_end_is_not_judged(tiny_run, tmp_path, monkeypatch):
    """There a take has zeros and a student anything, which would tell them apart."""
    judged, hinge, kept = [], adversarial.hinge_discriminator, []
    monkeypatch.setattr(adversarial, "hinge_discriminator", lambda *given: judged.append(given) or hinge(*given))
    valid = rdm_distillation._valid
    monkeypatch.setattr(rdm_distillation, "_valid", lambda taps, batch: kept.append(batch.valid) or valid(taps, batch))
    tiny_run.train("rdm-student", tmp_path / "run", "cutting.first_share=0", steps=4)
    assert not all(valid_Bn.all() for valid_Bn in kept)
    for (real, fake, *_), valid_Bn in zip(judged, kept[::2], strict=True):
        assert real.shape[:2] == fake.shape[:2] == (int(valid_Bn.sum()), 1)


@pytest.mark.parametrize("phases", [1, 2])
def test_a_student_that_is_told_its_own_past_resumes_exactly(phases, tiny_run, tmp_path):
    settings = ("rollout_share=0.5", "inference_points=0.5", f"phases={phases}")
    whole, _ = tiny_run.train("rdm-student", tmp_path / "whole", *settings, steps=4, save_every=2)
    shutil.copytree(tmp_path / "whole" / "step_2", tmp_path / "half" / "step_2")
    half, _ = tiny_run.train("rdm-student", tmp_path / "half", *settings, steps=4, resume=True)
    one, other = tensors(whole), tensors(half)
    assert all(torch.equal(one[name], other[name]) for name in one)
    assert all(torch.equal(whole.state()[name], half.state()[name]) for name in ("previous", "landed", "phase"))


def test_streams_are_judged_without_their_past(tiny_run, tmp_path, monkeypatch):
    judged, features = [], BoundSegments.features
    monkeypatch.setattr(
        BoundSegments, "features", lambda self, *given: judged.append(self.batch.index) or features(self, *given)
    )
    task, _ = tiny_run.train("rdm-student", tmp_path / "run", "rollout_share=0.5", "cutting.first_share=0", steps=4)
    assert len(judged) == 2 * 4  # what was made, and takes
    assert all((index[task.own.rows] == 0).all() for index in judged)
    takes = [row for row in range(task.config.batch) if row not in task.own.rows.tolist()]
    assert any((index[takes] > 0).any() for index in judged)
    assert (task.own.state()["index"] > 0).all()


def test_a_teacher_may_be_told_a_noisy_past_of_streams_alone(tiny_run, tmp_path, monkeypatch):
    told, tell = [], BoundSegments._past_at
    monkeypatch.setattr(BoundSegments, "_past_at", lambda *given: told.append((given, tell(*given))) or told[-1][1])
    settings = ("context_noise_rollout=true", "trajectory_rows=3", "rollout_share=0.5", "cutting.first_share=0")
    task, _ = tiny_run.train("rdm-student", tmp_path / "run", *settings)
    streams = set(task.own.rows.tolist())
    assert {len(given[0].batch.index) for given, _ in told} == {task.config.batch, 3}
    for (bound, t_B), (previous, level_B) in told:
        for row, level in enumerate(level_B.tolist()):
            assert level == (int(0.75 * t_B[row]) if row in streams else 0)
            if row not in streams:
                torch.testing.assert_close(previous[row], bound.batch.previous[row], atol=1e-4, rtol=0)
            elif level:
                assert not torch.allclose(previous[row], bound.batch.previous[row], atol=1e-2)


def test_who_overlaps_is_told_the_past_at_the_lower_edge_of_its_phase(tiny_run, tmp_path, monkeypatch):
    told, bind = [], BoundSegments._condition
    monkeypatch.setattr(
        BoundSegments,
        "_condition",
        lambda self, text, t_B, **more: told.append((self, t_B, bind(self, text, t_B, **more))) or told[-1][-1],
    )
    monkeypatch.setattr(rdm_distillation, "levels", lambda steps: levels(3))
    settings = ("overlapping=true", "phases=2", "trajectory_rows=3", "adversarial=0.1", "cutting.first_share=0")
    _, result = tiny_run.train("rdm-student", tmp_path / "run", *settings, steps=2, validate_every=2)
    assert result.validation["student_gap"] > 0
    assert {len(t_B) for _, t_B, _ in told} == {3, 4, 64}
    levels_seen = set()
    for bound, t_B, condition in told:
        past, given = condition.past, bound.batch.previous
        assert torch.equal(past.level, (t_B > 499) * 499)
        levels_seen |= set(past.level.tolist())
        for row, level in enumerate(past.level.tolist()):
            same = torch.allclose(past.frames[row], given[row], atol=1e-3)
            assert same == (level == 0)
    assert levels_seen == {0, 499}


def test_validation_is_of_takes_with_finished_pasts(tiny_run, tmp_path, monkeypatch):
    settings = ("context_noise_rollout=true", "rollout_share=0.5")
    told, init = [], BoundSegments.__init__
    monkeypatch.setattr(BoundSegments, "__init__", lambda *given: told.append(given) or init(*given))
    monkeypatch.setattr(rdm_distillation, "levels", lambda steps: levels(3))
    _, result = tiny_run.train("rdm-student", tmp_path / "run", *settings, steps=1, validate_every=1)
    assert result.validation["student_gap"] > 0
    assert len(told[-1][1].index) == 64
    assert told[-1][-1] is None


def test_lower_phases_meet_what_the_student_landed_at(tiny_run, tmp_path, monkeypatch):
    met, target = [], rdm_distillation.clean_target
    monkeypatch.setattr(
        rdm_distillation, "clean_target", lambda *given: met.append((given[-1], given[-2])) or target(*given)
    )
    landed, land = [], BoundSegments.land
    monkeypatch.setattr(BoundSegments, "land", lambda *given: landed.append(land(*given)) or landed[-1])
    settings = ("rollout_share=0.5", "phases=2", "trajectory_rows=4")
    task, _ = tiny_run.train("rdm-student", tmp_path / "run", *settings, steps=4)
    first, second = task.own.rows.tolist()
    assert [point_B[[first, second]].tolist() for point_B, _ in met] == [[9, 4], [4, 9]] * 2
    for step, (goes_on, begins) in zip((1, 2, 3), ((first, second), (second, first)) * 2, strict=False):
        assert torch.equal(met[step][1][goes_on], landed[step - 1][goes_on])
        assert not torch.equal(met[step][1][begins], landed[step - 1][begins])


def test_turns_are_learned_by_teacher_and_student(tiny_run, tmp_path, monkeypatch):
    teacher, _ = tiny_run.train(
        "rdm-7",
        tmp_path / "teacher",
        "heading_change=0.5",
        "heading_noise=0.3",
        "batch=16",
        steps=4,
    )
    assert teacher.denoiser.config.heading_change
    assert bool(teacher.denoiser.course.weight.any())
    with pytest.raises(InputError, match="a teacher that was trained with heading_change"):
        tiny_run.train("rdm-student", tmp_path / "refused", "heading_change=0.5")

    sources = {"teacher": tmp_path / "teacher"}
    told, bind = [], bound_segments.guided
    monkeypatch.setattr(
        bound_segments,
        "guided",
        lambda network, condition, *more: told.append((network, condition.past)) or bind(network, condition, *more),
    )
    task, result = tiny_run.train(
        "rdm-student",
        tmp_path / "student",
        "heading_change=0.6",
        "heading_noise=0.3",
        "rollout_share=0.5",
        sources=sources,
        steps=4,
    )
    assert bool(task.student.course.weight.any())
    config = load_trained(result.checkpoint, "student_ema").module.config
    assert config.heading_change
    pasts = [past for network, past in told if network is task.student]
    known = ~torch.cat([past.heading_change for past in pasts]).isnan()
    assert 0.1 < float(known.float().mean()) < 0.9
    told.clear()
    untold, _ = tiny_run.train("rdm-student", tmp_path / "untold", "rollout_share=0.5", sources=sources, steps=2)
    assert told
    assert all(past.heading_change.isnan().all() for _, past in told)
    assert untold.own.state()["turned"].isnan().all()


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"mismatched_text": 2.0}, "mismatched_text = 2"),
        ({"rollout_share": 1.5}, "rollout_share"),
        ({"rollout_share": -0.1}, "rollout_share"),
    ],
)
def test_what_a_student_of_streams_cannot_learn_is_refused(config, message):
    with pytest.raises(InputError, match=message):
        RDMStudentConfig(**config)


@pytest.mark.parametrize("teacher", ["light-rdm-1", "motiondiffuse", "dip"])
def test_only_a_segment_transformer_teaches_streams(teacher, tiny_run, tmp_path):
    with pytest.raises(InputError, match="only a segment_transformer teaches streams"):
        tiny_run.train("rdm-student", tmp_path / "run", sources={"teacher": tiny_run.runs / teacher})


@pytest.mark.parametrize(("rows", "said"), [(-1, "-1 is below 0"), (5, "5 is outside 0 to 4")])
def test_no_more_rows_follow_a_trajectory_than_a_batch_has(rows, said, tiny_run, tmp_path):
    with pytest.raises(InputError, match=f"trajectory_rows = {said}"):
        tiny_run.train("rdm-student", tmp_path / "run", f"trajectory_rows={rows}")


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["context_noise_rollout=true"], "set rollout_share too"),
        (["overlapping=true"], "in one the segment before is finished; set phases=2 or 4"),
        (["overlapping=true", "phases=2", "rollout_share=0.5", "context_noise_rollout=true"], "leave context_noise"),
    ],
)
def test_noisy_pasts_that_nobody_would_be_told_are_refused(settings, said, tiny_run, tmp_path):
    with pytest.raises(InputError, match=said):
        tiny_run.train("rdm-student", tmp_path / "run", *settings)
