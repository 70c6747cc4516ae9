"""Recurrent models and what they are compared with, trained for a few steps on motions from formulas."""

import json
import shutil
import typing
from dataclasses import replace

import pytest
import torch

from moveset.cli import train as command
from moveset.data.humanml3d import KIT
from moveset.diffusion.schedule import cosine, linear
from moveset.errors import InputError
from moveset.models.registry import build_model, parse_config
from moveset.training import checkpoint, rdm
from moveset.training.rdm import RDMTask, feature_weights
from moveset.training.tasks import RECIPES, TASKS, load_recipes
from moveset.training.trained import load_trained
from tests.training.hml_folder import write_folder

LITERAL = (
    "grid.anchor=first", "grid.share_noise=true", "grid.condition=previous", "depth_cap=6", "model.max_index=6",
    "flow.max_index=6", "flow.bound=hardtanh", "jacobian=1",
)  # fmt: skip


def test_every_recipe_names_what_can_be_trained():
    assert set(typing.get_args(command.What)) == {*TASKS, "all", "export"}
    for name in RECIPES:
        assert set(load_recipes(name)) <= set(TASKS)


@pytest.mark.parametrize("what", ["rdm-7", "md-7", "rdm-1", "light-rdm-1", "motiondiffuse", "dip", "rdm-student"])
def test_every_kind_of_training_moves_its_networks_and_can_be_loaded(what, tiny_run):
    folder = tiny_run.runs / what
    log = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    losses = [line["loss"] for line in log if "loss" in line and line["split"] == "train"]
    assert len(losses) == 4
    assert all(0 < loss < 100 for loss in losses)
    last = checkpoint.resolve(folder)
    for name in {"rdm-7": ("denoiser", "flow"), "rdm-student": ("student", "discriminator")}.get(what, ("denoiser",)):
        before, after = (checkpoint.read_tensors(at, name) for at in (folder / "step_2", last))
        assert any(not torch.equal(value, after[key]) for key, value in before.items()), name
    name = "student" if what == "rdm-student" else "denoiser"
    averaged, now = load_trained(last, f"{name}_ema"), checkpoint.read_tensors(last, name)
    assert any(not torch.equal(value, now[key]) for key, value in averaged.module.state_dict().items())
    assert build_model(averaged.kind, averaged.config).config == parse_config(averaged.kind, averaged.config)
    stored = json.loads((last / "config.json").read_text())["config"]["model"]
    assert stored == {**stored, "features": 269, "text_dim": 384}


def test_a_flow_that_has_nothing_to_learn_here_may_have_elsewhere(rdm7):
    """Processes that average their gradients must all take the step, or wait for each other for ever."""
    task, _ = rdm7
    batch = task.data.training_batch(4, 0)
    batch = replace(batch, index=torch.zeros_like(batch.index))

    class Loop:
        device, asked = torch.device("cpu"), []

        def __init__(self, world_size):
            self.world_size = world_size

        def minimise(self, loss, optimizer):
            self.asked.append((float(loss.detach()), optimizer, loss.requires_grad))

    assert task._train_flow(batch, Loop(1)) == {}
    assert Loop.asked == []
    assert task._train_flow(batch, Loop(2)) == {}
    assert Loop.asked == [(0.0, "flow", True)]


def test_a_course_is_learned_from_a_bent_past(tiny_run, tmp_path):
    task, _ = tiny_run.train(
        "md-7", tmp_path / "run", "heading=2.0", "past_perturbation=0.2", steps=1, validate_every=1
    )
    log = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    assert all(line["heading"] > 0 for line in log)
    spy, batch, loss, _ = loss_of(task, lambda x, t: x)
    yaw, later = task.data.codec.groups["root_yaw"], batch.index > 0
    told, real = spy.condition.past.frames[later].clone(), batch.previous[later].clone()
    assert len(told) > 5
    assert (told[..., yaw] != real[..., yaw]).all()
    told[..., yaw] = real[..., yaw] = 0.0
    torch.testing.assert_close(told, real)
    plain, _ = tiny_run.train("md-7", tmp_path / "plain", "past_perturbation=0.2", steps=1)
    assert loss > loss_of(plain, lambda x, t: x)[2]


def test_sides_are_told_beside_sentences_and_asked_for(tiny_run, tmp_path, monkeypatch):
    asked, weights, short, loss = [], [], rdm.side_shortfall, RDMTask._loss
    monkeypatch.setattr(rdm, "side_shortfall", lambda *given: asked.append(given[3]) or short(*given))
    monkeypatch.setattr(RDMTask, "_loss", lambda *given: weights.extend(x[1] for x in given[7:] if x) or loss(*given))
    task, _ = tiny_run.train("rdm-7", tmp_path / "run", "sides=0.7", "side_weight=1", "batch=16", steps=3)
    log = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    assert all(("sides" in line) == (line["split"] == "train") for line in log)
    shown = task.data.train.batch(16, task.data.seed, 1)
    told = ~asked[0].isnan()
    assert told.any()
    assert not told.all()
    assert torch.equal(asked[0][told], shown.sides[told])
    assert weights == pytest.approx([0.75, 0.25, 0.0])
    tiny_run.train("rdm-7", tmp_path / "silent", "sides=0", "side_weight=1", "batch=16", steps=1)
    assert len(asked) == 3


@pytest.mark.parametrize(
    "settings",
    [
        ("optimizer=adamw", "batch=3"),
        ("optimizer=momo", "batch=3"),
        ("augmentation.token_dropout=0.2", "augmentation.embedding_noise=0.3"),
    ],
)
def test_four_steps_are_two_a_stop_and_two(settings, tiny_run, tmp_path):
    """To the last bit, for both networks, their averages and optimisers; workers change nothing, and the flow rests
    in the second half."""
    settings, straight, halves = (*settings, "frozen_flow=0.5"), tmp_path / "straight", tmp_path / "halves"
    tiny_run.train("rdm-7", straight, *settings, steps=4, save_every=1, keep_last=4)
    shutil.copytree(straight / "step_2", halves / "step_2")
    workers = 2 * settings[0].startswith("augmentation")
    tiny_run.train("rdm-7", halves, *settings, steps=4, save_every=1, resume=True, workers=workers)
    names = {file.name for file in (straight / "step_4").iterdir()}
    assert {"denoiser.safetensors", "flow_ema.safetensors", "optimizer_flow.safetensors"} <= names
    for name in sorted(name for name in names if name.endswith(".safetensors")):
        assert (straight / "step_4" / name).read_bytes() == (halves / "step_4" / name).read_bytes(), name

    def moved(name, step):
        before, after = (checkpoint.read_tensors(straight / f"step_{n}", name) for n in (step - 1, step))
        return any(not torch.equal(before[key], after[key]) for key in before)

    assert [moved("flow", step) for step in (2, 3)] == [True, False]
    assert moved("denoiser", 3)


def test_the_denoisers_error_reaches_the_flow_only_where_they_learn_jointly(tiny_run, tmp_path):
    """Then by the same loss: the denoiser's first step is the same, and only while the flow learns at all."""
    entangled = ("grid.entangled=0.5", "depth_cap=6", "flow.max_index=6", "jacobian=1e-4", "frozen_flow=0")
    apart, _ = tiny_run.train("rdm-7", tmp_path / "apart", *entangled, steps=1, save_every=1)
    tiny_run.train("rdm-7", tmp_path / "both", *entangled, "joint=true", steps=1, save_every=1)
    read = checkpoint.read_tensors
    alone, together = ({n: read(tmp_path / x / "step_1", n) for n in ("denoiser", "flow")} for x in ("apart", "both"))
    assert all(torch.equal(alone["denoiser"][key], value) for key, value in together["denoiser"].items())
    assert any(not torch.equal(alone["flow"][key], value) for key, value in together["flow"].items())
    batch = apart.data.train.batch(4, 0, 0)
    text = apart.data.read(batch.captions)
    batch = replace(batch, index=torch.ones_like(batch.index))
    for joint in (False, True):
        loss, _ = apart._loss(apart.denoiser, apart.transport, batch, text, torch.Generator().manual_seed(0), joint)
        found = torch.autograd.grad(loss, list(apart.flow.blocks.parameters()), allow_unused=True)
        assert any(gradient is not None and bool(gradient.any()) for gradient in found) == joint
    frozen = ("joint=true", "frozen_flow=1.0")
    tiny_run.train("rdm-7", tmp_path / "frozen", *frozen, steps=1, save_every=1)
    assert not read(tmp_path / "frozen/step_1", "flow")["blocks.0.out.weight"].any()


def test_variants_train(tiny_run, tmp_path):
    task, _ = tiny_run.train("rdm-7", tmp_path / "identity", "flow.blocks=6", "flow=null", steps=1)
    assert task.flow is None
    assert task.transport.flow is None
    task, _ = tiny_run.train("rdm-7", tmp_path / "literal", *LITERAL, "cutting.aligned=true", steps=1)
    assert task.transport.depth_cap == 6
    assert task.denoiser.index.weight.shape[0] == 7
    nothing = ("grid.condition=clean", "md_condition=none")
    listens = ("model.max_index=1", "model.prev=xattn", "model.boundary=2")
    task, _ = tiny_run.train("motiondiffuse", tmp_path / "denoiser", *nothing, *listens, steps=1)
    config = task.denoiser.config
    assert (config.prev, config.boundary, config.max_index) == ("none", 0, 0)
    tiny_run.train("light-rdm-1", tmp_path / "light", *nothing, steps=1)  # it has nobody to listen to


@pytest.mark.parametrize(
    ("what", "settings", "message"),
    [
        ("rdm-7", ["predict=eps"], "without a flow"),
        ("motiondiffuse", ["sides=0.5", "side_weight=1"], "velocity, feet, heading and side_weight 0"),
        ("rdm-7", ["md_condition=none"], "without a flow"),
        ("rdm-1", ["jacobian=1"], "jacobian 1 is of the flow"),
        ("rdm-7", ["joint=true", "flow=null"], "joint 1 is of the flow"),
        ("rdm-7", ["grid.entangled=1", "grid.anchor=first"], 'grid.entangled 1 is for grid.anchor="segment"'),
        ("rdm-1", ["noise=coloured"], "segment transformer"),
        ("rdm-1", ["forecast=true"], "forecast=True is for the segment transformer"),
        ("light-rdm-1", ["heading_change=0.5"], "heading_change=0.5 is for the segment transformer"),
        ("rdm-7", ["heading_noise=0.3"], "heading_noise is for segments that are told their heading_change"),
        ("rdm-student", ["heading_noise=0.3"], "heading_noise is for segments that are told their heading_change"),
        ("rdm-7", ["optimizer=sgd"], "optimizer 'sgd' is not one of"),
        ("rdm-7", ["weight=w"], "weight 'w' is not one of"),
        ("rdm-7", ["predict=v"], "predict 'v' is not one of"),
        ("rdm-7", ["md_condition=noisy"], "md_condition 'noisy' is not one of"),
    ],
)
def test_settings_that_contradict_each_other_are_refused(what, settings, message, tiny_run, tmp_path):
    with pytest.raises(InputError, match=message):
        tiny_run.train(what, tmp_path / "run", *settings)


class Spy(torch.nn.Module):
    """A denoiser that remembers what it was asked and says what it is told to."""

    def __init__(self, says):
        super().__init__()
        self.says = says

    def forward(self, x, t, condition):
        self.x, self.t, self.condition = x, t, condition
        return self.says(x, t)


def loss_of(task, says, seed=0):
    spy, batch = Spy(says), task.data.train.batch(32, 0, 0)
    text = task.data.read(batch.captions)
    loss, parts = task._loss(spy, task.transport, batch, text, torch.Generator().manual_seed(seed))
    return spy, batch, float(loss), parts


def test_who_says_the_noise_is_judged_by_the_noise(tiny_run, tmp_path):
    task, _ = tiny_run.train("motiondiffuse", tmp_path / "run", steps=1)
    schedule, clean = linear(), task.data.train.batch(32, 0, 0).clean

    def noise(x, t):
        alpha, sigma = (f(t)[:, None, None] for f in (schedule.alpha, schedule.sigma))
        return (x - alpha * clean) / sigma

    spy, _, loss, parts = loss_of(task, noise)
    assert loss == pytest.approx(0, abs=1e-4)
    assert float(parts["error"]) == pytest.approx(0, abs=1e-4)
    assert not spy.condition.past.index.any()  # one segment, the whole clip
    _, _, silent, _ = loss_of(task, lambda x, t: torch.zeros_like(x))
    assert silent == pytest.approx(1, rel=0.1)


def test_what_an_autoregressive_baseline_is_told(tiny_run, tmp_path):
    told, _ = tiny_run.train("md-7", tmp_path / "told", steps=1)
    alone, _ = tiny_run.train("md-7", tmp_path / "alone", "md_condition=none", steps=1)
    for task, later in ((told, True), (alone, False)):
        spy, batch, _, _ = loss_of(task, lambda x, t: x)
        assert batch.index.any()
        past = spy.condition.past
        assert not past.level.any()
        torch.testing.assert_close(past.frames, batch.previous)
        assert bool(past.index.any()) == later
        assert task.denoiser.config.alone != later  # and so it is in use
        if later:
            assert torch.equal(past.index, batch.index)


def test_saying_the_clean_segment_costs_nothing(rdm7):
    task, _ = rdm7
    batch = task.data.train.batch(32, 0, 0)
    spy, _, loss, _ = loss_of(task, lambda x, t: batch.clean)
    assert loss == 0
    assert torch.equal(spy.condition.valid, batch.valid)
    assert bool((spy.condition.past.level < spy.t).all())  # t' < t
    # Words are dropped for guidance by the training step alone, never here.
    assert spy.condition.text.mask.any(dim=1).all()


@pytest.mark.parametrize("what", ["rdm-7", "motiondiffuse"])
def test_kit_folders_train_with_their_own_number_of_features(what, tiny_run, tmp_path):
    data = write_folder(tmp_path / "kit", KIT)
    settings = ("cutting.aligned=true",)
    task, result = tiny_run.train(what, tmp_path / "run", *settings, corpus=data, steps=1)
    assert isinstance(task, RDMTask)
    made = task.data.train.batch(4, 0, 0)
    assert made.clean.shape == (4, task.config.grid.frames, 251)
    stored = json.loads((result.checkpoint / "config.json").read_text())["config"]
    assert stored["model"]["features"] == 251
    assert what != "rdm-7" or stored["flow"]["features"] == 251


def test_the_root_counts_as_configured(rdm7):
    codec = rdm7[0].data.codec
    weights = feature_weights(codec, 5.0)
    assert float(weights.mean()) == pytest.approx(1)
    root = torch.zeros(codec.dim, dtype=torch.bool)
    for name in ("root_yaw", "root_velocity", "root_height"):
        root[codec.groups[name]] = True
    assert int(root.sum()) == 4
    torch.testing.assert_close(weights[root], 5 * weights[~root][:1].expand(4))


def test_dip_says_clean_frames_on_its_own_schedule(tiny_run, tmp_path):
    task, _ = tiny_run.train("dip", tmp_path / "run", steps=1)
    assert len(task.schedule) == 11
    assert torch.equal(task.schedule.alpha_bar, cosine(10).alpha_bar)
    batch = task.data.train.batch(64, 0, 0)
    text = task.data.read(batch.captions)
    spy = Spy(lambda x, t: batch.clean)
    loss, error = task._loss(spy, batch, text, torch.Generator().manual_seed(0))
    assert float(loss) == float(error) == 0
    noisy, t, prefix = spy.x, spy.t, spy.condition.past.frames
    assert sorted(t.unique().tolist()) == list(range(1, 11))
    assert torch.equal(prefix, batch.prefix)
    noise = (noisy - task.schedule.alpha(t)[:, None, None] * batch.clean) / task.schedule.sigma(t)[:, None, None]
    assert abs(float(noise.std()) - 1) < 0.05


def test_noise_is_what_is_asked_for_whatever_a_training_goes_on_from(tiny_run, tmp_path):
    def flat(network):
        return bool((network.spectrum == 1).all())

    white = tiny_run.runs / "rdm-7"
    coloured, _ = tiny_run.train("rdm-7", tmp_path / "coloured", "noise=coloured", steps=1, init=white)
    again, _ = tiny_run.train("rdm-7", tmp_path / "white", steps=1, init=tmp_path / "coloured")
    assert [flat(task.denoiser) for task in (coloured, again)] == [False, True]
    assert [flat(task.ema.module) for task in (coloured, again)] == [False, True]
    student, _ = tiny_run.train(
        "rdm-student", tmp_path / "student", steps=1, init=tiny_run.runs / "rdm-student",
        sources={"teacher": tmp_path / "coloured"},
    )  # fmt: skip
    assert not flat(student.student)
    assert torch.equal(student.student.spectrum, student.teacher.spectrum)
