"""MoMo-Adam: Adam whose step is cut where a model of the loss says that more would overshoot.

    d = β1 d + (1 - β1) g                  v = β2 v + (1 - β2) g²              D = sqrt(v / (1 - β2^k)) + ε
    F = β1 F + (1 - β1) f                  γ = β1 γ + (1 - β1) <g, x>
    τ = min( lr / (1 - β1^k),  max(0, (1 + lr λ) (F - γ) + <d, x>) / <d, d / D> )
    x = (x - τ d / D) / (1 + lr λ)

f is the loss at x in step k = 1, 2, …, g its gradient, λ the weight decay. The second term of τ is
Polyak's: it takes the averaged linear model of the loss down to 0, which no loss is below, and no further. While it is
the larger one, this is Adam.

Source: Schaipp, Ohana, Eickenberg, Defazio, Gower, "MoMo: Momentum Models for Adaptive Learning Rates", ICML 2024
(arXiv 2305.07583), Algorithm 3 with the lower bound 0.
"""

from collections.abc import Iterable
from typing import Any

import torch
from torch import Tensor, nn

from moveset.errors import InputError


class MomoAdam(torch.optim.Optimizer):
    """Adam with a Polyak-type cap; ``step`` wants the loss.

    All that a step depends on is in ``state_dict()``; what belongs to no single parameter (k, F, γ) is kept with
    the first one. Nothing waits for the device.

    Args:
        params: parameters of one loss, in one group: τ is a single number. Two losses need two optimisers.
        lr: the largest step size; the authors recommend 1e-2.
        weight_decay: λ, decoupled as in AdamW but as a division.

    Raises:
        InputError: an argument is out of range, or there is more than one group of parameters.
    """

    #: Whoever steps this optimiser must hand over the loss.
    wants_loss = True

    def __init__(
        self,
        params: Iterable[nn.Parameter] | Iterable[dict[str, Any]],
        lr: float = 1e-2,
        betas: tuple[float, float] = (0.9, 0.999),
        eps: float = 1e-8,
        weight_decay: float = 0.0,
    ) -> None:
        if not lr > 0.0:
            raise InputError(f"the learning rate is {lr} but must be above 0; the authors recommend 1e-2")
        for name, beta in zip(("beta1", "beta2"), betas, strict=True):
            if not 0.0 <= beta < 1.0:
                raise InputError(f"{name} is {beta} but must be at least 0 and below 1; try the default")
        for name, value in (("eps", eps), ("weight_decay", weight_decay)):
            if not value >= 0.0:
                raise InputError(f"{name} is {value} but must not be negative; give 0 or more")
        super().__init__(params, {"lr": lr, "betas": tuple(betas), "eps": eps, "weight_decay": weight_decay})

    def add_param_group(self, param_group: dict[str, Any]) -> None:
        """Takes the one group that there can be. Raises InputError for a second one."""
        if self.param_groups:
            raise InputError(
                "MoMo-Adam takes one group of parameters, since its step size is one number for one loss; make an "
                "optimiser for each group"
            )
        super().add_param_group(param_group)

    @torch.no_grad()
    def step(self, loss: Tensor) -> None:  # type: ignore[override]
        """One update.

        Args:
            loss: () the loss at the present parameters, of which their ``grad`` is the gradient. In a process group it
                may differ by process, and gradients must have been averaged: its mean is used, since a step size of
                their own would drive the replicas apart.
        """
        (group,) = self.param_groups
        lr, eps, decay, (beta1, beta2) = group["lr"], group["eps"], group["weight_decay"], group["betas"]
        values = [parameter for parameter in group["params"] if parameter.requires_grad]
        # A gradient that is missing in this step is zero, and must fade from d as it does from γ.
        gradients = [torch.zeros_like(x) if x.grad is None else x.grad for x in values]
        for x in values:
            if "momentum" not in self.state[x]:
                self.state[x].update(momentum=torch.zeros_like(x), square=torch.zeros_like(x))
        momenta, squares = ([self.state[x][name] for x in values] for name in ("momentum", "square"))
        whole = self._whole(group)
        whole["step"] += 1.0  # on the CPU, so that reading it waits for nobody
        rise1, rise2 = (1.0 - beta ** whole["step"].item() for beta in (beta1, beta2))

        torch._foreach_lerp_(momenta, gradients, 1.0 - beta1)
        torch._foreach_mul_(squares, beta2)
        torch._foreach_addcmul_(squares, gradients, gradients, 1.0 - beta2)
        scales = torch._foreach_sqrt(squares)
        torch._foreach_div_(scales, rise2**0.5)
        torch._foreach_add_(scales, eps)
        average, gamma = whole["loss"], whole["gamma"]
        average.lerp_(_mean(loss).to(average), 1.0 - beta1)
        gamma.lerp_(_inner(gradients, values).to(gamma), 1.0 - beta1)

        size = _inner(momenta, torch._foreach_div(momenta, scales))
        # Were d zero, any step would do: it moves nothing.
        size = size.clamp_min(torch.finfo(size.dtype).tiny)
        along = _inner(momenta, values)
        reach = (1.0 + lr * decay) * (average - gamma) + along
        tau = (reach.clamp_min(0.0) / size).clamp_max(lr / rise1)

        moves = torch._foreach_mul(momenta, tau)
        torch._foreach_div_(moves, scales)
        torch._foreach_sub_(values, moves)
        if decay:
            torch._foreach_div_(values, 1.0 + lr * decay)

    def _whole(self, group: dict[str, Any]) -> dict[str, Tensor]:
        """State that belongs to no single parameter; Optimizer.load_state_dict leaves "step" where it is."""
        first = group["params"][0]
        state = self.state[first]
        if "step" not in state:
            state["step"] = torch.zeros((), dtype=torch.float32)
            for name in ("loss", "gamma"):
                state[name] = torch.zeros((), dtype=first.dtype, device=first.device)
        return state


def _inner(left: list[Tensor], right: list[Tensor] | tuple[Tensor, ...]) -> Tensor:
    """Inner product () of two lists of tensors."""
    return torch.stack([product.sum() for product in torch._foreach_mul(left, right)]).sum()


def _mean(loss: Tensor) -> Tensor:
    """Mean over processes; the loss itself where there is one."""
    loss = loss.detach()
    if torch.distributed.is_available() and torch.distributed.is_initialized():
        loss = loss.float().clone()
        torch.distributed.all_reduce(loss)
        loss /= torch.distributed.get_world_size()
    return loss
