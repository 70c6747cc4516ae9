import numpy as np
import pytest
import torch
from scipy import linalg

from moveset.errors import InputError
from moveset.evaluation.frechet import frechet_distance


def _oracle(a, b):
    cov_a, cov_b = np.cov(a, rowvar=False), np.cov(b, rowvar=False)
    root = linalg.sqrtm(cov_a @ cov_b).real
    return ((a.mean(0) - b.mean(0)) ** 2).sum() + np.trace(cov_a + cov_b - 2 * root)


def test_equals_the_textbook_formula_with_scipy_s_matrix_root():
    rng = np.random.default_rng(0)
    a = rng.normal(size=(300, 12)) @ rng.normal(size=(12, 12))
    b = rng.normal(size=(200, 12)) @ rng.normal(size=(12, 12)) + 0.5
    ours = frechet_distance(torch.from_numpy(a), torch.from_numpy(b))
    assert ours == pytest.approx(_oracle(a, b), rel=1e-9)
    assert ours == pytest.approx(frechet_distance(torch.from_numpy(b), torch.from_numpy(a)), rel=1e-9)


def test_more_columns_than_rows_stays_finite_and_zero_on_itself():
    x = torch.randn(5, 40, generator=torch.Generator().manual_seed(0))
    assert frechet_distance(x, x) == pytest.approx(0.0, abs=1e-6)
    assert frechet_distance(x, x + 1.0) == pytest.approx(40.0, abs=1e-4)


def test_axis_aligned_gaussians_by_hand():
    # Two points a column: mean 0, sample variance 2 s^2; the distance is the sum of (sd_a - sd_b)^2.
    a = torch.tensor([[1.0], [-1.0]])
    assert frechet_distance(a, 3 * a) == pytest.approx(2 * (3 - 1) ** 2)


def test_one_row_is_refused():
    with pytest.raises(InputError, match="at least 2 rows"):
        frechet_distance(torch.zeros(1, 3), torch.zeros(5, 3))
