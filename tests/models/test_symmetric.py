"""A network with its mirror image leans to neither side."""

import pytest
import torch
from torch import nn

from moveset.models.segment_transformer import SegmentTransformerConfig
from moveset.models.symmetric import Symmetric
from moveset.motion.native import NativeCodec
from tests.conditions import call
from tests.motions import wander

CODEC = NativeCodec()
ORDER, SIGNS = CODEC.mirror()


def awake(**options):
    """A network whose zero-initialised layers speak."""
    torch.manual_seed(0)
    made = SegmentTransformerConfig(
        features=CODEC.dim, frames=8, text_dim=5, width=16, heads=2, hidden=32, blocks=1, **options
    ).build()
    for parameter in made.parameters():
        nn.init.normal_(parameter, std=0.1)
    return made.eval()


@pytest.fixture
def network():
    return awake(guided=True)


def inputs():
    torch.manual_seed(1)
    x, prev = torch.randn(2, 3, 8, CODEC.dim)
    said, mirrored = torch.randn(2, 3, 4, 5)
    return x, torch.tensor([999, 500, 10]), prev, torch.zeros(3).long(), torch.tensor([0, 1, 2]), said, mirrored


def even_call(even, x, t, prev, prev_t, index, said, mirrored, w=1.0, **more):
    mask = torch.ones(said.shape[:2], dtype=torch.bool)
    scale = None if w is None else torch.full((len(x),), w)
    with torch.no_grad():
        return call(even, x, t, prev, prev_t, index, said, mask, scale, mirrored_BLC=mirrored, **more)


def alone_call(network, x, t, prev, prev_t, index, said, w=1.0, **more):
    with torch.no_grad():
        return even_call(network, x, t, prev, prev_t, index, said, None, w, **more)


def test_features_of_the_mirror_image_are_the_mirrored_features():
    motion = wander(30, 4, bend=1.0)
    torch.testing.assert_close(CODEC.encode(motion.mirrored()), CODEC.encode(motion)[:, ORDER] * SIGNS)
    assert torch.equal(ORDER[ORDER], torch.arange(CODEC.dim))
    assert torch.equal(SIGNS[ORDER], SIGNS)


def test_the_mean_of_a_segment_mirrors_with_everything_it_is_made_from(network):
    even = Symmetric(network, ORDER, SIGNS)
    x, t, prev, prev_t, index, said, mirrored = inputs()
    one = even_call(even, x, t, prev, prev_t, index, said, mirrored)
    two = even_call(even, even.flipped(x), t, even.flipped(prev), prev_t, index, mirrored, said)
    torch.testing.assert_close(even.flipped(two.mean(dim=1)), one.mean(dim=1), atol=1e-5, rtol=0)
    alone = alone_call(network, x, t, prev, prev_t, index, said)
    other = alone_call(network, even.flipped(x), t, even.flipped(prev), prev_t, index, mirrored)
    assert (even.flipped(other) - alone).mean(dim=1).abs().max() > 0.01  # it alone is not even-handed


def test_nothing_but_the_mean_over_frames_is_changed(network):
    even = Symmetric(network, ORDER, SIGNS)
    x, t, prev, prev_t, index, said, mirrored = inputs()
    made = even_call(even, x, t, prev, prev_t, index, said, mirrored)
    alone = alone_call(network, x, t, prev, prev_t, index, said)
    moved = made - alone
    assert moved.abs().max() > 0.01
    torch.testing.assert_close(moved, moved[:, :1].expand_as(moved), atol=1e-5, rtol=0)


def test_both_images_have_turned_to_opposite_sides():
    network, given = awake(heading_change=True), {"turned_B": torch.tensor([0.0, 1.0, -2.0])}
    even, (x, t, prev, prev_t, index, said, mirrored) = Symmetric(network, ORDER, SIGNS), inputs()
    made = even_call(even, x, t, prev, prev_t, index, said, mirrored, None, **given)
    one = alone_call(network, x, t, prev, prev_t, index, said, None, **given)
    flipped = even.flipped(x), t, even.flipped(prev)
    other = even.flipped(alone_call(network, *flipped, prev_t, index, mirrored, None, turned_B=-given["turned_B"]))
    torch.testing.assert_close(made.mean(dim=1), (one + other).mean(dim=1) / 2, atol=1e-5, rtol=0)


def test_rows_do_not_mix(network):
    even = Symmetric(network, ORDER, SIGNS)
    x, t, prev, prev_t, index, said, mirrored = inputs()
    whole = even_call(even, x, t, prev, prev_t, index, said, mirrored)
    row = slice(1, 2)
    alone = even_call(even, x[row], t[row], prev[row], prev_t[row], index[row], said[row], mirrored[row])
    torch.testing.assert_close(alone, whole[row], atol=1e-5, rtol=0)
