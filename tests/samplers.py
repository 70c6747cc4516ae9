"""What the tests of RDM's samplers share: a network and a flow by arithmetic, and texts."""

import torch

from moveset.diffusion.schedule import linear
from moveset.rdm.noise import segment_noise
from moveset.rdm.sampler import Settings, Stream
from moveset.rdm.sequential import Solver
from moveset.rdm.staircase import levels
from moveset.rdm.transport import Transport

SCHEDULE = linear()
SHAPE, SEEDS = (3, 5), (11, 12)
IDENTITY = Transport(None)


class Denoiser:
    """A made-up network that is the same arithmetic for every row whatever the batch, and counts what it is asked."""

    def __init__(self):
        self.segments, self.waves, self.seen = 0, 0, []

    def __call__(self, x, t, prev, prev_t, index, numbers):
        assert len(x) == len(t) == len(prev) == len(prev_t) == len(index) == len(numbers)
        assert index.tolist() == list(numbers)
        assert (prev_t < t).all()
        assert prev_t[index == 0].eq(0).all()
        self.segments += len(x) / len(SEEDS)
        self.waves += 1
        self.seen.append((numbers[:: len(SEEDS)], t.tolist()[:: len(SEEDS)], prev_t.tolist()[:: len(SEEDS)]))
        level = (t + prev_t / 3)[:, None, None] / 1000
        return (
            0.6 * x / (1 + level * level) + 0.3 * prev / (1 + prev * prev) + 0.1 * level + 0.01 * index[:, None, None]
        )


class Scaled:
    """A flow by arithmetic, the same for every row whatever the batch: f(x; c) = x (1 + s(c)) + c."""

    dtype = torch.float32

    def context(self, pooled, index):
        return pooled[:, :1] + 0.01 * index.clamp(max=3)[:, None]

    def __call__(self, x, context):
        return x * (1 + 0.1 * context[:, :, None]) + context[:, :, None]

    def inverse(self, y, context):
        return (y - context[:, :, None]) / (1 + 0.1 * context[:, :, None])


def texts(segments):
    return [torch.randn(2, 4, generator=torch.Generator().manual_seed(j)) for j in range(segments)]


def noise_of_items(seeds, segment, step, shape):
    return torch.stack([segment_noise(seed, segment, step, shape) for seed in seeds])


def solver(steps, **options):
    return Solver(**{"schedule": SCHEDULE, "levels": levels(steps), **options})


def settings(plan, *, init_noise="independent", **options):
    return Settings(solver=solver(plan.steps, **options), staircase=plan, init_noise=init_noise)


def sample(denoiser, transport, settings, seeds, shape, pooled=None):
    """N segments (B, N, n, D); ``pooled`` has the sentence embeddings (B, C) of every one, for the flow."""
    enter = (lambda segment: None) if pooled is None else pooled.__getitem__
    return torch.stack(list(Stream(denoiser, transport, settings, seeds, shape, enter)), dim=1)


def run(plan, transport=None, denoiser=None, **options):
    return sample(
        denoiser or Denoiser(), transport or Transport(Scaled()), settings(plan, **options), SEEDS, SHAPE,
        texts(plan.segments),
    )  # fmt: skip


def calls(plan):
    """Network evaluations of one segment each."""
    return sum(map(len, plan.wavefront()))


def rows(plan):
    """All cells of a plan one by one, noise level by noise level and from left to right, as published.

    With a lag, rows lean: a segment's cell comes with its left neighbour's of ``lag`` - 1 steps later.
    """
    lean = plan.lag - 1
    for row in range(plan.steps + lean * (plan.segments - 1)):
        for segment in range(plan.segments):
            if plan.entry(segment) <= (step := row - lean * segment) < plan.steps:
                yield segment, step


def run_by_rows(plan, transport=None, denoiser=None, **options):
    """What ``run`` gives, one cell at a time."""
    live = Stream(
        denoiser or Denoiser(), transport or Transport(Scaled()), settings(plan, **options), SEEDS, SHAPE,
        texts(plan.segments).__getitem__,
    )  # fmt: skip
    made = [segment for cell in rows(plan) if (segment := live.evaluate((cell,))) is not None]
    return torch.stack([*made, *live], dim=1)
