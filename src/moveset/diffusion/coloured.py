"""Noise with the temporal spectrum of the data: slow where motion is slow.

White noise has as much of every frequency, and motion has almost nothing of the high ones. What a network leaves of
white noise is therefore jitter: in a first training of segments on white noise, samples had jerk twenty times that of
real motion. Noise with the data's own spectrum has the same share of signal at every frequency, and what is left of it
looks like motion. Diffusion does not change otherwise: it is the usual one in the coordinates in which every frequency
of every feature has unit variance.

Shapes: B rows, n frames, D features.
Source: diffusion in whitened coordinates, as for latents normalised by channel; the frequencies are those of the
orthonormal discrete cosine transform (DCT-II, Ahmed et al. 1974).
"""

import math
from functools import cache

import torch
from torch import Tensor


@cache
def dct_matrix(n: int, device: torch.device | str = "cpu", dtype: torch.dtype = torch.float32) -> Tensor:
    """The orthonormal DCT-II (n, n): frequencies by frames."""
    with torch.inference_mode(False):
        frequency = torch.arange(n, dtype=torch.float64)[:, None]
        frame = torch.arange(n, dtype=torch.float64)[None]
        matrix = torch.cos(math.pi / n * (frame + 0.5) * frequency) * (2.0 / n) ** 0.5
        matrix[0] /= 2**0.5
        return matrix.to(device, dtype)


def temporal_spectrum(segments_BnD: Tensor, least: float = 0.01) -> Tensor:
    """Root mean square (n, D) of every frequency of every feature of normalised segments, scaled to mean square 1.

    Args:
        least: no frequency gets less, so that nothing is divided by almost zero.
    """
    coefficients = torch.einsum(
        "kn,bnd->bkd", dct_matrix(segments_BnD.shape[1], dtype=torch.float64), segments_BnD.double()
    )
    root = coefficients.square().mean(0).sqrt()
    return (root / root.square().mean(0).sqrt().clamp_min(least)).clamp_min(least).float()


def colour(noise_BnD: Tensor, spectrum_nD: Tensor) -> Tensor:
    """Standard normal noise (B, n, D) with that spectrum instead of a flat one."""
    dct = dct_matrix(noise_BnD.shape[1], noise_BnD.device, noise_BnD.dtype)
    return torch.einsum("kn,bkd->bnd", dct, noise_BnD * spectrum_nD.to(noise_BnD))
