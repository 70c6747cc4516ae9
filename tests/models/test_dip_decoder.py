"""DiP's decoder: its size and cost, torch's decoder layer as oracle, and what may not matter."""

import pytest
import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from moveset.errors import InputError
from moveset.models.condition import PastSegment
from moveset.models.dip_decoder import DipDecoderConfig
from tests.conditions import condition_of

TINY = DipDecoderConfig(features=5, prefix=3, frames=6, text_dim=7, width=12, layers=2, heads=2, feed_forward=16)


@pytest.fixture(scope="module")
def model():
    torch.manual_seed(0)
    return TINY.build().eval()


def dip(network, x, t, prefix, tokens, mask, mask_Bn=None):
    return network(x, t, condition_of(tokens, mask, past=PastSegment.clean(prefix), valid=mask_Bn))


@pytest.fixture
def inputs():
    g = torch.Generator().manual_seed(1)
    x, prefix, tokens = (torch.randn(3, *shape, generator=g) for shape in ((6, 5), (3, 5), (4, 7)))
    return x, torch.tensor([1, 5, 10]), prefix, tokens, torch.arange(4) < torch.tensor([4, 2, 1])[:, None]


def test_published_size_shape_and_cost():
    with torch.device("meta"):
        model = DipDecoderConfig().build().eval()
        x, prefix, tokens = torch.empty(1, 40, 263), torch.empty(1, 20, 263), torch.empty(1, 20, 768)
        with FlopCounterMode(display=False) as counter:
            out = dip(model, x, torch.ones(1, dtype=torch.long), prefix, tokens, torch.ones(1, 20, dtype=torch.bool))
    assert out.shape == x.shape
    a_layer = 2 * 4 * 513 * 512 + 513 * 1024 + 1025 * 512 + 3 * 1024
    whole = 8 * a_layer + 264 * 512 + 513 * 263 + 769 * 512 + 2 * 513 * 512
    assert sum(p.numel() for p in model.parameters()) == whole == 26_424_583
    assert counter.get_total_flops() == pytest.approx(2.8e9, rel=0.03)  # with a caption of twenty tokens


def test_it_is_torch_s_decoder_on_prefix_and_frames(model, inputs):
    x, t, prefix, tokens, mask = inputs
    c = TINY
    stock = nn.TransformerDecoder(
        nn.TransformerDecoderLayer(c.width, c.heads, c.feed_forward, activation="gelu", batch_first=True), c.layers
    ).eval()
    names = {
        "itself.inward": "self_attn.in_proj_",
        "itself.outward": "self_attn.out_proj.",
        "memory.inward": "multihead_attn.in_proj_",
        "memory.outward": "multihead_attn.out_proj.",
        "inward": "linear1.",
        "outward": "linear2.",
        "itself_norm": "norm1.",
        "memory_norm": "norm2.",
        "norm": "norm3.",
    }
    state = {}
    for key, value in model.layers.state_dict().items():
        layer, name, kind = key.split(".")[0], ".".join(key.split(".")[1:-1]), key.split(".")[-1]
        state[f"layers.{layer}.{names[name]}{kind}"] = value
    stock.load_state_dict(state)

    def table(places):
        angle = places[:, None] / 10000 ** (torch.arange(0, c.width, 2) / c.width)
        return torch.stack((angle.sin(), angle.cos()), dim=-1).flatten(1)

    frames = model.frames_in(torch.cat((prefix, x), dim=1)) + table(torch.arange(9.0))
    memory = torch.cat((model.time(table(t.float()))[:, None], model.text_in(tokens)), dim=1)
    away = torch.cat((torch.zeros(3, 1).bool(), ~mask), dim=1)
    expected = model.out(stock(frames, memory, memory_key_padding_mask=away)[:, 3:])
    torch.testing.assert_close(dip(model, *inputs), expected)


def test_every_frame_sees_prefix_time_and_text(model, inputs):
    x, t, prefix, tokens, mask = inputs
    base = dip(model, *inputs)
    for changed in [
        (x + torch.eye(6)[5][:, None], t, prefix, tokens, mask),
        (x, t + 3, prefix, tokens, mask),
        (x, t, prefix + torch.eye(3)[0][:, None], tokens, mask),
        (x, t, prefix, -tokens, mask),
    ]:
        assert ((dip(model, *changed) - base).abs().amax(dim=-1) > 0).all()


def test_other_lengths_are_one_sentence(model, inputs):
    x, t, prefix, *text = inputs
    with pytest.raises(InputError, match="prefix of 2 frames does not fit this model; give it 3"):
        dip(model, x, t, prefix[:, :2], *text)
    with pytest.raises(InputError, match="prediction of 5 frames"):
        dip(model, x[:, :5], t, prefix, *text)
