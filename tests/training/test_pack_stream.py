"""Packing a stream: what is in the run folders comes out of the model folder, and what does not fit is refused."""

import shutil
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from moveset.data.feature_store import FeatureStore
from moveset.data.segments import CuttingConfig
from moveset.data.synthetic import synthetic_corpus
from moveset.errors import FormatError, InputError
from moveset.models.flow import FlowConfig
from moveset.models.segment_transformer import SegmentTransformerConfig
from moveset.pipelines.stored_weights import restored
from moveset.pipelines.stream_bundle import StreamBundle
from moveset.rdm.grid import GridConfig
from moveset.text.cache import EmbeddingCache
from moveset.text.encoder import get_text_encoder
from moveset.text.vocabulary import words_of
from moveset.training import checkpoint, pack_stream
from moveset.training.rdm import RDMConfig
from moveset.training.rdm_student import RDMStudentConfig
from moveset.training.stills import SENTENCES
from tests.training.run_folders import write_corpus, write_run

FRAMES = 8
MODEL = SegmentTransformerConfig(frames=FRAMES, width=32, heads=2, hidden=32, blocks=1)
FLOW = FlowConfig(blocks=2, hidden=8, text_context=4, index_context=4)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A corpus with its cache, and run folders as the training leaves them, of networks that were hardly trained."""
    folder = tmp_path_factory.mktemp("pack")
    write_corpus(folder)
    with torch.random.fork_rng(devices=[]), torch.no_grad():
        torch.manual_seed(0)
        rdm, md = MODEL.build(), MODEL.build()
        rdm.spectrum.copy_(torch.rand(FRAMES, 269) + 0.01)
        flow = FLOW.build()
        task = RDMConfig(model=MODEL, flow=FLOW, grid=GridConfig(frames=FRAMES), depth_cap=2)
        write_run(folder, "rdm-7", task, denoiser=MODEL.build(), denoiser_ema=rdm, flow=FLOW.build(), flow_ema=flow)
        write_run(
            folder, "md-7", replace(task, flow=None, grid=GridConfig(frames=FRAMES, condition="clean")), denoiser_ema=md
        )
        for phases in (1, 2):
            student = rdm.student()
            for weight in student.parameters():
                weight += 1e-3 * torch.randn_like(weight)
            learned = RDMStudentConfig(phases=phases, points=20, model=student.config, codec="native", frames=FRAMES)
            write_run(folder, f"rdm-pcm-{phases}", learned, student=rdm.student(), student_ema=student)
    return folder


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """No calibration of the familiarity limit, which encodes hundreds of sentences."""
    monkeypatch.setattr(pack_stream, "familiarity_limit", lambda known, encoder: 0.42)


def command(monkeypatch: pytest.MonkeyPatch, trained: Path, out: Path, *more: str) -> StreamBundle:
    given = ["--runs", str(trained / "runs"), "--corpus", str(trained / "corpus.safetensors"), "--out", str(out)]
    monkeypatch.setattr(sys, "argv", ["pack_stream", *given, *more])
    pack_stream.main()
    return StreamBundle(out)


def stored(trained: Path, run: str, name: str) -> dict[str, torch.Tensor]:
    return checkpoint.read_tensors(trained / "runs" / run / "step_7", name)


def test_of_several_runs_the_mean_is_packed(trained, tmp_path, monkeypatch, quick):
    """Of the flow, too: it is part of a run of "rdm"."""
    runs = trained / "runs"
    torch.manual_seed(3)
    task = RDMConfig(model=MODEL, flow=FLOW, grid=GridConfig(frames=FRAMES), depth_cap=2)
    write_run(trained, "other", task, denoiser_ema=MODEL.build(), flow_ema=FLOW.build())
    two = command(monkeypatch, trained, tmp_path / "two", "--networks", "--folder", "rdm=rdm-7,other")
    for network, name in (("rdm", "denoiser_ema"), ("flow", "flow_ema")):
        parts = [checkpoint.read_tensors(runs / run / "step_7", name) for run in ("rdm-7", "other")]
        for key, value in two.module(network).state_dict().items():
            mean = ((parts[0][key] + parts[1][key]) / 2).to(value.dtype)
            torch.testing.assert_close(value, mean, rtol=1e-3, atol=1e-4)
    assert two.config.provenance["rdm"] == "step 7 and step 7"
    with pytest.raises(InputError, match="'pcm-1' would be a student of 2 phases"):
        command(monkeypatch, trained, tmp_path / "no", "--networks", "pcm-1", "--folder", "pcm-1=rdm-pcm-1,rdm-pcm-2")
    other = replace(FLOW, seed=FLOW.seed + 1)
    write_run(trained, "shuffled", replace(task, flow=other), denoiser_ema=MODEL.build(), flow_ema=other.build())
    with pytest.raises(InputError, match=r"'flow' is to be the mean of networks of other .*order"):
        command(monkeypatch, trained, tmp_path / "no", "--networks", "--folder", "rdm=rdm-7,shuffled")
    narrow = replace(task, model=replace(MODEL, hidden=16))
    write_run(trained, "narrow", narrow, denoiser_ema=narrow.model.build(), flow_ema=FLOW.build())
    with pytest.raises(InputError, match="'rdm' is to be the mean of networks of different sizes"):
        command(monkeypatch, trained, tmp_path / "no", "--networks", "--folder", "rdm=rdm-7,narrow")


def test_the_folder_holds_the_averaged_networks_of_the_latest_checkpoints(trained, tmp_path, monkeypatch):
    networks = ("--networks", "rdm", "md", "pcm-1", "pcm-2")
    scales = ("--guidance", "1.5", "pcm-1=2.5")
    plan = (
        "--network",
        "pcm-2",
        "--steps",
        "12",
        "--start",
        "5",
        "--lag",
        "2",
        "--past-lag",
        "1",
        "--eta",
        "0.5",
        "--idle",
        "stand",
        "--travelling",
        "0.5",
    )
    bundle = command(monkeypatch, trained, tmp_path / "packed", *networks, *scales, *plan, "--name", "tried")
    config = bundle.config
    assert (config.name, config.network, config.idle, config.travelling) == ("tried", "pcm-2", "stand", 0.5)
    assert (config.segment, config.depth_cap, config.points) == (FRAMES, 2, 20)
    assert (config.sampler_steps, config.start, config.lag, config.past_lag, config.eta) == (12, 5, 2, 1, 0.5)
    assert config.guidance == {"rdm": 1.5, "md": 1.5, "pcm-1": 2.5, "pcm-2": 1.5}
    assert config.denoisers == ("rdm", "pcm-1", "pcm-2", "md")
    assert config.provenance["pcm-2"] == "step 7"
    assert 0.0 < config.far_prompt < 1.0
    whole = {"rdm": ("rdm-7", "denoiser_ema"), "md": ("md-7", "denoiser_ema"), "flow": ("rdm-7", "flow_ema")}
    for name, where in whole.items():
        for key, value in stored(trained, *where).items():
            assert torch.equal(bundle.tensors(f"{name}.safetensors")[key], value.half())
    for name in ("pcm-1", "pcm-2"):
        assert config.models[name].base == "rdm"
        assert any(key.endswith(":difference") for key in bundle.tensors(f"{name}.safetensors"))
        made = restored(bundle.tensors(f"{name}.safetensors"), bundle.tensors("rdm.safetensors"))
        for key, value in stored(trained, f"rdm-{name}", "student_ema").items():
            assert (made[key] - value).norm() <= 5e-3 * value.norm(), key
    store = FeatureStore(trained / "runs" / "cache" / "features-native")
    assert torch.equal(bundle.normalizer["feature_mean"], store.normalizer.mean)
    assert torch.equal(bundle.normalizer["feature_std"], store.normalizer.std)
    known = bundle.captions
    assert len(known.sentences) == len(known.pooled) > 10
    # Paraphrases say what captions do not; what is kept out of both is missing.
    assert not any(known.unread(sentence) for sentence in known.sentences)
    assert known.words > {word for sentence in known.sentences for word in words_of(sentence)}
    assert known.unread("a person saunters and walks") == ("saunters",)
    bundle.verify()


def test_students_can_be_whole_and_their_last_weights(quick, trained, tmp_path, monkeypatch):
    more = ("--networks", "pcm-1", "--last", "--whole")
    bundle = command(monkeypatch, trained, tmp_path / "whole", *more)
    assert tuple(bundle.config.models) == ("rdm", "pcm-1", "flow")
    last = stored(trained, "rdm-pcm-1", "student")
    held = bundle.tensors("pcm-1.safetensors")
    assert held.keys() == last.keys()
    assert all(torch.equal(held[key], value.half()) for key, value in last.items())


def test_smoothing_of_a_network_can_be_chosen_afterwards(quick, trained, tmp_path, monkeypatch):
    config = command(
        monkeypatch, trained, tmp_path / "smooth", "--networks", "pcm-1", "--smoothing", "pcm-1=0.6"
    ).config
    assert config.models["pcm-1"].config["smoothing"] == 0.6
    assert config.models["rdm"].config["smoothing"] != 0.6


def test_who_learned_to_stand_still_knows_the_words_for_it(quick, trained, tmp_path, monkeypatch):
    network = MODEL.build()
    task = RDMConfig(model=MODEL, flow=None, grid=GridConfig(frames=FRAMES), cutting=CuttingConfig(stills=8))
    write_run(trained, "standing", task, denoiser_ema=network)
    path = trained / "runs" / "cache" / "text-minilm.safetensors"
    EmbeddingCache.build(get_text_encoder("minilm"), SENTENCES, path)
    bundle = command(monkeypatch, trained, tmp_path / "stands", "--networks", "--folder", "rdm=standing")
    assert set(SENTENCES) <= set(bundle.captions.sentences)
    plain = command(monkeypatch, trained, tmp_path / "walks", "--networks")
    assert not set(SENTENCES) & set(plain.captions.sentences)


def test_a_model_without_flow_has_none(quick, trained, tmp_path, monkeypatch):
    bundle = command(monkeypatch, trained, tmp_path / "plain", "--networks", "--folder", "rdm=md-7")
    assert tuple(bundle.config.models) == ("rdm",)


def test_what_does_not_fit_is_refused(quick, trained, tmp_path, monkeypatch):
    cases = {
        ("pcm-1", "--folder", "pcm-1=rdm-pcm-2"): "student of 2 phases",
        ("pcm-4",): "no usable checkpoint",
        ("pcm-1", "--smoothing", "md=0.4"): "no network .md. to smooth",
        ("pcm-1", "--guidance", "1.5", "md=2"): "no network .md. to guide",
        ("pcm-1", "--guidance", "pcm-1=much"): "'pcm-1=much' has no number",
        ("pcm-3",): "no network 'pcm-3'; choose from rdm, md, pcm-1",
        ("pcm-1", "--folder", "pcm-1"): "--folder pcm-1 is no NETWORK=FOLDER",
        ("pcm-1", "--folder", "md=rdm-7"): "--folder md is no NETWORK=FOLDER of rdm, pcm-1",
    }
    for more, said in cases.items():
        with pytest.raises(InputError, match=said):
            command(monkeypatch, trained, tmp_path / "no", "--networks", *more)
    with pytest.raises(InputError, match="needs the network 'rdm'"):
        pack_stream.pack_stream(trained / "corpus.safetensors", trained, {}, {}, "none", tmp_path / "no")
    with pytest.raises(FormatError, match="takes a guidance scale"):
        command(monkeypatch, trained, tmp_path / "no", "--networks", "pcm-1", "--guidance", "rdm=1")
    assert not (tmp_path / "no").exists()


def test_students_of_different_grids_do_not_share_a_folder(trained, tmp_path, monkeypatch):
    step = trained / "runs" / "rdm-pcm-2" / "step_7"
    other = checkpoint.read_document(step, "config")
    other["config"]["points"] = 10
    tensors = {"student_ema": stored(trained, "rdm-pcm-2", "student_ema")}
    checkpoint.write(trained / "runs" / "other-grid", 7, tensors, {"config": other})
    with pytest.raises(InputError, match=r"grids of \[10, 20\] points"):
        command(monkeypatch, trained, tmp_path / "no", "--networks", "pcm-1", "pcm-2", "--folder", "pcm-2=other-grid")


def test_a_training_that_left_no_text_cache_is_packed_alike(trained, tmp_path, monkeypatch, quick):
    """One that rewords its captions encodes them as they come."""
    command(monkeypatch, trained, tmp_path / "wanted", "--networks", "pcm-1")
    copied = tmp_path / "copied"
    shutil.copytree(trained, copied)
    (file,) = (copied / "runs" / "cache").glob("text-*.safetensors")
    file.unlink()
    command(monkeypatch, copied, tmp_path / "found", "--networks", "pcm-1")
    for name in ("prompts.safetensors", "prompts.json", "pcm-1.safetensors"):
        assert (tmp_path / "found" / name).read_bytes() == (tmp_path / "wanted" / name).read_bytes(), name


def test_a_cache_of_another_corpus_is_refused(quick, trained, tmp_path, monkeypatch):
    """Its statistics would be packed, and every motion would be off without an error."""
    (tmp_path / "other").mkdir()
    other = synthetic_corpus(tmp_path / "other" / "corpus.safetensors", clips=12, seed=1)
    with pytest.raises(InputError, match="made from other clips"):
        command(monkeypatch, trained, tmp_path / "no", "--networks", "pcm-1", "--corpus", str(other))
    assert not (tmp_path / "no").exists()
