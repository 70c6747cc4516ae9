"""The length predictor learns how long sentences last, and resumes exactly."""

import torch

from moveset.training.trained import load_trained
from tests.training.recurrent import trained


def test_lengths_are_learned(folder, tmp_path):
    before = trained(folder, "length", tmp_path / "none", steps=1, validate_every=1)[1].validation
    after = trained(folder, "length", tmp_path / "some", "lr=0.01", steps=60, validate_every=60)[1].validation
    assert after["median_error"] < before["median_error"]
    assert after["constant_error"] == before["constant_error"]


def test_a_resumed_training_equals_one_that_never_stopped(folder, tmp_path):
    trained(folder, "length", tmp_path / "whole", steps=4)
    trained(folder, "length", tmp_path / "parts", steps=4, save_every=2, keep_last=2)
    (tmp_path / "parts" / "step_4").rename(tmp_path / "aside")
    trained(folder, "length", tmp_path / "parts", steps=4, resume=True)
    one, other = (load_trained(tmp_path / name, "length").module.state_dict() for name in ("whole", "parts"))
    assert all(torch.equal(one[key], other[key]) for key in one)
