"""The autoencoder's trainings: what suits which features, and whose sizes a decoder that goes on has."""

import pytest

from moveset.data.synthetic import synthetic_corpus
from moveset.errors import InputError
from moveset.models.token_vae import TokenVAEConfig
from moveset.training import vae
from moveset.training.trained import TrainedNetwork, load_trained
from tests.training.hml_folder import write_folder
from tests.training.recurrent import trained


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("vae")
    synthetic_corpus(folder / "corpus.safetensors", clips=12, seed=0)
    return folder


def test_a_loss_of_native_features_is_refused_for_others(tmp_path):
    data = write_folder(tmp_path / "data")
    with pytest.raises(InputError, match="loss=published"):
        trained(tmp_path, "vae", tmp_path / "vae", "loss=kinematic", corpus=data)
    task, result = trained(tmp_path, "vae", tmp_path / "vae", corpus=data, steps=1)
    assert result.step == 1
    assert (task.config.codec, task.config.loss, task.vae.config.features) == ("hml", "published", 263)


def test_a_decoder_has_the_sizes_of_the_autoencoder_that_it_is_of(folder):
    trained(folder, "vae", folder / "vae", "model.width=24", steps=1)
    task, result = trained(folder, "decoder", folder / "decoder", steps=1)
    found = load_trained(result.checkpoint, "vae_ema")
    assert task.vae.config.width == found.module.config.width == found.task["model"]["width"] == 24


def test_only_a_timed_autoencoders_decoder_goes_on(folder, tmp_path, monkeypatch):
    loaded = TrainedNetwork(TokenVAEConfig(width=32, layers=3, heads=2).build(), "token_vae", {}, {}, "", tmp_path)
    monkeypatch.setattr(vae, "load_trained", lambda *given: loaded)
    with pytest.raises(InputError, match="token_vae"):
        trained(folder, "decoder", tmp_path / "decoder", steps=1)
