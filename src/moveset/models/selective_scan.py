"""Mamba's selective state space in plain PyTorch: no CUDA extension, any device, fast enough for short sequences.

Shapes: B batch, L sequence, W width, E inner width, N states, R rank of the step size.
Source: Gu & Dao 2023 (arXiv 2312.00752), section 3.
"""

import math
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as fn


class _Recurrence(torch.autograd.Function):
    """h_l = a_l h_{l-1} + b_l along dimension 0, from h = 0.

    One multiply-add a step forward and one backward, and only a and h are kept: autograd's own record of the loop would
    hold every product besides.
    """

    @staticmethod
    def forward(ctx: Any, a: Tensor, b: Tensor) -> Tensor:
        h = torch.empty_like(b)
        state = torch.zeros_like(b[0])
        for step in range(len(b)):
            state = torch.addcmul(b[step], a[step], state, out=h[step])
        ctx.save_for_backward(a, h)
        return h

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, Tensor]:
        a, h = ctx.saved_tensors
        # d/db runs the same recurrence from the end: g_l = grad_l + a_{l+1} g_{l+1}.
        g = torch.empty_like(grad)
        g[-1] = grad[-1]
        for step in range(len(g) - 2, -1, -1):
            torch.addcmul(grad[step], a[step + 1], g[step + 1], out=g[step])
        grad_a = torch.zeros_like(g)
        torch.mul(g[1:], h[:-1], out=grad_a[1:])
        return grad_a, g


def recurrence(a: Tensor, b: Tensor) -> Tensor:
    """h with h_0 = b_0 and h_l = a_l h_{l-1} + b_l along the first dimension; a and b of one shape, L >= 1.

    >>> recurrence(torch.full((4,), 0.5), torch.ones(4)).tolist()
    [1.0, 1.5, 1.75, 1.875]
    """
    h: Tensor = _Recurrence.apply(a.contiguous(), b.contiguous())
    return h


def selective_scan(
    u_BLE: Tensor, dt_BLE: Tensor, rate_EN: Tensor, into_BLN: Tensor, outof_BLN: Tensor, skip_E: Tensor
) -> Tensor:
    """The state space h_l = exp(dt_l A) h_{l-1} + dt_l u_l B_l, y_l = C_l h_l + D u_l. (B, L, E)

    Args:
        u_BLE: input.
        dt_BLE: positive step sizes; where one is 0 the state passes unchanged.
        rate_EN: A, negative: the rates at which the states forget.
        into_BLN: B, how the input enters the states.
        outof_BLN: C, how the states are read.
        skip_E: D.

    Half-precision input is computed in single precision, also under autocast.
    """
    dtype = torch.promote_types(u_BLE.dtype, torch.float32)
    with torch.autocast(u_BLE.device.type, enabled=False):
        # The sequence comes first, so that a step reads and writes one block of memory.
        u, dt, into, outof = (part.to(dtype).transpose(0, 1) for part in (u_BLE, dt_BLE, into_BLN, outof_BLN))
        decay = torch.exp(dt[..., None] * rate_EN.to(dtype))
        h_LBEN = recurrence(decay, (dt * u)[..., None] * into[..., None, :])
        y = torch.einsum("lben,lbn->lbe", h_LBEN, outof) + skip_E.to(dtype) * u
        return y.transpose(0, 1).to(u_BLE.dtype)


class Mamba(nn.Module):
    """A gated selective state space behind a short causal convolution: element l sees elements up to l.

    Args:
        width: W.
        states: N.
        convolution: how many elements the convolution sees, the newest included.
        expand: E / W.
        rank: R.
    """

    def __init__(self, width: int, states: int, convolution: int, expand: int, rank: int) -> None:
        super().__init__()
        inner = expand * width
        self.states, self.rank = states, rank
        self.inward = nn.Linear(width, 2 * inner, bias=False)
        self.convolution = nn.Conv1d(inner, inner, convolution, groups=inner, padding=convolution - 1)
        self.select = nn.Linear(inner, rank + 2 * states, bias=False)
        self.step = nn.Linear(rank, inner)
        self.log_rate = nn.Parameter(torch.arange(1.0, states + 1.0).log().repeat(inner, 1))
        self.skip = nn.Parameter(torch.ones(inner))
        self.outward = nn.Linear(inner, width, bias=False)
        # Step sizes start spread between 1/1000 and 1/10: softplus(bias) = dt.
        nn.init.uniform_(self.step.weight, -(rank**-0.5), rank**-0.5)
        with torch.no_grad():
            dt = torch.exp(torch.empty(inner).uniform_(math.log(0.001), math.log(0.1)))
            self.step.bias.copy_(dt + torch.log(-torch.expm1(-dt)))

    def forward(self, x_BLW: Tensor, mask_BL: Tensor) -> Tensor:
        """Mixed sequence (B, L, W). Masked elements (False) count as nothing: not even as time that passes."""
        x, gate = self.inward(x_BLW.masked_fill(~mask_BL[..., None], 0.0)).chunk(2, dim=-1)
        x = fn.silu(self.convolution(x.mT)[..., : x_BLW.shape[1]].mT)
        low, into, outof = self.select(x).split((self.rank, self.states, self.states), dim=-1)
        dt = fn.softplus(self.step(low)).masked_fill(~mask_BL[..., None], 0.0)
        y = selective_scan(x, dt, -self.log_rate.exp(), into, outof, self.skip)
        return self.outward(y * fn.silu(gate))
