"""Fréchet distance between the Gaussians of two sets of features, in float64."""

import torch
from torch import Tensor

from moveset.errors import InputError


def frechet_distance(a: Tensor, b: Tensor) -> float:
    """Squared Fréchet (2-Wasserstein) distance between Gaussians fitted to the rows of a (N, E) and b (M, E).

    |mean_a - mean_b|^2 + tr(A) + tr(B) - 2 tr((A B)^1/2), with sample covariances A and B (Dowson and Landau 1982;
    Heusel et al. 2017, arXiv 1706.08500). With centred rows X and Y, A = X'X / (N - 1) and B = Y'Y / (M - 1), the
    trace of the root is the sum of the singular values of X Y' / sqrt((N - 1) (M - 1)). No matrix root is taken: fewer
    rows than columns (singular covariances) need no added diagonal, and nothing imaginary is thrown away.

    Raises:
        InputError: fewer than two rows, different numbers of columns, or values that are not finite.

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
    for table in (a, b):
        if bad := int((~torch.isfinite(table).all(dim=1)).sum()):
            raise InputError(
                f"{bad} of {len(table)} rows of features are not finite; a Fréchet distance cannot leave any out, so "
                "repair or drop those motions first"
            )
    x, y = _triangle(a), _triangle(b)
    cross = torch.linalg.svdvals(x @ y.T).sum()
    distance = (a.mean(0) - b.mean(0)).square().sum() + x.square().sum() + y.square().sum() - 2.0 * cross
    return max(distance.item(), 0.0)


def _triangle(rows: Tensor) -> Tensor:
    """(min(N, E), E) matrix R with R'R the sample covariance of rows (N, E)."""
    triangle: Tensor = torch.linalg.qr(rows - rows.mean(0), mode="r").R
    return triangle / (len(rows) - 1) ** 0.5
