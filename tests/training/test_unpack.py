"""From a model folder to run folders and back: weights survive, trainings start from them, other files stay."""

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from moveset.data.synthetic import synthetic_corpus
from moveset.errors import InputError
from moveset.pipelines.bundle import Bundle
from moveset.pipelines.motion_stream import MotionStream
from moveset.pipelines.stored_weights import MAX_ERROR
from moveset.pipelines.stream_bundle import StreamBundle
from moveset.recipes import tiny
from moveset.training import checkpoint, exchange, frozen, resume, unpack
from moveset.training.engine import run
from moveset.training.tasks import Sources, task_maker
from tests.bundles import tiny_bundle
from tests.streams import tiny_stream

# What 8-bit differences may be wrong by, and half precision besides.
STORED_ERROR = MAX_ERROR + 1e-3


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    root = tmp_path_factory.mktemp("models")
    return tiny_bundle(root / "clips"), tiny_stream(root / "streams")


@pytest.fixture(scope="module")
def runs(models: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs")
    for model in models:
        unpack.unpack(model, out, "tiny")
    return out


def test_networks_come_back_as_they_were_stored(models, runs):
    clips, streams = Bundle(models[0]), StreamBundle(models[1])
    kept = {
        "vae": (clips, "vae", "vae_ema"),
        "teacher": (clips, "teacher", "teacher_ema"),
        "lcm-1": (clips, "lcm-1", "student_ema"),
        "pcm-4": (clips, "pcm-4", "student"),
        "rdm-7": (streams, "rdm", "denoiser_ema"),
        "md-7": (streams, "md", "denoiser"),
        "rdm-pcm-2": (streams, "pcm-2", "student_ema"),
    }
    for folder, (model, name, saved) in kept.items():
        found = frozen.load(runs / folder, saved)
        stored = model.weights(name)
        assert found.module.state_dict().keys() == stored.keys()
        assert all(torch.equal(value, stored[key]) for key, value in found.module.state_dict().items())
    assert frozen.load(runs / "pcm-4", "student").task["phases"] == 4
    rdm = frozen.load(runs / "rdm-7", "denoiser_ema").task
    assert (rdm["grid"]["frames"], rdm["depth_cap"]) == (streams.config.segment, streams.config.depth_cap)
    flow = frozen.load(runs / "rdm-7", "flow_ema", part="coupling_flow").module.state_dict()
    assert all(torch.equal(flow[key], value) for key, value in streams.weights("flow").items())
    assert frozen.load(runs / "md-7", "denoiser").task["flow"] is None


def test_nothing_is_written_over(models, runs):
    before = {path: path.stat().st_mtime_ns for path in runs.rglob("*")}
    with pytest.raises(InputError, match="already holds a training"):
        unpack.unpack(models[0], runs, "tiny")
    assert {path: path.stat().st_mtime_ns for path in runs.rglob("*")} == before


@pytest.fixture(scope="module")
def sources(runs: Path) -> Sources:
    synthetic_corpus(runs / "corpus.safetensors", clips=24, seed=0)
    return Sources(corpus=runs / "corpus.safetensors", vae=runs / "vae", teacher=runs / "teacher", cache=runs / "cache")


def test_a_training_starts_with_the_weights_it_is_given(models, runs, sources, tmp_path):
    recipe, given = tiny.TRAINING["lcm"](), Bundle(models[0]).weights("pcm-1")
    maker = task_maker("lcm", replace(recipe.task, lr=1e-9), sources)
    run(maker, replace(recipe.engine, steps=1), tmp_path / "run", init=runs / "pcm-1")
    learned = checkpoint.read_tensors(tmp_path / "run" / "step_1", "student")
    assert all((learned[name] - given[name]).abs().max() < 1e-6 for name in given)
    assert any(not torch.equal(learned[name], given[name]) for name in given)
    # A resumed training goes on from its own checkpoint, whatever it once began with.
    with pytest.warns(UserWarning, match="with other settings: steps 1 -> 2"):
        run(maker, replace(recipe.engine, steps=2), tmp_path / "run", True, init=runs / "pcm-2")
    later = checkpoint.read_tensors(tmp_path / "run" / "step_2", "student")
    assert all((later[name] - given[name]).abs().max() < 1e-6 for name in given)


def test_weights_that_do_not_fit_are_refused(runs, sources, tmp_path):
    recipe = tiny.TRAINING["lcm"]()
    for wrong, message in (("vae", "has none of student"), ("rdm-pcm-1", "does not fit"), ("nothing", "no usable")):
        with pytest.raises(InputError, match=message):
            run(task_maker("lcm", recipe.task, sources), recipe.engine, tmp_path / "run", init=runs / wrong)
        assert not checkpoint.steps(tmp_path / "run")


def test_what_a_checkpoint_lacks_starts_anew(models, runs):
    student, judge = frozen.load(runs / "pcm-2", "student").module, torch.nn.Linear(2, 1)
    before = judge.weight.clone()
    parts = {"student": student, "discriminator": judge}
    task = SimpleNamespace(name="pcm", modules=lambda: parts, averages=lambda: {})
    with pytest.warns(UserWarning, match="has no discriminator: that starts anew"):
        resume.begin(task, [checkpoint.resolve(runs / "pcm-4")])
    assert torch.equal(judge.weight, before)
    wanted = Bundle(models[0]).weights("pcm-4")
    assert all(torch.equal(value, wanted[name]) for name, value in student.state_dict().items())


def test_each_module_comes_from_the_first_checkpoint_that_has_it(models, runs, tmp_path):
    student, judge = frozen.load(runs / "pcm-2", "student").module, torch.nn.Linear(2, 1)
    parts = {"student": student, "discriminator": judge}
    task = SimpleNamespace(name="pcm", modules=lambda: parts, averages=lambda: {})
    other = checkpoint.resolve(runs / "pcm-2")
    learned = {"weight": torch.full((1, 2), 3.0), "bias": torch.full((1,), 4.0)}
    tensors = {"student": checkpoint.read_tensors(other, "student"), "discriminator": learned}
    checkpoint.write(tmp_path, 1, tensors, {"state": {}, "config": {}})
    first = checkpoint.resolve(runs / "pcm-4")

    resume.begin(task, [first, checkpoint.resolve(tmp_path)])
    wanted = Bundle(models[0]).weights("pcm-4")
    assert all(torch.equal(value, wanted[name]) for name, value in student.state_dict().items())
    assert all(torch.equal(value, learned[name]) for name, value in judge.state_dict().items())
    with pytest.raises(InputError, match="leave out what follows"):
        resume.begin(task, [checkpoint.resolve(tmp_path), first])
    with pytest.raises(InputError, match="has none of discriminator"):
        resume.begin(task, [first, other])


def test_exchanging_a_student_leaves_everything_else(models, runs, tmp_path, monkeypatch):
    model = Bundle(models[0])
    arguments = ["exchange", str(models[0]), f"pcm-1={runs / 'pcm-2'}", "--guidance", "pcm-1=2.5", "--name", "mine"]
    monkeypatch.setattr(sys, "argv", [*arguments, "--out", str(tmp_path / "out")])
    with pytest.raises(InputError, match="a student of 2 phases"):
        exchange.main()
    arguments[2] = f"pcm-1={runs / 'lcm-1'}"
    monkeypatch.setattr(sys, "argv", [*arguments, "--out", str(tmp_path / "out")])
    exchange.main()
    out = Bundle(tmp_path / "out")
    changed = {name for name in model.files if model.files[name] != out.files[name]}
    assert changed == {"config.json", "pcm-1.safetensors"}
    assert out.config.name == "mine"
    assert (out.config.guidance["pcm-1"], out.config.guidance["pcm-2"]) == (2.5, 3.0)
    wanted, got = model.weights("lcm-1"), out.weights("pcm-1")
    for name, value in wanted.items():
        assert torch.linalg.vector_norm(got[name] - value) <= STORED_ERROR * torch.linalg.vector_norm(value), name
    with pytest.raises(InputError, match="is no student"):
        exchange.exchange(models[0], {"teacher": runs / "teacher"}, tmp_path / "other")
    with pytest.raises(InputError, match="they do not fit"):
        exchange.exchange(models[0], {"pcm-1": runs / "rdm-pcm-1"}, tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_what_cannot_be_exchanged_is_said_and_nothing_is_written(models, runs, tmp_path, monkeypatch):
    pcm, out = f"pcm-1={runs / 'pcm-1'}", tmp_path / "out"
    for model, arguments, message in (
        (models[0], ["pcm-1"], "'pcm-1' names no run"),
        (models[0], [pcm, "--guidance", "pcm-8=2"], "no network 'pcm-8' to guide; choose vae"),
        (models[0], [pcm, "--symmetric", "pcm-1"], "--symmetric is of streams"),
        (models[0], [pcm, "--travelling", "0.5"], "--travelling is of streams"),
        (models[0], [f"lcm-2={runs / 'lcm-1'}"], "add --guidance lcm-2=W"),
        (models[1], [f"pcm-1={runs / 'rdm-pcm-1'}", "--tremor", "md=1"], "no network 'md' to damp; choose pcm-1"),
    ):
        monkeypatch.setattr(sys, "argv", ["exchange", str(model), *arguments, "--out", str(out)])
        with pytest.raises(InputError, match=message):
            exchange.main()
    assert not out.exists()
    # Other networks of the model may be guided otherwise on the occasion.
    monkeypatch.setattr(sys, "argv", ["exchange", str(models[0]), pcm, "--guidance", "teacher=5", "--out", str(out)])
    exchange.main()
    assert Bundle(out).config.guidance["teacher"] == 5


def test_a_student_of_several_phases_needs_the_grid_of_the_model(models, runs, tmp_path):
    config = checkpoint.read_document(checkpoint.resolve(runs / "pcm-4"), "config")
    config["config"]["points"] = 20
    tensors = {"student_ema": Bundle(models[0]).weights("pcm-4")}
    other = checkpoint.write(tmp_path / "other-grid", 1, tensors, {"config": config})
    with pytest.raises(InputError, match="a grid of 20 points, the model has 10"):
        exchange.exchange(models[0], {"pcm-4": other}, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_differences_may_be_coarser_where_that_is_asked_for(models, runs, tmp_path):
    sizes, errors = [], []
    wanted = frozen.load(runs / "pcm-2", "student_ema").module.state_dict()
    for most in (0.0, 4e-3, 0.1):
        out = Bundle(exchange.exchange(models[0], {"pcm-2": runs / "pcm-2"}, tmp_path / str(most), max_error=most))
        got = out.weights("pcm-2")
        sizes.append(out.files["pcm-2.safetensors"][1])
        errors.append(max(float((got[key] - wanted[key]).norm() / wanted[key].norm()) for key in wanted))
        assert errors[-1] <= most + 1e-3
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[0] > sizes[-1]
    with pytest.raises(InputError, match="error of differences"):
        exchange.exchange(models[0], {"pcm-2": runs / "pcm-2"}, tmp_path / "out", max_error=0.2)


def test_several_runs_make_their_mean(models, runs, tmp_path):
    both = [runs / "pcm-1", runs / "lcm-1"]
    out = Bundle(exchange.exchange(models[0], {"pcm-1": both}, tmp_path / "out"))
    parts = [frozen.load(path, "student_ema").module.state_dict() for path in both]
    for name, value in out.weights("pcm-1").items():
        mean = (parts[0][name] + parts[1][name]) / 2
        assert torch.linalg.vector_norm(value - mean) <= STORED_ERROR * torch.linalg.vector_norm(mean), name
    assert " and " in out.config.provenance["pcm-1"]
    again = unpack.unpack(tmp_path / "out", tmp_path / "again", "tiny")["pcm-1"]
    assert again.name in {next(path.glob("step_*")).name for path in both}


def test_a_stream_with_another_student_plays(models, runs, tmp_path):
    student = {"pcm-1": runs / "rdm-pcm-1"}
    out = exchange.exchange(models[1], student, tmp_path / "out", tremor={"pcm-1": 7.0}, symmetric=(), travelling=0.5)
    config = StreamBundle(out).config
    assert (config.symmetric, config.travelling, config.models["pcm-1"].base) == ((), 0.5, "rdm")
    assert config.models["pcm-1"].config["tremor"] == 7.0
    assert len(next(MotionStream.from_pretrained(out, device="cpu")).motion) == 28
    trembling = exchange.exchange(models[1], student, tmp_path / "trembling", tremor={"pcm-1": 0.0}, symmetric=())
    jerk = [quickest(MotionStream.from_pretrained(folder, device="cpu")) for folder in (out, trembling)]
    assert jerk[0] < jerk[1]
    with pytest.raises(InputError, match="tremor"):
        exchange.exchange(models[1], student, tmp_path / "other", tremor={"pcm-1": -1.0})
    with pytest.raises(InputError, match="has no tremor to damp"):
        exchange.exchange(models[0], {"pcm-1": runs / "lcm-1"}, tmp_path / "other", tremor={"pcm-1": 2.0})
    assert not (tmp_path / "other").exists()


def quickest(stream: MotionStream) -> float:
    """Mean third difference of the joints of a first segment."""
    return float(next(stream).motion.joints.diff(n=3, dim=0).norm(dim=-1).mean())
