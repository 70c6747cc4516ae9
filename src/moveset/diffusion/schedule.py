"""The noise schedule: how much of the latent and how much noise make up z_t.

z_t = alpha_t z_0 + sigma_t eps, with alpha_t² + sigma_t² = 1. Two conventions of time are in use: latent diffusion
counts t = 0 … T-1 and has no noise-free time (sigma_0 = 0.029 for ``scaled_linear``); RDM and DiP count t = 0 … T,
where t = 0 is the clean segment (``linear``, ``cosine``).
"""

from dataclasses import dataclass, field

import torch
from torch import Tensor

from moveset.errors import InputError


@dataclass(frozen=True, eq=False)
class Schedule:
    """A variance-preserving schedule.

    Args:
        alpha_bar: float64 on the CPU, one number a time, falling from 1 or near it to near 0: the share of the
            signal's variance.

    Raises:
        InputError: values that are not strictly falling inside (0, 1].
    """

    alpha_bar: Tensor
    _tables: dict[tuple[torch.device, torch.dtype], tuple[Tensor, Tensor]] = field(
        default_factory=dict, init=False, repr=False
    )

    def __post_init__(self) -> None:
        a = self.alpha_bar
        if not (a.ndim == 1 and len(a) and bool((a.diff() < 0).all()) and float(a[-1]) > 0 and float(a[0]) <= 1):
            raise InputError("a schedule needs strictly falling alpha_bar values inside (0, 1]")

    def __len__(self) -> int:
        return len(self.alpha_bar)

    def alpha(self, t: Tensor, dtype: torch.dtype = torch.float32) -> Tensor:
        """sqrt(alpha_bar_t), of the shape of ``t`` (int64) and on its device."""
        return self._table(t.device, dtype)[0][t]

    def sigma(self, t: Tensor, dtype: torch.dtype = torch.float32) -> Tensor:
        """sqrt(1 - alpha_bar_t), of the shape of ``t`` (int64) and on its device."""
        return self._table(t.device, dtype)[1][t]

    def half_log_snr(self, t: Tensor, dtype: torch.dtype = torch.float32) -> Tensor:
        """lambda_t = ln(alpha_t / sigma_t) (MotionPCM, below Eq. 6)."""
        return torch.log(self.alpha(t, dtype) / self.sigma(t, dtype))

    def _table(self, device: torch.device, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
        # Roots are taken in double precision once per device: 1 - alpha_bar_0 keeps only four digits in float32.
        if (device, dtype) not in self._tables:
            # Tables first used while sampling must still be able to enter a training graph later.
            with torch.inference_mode(False):
                a = self.alpha_bar.double()
                self._tables[device, dtype] = (a.sqrt().to(device, dtype), (1 - a).sqrt().to(device, dtype))
        return self._tables[device, dtype]


def scaled_linear(steps: int = 1000, beta_start: float = 0.00085, beta_end: float = 0.012) -> Schedule:
    """The schedule of latent diffusion (Rombach et al. 2022, arXiv 2112.10752), used by MLD, MotionLCM and MotionPCM.

    The square roots of beta are linear in t; alpha_bar is the cumulative product of 1 - beta.

    >>> float(scaled_linear().alpha_bar[999].round(decimals=6))
    0.00466
    """
    beta = torch.linspace(beta_start**0.5, beta_end**0.5, steps, dtype=torch.float64) ** 2
    return Schedule(torch.cumprod(1 - beta, dim=0))


def linear(steps: int = 1000, beta_start: float = 1e-4, beta_end: float = 0.02) -> Schedule:
    """The schedule of DDPM (Ho et al. 2020, arXiv 2006.11239), used by MotionDiffuse and RDM: beta linear in t = 1 … T.

    It has T + 1 entries: time 0 is clean.

    >>> linear().alpha_bar[[0, 1]].tolist()
    [1.0, 0.9999]
    """
    beta = torch.linspace(beta_start, beta_end, steps, dtype=torch.float64)
    return _from_clean(torch.cumprod(1 - beta, dim=0))


def cosine(steps: int = 10, offset: float = 0.008, largest_beta: float = 0.999) -> Schedule:
    """The cosine schedule (Nichol & Dhariwal 2021, arXiv 2102.09672), as used by DiP with T = 10; time 0 is clean."""
    t = torch.arange(steps + 1, dtype=torch.float64) / steps
    share = torch.cos((t + offset) / (1 + offset) * torch.pi / 2) ** 2
    beta = (1 - share[1:] / share[:-1]).clamp(max=largest_beta)
    return _from_clean(torch.cumprod(1 - beta, dim=0))


def _from_clean(alpha_bar: Tensor) -> Schedule:
    return Schedule(torch.cat((alpha_bar.new_ones(1), alpha_bar)))
