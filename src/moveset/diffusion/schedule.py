"""The noise schedule: how much of the latent and how much noise make up z_t.

z_t = alpha_t z_0 + sigma_t eps, with alpha_t² + sigma_t² = 1 and t in 0 … T-1. There is no noise-free time: the
smallest noise is that of t = 0 (sigma_0 = 0.029 for the default schedule).
"""

from dataclasses import dataclass, field

import torch
from torch import Tensor

from moveset.errors import InputError


@dataclass(frozen=True, eq=False)
class Schedule:
    """A variance-preserving schedule.

    Args:
        alpha_bar: (T,) float64 on the CPU, falling from near 1 to near 0: the share of the signal's variance.

    Raises:
        InputError: values that are not strictly falling inside (0, 1).
    """

    alpha_bar: Tensor
    _tables: dict[tuple[torch.device, torch.dtype], tuple[Tensor, Tensor]] = field(
        default_factory=dict, init=False, repr=False
    )

    def __post_init__(self) -> None:
        a = self.alpha_bar
        if not (a.ndim == 1 and len(a) and bool((a.diff() < 0).all()) and float(a[-1]) > 0 and float(a[0]) < 1):
            raise InputError("a schedule needs strictly falling alpha_bar values inside (0, 1)")

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
