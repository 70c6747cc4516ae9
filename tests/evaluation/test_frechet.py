import math

import numpy as np
import pytest
import torch
from scipy import linalg

from moveset.errors import InputError
from moveset.evaluation.metrics import frechet_distance


def _oracle(a, b):
    cov_a, cov_b = np.cov(a, rowvar=False), np.cov(b, rowvar=False)
    root = linalg.sqrtm(cov_a @ cov_b).real
    return ((a.mean(0) - b.mean(0)) ** 2).sum() + np.trace(cov_a + cov_b - 2 * root)


def _tables(rows: int, other: int, width: int):
    rng = np.random.default_rng(0)
    a = rng.normal(size=(rows, width)) @ rng.normal(size=(width, width))
    return a, rng.normal(size=(other, width)) @ rng.normal(size=(width, width)) + 0.5


@pytest.mark.parametrize(("rows", "other", "width", "relative"), [(300, 200, 12, 1e-9), (400, 300, 256, 1e-6)])
def test_equals_the_textbook_formula_with_scipy_s_matrix_root(rows, other, width, relative):
    a, b = _tables(rows, other, width)
    ours = frechet_distance(torch.from_numpy(a), torch.from_numpy(b))
    assert ours == pytest.approx(_oracle(a, b), rel=relative)
    assert ours == pytest.approx(frechet_distance(torch.from_numpy(b), torch.from_numpy(a)), rel=1e-9)


def test_more_columns_than_rows_stays_finite_and_zero_on_itself():
    x = torch.randn(5, 40, generator=torch.Generator().manual_seed(0))
    assert frechet_distance(x, x) == pytest.approx(0.0, abs=1e-12)
    assert frechet_distance(x, x + 1.0) == pytest.approx(40.0, abs=1e-4)


def test_itself_is_at_distance_zero_whatever_the_size():
    x = 100.0 * torch.randn(300, 64, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    assert frechet_distance(x, x) < 1e-9 * float(x.var(0).sum())


def test_two_gaussians_whose_covariances_commute():
    """|m|^2 + sum (s - t)^2 in any common axes; samples are whitened first, so that the moments are exact."""
    generator = torch.Generator().manual_seed(0)
    white = torch.randn(50, 6, generator=generator, dtype=torch.float64)
    white = torch.linalg.qr(white - white.mean(0)).Q * 7.0  # unit covariance: 49 = 50 - 1
    turn = torch.linalg.qr(torch.randn(6, 6, generator=generator, dtype=torch.float64)).Q
    s, t = torch.tensor([[1.0, 2, 3, 4, 5, 6], [6.0, 0, 2, 2, 9, 0]], dtype=torch.float64)
    shift = torch.tensor([1.0, 2.0, 0.0, 0.0, 0.0, 2.0], dtype=torch.float64)
    expected = 9.0 + float(((s - t) ** 2).sum())
    assert frechet_distance(white * s @ turn, white * t @ turn + shift) == pytest.approx(expected, rel=1e-10)


def test_singular_covariances_have_a_closed_form_too():
    """Rank one against rank one: the trace of the root is s t |cos| of the angle between the two lines."""
    line = torch.linspace(-1, 1, 9, dtype=torch.float64)[:, None]
    line = line / line.std()
    a, b = line * torch.tensor([[2.0, 0.0, 0.0]]), line * 3.0 * torch.tensor([[math.cos(1.0), math.sin(1.0), 0.0]])
    assert frechet_distance(a, b) == pytest.approx(4.0 + 9.0 - 2 * 2.0 * 3.0 * math.cos(1.0))
    assert frechet_distance(a, line * torch.tensor([[0.0, 5.0, 0.0]])) == pytest.approx(29.0)


@pytest.mark.parametrize("rows", [20, 300])
def test_neither_order_nor_rotation_nor_place_matters(rows):
    a, b = (torch.from_numpy(x) for x in _tables(rows, rows + 7, 32))
    expected = frechet_distance(a, b)
    generator = torch.Generator().manual_seed(1)
    turn = torch.linalg.qr(torch.randn(32, 32, generator=generator, dtype=torch.float64)).Q
    shuffled = b[torch.randperm(len(b), generator=generator)]
    assert frechet_distance(a @ turn + 50.0, shuffled @ turn + 50.0) == pytest.approx(expected, rel=1e-9)


def test_one_row_is_refused():
    with pytest.raises(InputError, match="at least 2 rows"):
        frechet_distance(torch.zeros(1, 3), torch.zeros(5, 3))


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_is_not_finite_is_counted_and_refused(value):
    x = torch.zeros(5, 3)
    x[2, 1] = x[4, 0] = value
    with pytest.raises(InputError, match="2 of 5 motion"):
        frechet_distance(torch.zeros(5, 3), x)
