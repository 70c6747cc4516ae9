"""What a training that goes on, or starts from another's weights, has of its own."""

import json

import pytest
import torch

from moveset.data.dataset import open_for_training
from moveset.training import checkpoint
from moveset.training.engine import EngineConfig, run
from moveset.training.trained import load_trained
from tests.synthetic import synthetic_corpus
from tests.training.tiny_task import TinyConfig, TinyTask, train

ENGINE = EngineConfig(steps=10, save_every=5, validate_every=0, tensorboard=False, device="cpu")


def test_settings_of_an_optimiser_that_are_changed_are_used(tmp_path):
    train(tmp_path, steps=5)
    made = []

    def slower(loop):
        made.append(TinyTask(TinyConfig(), loop))
        made[0]._optimizers["discriminator"].param_groups[0].update(lr=0.0, betas=(0.5, 0.9))
        return made[0]

    with pytest.warns(UserWarning, match="steps 5 -> 10"):
        assert run(slower, ENGINE, tmp_path, True).step == 10
    (group,) = made[0].optimizers()["discriminator"].param_groups
    assert (group["lr"], group["betas"]) == (0.0, (0.5, 0.9))
    stored = json.loads((tmp_path / "step_10" / "state.json").read_text())["optimizers"]["discriminator"]
    assert stored["param_groups"][0]["betas"] == [0.5, 0.9]
    before, after = (checkpoint.read_tensors(tmp_path / f"step_{step}", "discriminator") for step in (5, 10))
    assert all(torch.equal(before[name], value) for name, value in after.items())


def test_what_a_task_is_given_is_not_taken_from_where_it_starts(tmp_path):
    train(tmp_path / "old", steps=5)
    made = []

    class Shifted(TinyTask):
        """The bias of its last layer is given."""

        def take_given(self):
            self.generator[-1].bias.data.fill_(7.0)

    def make(loop):
        made.append(Shifted(TinyConfig(lr=1e-30), loop))
        return made[0]

    old = checkpoint.read_tensors(tmp_path / "old" / "step_5", "generator")
    run(make, EngineConfig(steps=1, validate_every=0, tensorboard=False, device="cpu"), tmp_path / "new",
        init=tmp_path / "old")  # fmt: skip
    new = made[0].generator.state_dict()
    assert torch.equal(new["3.bias"], torch.full((3,), 7.0))
    torch.testing.assert_close(new["3.weight"], old["3.weight"])


def test_what_a_training_learns_from_is_kept_and_compared(tiny_run, tmp_path):
    tiny_run.train("rdm-student", tmp_path / "run", steps=1)
    kept = load_trained(tmp_path / "run", "student_ema").learned_from
    teacher = load_trained(tiny_run.runs / "rdm-7", "denoiser_ema").digest
    flow = load_trained(tiny_run.runs / "rdm-7", "flow_ema", part="coupling_flow").digest
    assert kept == {"corpus": open_for_training(tiny_run.corpus).fingerprint, "teacher": teacher, "flow": flow}
    other = synthetic_corpus(tmp_path / "corpus.safetensors", clips=24, seed=1)
    changed = pytest.warns(UserWarning, match="other settings: steps 1 -> 2$")
    with changed, pytest.warns(UserWarning, match="with another corpus$"):
        tiny_run.train("rdm-student", tmp_path / "run", corpus=other, steps=2, resume=True)
