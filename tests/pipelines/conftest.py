"""What the tests of streams share: a tiny model of random weights, and the text encoder."""

import pytest

from moveset.pipelines.model_config import StreamConfig
from moveset.pipelines.model_folder import ModelFolder
from moveset.pipelines.motion_stream import MotionStream
from moveset.pipelines.stream_settings import check_stream
from moveset.text.encoder import get_text_encoder


@pytest.fixture(scope="session")
def bundle(tiny_streams):
    return ModelFolder.open(tiny_streams, StreamConfig)


@pytest.fixture(scope="session")
def encoder():
    return get_text_encoder("minilm")


@pytest.fixture
def opened(bundle, encoder):
    """Open a stream; networks are read once."""

    def open_stream(prompt="a person walks forward", seconds=None, *, seed_motion=None, **options):
        request = check_stream(bundle.config, prompt, seconds, **options)
        return MotionStream(bundle, request, seed_motion=seed_motion, device="cpu", encoder=encoder)

    return open_stream
