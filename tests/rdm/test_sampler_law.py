"""What the samplers draw from, where it is known: a stationary Gaussian sequence with its exact denoiser.

Segments are points x^i = A x^(i-1) + e in the plane with identity covariance throughout, so Cov(x^i, x^j) = A^|i-j|.
The frames of a segment serve as independent repetitions.
"""

import math

import pytest
import torch

from moveset.diffusion.schedule import linear
from moveset.rdm.staircase import Staircase
from moveset.rdm.transport import Transport
from tests.samplers import sample, settings

SCHEDULE, REPEATS, N, KEEP = linear(), 4000, 4, 0.8
A = KEEP * torch.tensor([[math.cos(0.5), -math.sin(0.5)], [math.sin(0.5), math.cos(0.5)]])


class Affine:
    """The flow f(x) = scale x + shift; the identity when these are 1 and 0."""

    dtype = torch.float32

    def __init__(self, scale, shift):
        self.scale, self.shift = scale, shift

    def context(self, pooled, index):
        return index

    def __call__(self, x, context):
        return self.scale * x + self.shift

    def inverse(self, y, context):
        return (y - self.shift) / self.scale


def exact(transport):
    """E[x^i | x_t^i, x_t'^(i-1)] when both were noised in y-space."""
    flow = transport.flow

    def moments(index):
        """The clean law's mean and standard deviation in y-space: N(0, 1) in x-space, seen through the flow."""
        later = (index > 0).float()[:, None, None]
        return -later * flow.shift / flow.scale, 1 + later * (1 / flow.scale - 1)

    def level(t):
        return SCHEDULE.alpha(t)[:, None, None], SCHEDULE.sigma(t)[:, None, None]

    def denoise(x, t, prev, prev_t, index, numbers):
        first, before = (index == 0)[:, None, None], (index - 1).clamp(min=0)
        pooled = x.new_zeros(len(x), 0)
        alpha, sigma = level(prev_t)
        mean, spread = moments(before)
        gain = alpha * spread**2 / (alpha**2 * spread**2 + sigma**2)
        left = mean + gain * (transport.pull(prev, before, pooled) - alpha * mean)  # E[y^(i-1) | its noisy state]
        unsure = sigma**2 / (alpha**2 * spread**2 + sigma**2)  # share of variance left
        told = torch.where(first, 0.0, transport.push(left, before, pooled) @ A.T)
        variance = torch.where(first, 1.0, KEEP**2 * unsure + 1 - KEEP**2)
        alpha, sigma = level(t)
        mean, spread = moments(index)
        mean, variance = mean + told * spread, variance * spread**2
        gain = alpha * variance / (alpha**2 * variance + sigma**2)
        return transport.push(mean + gain * (transport.pull(x, index, pooled) - alpha * mean), index, pooled)

    return denoise


def error(transport, lag, steps=250, start=None, eta=1.0, **options):
    """Largest error of the joint covariance of N segments, and of their means."""
    plan = Staircase(steps, N, steps if start is None else start, lag=lag)
    made = sample(exact(transport), transport, settings(plan, eta=eta, **options), (3,), (REPEATS, 2))[0]
    x = made.transpose(0, 1).reshape(REPEATS, 2 * N)
    covariance = torch.cov(x.T)
    target = torch.cat(
        [
            torch.cat(
                [(power if i >= j else power.T) for j in range(N) for power in [torch.matrix_power(A, abs(i - j))]], 1
            )
            for i in range(N)
        ]
    )
    return float((covariance - target).abs().max()), float(x.mean(0).abs().max())


@pytest.mark.parametrize("flow", [Affine(1.0, 0.0), Affine(0.7, 0.6)], ids=["identity", "affine"])
def test_waiting_for_the_finished_segment_reproduces_the_joint_law(flow):
    """Up to sampling error, 0.016 per entry, and that of 250 steps; whatever the flow."""
    off, mean = error(Transport(flow), lag=250)
    assert off < 0.1
    assert mean < 0.08


def test_the_deterministic_sampler_reproduces_it_too():
    off, mean = error(Transport(Affine(0.7, 0.6)), lag=100, steps=100, eta=0.0)
    assert off < 0.1
    assert mean < 0.08


def test_a_shorter_lag_costs_some_of_the_law():
    transport = Transport(Affine(1.0, 0.0))
    near, far = (error(transport, lag, steps=100)[0] for lag in (1, 50))
    assert far < near


def test_a_late_start_costs_more_of_it():
    transport = Transport(Affine(1.0, 0.0))
    early, late = (error(transport, 1, 100, start)[0] for start in (60, 5))
    assert early + 0.2 < late
