"""Packing a baseline: what is in the run folder comes out of the model folder, and a chunk's start is a real pose."""

import sys

import pytest
import torch

from moveset.data.corpus import Corpus
from moveset.data.synthetic import synthetic_corpus
from moveset.errors import InputError
from moveset.evaluation.generators import Wanted
from moveset.evaluation.job import Job, open_generator
from moveset.models.dip_decoder import DipDecoderConfig
from moveset.models.segment_denoiser import SegmentDenoiserConfig
from moveset.motion.features import get_codec
from moveset.pipelines.baseline_bundle import BaselineBundle
from moveset.rdm.grid import GridConfig
from moveset.training import checkpoint, pack_baseline
from moveset.training.dip import DiPConfig
from moveset.training.rdm import RDMConfig
from tests.training.run_folders import write_corpus, write_run

VOLUME = SegmentDenoiserConfig(
    features=269, frames=40, text_dim=384, width=32, layers=1, heads=2, feed_forward=32, conditioning=32, text_width=32,
    text_layers=1, text_feed_forward=32,
)  # fmt: skip
CHUNKS = DipDecoderConfig(features=269, text_dim=384, frames=12, prefix=5, width=32, layers=1, heads=2, feed_forward=32)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pack")
    write_corpus(folder)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        whole = RDMConfig(
            model=VOLUME, flow=None, grid=GridConfig(frames=40), predict="eps", weight="x0", text_drop=0.0
        )
        write_run(folder, "motiondiffuse", whole, denoiser=VOLUME.build(), denoiser_ema=VOLUME.build())
        write_run(folder, "dip", DiPConfig(model=CHUNKS, levels=4), denoiser_ema=CHUNKS.build())
    return folder


def packed(monkeypatch, trained, run, out, *more):
    monkeypatch.setattr(pack_baseline, "familiarity_limit", lambda known, encoder: 0.42)
    given = ["--corpus", str(trained / "corpus.safetensors"), "--cache", str(trained / "runs" / "cache")]
    monkeypatch.setattr(sys, "argv", ["pack_baseline", str(trained / "runs" / run), *given, "--out", str(out), *more])
    pack_baseline.main()
    return BaselineBundle(out)


@pytest.mark.parametrize("run", ["motiondiffuse", "dip"])
def test_the_folder_holds_the_averaged_network_of_the_latest_checkpoint(trained, tmp_path, monkeypatch, run):
    bundle = packed(monkeypatch, trained, run, tmp_path / "packed", "--guidance", "1.5")
    assert (bundle.config.name, bundle.config.guidance) == (f"{run}-small", {"denoiser": 1.5})
    assert bundle.config.provenance["denoiser"] == "step 7"
    for key, value in checkpoint.read_tensors(trained / "runs" / run / "step_7", "denoiser_ema").items():
        assert torch.equal(bundle.tensors("denoiser.safetensors")[key], value.half())
    bundle.verify()


def test_sampling_is_as_trained(trained, tmp_path, monkeypatch):
    whole = packed(monkeypatch, trained, "motiondiffuse", tmp_path / "a", "--steps", "25", "--name", "md").config
    assert (whole.name, whole.predict, whole.frames, whole.prefix, whole.sampler_steps) == ("md", "eps", 40, 0, 25)
    assert (whole.schedule, whole.timesteps, whole.eta, dict(whole.guidance)) == ("linear", 1000, 0.0, {})
    dip = packed(monkeypatch, trained, "dip", tmp_path / "b").config
    assert (dip.predict, dip.frames, dip.prefix, dip.sampler_steps) == ("x0", 12, 5, 4)
    assert (dip.schedule, dip.timesteps, dip.eta) == ("cosine", 4, 1.0)


def test_a_checkpoint_is_called_after_its_run(trained, tmp_path, monkeypatch):
    assert packed(monkeypatch, trained, "motiondiffuse/step_3", tmp_path / "a").config.name == "motiondiffuse-small"


def test_what_is_no_baseline_is_refused(trained, tmp_path, monkeypatch):
    told = RDMConfig(model=VOLUME, flow=None, grid=GridConfig(frames=40, condition="clean"))
    write_run(trained, "md-7", told, denoiser_ema=VOLUME.build())
    write_run(trained, "rdm-7", RDMConfig(model=VOLUME), denoiser_ema=VOLUME.build())
    for run, more, message in (
        ("md-7", (), "a stream's network"),
        ("rdm-7", (), "pack it with pack_stream"),
        ("dip", ("--steps", "2"), "takes all 4 steps"),
    ):
        with pytest.raises(InputError, match=message):
            packed(monkeypatch, trained, run, tmp_path / "no", *more)
    assert not (tmp_path / "no").exists()


def test_what_is_packed_can_be_sampled(trained, tmp_path, monkeypatch):
    for run, steps in (("motiondiffuse", 3), ("dip", None)):
        packed(monkeypatch, trained, run, tmp_path / run)
        model = open_generator(Job(model=str(tmp_path / run), steps=steps, device="cpu"))
        made = model.generate([Wanted((("a person walks", 30),), 0)], 20.0)[0]
        assert made.shape == (30, 22, 3)


def test_a_rollout_starts_from_a_pose_of_the_data_at_rest(trained, tmp_path, monkeypatch):
    bundle, codec = packed(monkeypatch, trained, "dip", tmp_path / "dip"), get_codec("native")
    statistics = bundle.normalizer
    idle = statistics["idle"] * statistics["feature_std"] + statistics["feature_mean"]
    corpus = Corpus.open(trained / "corpus.safetensors")
    firsts = torch.stack([codec.encode(corpus.motion(k)[:2])[0] for k in corpus.indices("train", composed=False)])
    pose = codec.groups["rotations"]
    assert (firsts[:, pose] - idle[pose]).abs().amax(dim=1).min() < 1e-5
    still = codec.decode(idle.repeat(20, 1))
    assert (still.joints - still.joints[:1]).abs().max() < 1e-5


def test_a_folder_without_a_denoiser_is_refused(trained, tmp_path, monkeypatch):
    with pytest.raises(InputError, match="no usable checkpoint"):
        packed(monkeypatch, trained, "nothing", tmp_path / "x")


def test_a_cache_of_another_corpus_is_refused(trained, tmp_path, monkeypatch):
    other = synthetic_corpus(tmp_path / "corpus.safetensors", clips=12, seed=1)
    with pytest.raises(InputError, match="made from other clips"):
        packed(monkeypatch, trained, "motiondiffuse", tmp_path / "no", "--corpus", str(other))
    assert not (tmp_path / "no").exists()
