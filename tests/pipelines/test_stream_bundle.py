"""Folders of streams: what is written is read, absurd numbers are refused, and the two kinds are not confused."""

import dataclasses
import json

import pytest
import torch

from moveset import TextToMotion
from moveset.cli.__main__ import main
from moveset.errors import FormatError, InputError
from moveset.models.flow import FlowConfig
from moveset.models.segment_transformer import SegmentTransformerConfig
from moveset.models.sides import SidePredictorConfig
from moveset.models.symmetric import Symmetric
from moveset.pipelines import model_folder
from moveset.pipelines.model_config import ClipConfig, StreamConfig
from moveset.pipelines.model_folder import ModelFolder, save_model

CONFIG = StreamConfig(
    name="tiny-stream",
    network="pcm-1",
    segment=12,
    depth_cap=2,
    schedule="cosine",
    timesteps=500,
    points=8,
    sampler_steps=10,
    start=4,
    lag=2,
    eta=0.5,
    guidance={"pcm-1": 1.5, "pcm-2": 2.5},
    far_prompt=0.3,
    idle="a person waits",
    provenance={"data": "none"},
)
SIZES = {"features": 6, "frames": 12, "text_dim": 8, "width": 32, "heads": 2, "hidden": 64, "blocks": 1}
NORMALIZER = {"feature_mean": torch.arange(6.0), "feature_std": torch.ones(6)}


def networks():
    """A denoiser, its students a little away from it, a flow, and a side predictor."""
    with torch.random.fork_rng(devices=[]), torch.no_grad():
        torch.manual_seed(0)
        rdm = SegmentTransformerConfig(**SIZES).build()
        students = {name: SegmentTransformerConfig(**SIZES, guided=True).build() for name in ("pcm-1", "pcm-2")}
        for student in students.values():
            student.load_state_dict({**student.state_dict(), **rdm.state_dict()})
            for p in student.parameters():
                p += 1e-3 * torch.randn_like(p)
        flow = FlowConfig(features=6, blocks=2, hidden=8, text_dim=8, text_context=4, index_context=4).build()
        sides = SidePredictorConfig(text_dim=8, width=8).build()
    return {"rdm": rdm, **students, "flow": flow, "sides": sides}


def save(path, config=CONFIG, modules=None, normalizer=NORMALIZER):
    modules = networks() if modules is None else modules
    return save_model(path, config, modules, normalizer, ["a", "b"], torch.eye(2, 8))


@pytest.fixture
def folder(tmp_path):
    return save(tmp_path / "tiny-stream")


def test_what_is_written_is_read(folder):
    bundle = ModelFolder.open(folder, StreamConfig)
    assert dataclasses.replace(bundle.config, models={}) == CONFIG
    assert bundle.config.denoisers == ("rdm", "pcm-1", "pcm-2")
    assert bundle.config.steps("pcm") == (1, 2)
    for name, module in networks().items():
        for key, value in module.state_dict().items():
            assert torch.equal(bundle.tensors(f"{name}.safetensors")[key], value.half())
        assert type(bundle.module(name)) is type(module)
    assert torch.equal(bundle.normalizer["feature_mean"], NORMALIZER["feature_mean"])
    assert bundle.captions.sentences == ("a", "b")
    assert bundle.verify() == sum(p.stat().st_size for p in folder.iterdir() if p.name != "manifest.json")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"network": "pcm-4"}, "'pcm-4' is none of rdm, pcm-1, pcm-2"),
        ({"network": "flow"}, "'flow' is none of"),
        ({"network": "sides"}, "'sides' is none of"),
        ({"schedule": "round"}, "'round' is none of linear, cosine"),
        ({"segment": 0}, "segment 0"),
        ({"segment": 28.5}, "segment 28.5"),
        ({"depth_cap": -1}, "depth_cap -1"),
        ({"points": 501}, "points 501"),
        ({"points": 1}, "student of more steps than the 1 points"),
        ({"start": 11}, "start 11"),
        ({"lag": 0}, "lag 0"),
        ({"past_lag": 11}, "past_lag 11"),
        ({"eta": float("nan")}, "eta nan"),
        ({"variance": "learned"}, "variance 'learned'"),
        ({"eps_scale": float("nan")}, "eps_scale nan"),
        ({"time_shift": 1.5}, "time_shift 1.5"),
        ({"fps": 0.0}, "frame rate"),
        ({"symmetric": ("rdm",)}, "'rdm' is no guided network"),
        ({"symmetric": ("pcm-8",)}, "'pcm-8' is no guided network"),
        ({"guidance": {"pcm-1": 1.5}}, "'pcm-2' takes a guidance scale"),
        ({"guidance": {"pcm-1": 1.5, "pcm-2": -1.0}}, "below 0"),
        ({"guidance": {"pcm-1": 1.5, "pcm-2": 1.0, "pcm-8": 1.0}}, "not there"),
    ],
)
def test_absurd_numbers_are_refused_before_anything_is_written(tmp_path, change, message):
    with pytest.raises(FormatError, match=message):
        save(tmp_path / "absurd", dataclasses.replace(CONFIG, **change))
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_lacks_a_setting_is_refused(folder):
    config = json.loads((folder / "config.json").read_text())
    del config["lag"]
    with pytest.raises(FormatError, match="'lag' is missing"):
        StreamConfig.parse(json.dumps(config).encode(), folder / "config.json")


def test_symmetric_networks_come_with_their_mirror_image(tiny_streams):
    bundle = ModelFolder(tiny_streams, StreamConfig)
    assert bundle.config.symmetric == ("pcm-1",)
    assert isinstance(bundle.module("pcm-1"), Symmetric)
    assert bundle.module("pcm-1") is bundle.module("pcm-1")
    assert not isinstance(bundle.module("pcm-2"), Symmetric)


def test_what_leans_to_one_side_cannot_be_symmetric(tiny_streams):
    bundle = ModelFolder(tiny_streams, StreamConfig)
    bundle.normalizer["feature_mean"][0] += 0.01  # on average it turns
    with pytest.raises(FormatError, match="lean to one side"):
        bundle.module("pcm-1")


def test_other_features_have_no_mirror_image(tmp_path):
    config = dataclasses.replace(CONFIG, codec="hml", symmetric=("pcm-1",))
    with pytest.raises(FormatError, match="features of 'hml' are not symmetric"):
        ModelFolder(save(tmp_path / "hml", config), StreamConfig).module("pcm-1")


def test_statistics_are_needed(tmp_path):
    with pytest.raises(ValueError, match="lacks 'feature_std'"):
        save(tmp_path / "none", normalizer={"feature_mean": torch.zeros(6)})


def test_the_kinds_are_not_confused(folder, tiny_clips, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(model_folder, "shipped", lambda: {"tiny-clips": tiny_clips, "tiny-stream": folder})
    with pytest.raises(InputError, match=r"'tiny-stream' is a stream model, for `moveset stream`.*: tiny-clips$"):
        TextToMotion.from_pretrained("tiny-stream")
    with pytest.raises(InputError, match=r"'tiny' is a text-to-motion model, for `moveset gene.*: tiny-stream$"):
        ModelFolder.open("tiny-clips", StreamConfig)
    assert main(["generate", "a person walks", "--model", str(folder), "-o", str(tmp_path / "a.bvh")]) == 2
    err = capsys.readouterr().err
    assert "tiny-clips" in err
    assert err.count("\n") == 1


def test_folders_that_name_no_task_are_of_text_to_motion(tiny_clips):
    config = json.loads((tiny_clips / "config.json").read_text())
    assert config.pop("task") == "text-to-motion"
    before = ModelFolder(tiny_clips, ClipConfig).config
    assert type(before).parse(json.dumps(config).encode(), tiny_clips / "config.json") == before
    with pytest.raises(FormatError, match="has the task 'dance', not 'text-to-motion'"):
        type(before).parse(json.dumps(config | {"task": "dance"}).encode(), tiny_clips / "config.json")


def test_models_lists_both_kinds(folder, tiny_clips, monkeypatch, capsys):
    monkeypatch.setattr(model_folder, "shipped", lambda: {"tiny-clips": tiny_clips, "rdm-small": folder})
    assert main(["models", "--json"]) == 0
    first, second = json.loads(capsys.readouterr().out)["models"]
    assert (first["task"], second["task"]) == ("text-to-motion", "stream")
    assert (first["default"], second["default"]) == (False, True)
    assert second["network"] == "pcm-1"
    assert second["segment_seconds"] == 0.6
    assert second["networks"]["rdm"]["kind"] == "segment_transformer"
    assert set(second["networks"]) == {"rdm", "flow", "sides", "pcm-1", "pcm-2"}
    assert main(["models"]) == 0
    out = capsys.readouterr().out
    assert "a stream by pcm-1, or by rdm, pcm-2  20 fps  0.6 s a segment" in out
    assert "MotionPCM in 1/2/4 steps, LCM, teacher" in out
