"""Recurrent models and what they are compared with, trained for a few steps on motions from formulas."""

import json
import subprocess
import sys
import typing
from dataclasses import replace

import pytest
import torch

from moveset.cli import train as command
from moveset.data.humanml3d import KIT
from moveset.data.paraphrase import paraphrase
from moveset.diffusion.schedule import cosine, linear
from moveset.errors import InputError
from moveset.models.registry import build_model, parse_config
from moveset.rdm.grid import GridConfig
from moveset.recipes import paper, small, tiny
from moveset.training import checkpoint
from moveset.training.rdm import RDMConfig, RDMTask, feature_weights
from moveset.training.tasks import TASKS, with_settings
from moveset.training.trained import load_trained
from tests.training.hml_folder import write_folder
from tests.training.recurrent import trained

VARIANTS = (
    "rdm-1", "rdm-4", "rdm-7", "rdm-14", "light-rdm-1", "md-4", "md-7", "motiondiffuse", "dip", "rdm-student",
)  # fmt: skip
LITERAL = (
    "grid.anchor=first", "grid.share_noise=true", "grid.condition=previous", "depth_cap=6", "model.max_index=6",
    "flow.max_index=6", "flow.bound=hardtanh",
)  # fmt: skip


def test_every_variant_has_a_recipe_and_a_place_on_the_command_line():
    assert set(typing.get_args(command.What)) == {*TASKS, "export"}
    assert set(VARIANTS) <= set(TASKS)
    for recipes in (paper, small, tiny):
        assert set(VARIANTS) - {"rdm-student"} <= set(recipes.TRAINING) <= set(TASKS)
        for what in recipes.TRAINING:
            recipes.TRAINING[what]()


@pytest.mark.parametrize("recipes", [paper, small, tiny])
def test_a_recipe_is_what_its_name_says(recipes):
    for count, frames in ((1, 196), (4, 49), (7, 28), (14, 14)):
        task = recipes.TRAINING[f"rdm-{count}"]().task
        assert task.grid.frames == frames
        assert task.predict == "x0"
        assert replace(task.grid, clean_share=0.0) == GridConfig(frames=frames)
        assert (task.flow is None) == (count == 1)
    for count in (4, 7):
        told, alone = recipes.TRAINING[f"rdm-{count}"]().task, recipes.TRAINING[f"md-{count}"]().task
        grid = replace(told.grid, condition="clean", clean_share=0.0)
        assert alone == replace(told, flow=None, grid=grid)
    volumes = [recipes.TRAINING[what]().task for what in ("rdm-1", "light-rdm-1", "motiondiffuse")]
    assert all(task.grid.frames == 196 and task.flow is None and task.cutting.aligned for task in volumes)
    assert [task.predict for task in volumes] == ["x0", "x0", "eps"]
    assert [task.kind for task in volumes][1] == "light_t2m"


def test_the_published_settings():
    recipe = paper.TRAINING["rdm-7"]()
    task = recipe.task
    assert (task.optimizer, task.lr, task.flow_lr, task.constant_lr) == ("momo", 2e-4, 1e-4, True)
    assert (task.batch, task.ema, task.condition_dropout) == (512, 0.9999, 0)
    assert (task.weight, task.root, task.velocity) == ("x0", 1, 0)
    assert task.grid.clean_share == 0
    assert (task.cutting.aligned, task.cutting.whole_caption) == (True, 1.0)
    assert (task.flow.blocks, task.flow.hidden, task.flow.log_scale, task.noise) == (6, 256, 0.1, "white")
    assert recipe.engine.grad_clip == 0.5
    # The paper's reading, setting by setting.
    literal = with_settings(task, LITERAL)
    assert literal.grid == GridConfig(frames=28, anchor="first", share_noise=True, condition="previous")
    assert (literal.depth_cap, literal.model.max_index, literal.flow.max_index) == (6, 6, 6)
    diffuse = paper.TRAINING["motiondiffuse"]().task
    assert (diffuse.condition_dropout, diffuse.optimizer, diffuse.batch) == (0.0, "adamw", 128)
    with torch.device("meta"):
        count = sum(parameter.numel() for parameter in diffuse.model.build().parameters())
    assert count == 87_152_135  # 81.2 M and 5.9 M of text
    dip = paper.TRAINING["dip"]().task
    assert (dip.model.prefix, dip.model.frames, dip.levels, dip.condition_dropout, dip.ema) == (20, 40, 10, 0.1, 0.9999)


@pytest.mark.parametrize("what", ["teacher", "lcm-1", "pcm-1"])
def test_the_published_sentence_encoder_fits_the_published_networks(what):
    """Sentence-T5's one projected token of 768 numbers; T5's own states are 1024 wide."""
    assert paper.TRAINING[what]().task.text_encoder == "sentence-t5:sentence-transformers/sentence-t5-large"
    assert paper.TRAINING["teacher"]().task.model.text_dim == 768


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


def test_a_few_steps_change_every_network(rdm7):
    task, result = rdm7
    assert result.step == 4
    assert set(result.validation) == {"error", "noisy_std"}
    assert set(task.modules()) == {"denoiser", "flow"}
    torch.manual_seed(0)
    for name, module in task.modules().items():
        fresh = module.config.build()
        assert any(not torch.equal(a, b) for a, b in zip(module.parameters(), fresh.parameters(), strict=True)), name
        assert all(torch.isfinite(parameter).all() for parameter in module.parameters())
    assert task.flow.blocks[0].out.weight.abs().sum() > 0  # no longer the identity
    stored = json.loads((result.checkpoint / "config.json").read_text())
    assert stored["task"] == "rdm"  # what checkpoints of every variant carry
    assert (stored["config"]["model"]["features"], stored["config"]["model"]["frames"]) == (269, 28)
    assert (stored["config"]["model"]["text_dim"], stored["config"]["flow"]["text_dim"]) == (8, 8)
    loaded = load_trained(result.checkpoint, "denoiser_ema").module
    assert all(torch.equal(a, b) for a, b in zip(loaded.parameters(), task.ema.module.parameters(), strict=True))
    flow = load_trained(result.checkpoint, "flow_ema", part="coupling_flow").module
    assert all(torch.equal(a, b) for a, b in zip(flow.parameters(), task.flow_ema.module.parameters(), strict=True))


@pytest.mark.parametrize("what", ["md-7", "rdm-1", "light-rdm-1", "motiondiffuse", "dip", "rdm-student"])
def test_every_kind_of_training_learns_and_can_be_loaded(what, folder, rdm7, tmp_path):
    task, result = trained(folder, what, tmp_path / what)
    log = [json.loads(line) for line in (tmp_path / what / "metrics.jsonl").read_text().splitlines()]
    losses = [line["loss"] for line in log if "loss" in line]
    assert len(losses) == 3
    assert all(0 < loss < 100 for loss in losses)
    name = "student" if what == "rdm-student" else "denoiser"
    assert set(task.modules()) == {"student", "discriminator"} if what == "rdm-student" else {"denoiser"}
    loaded = load_trained(result.checkpoint, f"{name}_ema")
    assert loaded.module.config == task.config.model
    trained_now = task.modules()[name].state_dict()
    assert any(not torch.equal(value, trained_now[key]) for key, value in loaded.module.state_dict().items())
    assert build_model(loaded.kind, loaded.config).config == parse_config(loaded.kind, loaded.config)


def test_a_course_is_learned_from_a_bent_past(folder, tmp_path):
    task, _ = trained(folder, "md-7", tmp_path / "run", "heading=2.0", "past_perturbation=0.2", validate_every=3)
    log = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    assert all(line["heading"] > 0 for line in log)
    spy, batch, loss, _ = loss_of(task, lambda x, t: x)
    yaw, later = task.data.codec.groups["root_yaw"], batch.index > 0
    told, real = spy.condition.past.frames[later].clone(), batch.previous[later].clone()
    assert len(told) > 5
    assert (told[..., yaw] != real[..., yaw]).all()
    told[..., yaw] = real[..., yaw] = 0.0
    torch.testing.assert_close(told, real)
    plain, _ = trained(folder, "md-7", tmp_path / "plain", "past_perturbation=0.2")
    assert loss > loss_of(plain, lambda x, t: x)[2]


def test_settings_of_the_printed_algorithm_train(folder, tmp_path):
    task, _ = trained(folder, "rdm-7", tmp_path / "run", *LITERAL, "cutting.aligned=true")
    assert task.transport.depth_cap == 6
    assert task.denoiser.index.weight.shape[0] == 7


def test_twenty_steps_are_ten_a_stop_and_ten(folder, tmp_path):
    """To the last bit, for both networks, their averages and optimisers, by AdamW and by MoMo-Adam."""
    for optimizer in ("adamw", "momo"):
        settings = (f"optimizer={optimizer}", "frozen_flow=0.2", "batch=3")
        straight, halves = tmp_path / f"straight-{optimizer}", tmp_path / f"halves-{optimizer}"
        trained(folder, "rdm-7", straight, *settings, steps=20, save_every=10)
        halves.mkdir()
        subprocess.run(["cp", "-r", str(straight / "step_10"), str(halves)], check=True)
        trained(folder, "rdm-7", halves, *settings, steps=20, save_every=10, resume=True)
        names = {file.name for file in (straight / "step_20").iterdir()}
        assert {"denoiser.safetensors", "flow_ema.safetensors", "optimizer_flow.safetensors"} <= names
        for name in sorted(names):
            assert (straight / "step_20" / name).read_bytes() == (halves / "step_20" / name).read_bytes(), name
        before, after = (checkpoint.read_tensors(straight / f"step_{n}", "flow") for n in (10, 20))
        assert any(not torch.equal(before[key], after[key]) for key in before)


def test_reworded_captions_resume_too_and_workers_change_nothing(folder, tmp_path):
    settings = ("augmentation.paraphrased=0.2", "augmentation.reworded=0.6", "batch=6")
    straight, halves = tmp_path / "straight", tmp_path / "halves"
    trained(folder, "rdm-7", straight, *settings, steps=6, save_every=3)
    halves.mkdir()
    subprocess.run(["cp", "-r", str(straight / "step_3"), str(halves)], check=True)
    task, _ = trained(folder, "rdm-7", halves, *settings, steps=6, save_every=3, resume=True, workers=2)
    for name in ("denoiser", "flow", "denoiser_ema"):
        file = f"step_6/{name}.safetensors"
        assert (straight / file).read_bytes() == (halves / file).read_bytes(), name
    written = set(task.data.train.all_captions())
    said = [caption for step in range(12) for caption in task.data.train.batch(8, 0, step).captions]
    assert any(caption not in written and paraphrase(caption) not in written for caption in said)


def test_shares_of_captions_may_not_exceed_all_of_them(folder, tmp_path):
    with pytest.raises(InputError, match="no more than 1 together"):
        trained(folder, "rdm-7", tmp_path / "run", "augmentation.paraphrased=0.5", "augmentation.reworded=0.6")


def test_the_flow_rests_at_the_end_and_ignores_the_denoiser(folder, tmp_path):
    settings = ("frozen_flow=0.5",)
    run_folder = tmp_path / "run"
    trained(folder, "rdm-7", run_folder, *settings, steps=4, save_every=2, keep_last=5)
    rested = [checkpoint.read_tensors(run_folder / f"step_{n}", "flow") for n in (2, 4)]
    assert all(torch.equal(rested[0][key], rested[1][key]) for key in rested[0])
    denoisers = [checkpoint.read_tensors(run_folder / f"step_{n}", "denoiser") for n in (2, 4)]
    assert any(not torch.equal(denoisers[0][key], denoisers[1][key]) for key in denoisers[0])


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


def test_who_says_the_noise_is_judged_by_the_noise(folder, tmp_path):
    task, _ = trained(folder, "motiondiffuse", tmp_path / "run", steps=1)
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


def test_what_an_autoregressive_baseline_is_told(folder, tmp_path):
    told, _ = trained(folder, "md-7", tmp_path / "told", steps=1)
    alone, _ = trained(folder, "md-7", tmp_path / "alone", "md_condition=none", steps=1)
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


def test_networks_of_every_kind_can_be_told_nothing(folder, tmp_path):
    nothing = ("grid.condition=clean", "md_condition=none")
    listens = ("model.max_index=1", "model.prev=xattn", "model.boundary=2")
    denoiser, _ = trained(folder, "motiondiffuse", tmp_path / "denoiser", *nothing, *listens, steps=1)
    config = denoiser.denoiser.config
    assert (config.prev, config.boundary, config.max_index) == ("none", 0, 0)
    trained(folder, "light-rdm-1", tmp_path / "light", *nothing, steps=1)  # it has nobody to listen to


def test_saying_the_clean_segment_costs_nothing(rdm7):
    task, _ = rdm7
    batch = task.data.train.batch(32, 0, 0)
    spy, _, loss, _ = loss_of(task, lambda x, t: batch.clean)
    assert loss == 0
    assert torch.equal(spy.condition.valid, batch.valid)
    assert bool((spy.condition.past.level < spy.t).all())  # t' < t
    # Words are dropped for guidance by the training step alone, never here.
    assert spy.condition.text.mask.any(dim=1).all()


def test_settings_that_contradict_each_other_are_refused(folder, tmp_path):
    for settings, words in (
        (("predict=eps",), "without a flow"),
        (("md_condition=none",), "without a flow"),
        (("max_tokens=77",), "disturbed captions"),
    ):
        with pytest.raises(InputError, match=words):
            trained(folder, "rdm-7", tmp_path / "run", *settings)
    with pytest.raises(InputError, match="segment transformer"):
        trained(folder, "rdm-1", tmp_path / "run", "noise=coloured")
    for field, value in (("optimizer", "sgd"), ("weight", "w"), ("predict", "v"), ("md_condition", "noisy")):
        with pytest.raises(InputError, match=f"{field} '{value}' is not one of"):
            RDMConfig(**{field: value})


@pytest.mark.parametrize("what", ["rdm-7", "motiondiffuse"])
def test_kit_folders_train_with_their_own_number_of_features(what, folder, tmp_path):
    data = write_folder(tmp_path / "kit", KIT)
    settings = ("cutting.aligned=true",)
    task, result = trained(folder, what, tmp_path / "run", *settings, corpus=data, steps=2)
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


def test_dip_says_clean_frames_on_its_own_schedule(folder, tmp_path):
    task, _ = trained(folder, "dip", tmp_path / "run", steps=1)
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


def test_the_command_line_lists_them():
    done = subprocess.run([sys.executable, "-m", "moveset.cli", "train", "--help"], capture_output=True, text=True)
    assert done.returncode == 0
    assert all(what in done.stdout for what in VARIANTS)
