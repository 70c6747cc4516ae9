"""The autoencoder's trainings: what suits which features, and whose sizes a decoder that goes on has."""

from types import SimpleNamespace

import pytest
import torch

from moveset.errors import InputError
from moveset.models.token_vae import TokenVAEConfig
from moveset.motion.features import Normalizer, get_codec
from moveset.training import vae
from moveset.training.trained import TrainedNetwork, load_trained
from tests.training.hml_folder import write_folder


def test_a_loss_of_native_features_is_refused_for_others(tiny_run, tmp_path):
    data = write_folder(tmp_path / "data")
    with pytest.raises(InputError, match="loss=published"):
        tiny_run.train("vae", tmp_path / "vae", "loss=kinematic", corpus=data)
    task, result = tiny_run.train("vae", tmp_path / "vae", corpus=data, steps=1)
    assert result.step == 1
    assert (task.config.codec, task.config.loss, task.vae.config.features) == ("hml", "published", 263)


def test_motion_is_measured_in_full_precision_whatever_networks_compute_in(tiny_run, tmp_path):
    """Real motion is the same motion; and so is a latent's, as students of clips are asked for limbs in it."""
    task, _ = tiny_run.train("vae", tmp_path / "vae", steps=1)
    at = SimpleNamespace(device=torch.device("cpu"))
    data = tiny_run.train("pcm-1", tmp_path / "pcm", steps=1)[0].data
    batch = data.val.batch(4, 0, 0)
    features = data.vae.module.decode(batch.z0, batch.frames, int(batch.frames.max()))
    data.vae.module.decode = lambda *given: features
    plain, joints = task.validate(1, at), data.joints(batch.z0, batch.frames)
    with torch.autocast("cpu", torch.bfloat16):
        mixed, joints_mixed = task.validate(1, at), data.joints(batch.z0, batch.frames)
    for name in ("real_jerk", "real_skating"):
        assert mixed[name] == plain[name]
    assert joints_mixed.equal(joints)


@pytest.mark.parametrize("name", ["hml", "kit"])
def test_whoever_glides_skates_on_any_skeleton(name):
    codec = get_codec(name)
    still = codec.skeleton.rest_positions
    still = still - still[list(codec.skeleton.feet), 1].min() * torch.tensor([0.0, 1.0, 0.0])
    (features,) = codec.encode_clips([still + torch.arange(40)[:, None, None] * torch.tensor([0.0, 0.0, 0.1])])
    plain = Normalizer(torch.zeros(codec.dim), torch.ones(codec.dim))
    store = SimpleNamespace(normalizer=plain, batch=lambda crops: (features[None], torch.tensor([len(features)])))
    kept = SimpleNamespace(encode=lambda x, lengths: (x,), decode=lambda z, lengths, frames: z)
    report = vae.reconstruction_report(kept, store, [None], codec, torch.device("cpu"))
    assert report["skating"] == report["real_skating"] > 0.9


def test_a_decoder_has_the_sizes_of_the_autoencoder_that_it_is_of(tiny_run, tmp_path):
    task, result = tiny_run.train("decoder", tmp_path / "decoder", "model.width=24", steps=1)
    found = load_trained(result.checkpoint, "vae_ema")
    assert task.vae.config.width == found.module.config.width == found.task["model"]["width"] == 32


def test_a_decoder_that_goes_on_from_another_has_the_encoder_of_its_own_autoencoder(tiny_run, tmp_path):
    _, given = tiny_run.train("vae", tmp_path / "vae", "lr=0.01", steps=2)
    _, result = tiny_run.train(
        "decoder", tmp_path / "decoder", sources={"vae": given.checkpoint}, init=tiny_run.runs / "decoder", steps=1
    )
    encoder = load_trained(given.checkpoint, "vae_ema").module.encoder.state_dict()
    for name in ("vae", "vae_ema"):
        found = load_trained(result.checkpoint, name).module.encoder.state_dict()
        assert all(found[key].equal(encoder[key]) for key in encoder)


def test_only_a_timed_autoencoders_decoder_goes_on(tiny_run, tmp_path, monkeypatch):
    loaded = TrainedNetwork(TokenVAEConfig(width=32, layers=3, heads=2).build(), "token_vae", {}, {}, "", tmp_path)
    monkeypatch.setattr(vae, "load_trained", lambda *given: loaded)
    with pytest.raises(InputError, match="token_vae"):
        tiny_run.train("decoder", tmp_path / "decoder", steps=1)
