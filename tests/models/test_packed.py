"""Packed layers compute what the plain ones do."""

import pytest
import torch
from torch import nn
from torch.nn import functional as fn

from moveset.models.latent_denoiser import LatentDenoiserConfig
from moveset.models.packed import PackedTimeConv, pack
from moveset.models.timed_vae import TimedVAEConfig
from moveset.text.packed_linear import PackedLinear, can_pack
from tests.conditions import condition_of

pytestmark = pytest.mark.skipif(not can_pack("cpu"), reason="this build of torch has no oneDNN")


@pytest.mark.parametrize("rows", [1, 16, 48, 512])
@pytest.mark.parametrize("bias", [True, False])
def test_linear(rows, bias):
    layer = nn.Linear(96, 160, bias=bias)
    x = torch.randn(2, rows, 96)
    torch.testing.assert_close(PackedLinear.of(layer)(x), layer(x).detach(), atol=1e-5, rtol=1e-5)


def test_what_follows_a_layer_is_part_of_it():
    layer, x, other = nn.Linear(96, 160), torch.randn(2, 9, 96), torch.randn(2, 9, 160)
    plain = layer(x).detach()
    for post, approximate in (("gelu", "none"), ("tanh_gelu", "tanh")):
        expected = fn.gelu(plain, approximate=approximate)
        torch.testing.assert_close(PackedLinear.of(layer, post)(x), expected, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(PackedLinear.of(layer).plus(x, other), plain + other, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("kernel", [1, 3, 5])
@pytest.mark.parametrize("batch", [1, 3])
def test_convolution_over_time(kernel, batch):
    layer, gain = nn.Conv1d(32, 48, kernel, padding=kernel // 2), torch.rand(32, 1)
    x, other = torch.randn(batch, 49, 32), torch.randn(batch, 49, 48)
    plain = layer((x * gain[:, 0]).transpose(1, 2)).transpose(1, 2).detach()
    conv = PackedTimeConv(layer, gain)
    torch.testing.assert_close(conv(x), plain, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(conv.plus(x, other), plain + other, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("batch", [1, 3])
@pytest.mark.parametrize("guided", [True, False])
@pytest.mark.parametrize("padded", [True, False])
@pytest.mark.parametrize("carried", [True, False])
@torch.inference_mode()
def test_the_denoiser_keeps_its_output(batch, guided, padded, carried):
    torch.manual_seed(0)
    denoiser = perturbed(LatentDenoiserConfig(width=64, hidden=128, blocks=3, guided=guided, carried=carried).build())
    mask = torch.arange(9) < torch.tensor([6, 9, 7])[:batch, None] if padded else torch.ones(batch, 9, dtype=torch.bool)
    given, tokens = (torch.randn(batch, 16, 32), torch.tensor([999, 499, 0])[:batch]), torch.randn(batch, 9, 384)
    scale = {"scale": torch.tensor([3.0, 5.0, 0.0])[:batch]} if guided else {}
    length = torch.tensor([80, 196, 20])[:batch]
    conditions = [condition_of(tokens, mask, length=length, **scale), condition_of(tokens, mask)]
    taps = [[], []]
    plain = [denoiser(*given, condition, taps[0]) for condition in conditions]
    assert float(plain[0].abs().mean()) > 0.1
    packed = pack(denoiser)
    for expected, condition in zip(plain, conditions, strict=True):
        torch.testing.assert_close(packed(*given, condition, taps[1]), expected, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(taps[1], taps[0], atol=1e-4, rtol=1e-4)


@torch.inference_mode()
def test_a_sentence_longer_than_any_that_was_learned_is_read_as_far_as_there_are_places():
    denoiser = perturbed(LatentDenoiserConfig(width=64, hidden=128, blocks=3).build())
    given, tokens = (torch.randn(1, 16, 32), torch.tensor([999])), torch.randn(1, 128, 384)
    for network in (denoiser, pack(denoiser)):
        assert torch.equal(network(*given, condition_of(tokens)), network(*given, condition_of(tokens[:, :64])))


@pytest.mark.parametrize("lengths", [[196], [50], [190], [97, 97], [50, 196, 21]])
@torch.inference_mode()
def test_the_vae_keeps_its_output(lengths):
    torch.manual_seed(0)
    vae = perturbed(TimedVAEConfig(width=64, frame_width=32).build())
    z, lengths_B, frames = torch.randn(len(lengths), 16, 32), torch.tensor(lengths), max(lengths)
    plain = vae.decode(z, lengths_B, frames)
    assert float(plain.abs().mean()) > 0.1
    back = vae.encode(plain, lengths_B)
    packed = pack(vae)
    torch.testing.assert_close(packed.decode(z, lengths_B, frames), plain, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(packed.encode(plain, lengths_B), back, atol=1e-4, rtol=1e-4)


def test_what_others_read_is_left_alone():
    attention = nn.MultiheadAttention(16, 2)
    x = torch.randn(3, 1, 16)
    plain = attention(x, x, x)[0].detach()
    torch.testing.assert_close(pack(attention)(x, x, x)[0].detach(), plain)
    assert isinstance(pack(nn.Sequential(nn.Sequential(nn.Linear(2, 2))))[0][0], PackedLinear)


def perturbed(model):
    """Away from its initial weights, many of which are zero: nothing would be compared."""
    for p in model.parameters():
        p.add_(0.1 * torch.randn(p.shape))
    return model.eval()
