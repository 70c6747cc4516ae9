import json
import math
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch
from torch import nn

from moveset.errors import InputError, MovesetError
from moveset.io.process import locked
from moveset.training import checkpoint, resume
from moveset.training.engine import EngineConfig, Task, run, stream_seed
from tests.training.tiny_task import TinyConfig, TinyTask, train


def contents(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def metrics(folder: Path, split: str = "train") -> list[dict]:
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    timings = ("time", "steps_per_second")
    return [{k: v for k, v in line.items() if k not in timings} for line in lines if line["split"] == split]


@pytest.fixture(scope="module")
def straight(tmp_path_factory):
    folder = tmp_path_factory.mktemp("straight")
    train(folder)
    return folder


@pytest.mark.parametrize("half", [1, 10, 13])
def test_resuming_gives_the_bytes_of_an_uninterrupted_run(straight, tmp_path, half):
    stopped = train(tmp_path, stop_at=half)
    assert (stopped.step, stopped.stopped_by) == (half, "SIGTERM")
    assert stopped.checkpoint == tmp_path / f"step_{half}"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = train(tmp_path, resume=True)
    assert result.step == 20
    assert result.checkpoint == tmp_path / "step_20"
    got, want = contents(tmp_path / "step_20"), contents(straight / "step_20")
    assert got.keys() == want.keys()
    tensors = ("generator", "discriminator", "generator_ema", "optimizer_generator", "optimizer_discriminator", "rng")
    documents = ("config", "state", "manifest")
    assert got.keys() == {*(f"{name}.safetensors" for name in tensors), *(f"{name}.json" for name in documents)}
    for name, content in want.items():
        assert got[name] == content, name
    # The half runs validate and log once more, at their end; all lines after that are the same.
    later = [[line for line in metrics(folder) if line["step"] > half + 2] for folder in (straight, tmp_path)]
    assert later[0] == later[1] != []


def test_every_part_of_the_state_matters(straight, tmp_path):
    """The test above would pass vacuously if nothing random reached the parameters."""
    names = ["generator.safetensors", "rng.safetensors"]
    other = tmp_path / "seed"
    train(other, seed=1)
    for name in names:
        assert (other / "step_20" / name).read_bytes() != (straight / "step_20" / name).read_bytes()
    # Restoring the modules alone is not enough.
    train(tmp_path / "half", stop_at=10)
    made = {}

    def amnesiac(loop):
        made["task"] = TinyTask(TinyConfig(), loop)
        for name, module in made["task"].modules().items():
            checkpoint.load_module(module, tmp_path / "half" / "step_10", name)
        return made["task"]

    run(amnesiac, EngineConfig(steps=20, tensorboard=False, device="cpu"), tmp_path / "fresh")
    want = checkpoint.read_tensors(straight / "step_20", "generator")
    assert any((made["task"].generator.state_dict()[key] != value).any() for key, value in want.items())


def test_validation_leaves_no_trace_in_the_training(straight, tmp_path):
    train(tmp_path, validate_every=1)
    for name in ("rng.safetensors", "generator.safetensors"):
        assert (tmp_path / "step_20" / name).read_bytes() == (straight / "step_20" / name).read_bytes()
    assert [line["step"] for line in metrics(tmp_path, "val")] == list(range(1, 21))
    assert [line["step"] for line in metrics(straight, "val")] == [4, 8, 12, 16, 20]


def test_a_validation_that_fails_does_not_cost_the_steps_before_it(straight, tmp_path, monkeypatch):
    monkeypatch.setattr(TinyTask, "validate", lambda task, step, loop: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        train(tmp_path, validate_every=10)
    assert checkpoint.latest(tmp_path) == tmp_path / "step_10"
    monkeypatch.undo()
    train(tmp_path, validate_every=4, resume=True)
    for name in ("rng.safetensors", "generator.safetensors"):
        assert (tmp_path / "step_20" / name).read_bytes() == (straight / "step_20" / name).read_bytes()


def test_on_another_kind_of_device_noise_starts_anew(tmp_path, monkeypatch):
    kept = resume._rank_state

    def elsewhere(task, loop):
        """A generator of CUDA has a state of 16 bytes."""
        state = kept(task, loop)
        return state | {"generator/noise": torch.zeros(16, dtype=torch.uint8)}

    monkeypatch.setattr(resume, "_rank_state", elsewhere)
    train(tmp_path, stop_at=5)
    monkeypatch.undo()
    with pytest.warns(UserWarning, match="another kind of device: data order and noise start anew"):
        assert train(tmp_path, steps=20, resume=True).step == 20


def test_the_callers_generator_is_left_alone(tmp_path):
    torch.manual_seed(5)
    want = torch.rand(3)
    torch.manual_seed(5)
    train(tmp_path, steps=2)
    assert torch.equal(torch.rand(3), want)


def test_the_caller_cannot_influence_a_run(straight, tmp_path):
    torch.manual_seed(99)
    train(tmp_path)
    assert contents(tmp_path / "step_20") == contents(straight / "step_20")


def test_a_folder_with_a_training_is_not_overwritten(tmp_path):
    train(tmp_path, steps=5)
    before = contents(tmp_path / "step_5")
    with pytest.raises(InputError, match="step 5; continue it with --resume"):
        train(tmp_path)
    assert contents(tmp_path / "step_5") == before


def test_a_folder_that_cannot_be_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"cannot train in .*run: Not a directory; give another folder"):
        train(tmp_path / "file" / "run")


def test_resuming_nothing_starts_and_resuming_the_end_does_nothing(tmp_path):
    assert train(tmp_path, steps=5, resume=True).step == 5
    before = (tmp_path / "step_5" / "manifest.json").stat().st_mtime_ns
    result = train(tmp_path, steps=5, resume=True)
    assert (result.step, result.checkpoint) == (5, tmp_path / "step_5")
    assert (tmp_path / "step_5" / "manifest.json").stat().st_mtime_ns == before


@pytest.mark.parametrize("keep_last", [1, 2])
def test_a_damaged_checkpoint_is_passed_over_and_set_aside(straight, tmp_path, keep_last):
    train(tmp_path, stop_at=15)
    file = tmp_path / "step_15" / "generator.safetensors"
    file.write_bytes(file.read_bytes()[:-1] + b"\x7f")
    with pytest.warns(UserWarning, match="damaged checkpoint: .*generator.safetensors"):
        result = train(tmp_path, stop_at=12, resume=True, keep_last=keep_last)
    # Going by numbers alone would have kept the damaged step_15 and deleted what was just written.
    assert result.checkpoint == checkpoint.latest(tmp_path) == tmp_path / "step_12"
    train(tmp_path, resume=True)
    for name in ("generator.safetensors", "rng.safetensors"):
        assert (tmp_path / "step_20" / name).read_bytes() == (straight / "step_20" / name).read_bytes()
    assert (tmp_path / "damaged_step_15").is_dir()


def test_two_trainings_cannot_share_a_folder(tmp_path):
    with locked(tmp_path), pytest.raises(InputError, match="another training is running"):
        train(tmp_path)
    train(tmp_path, steps=1)


def test_changed_settings_are_named_when_resuming(tmp_path):
    train(tmp_path, steps=5)
    with pytest.warns(UserWarning, match=r"batch 4 -> 8; grad_clip 1.0 -> 2.0; steps 5 -> 6"):
        train(tmp_path, steps=6, resume=True, task=TinyConfig(batch=8), grad_clip=2.0)


def test_a_checkpoint_of_other_sizes_or_another_task_is_refused(tmp_path):
    train(tmp_path, steps=5)
    with pytest.warns(UserWarning, match="width"), pytest.raises(InputError, match="does not fit"):
        train(tmp_path, steps=6, resume=True, task=TinyConfig(width=8))

    class Other(TinyTask):
        name = "other"

    with pytest.raises(InputError, match=r"checkpoint of 'tiny', not of 'other'"):
        run(
            lambda loop: Other(TinyConfig(), loop),
            EngineConfig(steps=6, device="cpu", tensorboard=False),
            tmp_path,
            True,
        )


def test_kept_checkpoints(tmp_path):
    train(tmp_path, steps=20, save_every=2, keep_last=2, keep_every=6)
    assert checkpoint.steps(tmp_path) == [6, 12, 18, 20]
    assert not list(tmp_path.glob(".tmp-*"))


@dataclass(frozen=True)
class PlainConfig:
    lr: float = 1.0


class PlainTask(Task):
    """w <- w - lr * gradient; the loss is made by the test."""

    name = "plain"

    def __init__(self, loss, **modules: nn.Module) -> None:
        self.config, self.loss, self._modules = PlainConfig(), loss, modules
        self._optimizers = {name: torch.optim.SGD(module.parameters(), lr=1.0) for name, module in modules.items()}

    def modules(self):
        return self._modules

    def optimizers(self):
        return self._optimizers

    def training_step(self, step, loop):
        return self.loss(self, step, loop)


def run_plain(folder, loss, steps=1, modules=("a",), **settings):
    task = []

    def make(loop):
        task.append(PlainTask(loss, **{name: nn.Linear(3, 3) for name in modules}))
        return task[0]

    settings = {"device": "cpu", "precision": "32-true", "tensorboard": False, "validate_every": 0, **settings}
    run(make, EngineConfig(steps=steps, **settings), folder)
    return task[0]


def test_minimising_one_half_leaves_the_other_alone(tmp_path):
    before = {}

    def loss(task, step, loop):
        a, b = task.modules()["a"], task.modules()["b"]
        before["b"] = b.weight.clone()
        x = torch.ones(2, 3)
        assert loop.minimise(b(a(x)).square().sum(), "a") > 0
        assert all(parameter.grad is None for parameter in b.parameters())
        return {}

    task = run_plain(tmp_path, loss, modules=("a", "b"))
    assert torch.equal(task.modules()["b"].weight, before["b"])


def test_the_gradient_is_clipped_as_a_whole(tmp_path):
    seen = {}

    def loss(task, step, loop):
        module = task.modules()["a"]
        seen["before"] = nn.utils.parameters_to_vector(module.parameters()).detach()
        seen["norm"] = loop.minimise(module(torch.full((2, 3), 50.0)).square().sum(), "a")
        return {}

    task = run_plain(tmp_path, loss, grad_clip=0.25)
    moved = nn.utils.parameters_to_vector(task.modules()["a"].parameters()).detach() - seen["before"]
    assert seen["norm"] > 10
    assert moved.norm().item() == pytest.approx(0.25, rel=1e-4)


def test_a_failed_training_stops_and_saves_nothing_broken(tmp_path):
    def loss(task, step, loop):
        value = task.modules()["a"](torch.ones(1, 3)).sum() * (math.inf if step == 6 else 1.0)
        loop.minimise(value, "a")
        return {"loss": value}

    with pytest.raises(MovesetError, match=r"loss became (nan|-?inf) by step 8"):
        run_plain(tmp_path / "logged", loss, steps=9, log_every=4, save_every=5)
    assert checkpoint.steps(tmp_path / "logged") == [5]
    with pytest.raises(MovesetError, match=r"a\.weight is not finite after step 10, so it is not saved"):
        run_plain(tmp_path / "silent", lambda *a: loss(*a) and {}, steps=12, save_every=5)
    assert checkpoint.steps(tmp_path / "silent") == [5]
    assert not list((tmp_path / "silent").glob(".tmp-*"))


def computes_in(folder, precision):
    """The type of what a step's network makes, and of its weights afterwards."""
    seen = []

    def loss(task, step, loop):
        out = task.modules()["a"](torch.ones(2, 3))
        seen.append(out.dtype)
        loop.minimise(out.float().square().mean(), "a")
        return {}

    task = run_plain(folder, loss, precision=precision)
    return seen[0], task.modules()["a"].weight.dtype


def test_mixed_precision_computes_in_bfloat16_and_keeps_float32(tmp_path):
    assert computes_in(tmp_path, "bf16-mixed") == (torch.bfloat16, torch.float32)
    assert computes_in(tmp_path / "full", "32-true") == (torch.float32, torch.float32)


@pytest.mark.parametrize(
    ("processor", "wanted"),
    [
        ({"avx512_bf16": True, "amx_bf16": False}, torch.bfloat16),
        ({"amx_bf16": True}, torch.bfloat16),
        ({"avx512_bf16": False, "avx2": True}, torch.float32),
    ],
)
def test_a_processor_with_instructions_for_bfloat16_uses_them(tmp_path, monkeypatch, processor, wanted):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: processor)
    assert computes_in(tmp_path, "auto") == (wanted, torch.float32)


def test_mixed_precision_sees_updated_weights_within_one_step(tmp_path):
    """Autocast keeps its bfloat16 copies of weights until it ends; an optimiser's step in between must drop them."""
    seen = {}

    def loss(task, step, loop):
        module, x = task.modules()["a"], torch.ones(2, 3)
        loop.minimise(module(x).float().square().sum(), "a")
        with torch.autocast("cpu", enabled=False):
            seen["want"] = nn.functional.linear(x.bfloat16(), module.weight.bfloat16(), module.bias.bfloat16())
        seen["got"] = module(x)
        return {}

    run_plain(tmp_path, loss, precision="bf16-mixed", grad_clip=0.0)
    assert torch.equal(seen["got"], seen["want"])


def test_mixed_precision_finds_the_gradient_after_a_look_without_one(tmp_path):
    def loss(task, step, loop):
        module, x = task.modules()["a"], torch.ones(2, 3)
        with torch.no_grad():
            module(x)
        assert loop.minimise(module(x).float().square().sum(), "a") > 0
        return {}

    run_plain(tmp_path, loss, precision="bf16-mixed")
    assert torch.is_autocast_cache_enabled()


def test_a_metric_logged_on_some_steps_is_averaged_over_those(tmp_path):
    def loss(task, step, loop):
        loop.minimise(task.modules()["a"](torch.ones(1, 3)).square().sum(), "a")
        return {"n": torch.tensor(float(step)), **({"odd": 7.0} if step % 2 else {})}

    run_plain(tmp_path, loss, steps=4, log_every=4)
    (line,) = metrics(tmp_path)
    assert (line["n"], line["odd"]) == (2.5, 7.0)


def test_streams_depend_on_seed_name_and_rank():
    seeds = [stream_seed(s, n, r) for s in (0, 1) for n in ("a", "b") for r in (None, 0, 1)]
    assert len(set(seeds)) == len(seeds)
    assert all(0 <= seed < 2**63 for seed in seeds)


@pytest.mark.parametrize(
    ("setting", "value"),
    [("steps", 0), ("save_every", 0), ("keep_last", 0), ("grad_clip", -1.0), ("validate_every", -1), ("seed", 10**20)],
)
def test_nonsense_settings_are_refused(setting, value):
    with pytest.raises(InputError, match=setting):
        EngineConfig(**{"steps": 1, setting: value})


def test_an_absent_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "lightning_fabric", None)
    with pytest.raises(InputError, match=r"pip install 'moveset\[train\]'"):
        train(tmp_path)


def test_an_absent_device_is_refused(tmp_path):
    if not torch.cuda.is_available():
        with pytest.raises(InputError, match="cannot be used here; this machine has cpu"):
            train(tmp_path, device="cuda")
    with pytest.raises(InputError, match="double precision, which 'mps' does not have"):
        train(tmp_path, device="mps")


def test_more_processes_than_the_machine_can_bear_are_refused(tmp_path):
    with pytest.raises(InputError, match="9999 devices are too many for cpu; use 1 to"):
        train(tmp_path, device="cpu", devices=9999)


def test_tensorboard_events_are_written(tmp_path):
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    train(tmp_path, steps=6, tensorboard=True)
    events = EventAccumulator(str(tmp_path / "tensorboard"))
    events.Reload()
    assert [event.step for event in events.Scalars("train/g_loss")] == [2, 4, 5, 6]
    assert [event.step for event in events.Scalars("val/mse")] == [4, 6]
