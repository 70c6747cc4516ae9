"""What recurrent models are compared with, sampled for the tables: whole clips, and chunk after chunk."""

import pytest
import torch

from moveset.errors import FormatError, InputError
from moveset.models.condition import Denoiser
from moveset.models.light_t2m import LightT2MConfig
from moveset.motion.features import get_codec
from moveset.pipelines.baseline import Baseline
from moveset.pipelines.generator import Sampler, open_generator
from moveset.pipelines.model_config import BaselineConfig, ClipConfig
from moveset.pipelines.model_folder import ModelFolder, save_model
from moveset.pipelines.request import Request
from tests.baselines import SETTINGS, tiny_baseline
from tests.bundles import CAPTIONS, standing_features

WALK, BOW = "a person walks forward", "a person bows"


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    root = tmp_path_factory.mktemp("baselines")
    return {kind: tiny_baseline(root / kind, kind) for kind in SETTINGS}


def baseline(folder, **options):
    return Baseline(ModelFolder(folder, BaselineConfig), device="cpu", **options)


class Says(Denoiser):
    """Instead of a network: its conditions are written down, and it says what a function makes of its input."""

    config = None

    def __init__(self, answer):
        super().__init__()
        self.answer, self.told = answer, []

    def denoise(self, x, t, condition, taps):
        self.told.append(condition)
        return self.answer(x, t, condition)


def instead(model, answer):
    network = Says(answer)
    model._bundle._modules["denoiser", "cpu"] = network
    return network


@pytest.mark.parametrize("kind", SETTINGS)
def test_clips_are_as_long_as_asked_for_and_each_from_its_own_seed(folders, kind):
    asked = [Request((WALK,), (frames,), seed) for seed, frames in enumerate((50, 24, 37, 50))]
    ticks = []
    made = baseline(folders[kind]).generate(asked, ticks.append)
    assert [tuple(motion.joints.shape) for motion in made] == [(n, 22, 3) for n in (50, 24, 37, 50)]
    assert sum(ticks) == 4
    assert not torch.allclose(made[0].joints, made[3].joints, atol=1e-4)
    assert all(motion.joints.isfinite().all() for motion in made)


@pytest.mark.parametrize("kind", SETTINGS)
def test_the_batch_does_not_matter(folders, kind):
    asked = [Request((prompt,), (n,), seed) for seed, (prompt, n) in enumerate([(WALK, 50), (BOW, 30), (WALK, 44)])]
    together = baseline(folders[kind]).generate(asked)
    alone = baseline(folders[kind], batch=1).generate(asked[::-1])[::-1]
    for a, b in zip(together, alone, strict=True):
        assert torch.allclose(a.joints, b.joints, atol=1e-4)


def test_a_longer_clip_than_the_network_knows_is_cut(folders):
    assert len(baseline(folders["light"]).generate([Request((WALK,), (75,), 0)])[0]) == 60
    assert len(baseline(folders["chunks"]).generate([Request((WALK,), (75,), 0)])[0]) == 75


@pytest.mark.parametrize("kind", ["light", "noise"])
def test_what_the_network_says_is_what_comes_out(folders, kind):
    """A clean clip of zeros is the mean of the data; its noise is the input divided by sigma."""
    model = baseline(folders[kind], foot_lock=False)
    sigma = model._schedule.sigma
    network = instead(model, lambda x, t, _: 0 * x if kind == "light" else x / sigma(t)[:, None, None])
    made = model.generate([Request((WALK,), (30,), 0), Request((BOW,), (20,), 1)])
    standing = get_codec("native").decode(standing_features().repeat(30, 1)).joints
    # At the noisiest of the thousand levels alpha is 0.006, and rounding is divided by it.
    assert torch.allclose(made[0].joints, standing, atol=1e-3)
    assert len(network.told) == 3
    valid = network.told[0].valid
    assert valid.sum(dim=1).tolist() == [20, 30, 20, 30]  # told and untold, the shorter clip first


def test_guidance_goes_beyond_what_the_text_adds(folders):
    said = {}

    def answer(x, t, condition):
        # One where the text is read, zero where there is none.
        return (
            torch.ones_like(x) * (condition.text.tokens.abs().sum(dim=(1, 2)) != said["empty"]).float()[:, None, None]
        )

    for w, expected in ((1.5, 2.5), (0.0, 1.0)):
        model = baseline(folders["light"], guidance=w, foot_lock=False)
        said["empty"] = model._text.encode([""]).tokens.abs().sum()
        instead(model, answer)
        features = model._volumes([Request((WALK,), (20,), 0)])
        assert torch.allclose(features[0, :20], torch.full((20, 269), expected), atol=1e-4)


def test_chunks_go_on_from_the_frames_before(folders):
    model = baseline(folders["chunks"], guidance=0.0, foot_lock=False)
    network = instead(model, lambda x, t, c: c.past.frames[:, -1:] + torch.arange(1, 13)[:, None] + 0 * x)
    features = model._chunks([Request((WALK,), (30,), 0)])
    # The last step of a DDPM sampler adds no noise, so frames count on from zero, the pose of the start.
    assert torch.allclose(features[0, :, 0], torch.arange(1.0, 31.0), atol=1e-4)
    assert len(network.told) == 3 * 4


def test_a_chunk_is_told_the_part_that_it_begins_in(folders):
    model = baseline(folders["chunks"], guidance=0.0)
    heard = []
    text, encode = model._text, model._text.encode
    text.encode = lambda said: heard.append(tuple(said)) or encode(said)
    model.generate([Request((WALK, BOW), (13, 12), 0)])
    assert [said for said in heard if said != ("",)] == [(WALK,)] * 8 + [(BOW,)] * 4


def test_a_clip_of_two_parts_is_told_both(folders):
    model = baseline(folders["light"], guidance=0.0)
    heard = []
    text, encode = model._text, model._text.encode
    text.encode = lambda said: heard.append(tuple(said)) or encode(said)
    model.generate([Request((WALK, BOW), (13, 12), 0)])
    assert heard[0] == (f"{WALK} then {BOW}",)


def test_a_folder_is_opened_by_its_name(folders):
    made = open_generator(folders["light"], sampler=Sampler(steps=2, guidance=2.0), device="cpu")
    assert (made.slug, made.steps, made.describe()["guidance"]) == ("light-2-steps-guidance2", 2, 2.0)
    assert set(made.weights()) == {"denoiser.safetensors", "normalizer.safetensors", "denoiser in config.json"}


@pytest.mark.parametrize(
    ("kind", "given", "message"),
    [
        ("light", {"sampler": Sampler(steps=0)}, "cannot take 0 steps"),
        ("chunks", {"sampler": Sampler(steps=3)}, "'chunks' cannot take 3 steps; its own choice is 4"),
        ("light", {"network": "pcm-1"}, "has no network 'pcm-1'"),
        ("light", {"sampler": Sampler(start=3)}, "start is a setting of streams"),
        ("light", {"sampler": Sampler(guidance=-1.0)}, "guidance -1 is not in"),
    ],
)
def test_what_a_baseline_cannot_do(folders, kind, given, message):
    with pytest.raises(InputError, match=message):
        open_generator(folders[kind], device="cpu", **given)


def test_a_baseline_is_for_the_evaluation_only(folders, tiny_clips):
    with pytest.raises(InputError, match="is a baseline model, for `moveset evaluate`"):
        ModelFolder(folders["light"], ClipConfig)
    with pytest.raises(InputError, match="is a text-to-motion model"):
        ModelFolder(tiny_clips, BaselineConfig)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"frames": 1}, "frames 1 is no whole number in 2"),
        ({"schedule": "sine"}, "unknown schedule"),
        ({"predict": "v"}, "unknown schedule 'linear' or prediction 'v'"),
        ({"eta": 2.0}, "eta 2.0 is not in 0 to 1"),
        ({"sampler_steps": 5000}, "sampler_steps 5000"),
        ({"guidance": {"denoiser": -1.0}}, "guidance of a network"),
    ],
)
def test_settings_that_no_baseline_has(tmp_path, changed, message):
    model = LightT2MConfig(features=269, frames=60, text_dim=384, width=32, stages=1, groups=4, rank=4).build()
    mean = standing_features()
    config = BaselineConfig(name="x", **({"frames": 60} | changed))
    with pytest.raises(FormatError, match=message):
        save_model(
            tmp_path / "x", config, {"denoiser": model}, {"feature_mean": mean, "feature_std": mean + 1}, CAPTIONS,
            torch.zeros(len(CAPTIONS), 384),
        )  # fmt: skip


def test_chunks_need_a_pose_to_start_from(tmp_path):
    config, mean = BaselineConfig(name="x", frames=12, prefix=5), standing_features()
    with pytest.raises(ValueError, match="lacks 'idle'"):
        save_model(tmp_path / "x", config, {}, {"feature_mean": mean, "feature_std": mean}, [], mean)
