"""Which models are offered, and what is suggested."""

from pathlib import Path

import pytest
import torch

from moveset.errors import InputError
from moveset.pipelines.stream_settings import check_stream
from moveset.server import catalog as catalog_module
from moveset.server.catalog import Catalog, representative
from moveset.server.failures import RequestError
from tests.bundles import tiny_bundle


def test_suggestions_stand_for_all_and_what_is_said_most_comes_first():
    around = torch.tensor([[1.0, 0.0], [0.96, 0.28], [0.96, -0.28], [0.0, 1.0], [-1.0, 0.0], [-0.8, 0.6]])
    names = ["east", "north-east", "south-east", "north", "west", "north-west"]
    assert representative(names, around, 1) == ["north-east"]  # it is near the north, too
    assert representative(names, around, 2) == ["north-east", "north-west"]
    assert sorted(representative(names, around)) == sorted(names)
    assert representative(["x" * 100, "short"], around[:2], 2) == ["short"]
    assert representative(["one. two", "one"], around[:2], 2) == ["one"]
    assert representative(["x" * 100], around[:1], 2) == ["x" * 100]


def test_a_models_own_examples_are_suggested():
    catalog = Catalog([Path("motionpcm-small"), Path("rdm-small")], "cpu")
    for name, bundle in (("motionpcm-small", catalog.clip(None).bundle), ("rdm-small", catalog.stream(None))):
        assert catalog.suggestions(name) == list(bundle.config.examples)
        assert len(bundle.config.examples) > 10


def test_streams_may_be_made_in_fewer_steps():
    catalog = Catalog([Path("rdm-small")], "cpu")
    (row,) = (row for row in catalog.describe() if row["name"] == "rdm-small")
    assert (row["steps"], row["default_steps"]) == ([2, 5, 10], 10)
    bundle = catalog.stream(None)
    for steps in row["steps"]:
        settings = catalog.request(bundle, None, 0, steps, None).settings
        assert (settings.steps, settings.sequential, settings.network) == (steps, True, "rdm")


def test_nobody_may_ask_a_sampler_for_more_than_its_own_steps():
    catalog = Catalog([Path("rdm-small")], "cpu")
    bundle = catalog.stream(None)
    for steps in range(1, 11):
        assert catalog.request(bundle, None, 0, steps, None).settings.steps == steps
    for steps in (11, 300, 1000):
        with pytest.raises(InputError, match=f"^{steps} steps are more than the limit of 10 of model 'rdm-small'; "):
            catalog.request(bundle, None, 0, steps, None)


def test_models_are_known_by_name(models, tmp_path):
    catalog = Catalog(models, "cpu")
    assert catalog.clip(None) is catalog.clip("tiny")
    assert catalog.stream(None) is catalog.stream("tiny-stream")
    for wrong in ("tiny-stream", str(models[0]), "../tiny", ""):
        with pytest.raises(RequestError, match="no model"):
            catalog.clip(wrong)
    with pytest.raises(InputError, match="two models are called 'tiny'"):
        Catalog([models[0], tiny_bundle(tmp_path / "tiny")], "cpu")
    only = Catalog([models[0]], "cpu")
    assert only.default == {"clip": "tiny", "stream": None}
    with pytest.raises(RequestError, match="start the server with one"):
        only.stream(None)


def test_the_encoder_is_shared(models):
    catalog = Catalog(models, "cpu")
    bundle = catalog.stream(None)
    settings = [catalog.request(bundle, None, 0, 1, w).settings for w in (0.0, 3.0)]
    batches = [catalog.batch(bundle, one) for one in settings]
    assert batches[0] is batches[1]
    assert catalog.ready(catalog.clip(None)).encoder is batches[0].encoder


def test_batches_of_any_settings_do_not_pile_up(models):
    catalog = Catalog([models[1]], "cpu")
    bundle = catalog.stream(None)

    def batch(steps):
        settings = check_stream(bundle.config, network="md", steps=steps).settings
        return catalog.batch(bundle, settings)

    first = batch(1)
    assert batch(1) is first
    for steps in range(2, 60):
        batch(steps)
        assert batch(1) is first  # in use, so it stays
    assert len(catalog._batches) == catalog_module._BATCHES
