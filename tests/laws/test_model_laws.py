"""What every network here promises, whatever its architecture: add a builder to the lists and it must keep them too."""

import pytest
import torch

from moveset.models.latent_denoiser import LatentDenoiserConfig
from moveset.models.timed_vae import TimedVAEConfig
from moveset.models.token_denoiser import TokenDenoiserConfig
from moveset.models.token_vae import TokenVAEConfig

# Registered architectures at test size: 7 features, 3 latent tokens of 4 or one of 12; text tokens of 6.
VAES = {
    "token": lambda: TokenVAEConfig(
        features=7, tokens=3, token_dim=4, width=16, layers=3, heads=2, feed_forward=32, positions=40
    ).build(),
    "timed": lambda: TimedVAEConfig(features=7, tokens=3, token_dim=4, width=16, frame_width=8).build(),
    "global": lambda: TimedVAEConfig(features=7, tokens=1, slots=6, token_dim=12, width=16, frame_width=8).build(),
}
DENOISERS = {
    "token": lambda guidance: TokenDenoiserConfig(
        token_dim=4, text_dim=6, width=16, layers=3, heads=2, feed_forward=32, positions=30, guidance=guidance
    ).build(),
    "latent": lambda guidance: LatentDenoiserConfig(
        tokens=3, token_dim=4, text_dim=6, width=16, heads=2, hidden=32, blocks=3, guided=guidance
    ).build(),
    "carried": lambda guidance: LatentDenoiserConfig(
        tokens=3, token_dim=4, text_dim=6, width=16, heads=2, hidden=32, blocks=3, guided=guidance, carried=True
    ).build(),
}


def _rand(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def _latents(vae, count, seed=0):
    return _rand(count, vae.config.tokens, vae.config.token_dim, seed=seed)


def _close(a, b):
    torch.testing.assert_close(a, b, atol=1e-5, rtol=0)


def _perturbed(model):
    """Away from its initial weights: many start at zero, and a law must hold for all weights."""
    g = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for p in model.parameters():
            p.add_(0.1 * torch.randn(p.shape, generator=g))
    return model


@pytest.fixture(params=VAES)
def vae(request):
    torch.manual_seed(0)
    return _perturbed(VAES[request.param]())


@pytest.fixture(params=DENOISERS)
def denoiser(request):
    torch.manual_seed(0)
    return lambda guidance: _perturbed(DENOISERS[request.param](guidance))


LENGTHS = torch.tensor([20, 13, 5, 1])


class TestVAE:
    def test_gradients_reach_every_parameter(self, vae):
        vae.train()
        mean, log_variance = vae.encode(_rand(4, 20, 7), LENGTHS)
        z = mean + (0.5 * log_variance).exp() * _latents(vae, 4, seed=1)
        (vae.decode(z, LENGTHS, 20).square().mean() + mean.square().mean() + log_variance.square().mean()).backward()
        silent = [n for n, p in vae.named_parameters() if p.grad is None or not p.grad.any()]
        assert silent == []

    def test_what_stands_in_padding_does_not_matter(self, vae):
        vae.eval()
        x = _rand(4, 20, 7)
        padding = torch.arange(20) >= LENGTHS[:, None]
        clean = vae.encode(x, LENGTHS)
        for filler in (0.0, 1e6, float("nan")):
            dirty = vae.encode(x.masked_fill(padding[..., None], filler), LENGTHS)
            for a, b in zip(clean, dirty, strict=True):
                assert torch.isfinite(b).all()
                _close(a, b)

    def test_how_much_padding_there_is_does_not_matter(self, vae):
        vae.eval()
        x = _rand(4, 20, 7)
        longer = torch.cat((x, _rand(4, 11, 7, seed=2)), dim=1)
        for a, b in zip(vae.encode(x, LENGTHS), vae.encode(longer, LENGTHS), strict=True):
            _close(a, b)
        z = _latents(vae, 4)
        short, long = vae.decode(z, LENGTHS, 20), vae.decode(z, LENGTHS, 31)
        _close(short, long[:, :20])
        assert (long[:, 20:] == 0).all()

    def test_an_item_of_a_batch_is_the_item_alone(self, vae):
        vae.eval()
        x, z = _rand(4, 20, 7), _latents(vae, 4)
        means, log_variances = vae.encode(x, LENGTHS)
        decoded = vae.decode(z, LENGTHS, 20)
        for k, n in enumerate(LENGTHS.tolist()):
            mean, log_variance = vae.encode(x[k : k + 1, :n], LENGTHS[k : k + 1])
            _close(mean[0], means[k])
            _close(log_variance[0], log_variances[k])
            _close(vae.decode(z[k : k + 1], LENGTHS[k : k + 1], n)[0], decoded[k, :n])
            assert (decoded[k, n:] == 0).all()

    def test_every_frame_and_every_latent_token_counts(self, vae):
        vae.eval()
        x = _rand(1, 20, 7).requires_grad_()
        vae.encode(x, LENGTHS[:1])[0].square().sum().backward()
        assert (x.grad.abs().amax(-1) > 0).all()
        z = _latents(vae, 1).requires_grad_()
        vae.decode(z, LENGTHS[:1], 20).square().sum().backward()
        assert (z.grad.abs().amax(-1) > 0).all()

    def test_evaluation_is_deterministic(self, vae):
        vae.eval()
        z = _latents(vae, 4)
        assert torch.equal(vae.decode(z, LENGTHS, 20), vae.decode(z, LENGTHS, 20))


class TestDenoiser:
    def _inputs(self):
        mask = torch.arange(6) < torch.tensor([6, 3, 1, 2])[:, None]
        return _rand(4, 3, 4), torch.tensor([0, 99, 500, 999]), _rand(4, 6, 6, seed=3), mask

    @pytest.mark.parametrize("guidance", [False, True])
    def test_gradients_reach_every_parameter(self, denoiser, guidance):
        model = denoiser(guidance).train()
        w = torch.tensor([5.0, 8.0, 11.0, 15.0]) if guidance else None
        model(*self._inputs(), w).square().mean().backward()
        silent = [n for n, p in model.named_parameters() if p.grad is None or not p.grad.any()]
        assert silent == []

    def test_text_padding_does_not_matter(self, denoiser):
        model = denoiser(False).eval()
        z, t, tokens, mask = self._inputs()
        expected = model(z, t, tokens, mask)
        for filler in (0.0, 1e6):
            _close(model(z, t, tokens.masked_fill(~mask[..., None], filler), mask), expected)
        more = torch.cat((tokens, _rand(4, 5, 6, seed=4)), dim=1)
        _close(model(z, t, more, torch.cat((mask, torch.zeros(4, 5).bool()), dim=1)), expected)

    @pytest.mark.parametrize("guidance", [False, True])
    def test_an_item_of_a_batch_is_the_item_alone(self, denoiser, guidance):
        model = denoiser(guidance).eval()
        z, t, tokens, mask = self._inputs()
        w = torch.tensor([5.0, 8.0, 11.0, 15.0]) if guidance else None
        expected = model(z, t, tokens, mask, w)
        for k in range(4):
            alone = model(*(x[k : k + 1] for x in (z, t, tokens, mask)), None if w is None else w[k : k + 1])
            _close(alone[0], expected[k])

    def test_taps_are_the_latent_tokens_and_change_nothing(self, denoiser):
        model, taps = denoiser(False).eval(), []
        inputs = self._inputs()
        assert torch.equal(model(*inputs, None, taps), model(*inputs))
        assert len(taps) > 0
        assert {tuple(tap.shape) for tap in taps} == {(4, 3, taps[0].shape[-1])}

    def test_the_noise_of_every_token_depends_on_every_token(self, denoiser):
        model = denoiser(False).eval()
        z, *rest = self._inputs()
        z.requires_grad_()
        for n in range(3):
            (grad,) = torch.autograd.grad(model(z, *rest)[:, n].square().sum(), z)
            assert (grad.abs().amax(-1) > 0).all()
