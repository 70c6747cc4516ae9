import json
from itertools import pairwise

import pytest
import torch
from torch import nn

from moveset.errors import FormatError, InputError
from moveset.training.ema import Ema, ema_warmup
from moveset.training.momo import MomoAdam
from moveset.training.optim import cosine_lr, flatten_optimizer, unflatten_optimizer


def test_the_schedule_rises_then_falls_between_its_bounds():
    rates = [cosine_lr(step, 2e-4, 100, 1000) for step in range(1, 1001)]
    assert rates[0] == pytest.approx(2e-6)
    assert max(rates) == rates[99] == 2e-4
    assert rates[-1] == 0.0
    assert all(a < b for a, b in pairwise(rates[:100]))
    assert all(a > b for a, b in pairwise(rates[99:]))
    assert cosine_lr(5000, 2e-4, 100, 1000) == 0.0


def test_without_a_warm_up_the_first_step_has_the_whole_rate():
    assert cosine_lr(0, 0.5, 0, 10) == 0.5  # a student that waits for its discriminator is at step 0
    assert cosine_lr(10, 0.5, 0, 10) == 0.0
    assert [cosine_lr(step, 0.5, 0, 10) for step in (1, 5)] == [cosine_lr(step + 1, 0.5, 1, 11) for step in (1, 5)]


def test_the_schedule_is_torchs_after_the_warm_up():
    optimizer = torch.optim.SGD([nn.Parameter(torch.zeros(1))], lr=0.5)
    theirs = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, T_max=50)
    for step in range(51):
        assert cosine_lr(step + 10, 0.5, 10, 60) == pytest.approx(theirs.get_last_lr()[0], abs=1e-12)
        optimizer.step(), theirs.step()


def stepped(make, steps, model=None, optimizer=None):
    model = model or nn.Linear(3, 2)
    optimizer = optimizer or make(model.parameters())
    generator = torch.Generator().manual_seed(1)
    for _ in range(steps):
        optimizer.zero_grad()
        loss = model(torch.randn(4, 3, generator=generator)).square().sum()
        loss.backward()
        optimizer.step(*([loss.detach()] if getattr(optimizer, "wants_loss", False) else []))
    return model, optimizer


@pytest.mark.parametrize(
    "make",
    [
        lambda p: torch.optim.AdamW(p, lr=1e-2, betas=(0.0, 0.999), weight_decay=1e-3),
        lambda p: torch.optim.Adam(p, lr=1e-2, amsgrad=True),
        lambda p: torch.optim.SGD(p, lr=1e-2, momentum=0.9, nesterov=True),
        lambda p: torch.optim.RAdam(p, lr=1e-2),
        lambda p: torch.optim.SGD(p, lr=1e-2),
    ],
)
def test_an_optimiser_survives_tensors_and_json(make):
    model, optimizer = stepped(make, 3)
    tensors, rest = flatten_optimizer(optimizer)
    tensors = {key: value.clone() for key, value in tensors.items()}
    twin = nn.Linear(3, 2)
    twin.load_state_dict(model.state_dict())
    other = make(twin.parameters())
    unflatten_optimizer(other, tensors, json.loads(json.dumps(rest)))
    assert other.state_dict()["param_groups"] == optimizer.state_dict()["param_groups"]
    stepped(make, 2, model, optimizer), stepped(make, 2, twin, other)
    assert all(torch.equal(a, b) for a, b in zip(model.parameters(), twin.parameters(), strict=True))


@pytest.mark.parametrize(
    ("make", "given"),
    [
        (torch.optim.AdamW, {"lr": 1e-2, "betas": (0.9, 0.99)}),
        (MomoAdam, {"lr": 1e-2, "betas": (0.9, 0.99)}),
        (torch.optim.SGD, {"lr": 1e-2, "momentum": 0.9}),
    ],
)
def test_hyper_parameters_are_the_new_ones_and_moments_the_old_ones(make, given):
    """As if they had been changed on the way."""
    changed = {"lr": 3e-3, "weight_decay": 0.1} | ({"betas": (0.5, 0.9)} if "betas" in given else {"momentum": 0.5})
    model, optimizer = stepped(lambda p: make(p, **given), 3)
    tensors, rest = flatten_optimizer(optimizer)
    tensors = {key: value.clone() for key, value in tensors.items()}
    twin = nn.Linear(3, 2)
    twin.load_state_dict(model.state_dict())
    other = make(twin.parameters(), **changed)
    unflatten_optimizer(other, tensors, json.loads(json.dumps(rest)))
    optimizer.param_groups[0].update(changed)
    stepped(make, 2, model, optimizer), stepped(make, 2, twin, other)
    assert all(torch.equal(a, b) for a, b in zip(model.parameters(), twin.parameters(), strict=True))


def test_state_of_another_model_is_refused():
    tensors, rest = flatten_optimizer(stepped(torch.optim.AdamW, 1)[1])
    with pytest.raises(FormatError, match="another model"):
        unflatten_optimizer(torch.optim.AdamW(nn.Linear(3, 5).parameters()), tensors, rest)
    with pytest.raises(FormatError, match="another model"):
        unflatten_optimizer(torch.optim.AdamW(nn.Linear(3, 2, bias=False).parameters()), tensors, rest)
    with pytest.raises(FormatError, match="another model"):
        unflatten_optimizer(
            torch.optim.AdamW(nn.Sequential(nn.Linear(3, 2), nn.Linear(2, 2)).parameters()), tensors, rest
        )


def test_the_average_follows_the_closed_form():
    module = nn.Linear(2, 2)
    start = module.weight.detach().clone()
    ema, values = Ema(module, 0.9), []
    for k in range(5):
        with torch.no_grad():
            module.weight.fill_(float(k))
        values.append(float(k))
        ema.update(module)
    want = 0.9**5 * start + sum(0.1 * 0.9 ** (4 - k) * value for k, value in enumerate(values))
    torch.testing.assert_close(ema.module.weight.detach(), want)


@pytest.mark.parametrize("decay", [-0.1, 1.5, float("nan")])
def test_an_average_forgets_a_share(decay):
    with pytest.raises(InputError, match=r"ema = .* is outside 0"):
        Ema(nn.Linear(1, 1), decay)


def test_the_average_is_frozen_and_copies_buffers():
    module = nn.Sequential(nn.Linear(3, 3), nn.BatchNorm1d(3), nn.Dropout(0.5))
    ema = Ema(module, 0.5)
    module.train()(torch.randn(8, 3))
    ema.update(module)
    assert not ema.module.training
    assert all(not parameter.requires_grad for parameter in ema.module.parameters())
    assert all(parameter.requires_grad for parameter in module.parameters())
    assert torch.equal(ema.module[1].running_mean, module[1].running_mean)
    ema.update(module, decay=0.0)
    assert torch.equal(ema.module[0].weight, module[0].weight)


def test_the_warm_up_reaches_the_constant_decay():
    decays = [ema_warmup(step, 0.99) for step in range(2000)]
    assert decays[0] == pytest.approx(0.1)
    assert decays == sorted(decays)
    assert decays[-1] == 0.99
