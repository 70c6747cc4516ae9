"""Laws of phased consistency: exact students, a student that must converge, and who receives gradients."""

import copy

import pytest
import torch
from torch import nn

from moveset.diffusion.guidance import cfg
from moveset.diffusion.phases import PhaseGrid
from moveset.diffusion.schedule import scaled_linear
from moveset.diffusion.steps import add_noise, ddim_step, predict_z0
from moveset.pcm.consistency import (
    adversarial_pair,
    draw,
    lcm_prediction,
    lcm_target,
    phase_entry,
    phased_prediction,
    phased_target,
    teacher_step,
    trajectory_target,
)
from moveset.pcm.losses import pseudo_huber
from moveset.pcm.sampler import lcm_timesteps, sample_lcm, sample_phased

SCHEDULE = scaled_linear()
GRIDS = [PhaseGrid(10, m) for m in (1, 2, 4)]
MU, OTHER, V = torch.tensor([[1.5, -0.5, 0.3]]), torch.tensor([[1.0, -0.5, 0.5]]), torch.tensor([[0.3, 1.5, 0.05]])


def tables(t, like):
    shape = (*t.shape, *(1,) * (like.ndim - t.ndim))
    return SCHEDULE.alpha(t, like.dtype).view(shape), SCHEDULE.sigma(t, like.dtype).view(shape)


def gaussian_eps(z, t, mu):
    a, s = tables(t, z)
    return s * (z - a * mu) / (a * a * V + s * s)


def gaussian_flow(z, t, s, mu):
    (at, st), (as_, ss) = tables(t, z), tables(s, z)
    return as_ * mu + ((as_**2 * V + ss**2) / (at**2 * V + st**2)).sqrt() * (z - at * mu)


def teacher(w):
    return lambda z, t: cfg(gaussian_eps(z, t, MU), gaussian_eps(z, t, OTHER), w)


def bound(student, w):
    return lambda z, t: student(z, t, w)


def normal(*shape, seed=0, dtype=torch.float32):
    return torch.randn(*shape, dtype=dtype, generator=torch.Generator().manual_seed(seed))


class ExactStudent:
    """The noise with which one jump to the phase's lower edge lands exactly on the probability flow."""

    def __init__(self, grid):
        self.below = {t: s for t, s in grid.jumps} | {
            int(grid.time(i)): int(grid.lower(i)) for i in torch.arange(grid.points)
        }

    def __call__(self, z, t):
        s = torch.tensor([self.below[int(k)] for k in t])
        landed = gaussian_flow(z, t, s, MU)
        at_zero = ddim_step(SCHEDULE, z, torch.zeros_like(z), t, s)
        slope = ddim_step(SCHEDULE, torch.zeros_like(z), torch.ones_like(z), t, s)
        return (landed - at_zero) / slope


@pytest.mark.parametrize("grid", GRIDS, ids=lambda g: f"M={g.phases}")
def test_exact_students_land_on_one_trajectory_whatever_the_number_of_phases(grid):
    z = normal(32, 1, 3, dtype=torch.float64)
    seen = []
    exact = ExactStudent(grid)

    def model(z, t):
        seen.append((z, t, exact(z, t)))
        return seen[-1][2]

    result = sample_phased(model, SCHEDULE, grid, z)
    top, zero = torch.full((32,), 999), torch.zeros(32, dtype=torch.int64)
    for at, t, _ in seen:
        torch.testing.assert_close(at, gaussian_flow(z, top, t, MU), atol=1e-9, rtol=1e-9)
    # adding back the noise that the last jump leaves out gives the flow's own end at t = 0
    landed = add_noise(SCHEDULE, result, seen[-1][2], zero)
    torch.testing.assert_close(landed, gaussian_flow(z, top, zero, MU), atol=1e-9, rtol=1e-9)


@pytest.mark.parametrize("grid", GRIDS, ids=lambda g: f"M={g.phases}")
def test_exact_students_are_consistent_along_the_flow(grid):
    i = torch.arange(1, grid.points)
    same = grid.phase(i) == grid.phase(i - 1)
    z = normal(len(i), 1, 3, dtype=torch.float64)
    below = gaussian_flow(z, grid.time(i), grid.time(i - 1), MU)
    student = ExactStudent(grid)
    high = phased_prediction(SCHEDULE, grid, student, z, i)
    low = phased_prediction(SCHEDULE, grid, student, below, i - 1)
    torch.testing.assert_close(high[same], low[same], atol=1e-9, rtol=1e-9)
    assert int(same.sum()) == grid.points - grid.phases


class TinyStudent(nn.Module):
    """Noise that is affine in z and in w, with its own coefficients at every time: can represent the answer exactly."""

    def __init__(self, grid):
        super().__init__()
        i = torch.arange(grid.points)
        a, s = SCHEDULE.alpha(grid.time(i))[:, None], SCHEDULE.sigma(grid.time(i))[:, None]
        scale = s / (a * a * V + s * s)
        # as a student starts from its teacher: the text-conditional noise, and no effect of w; the last row is t = 0
        self.scale, self.shift = (nn.Parameter(torch.cat((x, torch.zeros(1, 3)))) for x in (scale, -scale * a * MU))
        self.guidance = nn.Parameter(torch.zeros(grid.points + 1, 3))

    def forward(self, z, t, w):
        row = (t + 1) // 100 - 1
        return self.scale[row, None] * z + (self.shift[row] + self.guidance[row] * w[:, None])[:, None]


def train(student, prediction, target, grid, steps):
    """A few hundred iterations on Gaussian data, as the trainer does them; returns the last loss."""
    ema = copy.deepcopy(student)
    optimizer = torch.optim.Adam(student.parameters(), lr=0.02)
    decay = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps, 1e-5)
    generator = torch.Generator().manual_seed(1)
    for _ in range(steps):
        z0 = MU + V.sqrt() * torch.randn(128, 1, 3, generator=generator)
        d = draw(grid, z0, (1.0, 4.0), generator)
        z = add_noise(SCHEDULE, z0, d.noise_BND, grid.time(d.point_B))
        aim = target(SCHEDULE, grid, teacher(d.w_B), bound(ema, d.w_B), z, d.point_B)
        loss = pseudo_huber(prediction(bound(student, d.w_B), z, d), aim)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        decay.step()
        with torch.no_grad():
            for slow, fast in zip(ema.parameters(), student.parameters(), strict=True):
                slow.lerp_(fast, 0.05)
    return float(loss.detach())


def solved(z, w, t_from, t_to, grid):
    """The teacher's own solver steps from one grid time down to another."""
    for i in reversed(range(grid.points)):
        point = torch.full((len(z),), i)
        if t_to < int(grid.time(point[0])) <= t_from:
            z = teacher_step(SCHEDULE, grid, teacher(w), z, point)
    return z


@pytest.mark.parametrize("grid", GRIDS, ids=lambda g: f"M={g.phases}")
def test_a_phased_student_converges_to_the_teachers_solver(grid):
    student = TinyStudent(grid)
    loss = train(student, lambda s, z, d: phased_prediction(SCHEDULE, grid, s, z, d.point_B), phased_target, grid, 700)
    assert loss < 1e-4
    z, w = normal(256, 1, 3, seed=4), torch.linspace(1.0, 4.0, 256)
    seen = []
    with torch.no_grad():
        sample_phased(lambda z, t: seen.append(z) or student(z, t, w), SCHEDULE, grid, z)
        for at, (t, s) in zip(seen, grid.jumps, strict=True):
            t_B = torch.full((256,), t)
            jump = ddim_step(SCHEDULE, at, student(at, t_B, w), t_B, torch.full((256,), s))
            torch.testing.assert_close(jump, solved(at, w, t, s, grid), atol=0.04, rtol=0)
        one, other = (sample_phased(bound(student, torch.full((256,), g)), SCHEDULE, grid, z) for g in (1.0, 4.0))
    # guidance moves the mean of the samples by about 3 (MU - OTHER); ten solver steps are off by a few per cent
    torch.testing.assert_close((other - one).mean(0), 3 * (MU - OTHER), atol=0.1, rtol=0)


def test_a_consistency_student_converges_too():
    grid = PhaseGrid(10)
    student = TinyStudent(grid)

    def prediction(s, z, d):
        return lcm_prediction(SCHEDULE, s, z, grid.time(d.point_B))

    assert train(student, prediction, lcm_target, grid, 700) < 1e-4
    z, w = normal(256, 1, 3, seed=4), torch.linspace(1.0, 4.0, 256)
    with torch.no_grad():
        result = sample_lcm(bound(student, w), SCHEDULE, lcm_timesteps(1), [z])
    # its target at t_0 is the teacher's z at t = 0
    torch.testing.assert_close(result, solved(z, w, 999, 0, grid), atol=0.04, rtol=0)


@pytest.mark.parametrize("grid", GRIDS, ids=lambda g: f"M={g.phases}")
def test_at_phase_starts_the_target_is_the_teachers_step(grid):
    z, w = normal(10, 1, 3), torch.full((10,), 3.0)
    i = torch.arange(10)
    absurd = lambda z, t: 1e6 * torch.ones_like(z)  # noqa: E731
    target = phased_target(SCHEDULE, grid, teacher(w), absurd, z, i)
    step = teacher_step(SCHEDULE, grid, teacher(w), z, i)
    starts = torch.isin(i, torch.tensor(grid.starts))
    assert torch.equal(target[starts], step[starts])
    assert not torch.isclose(target[~starts], step[~starts]).any()
    # and the consistency model's target at its only phase start
    assert torch.equal(lcm_target(SCHEDULE, grid, teacher(w), absurd, z, i)[0], step[0])


@pytest.mark.parametrize("targets", [phased_target, lcm_target])
def test_no_gradient_reaches_teacher_or_average(targets):
    grid = PhaseGrid(10, 2)
    nets = nn.ModuleDict({name: nn.Linear(3, 3) for name in ("student", "teacher", "ema")})
    student, teacher, ema = (lambda z, t, n=n: nets[n](z) for n in ("student", "teacher", "ema"))
    z0 = normal(16, 1, 3)
    d = draw(grid, z0, (5.0, 15.0), torch.Generator().manual_seed(0))
    z = add_noise(SCHEDULE, z0, d.noise_BND, grid.time(d.point_B))
    prediction = phased_prediction(SCHEDULE, grid, student, z, d.point_B)
    target = targets(SCHEDULE, grid, teacher, ema, z, d.point_B)
    assert not target.requires_grad
    fake, real = adversarial_pair(SCHEDULE, grid, d, prediction, z0)
    # the student learns from the discriminator's verdict as well as from the distance
    (through_fake,) = torch.autograd.grad(fake.mean(), nets["student"].weight, retain_graph=True)
    assert through_fake.abs().sum() > 0
    pseudo_huber(prediction, target).backward()
    assert not real.requires_grad
    assert all(p.grad is None for n in ("teacher", "ema") for p in nets[n].parameters())
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in nets["student"].parameters())


@pytest.mark.parametrize("grid", GRIDS, ids=lambda g: f"M={g.phases}")
def test_draws_stay_in_range_and_cover_it(grid):
    d = draw(grid, torch.zeros(40_000, 1, 1), (5.0, 15.0), torch.Generator().manual_seed(2))
    assert d.w_B.min() >= 5
    assert d.w_B.max() <= 15
    assert abs(d.w_B.mean() - 10) < 0.1
    assert torch.equal(d.point_B.unique(), torch.arange(10))
    low, high = grid.lower(d.point_B), grid.upper(d.point_B)
    assert (low <= d.judged_B).all()
    assert (d.judged_B <= high).all()
    where = (d.judged_B - low) / (high - low)
    assert abs(where.mean() - 0.5) < 0.01
    assert torch.isin(torch.tensor(grid.edges), d.judged_B).all()
    flat = torch.stack((d.noise_BND, d.fake_noise_BND, d.real_noise_BND)).view(3, -1)
    torch.testing.assert_close(torch.corrcoef(flat), torch.eye(3), atol=0.02, rtol=0)
    again = draw(grid, torch.zeros(40_000, 1, 1), (5.0, 15.0), torch.Generator().manual_seed(2))
    assert all(torch.equal(getattr(d, n), getattr(again, n)) for n in vars(d))


@pytest.mark.parametrize("grid", GRIDS, ids=lambda g: f"M={g.phases}")
def test_draws_may_dwell_where_students_are_used_and_where_the_discriminator_sees(grid):
    z0, plain = torch.zeros(40_000, 1, 1), torch.Generator().manual_seed(2)
    uniform = draw(grid, z0, (5.0, 15.0), plain)
    again = torch.Generator().manual_seed(2)
    dwelt = draw(grid, z0, (5.0, 15.0), again, inference_points=0.5, discriminator_max_noise=0.4)
    used = torch.tensor([edge for edge, _ in grid.jumps])
    share = torch.isin(grid.time(uniform.point_B), used).double().mean()
    assert abs(torch.isin(grid.time(dwelt.point_B), used).double().mean() - (share + (1 - share) * 0.5)) < 0.01
    # How often a phase is drawn stays as it was.
    assert torch.equal(grid.phase(dwelt.point_B), grid.phase(uniform.point_B))
    low, high = grid.lower(dwelt.point_B), grid.upper(dwelt.point_B)
    where = (dwelt.judged_B - low) / (high - low)
    assert where.min() >= 0
    assert 0.39 < where.max() <= 0.4
    assert abs(where.mean() - 0.2) < 0.01


@pytest.mark.parametrize("grid", GRIDS, ids=lambda g: f"M={g.phases}")
def test_a_perfect_students_fakes_are_distributed_like_the_real_ones(grid):
    z0 = MU.double() + V.double().sqrt() * normal(60_000, 1, 3, dtype=torch.float64)
    d = draw(grid, z0, (0.0, 0.0), torch.Generator().manual_seed(3))
    z = add_noise(SCHEDULE, z0, d.noise_BND, grid.time(d.point_B))
    landed = gaussian_flow(z, grid.time(d.point_B), grid.lower(d.point_B), MU)
    fake, real = adversarial_pair(SCHEDULE, grid, d, landed, z0)
    for s in (d.judged_B < 300, d.judged_B > 600):
        torch.testing.assert_close(fake[s].mean(0), real[s].mean(0), atol=0.03, rtol=0)
        torch.testing.assert_close(fake[s].std(0), real[s].std(0), atol=0.03, rtol=0)


@pytest.mark.parametrize("grid", GRIDS, ids=lambda g: f"M={g.phases}")
def test_the_whole_target_is_the_teachers_own_way_to_the_edge(grid):
    """From every point at once: rows arrive after unlike numbers of steps, and wait for each other unchanged."""
    point = torch.arange(grid.points)
    z, w = normal(grid.points, 1, 3), torch.linspace(0.0, 4.0, grid.points)
    whole = trajectory_target(SCHEDULE, grid, teacher(w), z, point)
    for i in range(grid.points):
        one = slice(i, i + 1)
        alone = solved(z[one], w[one], int(grid.time(point[i])), int(grid.lower(point[i])), grid)
        torch.testing.assert_close(whole[one], alone, rtol=1e-6, atol=1e-6)
    lowest = torch.tensor(grid.starts)
    student = TinyStudent(grid)
    aim = phased_target(SCHEDULE, grid, teacher(w[lowest]), bound(student, w[lowest]), z[lowest], lowest)
    torch.testing.assert_close(whole[lowest], aim, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("grid", GRIDS, ids=lambda g: f"M={g.phases}")
def test_phases_are_entered_where_sampling_enters_them(grid):
    """Each phase jumps from there as sampling does; rows of unlike phases do not disturb each other."""
    student, phases = TinyStudent(grid), torch.arange(grid.phases)
    noise, w = normal(1, 1, 3).expand(grid.phases, 1, 3), torch.full((grid.phases,), 2.0)
    z = phase_entry(SCHEDULE, grid, bound(student, w), noise, phases)
    torch.testing.assert_close(z[-1], noise[-1], rtol=0, atol=0)
    below = phased_prediction(SCHEDULE, grid, bound(student, w), z, grid.highest_of(phases))
    torch.testing.assert_close(z[:-1], below[1:], rtol=1e-6, atol=1e-6)
    zero, t_B = torch.zeros(1, dtype=torch.long), torch.full((1,), grid.jumps[-1][0])
    sampled = sample_phased(bound(student, w[:1]), SCHEDULE, grid, noise[:1])
    # Sampling ends in the estimate without noise, training at time 0, which keeps a little of it.
    eps = student(z[:1], t_B, w[:1])
    torch.testing.assert_close(sampled, predict_z0(SCHEDULE, z[:1], eps, t_B), rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(below[:1], ddim_step(SCHEDULE, z[:1], eps, t_B, zero), rtol=1e-6, atol=1e-6)
