"""Streams that make segments ahead, in a thread of their own."""

import itertools

import pytest
import torch

from moveset.pipelines.model_config import StreamConfig
from moveset.pipelines.model_folder import ModelFolder
from moveset.pipelines.motion_stream import MotionStream
from moveset.pipelines.stream_settings import check_stream
from tests.streams import FRAMES, tiny_stream

WALK, BOW = "a person walks forward", "a person bows politely"


@pytest.fixture
def opened(tmp_path, encoder):
    """Open a stream; networks are read once."""
    bundle = ModelFolder.open(tiny_stream(tmp_path / "tiny-stream"), StreamConfig)
    return lambda prompt=WALK, seconds=None, **options: MotionStream(
        bundle, check_stream(bundle.config, prompt, seconds, **options), device="cpu", encoder=encoder
    )


def take(stream, count):
    return list(itertools.islice(stream, count))


def same(one, two):
    return torch.equal(one.motion.rotations, two.motion.rotations) and torch.equal(one.motion.root, two.motion.root)


def test_a_buffer_changes_nothing_but_the_time(opened):
    plain_ones, ahead = take(opened(), 6), opened(buffer=2)
    first = take(ahead, 2)
    state = ahead.state()
    frame = ahead.prompt(BOW)
    # Two segments are there already, of prompts that cannot be changed any more.
    assert frame == 4 * FRAMES
    more = take(ahead, 3)
    assert all(map(same, plain_ones[:4], [*first, *more[:2]]))
    assert more[2].prompt == BOW
    for one, two in zip(plain_ones[2:], take(opened().restore(state), 4), strict=True):
        assert same(one, two)


@pytest.mark.parametrize("buffer", [0, 1, 4])
def test_a_state_may_be_restored_again_and_again_while_the_stream_makes_ahead(opened, buffer):
    stream = opened([WALK, BOW], 3.0, buffer=buffer, seed=3)
    take(stream, 2)
    state = stream.state()
    expected = take(stream, 5)
    for _ in range(3):
        # Segments are still being made by then.
        again = take(stream.restore(state), 5)
        assert [one.number for one in again] == [one.number for one in expected]
        assert all(map(same, expected, again))
