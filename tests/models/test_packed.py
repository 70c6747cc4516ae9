"""Packed layers compute what the plain ones do."""

import pytest
import torch
from torch import nn

from moveset.models.latent_denoiser import LatentDenoiserConfig
from moveset.models.packed import PackedConv1d, PackedLinear, can_pack, pack
from moveset.models.timed_vae import TimedVAEConfig

pytestmark = pytest.mark.skipif(not can_pack("cpu"), reason="this build of torch has no oneDNN")


@pytest.mark.parametrize("rows", [1, 16, 48, 512])
@pytest.mark.parametrize("bias", [True, False])
def test_linear(rows, bias):
    layer = nn.Linear(96, 160, bias=bias)
    x = torch.randn(2, rows, 96)
    torch.testing.assert_close(PackedLinear(layer)(x), layer(x).detach(), atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize(
    ("kernel", "dilation", "stride", "groups"), [(1, 1, 1, 1), (3, 1, 1, 1), (5, 3, 1, 1), (4, 1, 2, 2)]
)
@pytest.mark.parametrize("time", [7, 49, 196])
def test_conv(kernel, dilation, stride, groups, time):
    padding = dilation * (kernel // 2)
    layer = nn.Conv1d(32, 48, kernel, stride=stride, padding=padding, dilation=dilation, groups=groups)
    x = torch.randn(3, 32, time)
    torch.testing.assert_close(PackedConv1d(layer)(x), layer(x).detach(), atol=1e-5, rtol=1e-5)


@torch.inference_mode()
def test_the_shipped_networks_keep_their_output():
    torch.manual_seed(0)
    denoiser = LatentDenoiserConfig(width=64, hidden=128, blocks=3, guided=True).build().eval()
    nn.init.normal_(denoiser.out.weight)  # zero at the start: nothing would be compared
    nn.init.normal_(denoiser.modulate_out.weight, std=0.1)
    given = (
        torch.randn(2, 16, 32),
        torch.tensor([999, 499]),
        torch.randn(2, 9, 384),
        torch.ones(2, 9, dtype=torch.bool),
    )
    more = (torch.tensor([3.0, 5.0]), None, torch.tensor([80, 196]))
    plain = denoiser(*given, *more)
    assert float(plain.abs().mean()) > 0.1
    torch.testing.assert_close(pack(denoiser)(*given, *more), plain, atol=1e-4, rtol=1e-4)

    vae = TimedVAEConfig(width=64, frame_width=32).build().eval()
    z, lengths = torch.randn(2, 16, 32), torch.tensor([50, 196])
    plain = vae.decode(z, lengths, 196)
    torch.testing.assert_close(pack(vae).decode(z, lengths, 196), plain, atol=1e-4, rtol=1e-4)


def test_what_others_read_is_left_alone():
    attention = nn.MultiheadAttention(16, 2)
    x = torch.randn(3, 1, 16)
    plain = attention(x, x, x)[0].detach()
    torch.testing.assert_close(pack(attention)(x, x, x)[0].detach(), plain)
    assert isinstance(pack(nn.Sequential(nn.Sequential(nn.Linear(2, 2))))[0][0], PackedLinear)
