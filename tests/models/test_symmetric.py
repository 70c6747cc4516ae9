"""A network with its mirror image leans to neither side."""

import pytest
import torch
from torch import nn

from moveset.models.segment_transformer import SegmentTransformerConfig
from moveset.models.symmetric import Symmetric
from moveset.motion.native import NativeCodec
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


def inputs(rows=3):
    torch.manual_seed(1)
    x, prev = torch.randn(2, rows, 8, CODEC.dim)
    t, index = torch.tensor([999, 500, 10])[:rows], torch.tensor([0, 1, 2])[:rows]
    said, mirrored = torch.randn(2, rows, 4, 5)
    return x, t, prev, torch.zeros(rows).long(), index, said, mirrored


def call(even, x, t, prev, prev_t, index, said, mirrored):
    tokens = torch.cat((said, mirrored))
    mask = torch.ones(tokens.shape[:2], dtype=torch.bool)
    with torch.no_grad():
        return even(x, t, prev, prev_t, index, tokens, mask, torch.ones(len(x)))


def test_features_of_the_mirror_image_are_the_mirrored_features():
    motion = wander(30, 4, bend=1.0)
    torch.testing.assert_close(CODEC.encode(motion.mirrored()), CODEC.encode(motion)[:, ORDER] * SIGNS)
    assert torch.equal(ORDER[ORDER], torch.arange(CODEC.dim))
    assert torch.equal(SIGNS[ORDER], SIGNS)


def test_the_mean_of_a_segment_mirrors_with_everything_it_is_made_from(network):
    even = Symmetric(network, ORDER, SIGNS)
    x, t, prev, prev_t, index, said, mirrored = inputs()
    one = call(even, x, t, prev, prev_t, index, said, mirrored)
    two = call(even, even.flipped(x), t, even.flipped(prev), prev_t, index, mirrored, said)
    torch.testing.assert_close(even.flipped(two.mean(dim=1)), one.mean(dim=1), atol=1e-5, rtol=0)
    alone = network(x, t, prev, prev_t, index, said, torch.ones(said.shape[:2], dtype=torch.bool), torch.ones(3))
    other = network(
        even.flipped(x), t, even.flipped(prev), prev_t, index, mirrored, torch.ones(said.shape[:2], dtype=torch.bool),
        torch.ones(3),
    )  # fmt: skip
    assert (even.flipped(other) - alone).mean(dim=1).abs().max() > 0.01  # it alone is not even-handed


def test_nothing_but_the_mean_over_frames_is_changed(network):
    even = Symmetric(network, ORDER, SIGNS)
    x, t, prev, prev_t, index, said, mirrored = inputs()
    made = call(even, x, t, prev, prev_t, index, said, mirrored)
    with torch.no_grad():
        alone = network(x, t, prev, prev_t, index, said, torch.ones(said.shape[:2], dtype=torch.bool), torch.ones(3))
    moved = made - alone
    assert moved.abs().max() > 0.01
    torch.testing.assert_close(moved, moved[:, :1].expand_as(moved), atol=1e-5, rtol=0)


def test_both_images_are_at_the_same_place():
    network = awake(placed=True)
    even, (x, t, prev, prev_t, index, said, mirrored) = Symmetric(network, ORDER, SIGNS), inputs()
    place = torch.tensor([[0.0, 40.0], [8.0, 32.0], [-1.0, -1.0]])
    mask = torch.ones(said.shape[:2], dtype=torch.bool)
    with torch.no_grad():
        made = even(x, t, prev, prev_t, index, torch.cat((said, mirrored)), mask.repeat(2, 1), place_B2=place)
        one = network(x, t, prev, prev_t, index, said, mask, place_B2=place)
        flipped = even.flipped(x), t, even.flipped(prev)
        other = even.flipped(network(*flipped, prev_t, index, mirrored, mask, place_B2=place))
    torch.testing.assert_close(made.mean(dim=1), (one + other).mean(dim=1) / 2, atol=1e-5, rtol=0)


def test_the_mirror_image_has_turned_to_the_other_side():
    network = awake(coursed=True)
    even, (x, t, prev, prev_t, index, said, mirrored) = Symmetric(network, ORDER, SIGNS), inputs()
    turned = torch.tensor([0.0, 1.0, -2.0])
    mask = torch.ones(said.shape[:2], dtype=torch.bool)
    with torch.no_grad():
        made = even(x, t, prev, prev_t, index, torch.cat((said, mirrored)), mask.repeat(2, 1), turned_B=turned)
        one = network(x, t, prev, prev_t, index, said, mask, turned_B=turned)
        flipped = even.flipped(x), t, even.flipped(prev)
        other = even.flipped(network(*flipped, prev_t, index, mirrored, mask, turned_B=-turned))
    torch.testing.assert_close(made.mean(dim=1), (one + other).mean(dim=1) / 2, atol=1e-5, rtol=0)


def test_rows_do_not_mix(network):
    even = Symmetric(network, ORDER, SIGNS)
    x, t, prev, prev_t, index, said, mirrored = inputs()
    whole = call(even, x, t, prev, prev_t, index, said, mirrored)
    row = slice(1, 2)
    alone = call(even, x[row], t[row], prev[row], prev_t[row], index[row], said[row], mirrored[row])
    torch.testing.assert_close(alone, whole[row], atol=1e-5, rtol=0)
