"""Sides beside sentences: written onto the first token alone, and now and then left out."""

import torch

from moveset.text.encoder import TextEmbedding
from moveset.text.sides import forget, with_sides


def sentences(count=3):
    generator = torch.Generator().manual_seed(0)
    tokens = torch.randn(count, 5, 12, generator=generator)
    return TextEmbedding(tokens, torch.ones(count, 5, dtype=torch.bool), torch.randn(count, 12, generator=generator))


def test_what_is_not_said_leaves_a_sentence_as_it_is():
    text = sentences()
    assert with_sides(text, torch.full((3, 3), torch.nan)) is text
    some = with_sides(text, torch.tensor([[1.0, torch.nan, torch.nan], [torch.nan] * 3, [torch.nan] * 3]))
    assert torch.equal(some.tokens[1:], text.tokens[1:])
    assert torch.equal(some.tokens[0, 1:], text.tokens[0, 1:])


def test_left_right_and_neither_are_told_apart_and_opposite_sides_are_opposite():
    text = sentences(1)
    said = {
        side: with_sides(text, torch.tensor([[torch.nan, side, torch.nan]])).tokens[0, 0] for side in (1.0, 0.0, -1.0)
    }
    plain = text.tokens[0, 0]
    torch.testing.assert_close(said[1.0] - said[0.0], said[0.0] - said[-1.0])
    assert all(not torch.equal(one, plain) for one in said.values())


def test_sides_are_left_out_as_often_as_asked():
    draws = torch.Generator().manual_seed(1)
    kept = ~forget(torch.ones(4000, 3), 0.4, draws).isnan()
    assert abs(float(kept.any(dim=1).float().mean()) - 0.6 * 7 / 8) < 0.03
    assert abs(float(kept.float().mean()) - 0.3) < 0.02
    assert not (~forget(torch.ones(50, 3), 1.0, draws).isnan()).any()
