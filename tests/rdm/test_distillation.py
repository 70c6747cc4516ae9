"""Phased consistency of segments: jumps, their inverse, and MotionPCM's own target as an oracle."""

import pytest
import torch
from torch import nn

from moveset.diffusion.guidance import cfg
from moveset.diffusion.phases import PhaseGrid
from moveset.diffusion.schedule import linear
from moveset.diffusion.steps import denoise_step, over, predict_z0
from moveset.pcm.consistency import phased_target
from moveset.rdm.distillation import clean_target, implied_clean, share_of_clean, trajectory_target

SCHEDULE, B = linear(), 10
EVERY_POINT = torch.arange(B)
FROM, TO = torch.tensor([1000, 999, 500, 499, 100, 37, 2, 1, 700, 80]), torch.tensor([0, 0, 0, 99, 99, 5, 1, 0, 699, 9])


def _rand(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


Z, CLEAN = _rand(B, 4, 3, seed=1), _rand(B, 4, 3, seed=2)


def same(x):
    return x


def test_a_jump_is_so_much_clean_and_so_much_of_where_it_starts():
    share = share_of_clean(SCHEDULE, FROM, TO)
    ratio = (SCHEDULE.sigma(TO, torch.float64) / SCHEDULE.sigma(FROM, torch.float64)).float()
    want = over(share, Z) * CLEAN + over(ratio, Z) * Z
    torch.testing.assert_close(denoise_step(SCHEDULE, Z, CLEAN, FROM, TO), want, rtol=1e-4, atol=1e-4)


def test_a_jump_along_the_noising_lands_on_it():
    """z_t and z_s of one clean segment and one noise: the jump from the one with the true y0 is the other."""
    noise = _rand(B, 4, 3, seed=3)
    at = {t: over(SCHEDULE.alpha(t), Z) * CLEAN + over(SCHEDULE.sigma(t), Z) * noise for t in (FROM, TO)}
    torch.testing.assert_close(denoise_step(SCHEDULE, at[FROM], CLEAN, FROM, TO), at[TO], rtol=1e-3, atol=1e-3)


def test_the_implied_clean_segment_undoes_the_jump():
    landed = denoise_step(SCHEDULE, Z, CLEAN, FROM, TO)
    found = implied_clean(SCHEDULE, Z, landed, FROM, TO)
    loose = share_of_clean(SCHEDULE, FROM, TO) < 0.1  # so little of it is in a short jump
    assert loose.any()
    torch.testing.assert_close(found[~loose], CLEAN[~loose], rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(found[loose], CLEAN[loose], rtol=0.1, atol=0.1)


def test_the_share_of_the_clean_segment_is_none_for_no_jump_and_all_for_a_whole_one():
    t = torch.arange(1, 1001)
    assert share_of_clean(SCHEDULE, t, t).abs().max() < 1e-7
    assert torch.equal(share_of_clean(SCHEDULE, t, torch.zeros_like(t)), torch.ones(1000))
    steps = share_of_clean(SCHEDULE, torch.full((999,), 1000), torch.arange(1, 1000))
    assert bool((steps.diff() < 0).all())
    assert float(steps.min()) > 0


class Noise(nn.Module):
    """Some network that says noise, of z, t and w."""

    def __init__(self, seed):
        super().__init__()
        torch.manual_seed(seed)
        self.net = nn.Linear(3, 3)

    def forward(self, z, t, w=None):
        bent = torch.tanh(self.net(z)) * over(0.5 + t / 1000, z)
        return bent if w is None else bent * over(1 + 0.1 * w, z)


@pytest.mark.parametrize("phases", [1, 2, 4, 10])
def test_without_a_flow_the_target_is_that_of_motionpcm(phases):
    told, untold, averaged = Noise(0), Noise(1), Noise(2)
    grid, w = PhaseGrid(10, phases), torch.linspace(0, 3, B)

    def teacher(x, t):
        return predict_z0(SCHEDULE, x, cfg(told(x, t), untold(x, t), w), t)

    def ema(x, t):
        return predict_z0(SCHEDULE, x, averaged(x, t, w), t)

    target, share = clean_target(SCHEDULE, grid, teacher, ema, same, same, Z, EVERY_POINT)
    landed = phased_target(
        SCHEDULE, grid, lambda z, t: cfg(told(z, t), untold(z, t), w), lambda z, t: averaged(z, t, w), Z, EVERY_POINT
    )
    t, edge = grid.time(EVERY_POINT), grid.lower(EVERY_POINT)
    torch.testing.assert_close(denoise_step(SCHEDULE, Z, target, t, edge), landed, rtol=2e-3, atol=2e-3)
    assert torch.equal(share, share_of_clean(SCHEDULE, t, edge))
    assert float(share.min()) > 0


def test_a_student_that_says_the_truth_has_reached_its_target():
    """If teacher and average know the clean segment, so does the target, at every point and in any coordinates."""

    def truth(x, t):
        return CLEAN

    push, pull = (lambda y: 2 * y + 1), (lambda x: (x - 1) / 2)
    for phases in (1, 2, 4):
        z = over(SCHEDULE.alpha(PhaseGrid().time(EVERY_POINT)), Z) * pull(CLEAN)
        z = z + over(SCHEDULE.sigma(PhaseGrid().time(EVERY_POINT)), Z) * _rand(B, 4, 3, seed=4)
        grid = PhaseGrid(10, phases)
        target, _ = clean_target(SCHEDULE, grid, truth, truth, push, pull, z, EVERY_POINT)
        torch.testing.assert_close(target, CLEAN, rtol=1e-2, atol=1e-2)


def test_no_gradient_reaches_teacher_or_average():
    teacher, ema = Noise(0), Noise(1)
    z = Z.clone().requires_grad_()
    target, share = clean_target(SCHEDULE, PhaseGrid(), teacher, ema, same, same, z, EVERY_POINT)
    assert not target.requires_grad
    assert not share.requires_grad
    student = Noise(2)
    (student(Z, PhaseGrid().time(EVERY_POINT)) - target).square().mean().backward()
    assert all(p.grad is None for network in (teacher, ema) for p in network.parameters())
    assert all(p.grad is not None for p in student.parameters())


def test_a_jump_is_differentiable_in_the_clean_segment():
    clean = CLEAN.clone().requires_grad_()
    denoise_step(SCHEDULE, Z, clean, FROM, TO).sum().backward()
    share = over(share_of_clean(SCHEDULE, FROM, TO), Z).expand_as(Z)
    torch.testing.assert_close(clean.grad, share, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("phases", [1, 2, 4])
def test_the_whole_way_is_the_teachers_sampling_down_to_the_edge(phases):
    grid, network = PhaseGrid(10, phases), Noise(0)

    def teacher(x, t):
        return predict_z0(SCHEDULE, x, network(x, t), t)

    target = trajectory_target(SCHEDULE, grid, teacher, same, same, Z, EVERY_POINT)
    for k in range(B):
        point = EVERY_POINT[k : k + 1]
        start, edge = grid.time(point), grid.lower(point)
        z, t = Z[k : k + 1], start
        while int(t) > int(edge):
            before = grid.previous(point)
            z = denoise_step(SCHEDULE, z, teacher(z, t), t, before)
            point, t = point - 1, before
        assert not target.requires_grad
        landed = denoise_step(SCHEDULE, Z[k : k + 1], target[k : k + 1], start, edge)
        torch.testing.assert_close(landed, z, rtol=2e-3, atol=2e-3)


def test_the_whole_way_of_one_who_knows_the_truth_is_the_truth_in_any_coordinates():
    push, pull = (lambda y: 2 * y + 1), (lambda x: (x - 1) / 2)
    target = trajectory_target(SCHEDULE, PhaseGrid(10, 2), lambda x, t: CLEAN, push, pull, Z, EVERY_POINT)
    torch.testing.assert_close(target, CLEAN, rtol=1e-2, atol=1e-2)
