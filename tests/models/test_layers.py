import math

import pytest
import torch
from torch import nn

from moveset.errors import InputError
from moveset.models.layers import Block, Positions, TimeEmbedding, time_embedding
from moveset.models.skip_transformer import SkipTransformer
from moveset.models.token_denoiser import TokenDenoiserConfig


def _copy_attention(ours, theirs):
    with torch.no_grad():
        theirs.in_proj_weight.copy_(ours.inward.weight)
        theirs.in_proj_bias.copy_(ours.inward.bias)
        theirs.out_proj.load_state_dict(ours.outward.state_dict())


def _randomised(block):
    g = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for p in block.parameters():
            p.add_(torch.randn(p.shape, generator=g) * 0.1)
    return block.eval()


@pytest.mark.parametrize("cross", [False, True])
def test_a_block_is_torch_s_post_norm_layer(cross):
    block = _randomised(Block(32, 4, 64, 0.1, cross))
    layer_class = nn.TransformerDecoderLayer if cross else nn.TransformerEncoderLayer
    oracle = layer_class(32, 4, 64, 0.1, activation="gelu", batch_first=True, norm_first=False).eval()
    _copy_attention(block.attention, oracle.self_attn)
    oracle.linear1.load_state_dict(block.inward.state_dict())
    oracle.linear2.load_state_dict(block.outward.state_dict())
    norms = [block.attention_norm, block.cross_norm, block.norm] if cross else [block.attention_norm, block.norm]
    for k, norm in enumerate(norms, start=1):
        getattr(oracle, f"norm{k}").load_state_dict(norm.state_dict())
    x, memory = torch.randn(3, 7, 32), torch.randn(3, 5, 32)
    mask = torch.arange(7) < torch.tensor([7, 4, 1])[:, None]
    if cross:
        _copy_attention(block.cross, oracle.multihead_attn)
        ours, theirs = block(x, mask, memory), oracle(x, memory, tgt_key_padding_mask=~mask)
    else:
        ours, theirs = block(x, mask, None), oracle(x, src_key_padding_mask=~mask)
    torch.testing.assert_close(ours[mask], theirs[mask], atol=2e-6, rtol=1e-5)
    assert sum(p.numel() for p in block.parameters()) == sum(p.numel() for p in oracle.parameters())


def test_time_embedding_is_cosines_then_sines():
    e = time_embedding(torch.tensor([0, 999]), 768)
    assert e.shape == (2, 768)
    for i in (0, 1, 200, 383):
        angle = 999 * 10000 ** (-i / 384)
        assert math.isclose(e[1, i].item(), math.cos(angle), abs_tol=2e-4)
        assert math.isclose(e[1, 384 + i].item(), math.sin(angle), abs_tol=2e-4)
    assert e[0].sum() == 384


def test_guidance_goes_only_where_it_belongs():
    plain, distilled = TimeEmbedding(8, 12, None), TimeEmbedding(8, 12, 6)
    t, w = torch.tensor([3]), torch.ones(1, 6)
    with pytest.raises(InputError, match="does not take"):
        plain(t, w)
    with pytest.raises(InputError, match="needs"):
        distilled(t, None)


def test_positions_run_out_with_a_sentence():
    with pytest.raises(InputError, match="6 tokens exceeds the model's 5 positions"):
        Positions(5, 4)(torch.zeros(1, 6, 4))


@pytest.mark.parametrize(("cross", "count"), [(False, 7_633_664), (True, 10_006_784)])
def test_published_stack_sizes(cross, count):
    assert sum(p.numel() for p in SkipTransformer(TokenDenoiserConfig(), cross=cross).parameters()) == count


def test_skips_are_last_in_first_out():
    stack = SkipTransformer(TokenDenoiserConfig(width=8, layers=5, heads=2, feed_forward=16), cross=False).eval()
    inputs: list[torch.Tensor] = []
    for join in stack.joins:
        join.register_forward_hook(lambda _module, args, _out: inputs.append(args[0]))
    taps: list[torch.Tensor] = []
    stack(torch.randn(2, 3, 8), taps=taps)
    assert len(taps) == 5
    for fed, (current, partner) in zip(inputs, [(2, 1), (3, 0)], strict=True):
        assert torch.equal(fed, torch.cat((taps[current], taps[partner]), dim=-1))


@pytest.mark.parametrize("bad", [{"layers": 8}, {"heads": 3}, {"width": 0}, {"dropout": 1.0}])
def test_impossible_sizes_are_refused(bad):
    with pytest.raises(InputError):
        TokenDenoiserConfig(**bad)
