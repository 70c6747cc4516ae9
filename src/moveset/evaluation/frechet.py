"""Fréchet distance between the Gaussians of two sets of features, in float64."""

import torch
from torch import Tensor

from moveset.errors import InputError


def frechet_distance(a: Tensor, b: Tensor) -> float:
    """Squared Fréchet (2-Wasserstein) distance between Gaussians fitted to the rows of a (N, D) and b (M, D).

    |mean_a - mean_b|^2 + tr(A) + tr(B) - 2 tr((A B)^1/2), with sample covariances A and B (Dowson and Landau 1982;
    Heusel et al. 2017, arXiv 1706.08500). The trace of the root comes from the symmetric A^1/2 B A^1/2, which has the
    same eigenvalues as A B and no imaginary parts to throw away.

    Raises:
        InputError: fewer than two rows, or different numbers of columns.

    >>> x = torch.tensor([[0.0, 1.0], [2.0, 0.0], [1.0, 5.0]])
    >>> round(frechet_distance(x, x), 9), round(frechet_distance(x, x + 3.0), 6)
    (0.0, 18.0)
    """
    if a.ndim != 2 or b.ndim != 2 or a.shape[1] != b.shape[1] or min(len(a), len(b)) < 2:
        raise InputError(
            f"a Fréchet distance needs two tables of features with at least 2 rows and equal columns, not "
            f"{tuple(a.shape)} and {tuple(b.shape)}"
        )
    a, b = a.double(), b.double()
    cov_a, cov_b = (torch.atleast_2d(torch.cov(x.T)) for x in (a, b))
    values, vectors = torch.linalg.eigh(cov_a)
    root = (vectors * values.clamp_min(0.0).sqrt()) @ vectors.T
    cross = torch.linalg.eigvalsh(root @ cov_b @ root).clamp_min(0.0).sqrt().sum()
    distance = (a.mean(0) - b.mean(0)).square().sum() + cov_a.trace() + cov_b.trace() - 2.0 * cross
    return max(distance.item(), 0.0)
