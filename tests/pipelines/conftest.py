"""What the tests of streams share: a tiny model of random weights, and the text encoder."""

import pytest

from moveset.pipelines.model_config import StreamConfig
from moveset.pipelines.model_folder import ModelFolder
from moveset.text.encoder import get_text_encoder
from tests.streams import tiny_stream


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    return ModelFolder.open(tiny_stream(tmp_path_factory.mktemp("streams") / "tiny-stream"), StreamConfig)


@pytest.fixture(scope="module")
def encoder():
    return get_text_encoder("minilm")
