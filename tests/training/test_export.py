"""Model folders are the averaged networks of the latest checkpoints, with the statistics and captions of their data."""

import shutil
from dataclasses import asdict, replace

import pytest
import torch

from moveset.data.dataset import open_for_training
from moveset.data.feature_store import FeatureStore
from moveset.errors import InputError
from moveset.io.quantization import restored
from moveset.models.dip_decoder import DipDecoderConfig
from moveset.models.flow import FlowConfig
from moveset.models.segment_transformer import SegmentTransformerConfig
from moveset.pipelines.model_config import IDLE, BaselineConfig, StreamConfig
from moveset.pipelines.model_folder import ModelFolder
from moveset.rdm.grid import GridConfig
from moveset.text.vocabulary import words_of
from moveset.training import checkpoint
from moveset.training.dip import DiPConfig
from moveset.training.export import BaselineExport, StreamExport, export
from moveset.training.rdm import RDMConfig
from moveset.training.rdm_distillation import RDMStudentConfig
from tests.synthetic import synthetic_corpus

FRAMES = 8
MODEL = SegmentTransformerConfig(frames=FRAMES, width=32, heads=2, hidden=32, blocks=1)
FLOW = FlowConfig(blocks=2, hidden=8, text_context=4, index_context=4)
TASK = RDMConfig(codec="native", model=MODEL, flow=FLOW, grid=GridConfig(frames=FRAMES), depth_cap=2)
DIP = DiPConfig(codec="native", model=DipDecoderConfig(prefix=4, frames=8, width=32, layers=1, heads=2))


def write_run(runs, name, task, learned_from=None, **modules):
    """A run folder with checkpoints of steps 3 and 7; the later one holds the modules as they are."""
    for step, offset in ((3, 1.0), (7, 0.0)):
        tensors = {k: {key: value + offset for key, value in m.state_dict().items()} for k, m in modules.items()}
        checkpoint.write(
            runs / name, step, tensors, {"config": {"config": asdict(task), "learned_from": learned_from or {}}}
        )


@pytest.fixture(scope="module")
def dataset(tiny_run):
    return open_for_training(tiny_run.corpus)


@pytest.fixture(scope="module")
def runs(tiny_run, tmp_path_factory):
    """Run folders as the training leaves them, of networks that were hardly trained."""
    runs = tmp_path_factory.mktemp("runs")
    shutil.copytree(tiny_run.folder / "cache", runs / "cache")
    with torch.random.fork_rng(devices=[]), torch.no_grad():
        torch.manual_seed(0)
        rdm, md, flow = MODEL.build(), MODEL.build(), FLOW.build()
        rdm.spectrum.copy_(torch.rand(FRAMES, 269) + 0.01)
        write_run(runs, "rdm-7", TASK, denoiser=MODEL.build(), denoiser_ema=rdm, flow=FLOW.build(), flow_ema=flow)
        alone = replace(TASK, flow=None, grid=GridConfig(frames=FRAMES, condition="clean"))
        write_run(runs, "md-7", alone, denoiser_ema=md)
        write_run(runs, "rdm-1", replace(TASK, flow=None), denoiser_ema=rdm)
        write_run(runs, "dip", DIP, denoiser_ema=DIP.model.build())
        for phases, points in ((1, 20), (2, 20), (4, 10)):
            student = rdm.student()
            for weight in student.parameters():
                weight += 1e-3 * torch.randn_like(weight)
            learned = RDMStudentConfig(phases=phases, points=points, model=student.config)
            write_run(runs, f"rdm-pcm-{phases}", learned, student=rdm.student(), student_ema=student)
        write_run(
            runs, "of-no-flow", RDMStudentConfig(model=rdm.student().config), {"flow": ""}, student_ema=rdm.student()
        )
    return runs


def stored(runs, run, name):
    return checkpoint.read_tensors(runs / run / "step_7", name)


def stream(dataset, runs, out, networks, **more):
    own = {name: more.pop(name) for name in ("guidance", "tremor", "last", "differences", "compact") if name in more}
    what = StreamExport(name="tried", runs=networks, sampling=more, **own)
    return ModelFolder(export(what, dataset, runs, runs / "cache", out), StreamConfig)


def test_a_stream_holds_averaged_networks_and_what_it_does_by_default(dataset, runs, tmp_path):
    networks = {"rdm": "rdm-7", "md": "md-7", "pcm-1": "rdm-pcm-1", "pcm-2": "rdm-pcm-2"}
    sampling = {"network": "pcm-2", "sampler_steps": 12, "start": 5, "lag": 2, "past_lag": 1, "eta": 0.5,
                "variance": "beta"}  # fmt: skip
    scales = {"rdm": 1.5, "md": 1.5, "pcm-1": 2.5, "pcm-2": 1.5}
    given = {**sampling, "idle": "stand", "guidance": scales, "tremor": {"pcm-1": 0.6}}
    bundle = stream(dataset, runs, tmp_path / "made", networks, **given)
    config = bundle.config
    assert all(getattr(config, name) == value for name, value in given.items() if name != "tremor")
    assert (config.name, config.segment, config.depth_cap, config.points) == ("tried", FRAMES, 2, 20)
    assert (config.codec, config.fps, config.denoisers) == ("native", 20.0, ("rdm", "md", "pcm-1", "pcm-2"))
    assert config.models["pcm-1"].config["tremor"] == 0.6 != config.models["rdm"].config["tremor"]
    assert config.provenance["pcm-2"] == "rdm-pcm-2, step 7"
    assert 0.0 < config.far_prompt < 1.0
    whole = {"rdm": ("rdm-7", "denoiser_ema"), "md": ("md-7", "denoiser_ema"), "flow": ("rdm-7", "flow_ema")}
    for name, where in whole.items():
        for key, value in stored(runs, *where).items():
            assert torch.equal(bundle.tensors(f"{name}.safetensors")[key], value.half())
    for name in ("pcm-1", "pcm-2"):
        assert config.models[name].base == "rdm"
        made = restored(bundle.tensors(f"{name}.safetensors"), bundle.tensors("rdm.safetensors"))
        for key, value in stored(runs, f"rdm-{name}", "student_ema").items():
            assert (made[key] - value).norm() <= 5e-3 * value.norm(), key
    store = FeatureStore(runs / "cache" / "features-native")
    assert torch.equal(bundle.normalizer["feature_mean"], store.normalizer.mean)
    assert torch.equal(bundle.normalizer["feature_std"], store.normalizer.std)
    known = bundle.captions
    assert len(known.sentences) == len(known.pooled) > 10
    assert known.words >= {word for sentence in known.sentences for word in words_of(sentence)}
    assert known.unread("a person saunters and walks") == ("saunters",)
    bundle.verify()


def test_students_can_be_whole_and_their_last_weights(dataset, runs, tmp_path):
    networks, scales = {"rdm": "rdm-7", "pcm-1": "rdm-pcm-1"}, {"pcm-1": 1.0}
    bundle = stream(dataset, runs, tmp_path / "made", networks, guidance=scales, last=True, differences=False)
    held = bundle.tensors("pcm-1.safetensors")
    assert all(torch.equal(held[key], value.half()) for key, value in stored(runs, "rdm-pcm-1", "student").items())


@pytest.mark.parametrize(
    ("networks", "more", "message"),
    [
        ({"md": "md-7"}, {}, "needs the network 'rdm'"),
        ({"rdm": "nowhere"}, {}, "no usable checkpoint"),
        ({"rdm": "rdm-7", "pcm-1": "rdm-pcm-2"}, {}, "'pcm-1' would be a student of 2 phases"),
        ({"rdm": "rdm-7", "pcm-2": "rdm-pcm-2", "pcm-4": "rdm-pcm-4"}, {}, r"grids of \[10, 20\] points"),
        ({"rdm": "rdm-7", "pcm-1": "of-no-flow"}, {}, "of-no-flow.* was trained with another flow"),
        ({"rdm": "rdm-7"}, {"tremor": {"md": 0.4}}, "no network 'md' to steady"),
        ({"rdm": "rdm-7"}, {"guidance": {"md": 0.4}}, "no network 'md' to guide"),
    ],
)
def test_what_does_not_belong_together_is_refused(dataset, runs, tmp_path, networks, more, message):
    with pytest.raises(InputError, match=message):
        stream(dataset, runs, tmp_path / "no", networks, **more)
    assert not (tmp_path / "no").exists()


def test_a_cache_of_other_data_is_refused(dataset, runs, tmp_path):
    """Its statistics would be exported, and every motion would be off without an error."""
    FeatureStore.cached(dataset, "native", runs / "cache")
    other = open_for_training(synthetic_corpus(tmp_path / "corpus.safetensors", clips=12, seed=1))
    with pytest.raises(InputError, match="made from other clips"):
        stream(other, runs, tmp_path / "no", {"rdm": "rdm-7"})
    assert not (tmp_path / "no").exists()


def test_baselines_are_of_whole_clips_or_of_chunks(dataset, runs, tmp_path):
    def made(run, **more):
        what = BaselineExport(name=run, runs={"denoiser": run}, **more)
        return ModelFolder(export(what, dataset, runs, runs / "cache", tmp_path / run), BaselineConfig)

    whole, chunks = made("rdm-1", steps=7, guidance={"denoiser": 1.5}, variance="beta"), made("dip")
    assert (whole.config.frames, whole.config.prefix, whole.config.sampler_steps) == (FRAMES, 0, 7)
    assert (whole.config.eta, whole.config.variance, chunks.config.variance) == (0.0, "beta", "posterior")
    assert (whole.config.predict, whole.config.schedule, whole.config.guidance) == ("x0", "linear", {"denoiser": 1.5})
    assert (chunks.config.frames, chunks.config.prefix, chunks.config.sampler_steps) == (8, 4, DIP.levels)
    assert (chunks.config.schedule, chunks.config.eta, chunks.config.timesteps) == ("cosine", 1.0, DIP.levels)
    assert chunks.normalizer[IDLE].shape == (269,)
    with pytest.raises(InputError, match="is a stream's network"):
        made("rdm-7")
