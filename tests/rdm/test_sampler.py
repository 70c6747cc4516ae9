"""The samplers: a wave as one batch against one cell at a time, calls against formulas, plain diffusion as the edge."""

import itertools
import json

import pytest
import torch

from moveset.diffusion.steps import denoise_step
from moveset.errors import InputError
from moveset.models.flow import FlowConfig
from moveset.rdm.noise import START, segment_noise
from moveset.rdm.sampler import Stream
from moveset.rdm.staircase import Staircase, levels
from moveset.rdm.state import StreamState
from moveset.rdm.transport import Transport
from tests.samplers import (
    IDENTITY,
    SCHEDULE,
    SEEDS,
    SHAPE,
    Denoiser,
    Scaled,
    calls,
    noise_of_items,
    run,
    run_by_rows,
    sample,
    settings,
    texts,
)

CLASSES = [
    {"eta": 0.0}, {"eta": 0.0, "init_noise": "shared"}, {"eta": 1.0},
    {"eta": 0.5, "variance": "beta"}, {"eps_scale": 1.1, "time_shift": 0.1},
]  # fmt: skip


def plans(steps=6, segments=(4, 7, 14), lags=(1, 3, 6)):
    return [
        Staircase(steps, n, start, shape, lag)
        for n in segments
        for shape in ("triangle", "parallelogram")
        for start in (0, 3, 5, steps)
        for lag in lags
    ]


@pytest.mark.parametrize("options", CLASSES, ids=str)
def test_a_wave_in_one_batch_is_every_cell_alone_to_the_last_bit(options):
    for plan in plans(steps=6, segments=(5,), lags=(1, 2, 6)):
        together, alone = Denoiser(), Denoiser()
        batched = run(plan, denoiser=together, **options)
        one_by_one = run_by_rows(plan, denoiser=alone, **options)
        assert torch.equal(batched, one_by_one), plan
        assert batched.isfinite().all()
        assert batched.shape == (2, plan.segments, *SHAPE)
        assert (together.segments, together.waves) == (calls(plan), plan.end(plan.segments - 1))
        assert (alone.segments, alone.waves) == (calls(plan), calls(plan))


def test_a_real_network_and_flow_agree_up_to_the_order_of_sums():
    torch.manual_seed(0)
    net = torch.nn.Sequential(torch.nn.Linear(2 * 15 + 3, 32), torch.nn.SiLU(), torch.nn.Linear(32, 15))
    flow = FlowConfig(features=5, blocks=2, hidden=8, text_dim=4, text_context=3, index_context=2, max_index=3).build()
    for block in flow.blocks:
        torch.nn.init.normal_(block.out.weight, std=0.3)

    def denoise(x, t, prev, prev_t, index, numbers):
        rest = torch.stack((t / 1000, prev_t / 1000, (index > 0).float()), dim=-1)
        return net(torch.cat((x.flatten(1), prev.flatten(1), rest), dim=-1)).view_as(x)

    for cap, plan in itertools.product(
        (1, 3), (Staircase(6, 5, 4), Staircase(6, 5, 3, "triangle"), Staircase(6, 4, 6, lag=6))
    ):
        results = [made(plan, Transport(flow, cap), denoise, eta=1.0) for made in (run, run_by_rows)]
        torch.testing.assert_close(*results, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("eta", [0.0, 1.0])
@pytest.mark.parametrize("edges", [levels(10), (999, 499, 0), (1000, 0)])
def test_one_segment_is_ordinary_diffusion(edges, eta):
    plan = Staircase(len(edges) - 1, 1, 1)
    made = run(plan, eta=eta, levels=edges)[:, 0]
    z, net, zero = noise_of_items(SEEDS, 0, START, SHAPE), Denoiser(), torch.zeros(2, dtype=torch.int64)
    for k, (t, s) in enumerate(itertools.pairwise(edges)):
        clean = net(z, zero + t, torch.zeros_like(z), zero, zero, [0, 0])
        z = denoise_step(SCHEDULE, z, clean, zero + t, zero + s, eta, noise_of_items(SEEDS, 0, k, SHAPE))
    assert torch.equal(made, z)


def test_the_identity_flow_is_plain_diffusion_of_every_segment():
    def unconditioned(x, t, prev, prev_t, index, numbers):
        return net(x, t, torch.zeros_like(x), torch.zeros_like(t), torch.zeros_like(index), [0] * len(x))

    net = Denoiser()
    plan = Staircase(10, 5, 10)
    made = sample(unconditioned, IDENTITY, settings(plan, eta=1.0), SEEDS, SHAPE)
    for segment in range(5):
        z = noise_of_items(SEEDS, segment, START, SHAPE)
        for k, (t, s) in enumerate(itertools.pairwise(levels(10))):
            t_B, s_B = torch.full((2,), t), torch.full((2,), s)
            clean = unconditioned(z, t_B, z, t_B, t_B, None)
            z = denoise_step(SCHEDULE, z, clean, t_B, s_B, 1.0, noise_of_items(SEEDS, segment, k, SHAPE))
        assert torch.equal(made[:, segment], z)


def test_disentangled_is_the_flow_alone():
    transport, text = Transport(Scaled()), texts(6)
    made = run(Staircase(5, 6, 0), transport)
    first = run(Staircase(5, 1, 0), transport)
    assert torch.equal(made[:, :1], first)
    for j in range(1, 6):
        context = transport.flow.context(text[j], torch.full((2,), j))
        assert torch.equal(made[:, j], transport.flow(made[:, j - 1], context))


def test_a_copied_entry_is_the_image_of_the_flow():
    """With the depth of the paper and one text, pushing the copied state is f of the left neighbour's noisy state."""
    flow = Scaled()
    flow.context = lambda pooled, index: pooled[:, :1]
    transport, pooled = Transport(flow, depth_cap=8), torch.full((2, 1), 0.3)
    pushed = {}

    def watch(x, t, prev, prev_t, index, numbers):
        pushed.update({(j, int(t[2 * k])): x[2 * k : 2 * k + 2] for k, j in enumerate(numbers[::2])})
        return 0.5 * x

    sample(watch, transport, settings(Staircase(6, 4, 3, "triangle")), SEEDS, SHAPE, [pooled] * 4)
    for j, level in ((1, 500), (2, 333), (3, 166)):
        torch.testing.assert_close(pushed[j, level], flow(pushed[j - 1, level], pooled))


def test_init_noise_does_what_it_says_and_late_entries_are_copies():
    starts = {}

    def watch(x, t, prev, prev_t, index, numbers):
        for k, j in enumerate(numbers[::2]):
            starts.setdefault(j, x[2 * k : 2 * k + 2])
        return 0.5 * x

    def first_states(plan, **options):
        starts.clear()
        sample(watch, IDENTITY, settings(plan, **options), SEEDS, SHAPE)
        return [starts[j] for j in range(plan.segments)]

    full = Staircase(6, 4, 6)
    shared = first_states(full, init_noise="shared")
    assert all(torch.equal(x, shared[0]) for x in shared)
    own = first_states(full, init_noise="independent")
    assert all(torch.equal(x, noise_of_items(SEEDS, j, START, SHAPE)) for j, x in enumerate(own))
    late = Staircase(6, 4, 2)
    copied = first_states(late)
    assert torch.equal(copied[1], copied[2])
    assert torch.equal(copied[1], copied[3])


def test_the_lag_of_all_steps_conditions_on_finished_segments():
    net = Denoiser()
    run(Staircase(5, 3, 5, lag=5), denoiser=net)
    assert all(prev_t == [0] for _, _, prev_t in net.seen)
    lagged = Denoiser()
    run(Staircase(10, 3, 10, lag=4), denoiser=lagged)
    assert {(t, prev_t) for _, ts, prevs in lagged.seen for t, prev_t in zip(ts[1:], prevs[1:], strict=True)} <= {
        (t, max(t - 400, 0)) for t in range(100, 1001, 100)
    }


@pytest.mark.parametrize("options", [*CLASSES, {"eta": 0.5, "past_lag": 2}], ids=str)
def test_a_stream_is_the_sample_and_can_be_stopped_anywhere(options):
    for plan in plans(steps=6, segments=(7,), lags=(6,) if "past_lag" in options else (1, 6)):
        whole, text = run(plan, **options), texts(40)
        endless = Staircase(plan.steps, None, plan.start, plan.shape, plan.lag)
        asked = []

        def enter(segment, asked=asked, text=text):
            asked.append(segment)
            return text[segment]

        def start(state=None, endless=endless, enter=enter):
            return Stream(Denoiser(), Transport(Scaled()), settings(endless, **options), SEEDS, SHAPE, enter, state)

        live = start()
        made, saved = [], []
        for _ in range(7):
            saved.append((json.dumps(live.progress.numbers()), live.progress.tensors()))
            made.append(next(live))
        assert torch.equal(torch.stack(made, dim=1), whole), plan
        assert asked == list(range(len(asked)))
        later = [next(live) for _ in range(5)]
        for k in (0, 3, 6):
            again = start(StreamState.restore(json.loads(saved[k][0]), saved[k][1]))
            resumed = [next(again) for _ in range(12 - k)]
            assert all(torch.equal(a, b) for a, b in zip(resumed, [*made[k:], *later], strict=True))


def test_an_endless_stream_holds_only_the_segments_in_work():
    sizes, entered = set(), []
    plan = Staircase(6, None, 4)

    def enter(segment):
        entered.append(segment)
        return torch.zeros(2, 4)

    live = Stream(Denoiser(), Transport(Scaled()), settings(plan, eta=1.0), SEEDS, SHAPE, enter)
    for number in range(500):
        assert next(live).isfinite().all()
        held = live.progress
        kept = [*held.y, held.left, *([] if held.waiting is None else [held.waiting])]
        storages = {tensor.untyped_storage().data_ptr(): tensor.untyped_storage().nbytes() for tensor in kept}
        if number > 3:
            sizes.add((len(held.active), len(kept), sum(storages.values())))
        assert entered == list(range(held.entered))
        assert held.entered - number <= plan.start + 1  # a prompt is asked for no earlier than it is needed
    assert len(sizes) == 1
    active, tensors, size = sizes.pop()
    assert active < plan.start
    assert tensors <= active + 2
    assert size <= (plan.start + 2) * 2 * 3 * 5 * 4
    assert live.progress.wave == plan.end(499)


def test_a_live_state_is_not_changed_by_what_is_done_with_its_copy():
    plan = Staircase(6, None, 4)
    live = Stream(Denoiser(), IDENTITY, settings(plan), SEEDS, SHAPE, lambda j: None)
    next(live)
    kept = live.progress.copy()
    before = {name: held.clone() for name, held in kept.tensors().items()}, kept.numbers()
    for _ in range(5):
        next(live)
    assert kept.numbers() == before[1]
    assert all(torch.equal(held, before[0][name]) for name, held in kept.tensors().items())


def test_noise_is_a_function_of_its_key():
    keys = list(itertools.product((0, 1, 2**40, -3), (0, 1, 2), (START, 0, 1, 2)))
    drawn = [segment_noise(*key, (4, 6)) for key in keys]
    assert all(torch.equal(z, segment_noise(*key, (4, 6))) for key, z in zip(keys, drawn, strict=True))
    assert len({tuple(z.flatten().tolist()) for z in drawn}) == len(keys)
    many = torch.stack([segment_noise(5, j, k, (10,)) for j in range(60) for k in range(60)]).double()
    assert abs(float(many.mean())) < 0.02
    assert abs(float(many.std()) - 1) < 0.02
    neighbours = (many[:-1] * many[1:]).mean()
    assert abs(float(neighbours)) < 0.02


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"levels": (1000, 500, 0)}, "3 levels do not make 6 steps"),
        ({"levels": (1000, 800, 600, 400, 400, 100, 0)}, "must fall"),
        ({"levels": (1000, 800, 600, 400, 200, 100, 1)}, "must fall"),
        ({"levels": (1001, 800, 600, 400, 200, 100, 0)}, "must fall"),
        ({"eta": 1.5}, "eta 1.5"),
        ({"init_noise": "none"}, "none"),
        ({"past_lag": 1}, "past_lag 1 is for a lag of all 6 steps"),
    ],
)
def test_settings_that_do_not_fit_are_refused(changed, message):
    with pytest.raises(InputError, match=message):
        run(Staircase(6, 3, 3), **changed)
