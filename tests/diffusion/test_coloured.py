"""Coloured noise: an orthonormal transform, and the spectrum that was asked for."""

import numpy as np
import pytest
import scipy.fft
import torch

from moveset.diffusion.coloured import colour, dct_matrix, temporal_spectrum


@pytest.mark.parametrize("n", [2, 7, 28])
def test_transform_is_orthonormal_and_that_of_scipy(n):
    matrix = dct_matrix(n, dtype=torch.float64)
    torch.testing.assert_close(matrix @ matrix.T, torch.eye(n, dtype=torch.float64))
    x = np.random.default_rng(0).normal(size=(n, 3))
    np.testing.assert_allclose(matrix.numpy() @ x, scipy.fft.dct(x, axis=0, norm="ortho"), atol=1e-12)


def test_flat_spectrum_keeps_noise_white():
    noise = torch.randn(2000, 8, 3, generator=torch.Generator().manual_seed(0))
    made = colour(noise, torch.ones(8, 3))
    covariance = torch.einsum("bnd,bmd->nm", made, made) / (2000 * 3)
    torch.testing.assert_close(covariance, torch.eye(8), atol=0.06, rtol=0)


def test_noise_has_the_spectrum_of_the_segments_it_was_fitted_to():
    generator = torch.Generator().manual_seed(0)
    slow = torch.randn(4000, 12, 2, generator=generator).cumsum(1)
    slow[..., 1] *= 0.1
    slow = slow / slow.square().mean((0, 1)).sqrt()
    spectrum = temporal_spectrum(slow)
    made = colour(torch.randn(4000, 12, 2, generator=generator), spectrum)
    torch.testing.assert_close(temporal_spectrum(made), spectrum, atol=0.02, rtol=0.08)
    torch.testing.assert_close(made.diff(dim=1).std(), slow.diff(dim=1).std(), atol=0.02, rtol=0.05)
    torch.testing.assert_close(spectrum.square().mean(0), torch.ones(2), atol=0.01, rtol=0)
    torch.testing.assert_close(temporal_spectrum(slow * torch.tensor([3.0, 0.2])), spectrum)  # of the shape alone


def test_a_feature_that_never_changes_still_gets_noise():
    spectrum = temporal_spectrum(torch.ones(10, 6, 1))
    assert (spectrum >= 0.01).all()
    assert torch.isfinite(spectrum).all()
