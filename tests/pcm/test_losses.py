"""Distance and hinge losses: values, and signs that move the logits the right way."""

import pytest
import torch

from moveset.pcm.losses import hinge_discriminator, hinge_generator, pseudo_huber


@pytest.mark.parametrize("c", [0.5, 0.001])
def test_pseudo_huber_equals_its_formula_and_its_limits(c):
    d = torch.linspace(-8, 8, 4001, dtype=torch.float64)
    one = torch.stack([pseudo_huber(x, torch.zeros((), dtype=x.dtype), c) for x in d[::400]])
    torch.testing.assert_close(one, torch.sqrt(d[::400] ** 2 + c * c) - c)
    mean = pseudo_huber(d + 3, torch.full_like(d, 3.0), c)
    torch.testing.assert_close(mean, (torch.sqrt(d**2 + c * c) - c).mean())
    # in single precision the printed form is zero below d = c / 3000; the loss must not be
    small = torch.tensor([c * 1e-5])
    torch.testing.assert_close(pseudo_huber(small, torch.zeros(1), c), (small**2 / (2 * c)).mean(), rtol=1e-3, atol=0)


def test_gradient_at_zero_distance_is_zero_and_finite():
    x = torch.zeros(3, requires_grad=True)
    pseudo_huber(x, torch.zeros(3)).backward()
    assert torch.equal(x.grad, torch.zeros(3))


def test_hinge_values():
    real, fake = torch.tensor([2.0, 0.0]), torch.tensor([-3.0, 1.0])
    assert hinge_discriminator(real, fake) == (0 + 1) / 2 + (0 + 2) / 2
    assert hinge_generator(fake) == (4 + 0) / 2


def test_mismatched_text_counts_as_fake_and_shares_its_weight():
    real, fake, misread = torch.tensor([2.0, 0.0]), torch.tensor([-3.0, 1.0]), torch.tensor([2.5, -0.5])
    assert hinge_discriminator(real, fake, misread, 0.25) == (0 + 1) / 2 + 0.75 * (0 + 2) / 2 + 0.25 * (3.5 + 0.5) / 2
    assert hinge_discriminator(real, fake, misread) == hinge_discriminator(real, fake, misread, 0.5)
    # Where nothing can be told, no verdict is better than another: fakes of two kinds do not outvote real ones.
    same = [torch.full((3,), verdict) for verdict in (-0.9, 0.0, 0.9)]
    assert {round(float(hinge_discriminator(x, x, x, 0.5)), 5) for x in same} == {2.0}


def test_steps_of_either_side_move_the_logits_the_right_way():
    generator = torch.Generator().manual_seed(5)
    real, fake = torch.randn(2, 64, 4, generator=generator) + torch.tensor([[[1.0]], [[0.5]]])
    heads = torch.nn.Linear(4, 1)
    with torch.no_grad():  # within the hinge, whatever the data
        heads.weight.fill_(0.01)
        heads.bias.zero_()
    before = (heads(real).mean() - heads(fake).mean()).item()
    hinge_discriminator(heads(real), heads(fake)).backward()
    with torch.no_grad():
        for p in heads.parameters():
            p -= 0.1 * p.grad
    assert heads(real).mean() - heads(fake).mean() > before

    fake = fake.clone().requires_grad_()
    frozen = heads.requires_grad_(False)
    hinge_generator(frozen(fake)).backward()
    assert frozen(fake - fake.grad).mean() > frozen(fake).mean()
