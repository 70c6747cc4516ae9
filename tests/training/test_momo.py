"""MoMo-Adam: Adam where it may be, Polyak's step where Adam would overshoot, and everything in the state dict."""

import copy
import json
from pathlib import Path

import pytest
import torch
from torch import nn

from moveset.errors import InputError
from moveset.training.engine import EngineConfig, Task, run
from moveset.training.momo import MomoAdam
from moveset.training.optim import flatten_optimizer, unflatten_optimizer
from tests.training.tiny_task import TinyConfig


def network(seed: int = 0) -> nn.Module:
    torch.manual_seed(seed)
    return nn.Sequential(nn.Linear(6, 16), nn.Tanh(), nn.Linear(16, 3))


def losses(model: nn.Module, optimizer: torch.optim.Optimizer, steps: int, generator: torch.Generator) -> list[float]:
    """Regression on fresh batches; Adam and MoMo-Adam alike."""
    out = []
    for _ in range(steps):
        x = torch.randn(8, 6, generator=generator)
        loss = (model(x) - x[:, :3].sin()).square().mean() + 0.3
        optimizer.zero_grad()
        loss.backward()
        optimizer.step(loss) if isinstance(optimizer, MomoAdam) else optimizer.step()
        out.append(loss.item())
    return out


def quadratic(optimizer_of, steps: int = 300) -> tuple[float, float]:
    """Distances from the minimum of sum(a (x - 3)²) / 2, badly scaled, on the way from zero: the largest
    and the last one."""
    curvature, distances = torch.tensor([1.0, 10.0, 100.0]), []
    x = nn.Parameter(torch.zeros(3))
    optimizer = optimizer_of([x])
    for _ in range(steps):
        loss = 0.5 * (curvature * (x - 3.0).square()).sum()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step(loss) if isinstance(optimizer, MomoAdam) else optimizer.step()
        distances.append((x - 3.0).abs().max().item())
    return max(distances), distances[-1]


@pytest.mark.parametrize("betas", [(0.9, 0.999), (0.0, 0.99)])
def test_it_is_adam_to_the_last_bit_while_the_cap_does_not_bind(betas):
    ours, theirs = network(), network()
    one = MomoAdam(ours.parameters(), lr=1e-3, betas=betas)
    two = torch.optim.Adam(theirs.parameters(), lr=1e-3, betas=betas, foreach=False)
    losses(ours, one, 50, torch.Generator().manual_seed(1))
    losses(theirs, two, 50, torch.Generator().manual_seed(1))
    assert all(torch.equal(a, b) for a, b in zip(ours.parameters(), theirs.parameters(), strict=True))


def test_the_cap_binds_where_a_step_of_adam_would_overshoot():
    farthest, last = quadratic(lambda p: MomoAdam(p, lr=1e2))
    assert farthest <= 3.0
    assert last < 1e-3
    assert quadratic(lambda p: torch.optim.Adam(p, lr=1e2))[0] > 90.0


@pytest.mark.parametrize("lr", [1e2, 1e-2])
def test_the_first_step_is_the_closed_form(lr):
    """k = 1: d = (1 - β1) g, F = (1 - β1) f, γ = (1 - β1) <g, x>, D = |g| + ε, so the cap is f / <g, g / D>."""
    start, decay, eps = torch.tensor([2.0, -1.0, 0.5], dtype=torch.float64), 0.1, 1e-8
    x = nn.Parameter(start.clone())
    optimizer = MomoAdam([x], lr=lr, weight_decay=decay, eps=eps)
    weights = torch.tensor([1.0, -4.0, 0.3], dtype=torch.float64)
    loss = (weights * x).square().sum() + x.sum()
    loss.backward()
    optimizer.step(loss)
    gradient = 2 * weights.square() * start + 1.0
    scale, along = gradient.abs() + eps, gradient @ start
    model = (1 + lr * decay) * (loss.item() - along) + along
    tau = min(lr / 0.1, max(0.0, model.item() * 0.1) / (0.01 * gradient @ (gradient / scale)).item())
    want = (start - tau * 0.1 * gradient / scale) / (1 + lr * decay)
    torch.testing.assert_close(x.detach(), want, rtol=1e-12, atol=1e-12)
    assert (tau < lr / 0.1) == (lr == 1e2)


def test_a_gradient_of_zero_moves_nothing():
    x = nn.Parameter(torch.tensor([1.0, 2.0]))
    optimizer = MomoAdam([x, nn.Parameter(torch.ones(3))], lr=1.0)
    for _ in range(3):
        loss = (0.0 * x).sum() + 1.0
        loss.backward()
        optimizer.step(loss)
    assert x.tolist() == [1.0, 2.0]


@pytest.mark.parametrize("lr", [0.05, 20.0])
def test_many_steps_follow_the_published_recursion(lr):
    """Algorithm 3, written out on one vector."""
    beta1, beta2, eps, decay = 0.8, 0.95, 1e-8, 0.02
    table = torch.Generator().manual_seed(5)
    targets = torch.randn(30, 4, generator=table, dtype=torch.float64)
    x = torch.randn(4, generator=table, dtype=torch.float64)
    parts = [nn.Parameter(part.clone()) for part in x.split([1, 3])]
    optimizer = MomoAdam(parts, lr, (beta1, beta2), eps, decay)
    d, v, mean, gamma, capped = torch.zeros_like(x), torch.zeros_like(x), 0.0, 0.0, 0
    for k, target in enumerate(targets, 1):
        loss = (torch.cat(parts) - target).square().sum() + 5.0
        optimizer.zero_grad()
        loss.backward()
        optimizer.step(loss)

        g, f = 2 * (x - target), (x - target).square().sum().item() + 5.0
        d, v = beta1 * d + (1 - beta1) * g, beta2 * v + (1 - beta2) * g * g
        mean, gamma = beta1 * mean + (1 - beta1) * f, beta1 * gamma + (1 - beta1) * float(g @ x)
        scale, unit, rho = (v / (1 - beta2**k)).sqrt() + eps, 1 + lr * decay, 1 - beta1**k
        norm, along = float(d @ (d / scale)), float(d @ x)
        reach = unit * (mean - gamma) + along
        polyak = max(0.0, reach) / norm
        tau = min(lr / rho, polyak)
        capped += polyak < lr / rho
        x = (x - tau * d / scale) / unit
        torch.testing.assert_close(torch.cat(parts).detach(), x, rtol=1e-9, atol=1e-9)
    assert (0 if lr < 1 else 10) <= capped <= (15 if lr < 1 else 30)


@pytest.mark.parametrize("settings", [{"lr": 1e2}, {"lr": 1e-2, "weight_decay": 0.1}])
def test_ten_steps_are_five_a_round_trip_and_five(settings):
    model, generator = network(), torch.Generator().manual_seed(1)
    optimizer = MomoAdam(model.parameters(), **settings)
    losses(model, optimizer, 5, generator)
    twin, again = copy.deepcopy(model), generator.clone_state()
    other = MomoAdam(twin.parameters(), **settings)
    tensors, rest = flatten_optimizer(optimizer)
    unflatten_optimizer(other, {k: v.clone() for k, v in tensors.items()}, json.loads(json.dumps(rest)))
    assert losses(model, optimizer, 5, generator) == losses(twin, other, 5, again)
    assert all(torch.equal(a, b) for a, b in zip(model.parameters(), twin.parameters(), strict=True))
    mine, theirs = flatten_optimizer(optimizer)[0], flatten_optimizer(other)[0]
    assert mine.keys() == theirs.keys()
    assert all(torch.equal(value, theirs[name]) for name, value in mine.items())


class Regression(Task):
    """One network, by MoMo-Adam."""

    name = "regression"

    def __init__(self, loop) -> None:
        self.config, self.net = TinyConfig(), network()
        self.optimizer = MomoAdam(self.net.parameters(), lr=10.0)
        self.noise = loop.generator("noise")

    def modules(self):
        return {"net": self.net}

    def optimizers(self):
        return {"net": self.optimizer}

    def training_step(self, step, loop):
        x = torch.randn(8, 6, generator=self.noise)
        loop.minimise((self.net(x) - x[:, :3].sin()).square().mean(), "net")
        return {}


def engine(folder: Path, steps: int, resume: bool = False) -> nn.Module:
    made = []

    def make(loop):
        made.append(Regression(loop))
        return made[0]

    exact = {"device": "cpu", "precision": "32-true"}
    config = EngineConfig(steps=steps, save_every=5, validate_every=0, tensorboard=False, **exact)
    run(make, config, folder, resume)
    return made[0].net


def test_two_groups_are_refused():
    groups = [{"params": [nn.Parameter(torch.ones(1))]} for _ in range(2)]
    with pytest.raises(InputError, match="one group of parameters"):
        MomoAdam(groups)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ({"lr": 0.0}, "learning rate"),
        ({"lr": float("nan")}, "learning rate"),
        ({"betas": (1.0, 0.9)}, "beta1"),
        ({"betas": (0.9, -0.1)}, "beta2"),
        ({"eps": -1e-8}, "eps"),
        ({"weight_decay": -1.0}, "weight_decay"),
    ],
)
def test_nonsense_is_refused(setting, words):
    with pytest.raises(InputError, match=words):
        MomoAdam([nn.Parameter(torch.ones(1))], **setting)
