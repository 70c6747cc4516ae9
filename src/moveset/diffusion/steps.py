"""Steps between noise levels, as pure functions.

Shapes: ``z`` is (B, …) and times are int64 tensors that match the leading dimensions of ``z``: (B,) for one level per
item, (B, N) for one per segment, () for one level everywhere. Keep ``z`` in float32: predicting z_0 divides by alpha_t,
which is 0.068 at t = 999.
"""

from typing import Literal, get_args

import torch
from torch import Tensor

from moveset.diffusion.schedule import Schedule
from moveset.errors import InputError

Variance = Literal["posterior", "beta"]


def over(value: Tensor, z: Tensor) -> Tensor:
    """``value`` shaped to broadcast over the trailing dimensions of ``z``.

    >>> over(torch.zeros(2), torch.zeros(2, 16, 32)).shape
    torch.Size([2, 1, 1])
    """
    return value.reshape(value.shape + (1,) * (z.ndim - value.ndim))


def _alpha_sigma(schedule: Schedule, t: Tensor, z: Tensor) -> tuple[Tensor, Tensor]:
    return over(schedule.alpha(t, z.dtype), z), over(schedule.sigma(t, z.dtype), z)


def add_noise(schedule: Schedule, z0: Tensor, eps: Tensor, t: Tensor) -> Tensor:
    """z_t = alpha_t z_0 + sigma_t eps."""
    alpha, sigma = _alpha_sigma(schedule, t, z0)
    return alpha * z0 + sigma * eps


def predict_z0(schedule: Schedule, z: Tensor, eps: Tensor, t: Tensor) -> Tensor:
    """The noise-free latent that z_t and the predicted noise imply: (z_t - sigma_t eps) / alpha_t."""
    alpha, sigma = _alpha_sigma(schedule, t, z)
    return (z - sigma * eps) / alpha


def ddim_step(schedule: Schedule, z: Tensor, eps: Tensor, t: Tensor, s: Tensor) -> Tensor:
    """The deterministic step from time t to time s (DDIM, Song et al. 2021, arXiv 2010.02502, Eq. 12 with eta = 0).

    Equal to F(z, t, s) = (alpha_s/alpha_t) z - alpha_s eps (e^-lambda_t - e^-lambda_s) of MotionPCM, Eq. 8. Written
    around z, as here, F(z, s, s) = z holds to the last bit.
    """
    alpha_t, sigma_t = _alpha_sigma(schedule, t, z)
    alpha_s, sigma_s = _alpha_sigma(schedule, s, z)
    ratio = alpha_s / alpha_t
    return ratio * z + (sigma_s - ratio * sigma_t) * eps


def predict_eps(schedule: Schedule, z: Tensor, z0: Tensor, t: Tensor) -> Tensor:
    """The noise that z_t and the predicted clean z_0 imply: (z_t - alpha_t z_0) / sigma_t, for t above 0."""
    alpha, sigma = _alpha_sigma(schedule, t, z)
    return (z - alpha * z0) / sigma


def require_variance(variance: str) -> None:
    """Raises InputError for a variance of fresh noise that there is not."""
    if variance not in get_args(Variance):
        raise InputError(f"variance {variance!r} is not one of {', '.join(get_args(Variance))}")


def denoise_step(
    schedule: Schedule,
    z: Tensor,
    z0: Tensor,
    t: Tensor,
    s: Tensor,
    eta: float = 0.0,
    noise: Tensor | None = None,
    variance: Variance = "posterior",
    eps_scale: float = 1.0,
) -> Tensor:
    """From time t down to time s, given a prediction of the clean z_0 (DDIM, arXiv 2010.02502, Eq. 12 and 16).

    With ``eta`` = 1 this is the posterior q(z_s | z_t, z_0): DDPM's step with its smaller variance when s = t - 1.
    Rows with a clean s become z_0 itself.

    Args:
        eta: share of the posterior's standard deviation in 0 … 1; 0 is deterministic.
        noise: standard normal, like z; needed unless ``eta`` is 0.
        variance: of the noise where ``eta`` is 1: the "posterior"'s, or "beta", that of the step from s up to t, the
            larger of DDPM's two (Ho et al. 2020, Section 3.2) and RDM's; the mean is the same.
        eps_scale: factor of the noise that z and z_0 imply. What a network has not learned to tell apart it averages,
            so samples vary too little, or with predicted noise too much (epsilon scaling, Ning et al. 2024, arXiv
            2308.15321, who divide by theirs).

    Raises:
        InputError: ``eta`` out of range, or above 0 without noise; or an unknown variance.
    """
    require_variance(variance)
    if not 0.0 <= eta <= 1.0 or (eta and noise is None):
        raise InputError(f"eta {eta} is not in 0 to 1, or there is no noise for it")
    alpha_t, sigma_t = _alpha_sigma(schedule, t, z)
    alpha_s, sigma_s = _alpha_sigma(schedule, s, z)
    eps = eps_scale * (z - alpha_t * z0) / sigma_t
    if noise is None or eta == 0.0:
        out = alpha_s * z0 + sigma_s * eps
    else:
        ratio = alpha_t / alpha_s
        beta = (1 - ratio * ratio).clamp_min(0.0).sqrt()
        spread = eta * (sigma_s / sigma_t) * beta
        added = spread if variance == "posterior" else eta * beta
        out = alpha_s * z0 + (sigma_s**2 - spread**2).clamp_min(0.0).sqrt() * eps + added * noise
    return torch.where(sigma_s == 0, z0, out)


def renoise(schedule: Schedule, z: Tensor, s_from: Tensor, s_to: Tensor, noise: Tensor) -> Tensor:
    """From the marginal at ``s_from`` to that at a later ``s_to``: r z + sqrt(1 - r²) noise, r = alpha_to/alpha_from.

    The forward process itself, conditioned on z at ``s_from`` (PCM, Wang et al. 2024, arXiv 2405.18407).
    """
    a = schedule.alpha(s_to, torch.float64) / schedule.alpha(s_from, torch.float64)
    keep, add = over(a, z).to(z.dtype), over((1 - a * a).sqrt(), z).to(z.dtype)
    return keep * z + add * noise


def ddim_timesteps(count: int, steps: int = 1000) -> tuple[int, ...]:
    """Evaluation times of DDIM sampling, falling: the "leading" grid with offset 1 of latent diffusion.

    Raises:
        InputError: ``count`` not in 2 … steps // 2 (one leading step would start from almost no noise).

    >>> ddim_timesteps(4)
    (751, 501, 251, 1)
    """
    if not 2 <= count <= steps // 2:
        raise InputError(f"{count} DDIM steps is not in 2 to {steps // 2}; 50 is usual")
    return tuple(k * (steps // count) + 1 for k in reversed(range(count)))
