"""What every network here promises, whatever its architecture: add a builder to the lists and it must keep them too."""

from dataclasses import replace
from functools import reduce

import pytest
import torch

from moveset.diffusion.guidance import cfg
from moveset.errors import InputError
from moveset.models.condition import Condition, guided
from moveset.models.latent_denoiser import LatentDenoiserConfig
from moveset.models.registry import build_model, describe
from moveset.models.timed_vae import TimedVAEConfig
from moveset.models.token_denoiser import TokenDenoiserConfig
from moveset.models.token_vae import TokenVAEConfig
from tests.conditions import condition_of

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
        token_dim=4, text_dim=6, width=16, layers=3, heads=2, feed_forward=32, positions=30, guided=guidance
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
        # This one shifts all channels alike, which the norm behind it takes out again: rounding is all it ever gets.
        assert set(silent) <= {"encoder_mixer.1.time.2.bias"}

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


class TestDenoiser:
    MASK = torch.arange(6) < torch.tensor([6, 3, 1, 2])[:, None]
    SCALE = torch.tensor([5.0, 8.0, 11.0, 15.0])

    def _inputs(self, guidance=False):
        condition = condition_of(_rand(4, 6, 6, seed=3), self.MASK, length=torch.tensor([40, 60, 80, 196]))
        return (
            _rand(4, 3, 4),
            torch.tensor([0, 99, 500, 999]),
            replace(condition, scale=self.SCALE) if guidance else condition,
        )

    @pytest.mark.parametrize("guidance", [False, True])
    def test_gradients_reach_every_parameter(self, denoiser, guidance):
        model = denoiser(guidance).train()
        model(*self._inputs(guidance)).square().mean().backward()
        silent = [n for n, p in model.named_parameters() if p.grad is None or not p.grad.any()]
        assert silent == []

    def test_text_padding_does_not_matter(self, denoiser):
        model = denoiser(False).eval()
        z, t, condition = self._inputs()
        tokens, mask = condition.text.tokens, condition.text.mask
        expected = model(z, t, condition)
        for filler in (0.0, 1e6):
            _close(model(z, t, self._with(condition, tokens.masked_fill(~mask[..., None], filler), mask)), expected)
        more = torch.cat((tokens, _rand(4, 5, 6, seed=4)), dim=1)
        _close(model(z, t, self._with(condition, more, torch.cat((mask, torch.zeros(4, 5).bool()), dim=1))), expected)

    @pytest.mark.parametrize("guidance", [False, True])
    def test_an_item_of_a_batch_is_the_item_alone_and_conditions_join(self, denoiser, guidance):
        model = denoiser(guidance).eval()
        z, t, whole = self._inputs(guidance)
        expected = model(z, t, whole)
        rows = [
            Condition(
                whole.text[k : k + 1],
                length=whole.length[k : k + 1],
                scale=whole.scale[k : k + 1] if guidance else None,
            )
            for k in range(4)
        ]
        for k, row in enumerate(rows):
            _close(model(z[k : k + 1], t[k : k + 1], row)[0], expected[k])
        assert torch.equal(model(z, t, reduce(Condition.joined, rows)), expected)

    @pytest.mark.parametrize("guidance", [False, True])
    def test_a_condition_may_be_prepared_for_any_number_of_evaluations(self, denoiser, guidance):
        model = denoiser(guidance).eval()
        z, t, condition = self._inputs(guidance)
        prepared = model.prepare(condition)
        for noisy, level in ((z, t), (2 * z, t.clamp(min=1) - 1)):
            assert torch.equal(model(noisy, level, prepared), model(noisy, level, condition))

    @pytest.mark.parametrize("grad", [False, True])
    def test_guidance_is_two_evaluations_extrapolated_or_an_input(self, denoiser, grad):
        z, t, condition = self._inputs()
        empty = condition_of(_rand(1, 2, 6, seed=5)).text
        with torch.set_grad_enabled(grad):
            teacher, student = denoiser(False).eval(), denoiser(True).eval()
            assert torch.equal(guided(teacher, condition)(z, t), teacher(z, t, condition))
            both = teacher(z, t, condition), teacher(z, t, condition.dropped(empty))
            for w in (0.0, 2.5, self.SCALE):
                _close(guided(teacher, condition, w, empty)(z, t), cfg(*both, w))
                scale = torch.as_tensor(w).expand(4)
                assert torch.equal(guided(student, condition, w)(z, t), student(z, t, replace(condition, scale=scale)))
        with pytest.raises(InputError, match="empty"):
            guided(teacher, condition, 2.0)

    def test_a_fresh_student_is_its_teacher_whatever_the_guidance(self, denoiser):
        teacher, inputs = denoiser(False).eval(), self._inputs()
        student, expected = teacher.student(), teacher(*inputs)
        assert not student.training
        guided_inputs = self._inputs(guidance=True)
        assert torch.equal(student(*guided_inputs), expected)
        student(*guided_inputs).square().mean().backward()
        weights = [p for name, p in student.named_parameters() if name.endswith("guidance.weight")]
        assert all(weight.grad.any() for weight in weights)  # it learns, though it starts at zero
        with torch.no_grad():
            for weight in weights:
                weight.normal_()
        assert not torch.allclose(student(*guided_inputs), expected)
        assert torch.equal(teacher(*inputs), expected)  # a copy, not a view
        if isinstance(teacher.config, LatentDenoiserConfig):
            return
        with pytest.raises(InputError, match="does not take"):
            teacher(*guided_inputs)
        with pytest.raises(InputError, match="needs"):
            student(*inputs)

    @pytest.mark.parametrize("guidance", [False, True])
    def test_a_network_is_rebuilt_from_its_description(self, denoiser, guidance):
        model = denoiser(guidance).eval()
        twin = build_model(*describe(model.config)).eval()
        twin.load_state_dict(model.state_dict())
        assert torch.equal(twin(*self._inputs(guidance)), model(*self._inputs(guidance)))

    def test_taps_are_the_latent_tokens_and_change_nothing(self, denoiser):
        model, taps = denoiser(False).eval(), []
        inputs = self._inputs()
        assert torch.equal(model(*inputs, taps), model(*inputs))
        assert len(taps) > 0
        assert {tuple(tap.shape) for tap in taps} == {(4, 3, taps[0].shape[-1])}

    def test_the_noise_of_every_token_depends_on_every_token(self, denoiser):
        model = denoiser(False).eval()
        z, *rest = self._inputs()
        z.requires_grad_()
        for n in range(3):
            (grad,) = torch.autograd.grad(model(z, *rest)[:, n].square().sum(), z)
            assert (grad.abs().amax(-1) > 0).all()

    @staticmethod
    def _with(condition, tokens, mask):
        return replace(condition, text=condition_of(tokens, mask).text)
