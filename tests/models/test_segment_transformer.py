"""The segment denoiser that ships: what it looks at, what it ignores, and how a student begins."""

from dataclasses import replace

import pytest
import torch

from moveset.diffusion.coloured import colour, dct_matrix
from moveset.diffusion.schedule import linear
from moveset.models.segment_transformer import SegmentTransformerConfig
from tests.conditions import awake, call

CONFIG = SegmentTransformerConfig(features=5, frames=6, text_dim=7, width=16, heads=2, hidden=24, blocks=2)
ROWS = 4


@pytest.fixture(scope="module")
def model():
    return awake(CONFIG)


@pytest.fixture
def inputs():
    g = torch.Generator().manual_seed(1)
    x, prev, tokens = (torch.randn(ROWS, *shape, generator=g) for shape in ((6, 5), (6, 5), (8, 7)))
    return {
        "x_BnD": x,
        "t_B": torch.tensor([1, 30, 500, 1000]),
        "prev_BnD": prev,
        "prev_t_B": torch.tensor([0, 0, 0, 700]),
        "index_B": torch.tensor([0, 1, 2, 9]),
        "tokens_BLC": tokens,
        "mask_BL": torch.arange(8) < torch.tensor([8, 3, 1, 5])[:, None],
    }


def gap(one, other):
    return (one - other).detach().abs().amax(dim=(1, 2))


def test_who_is_alone_takes_every_segment_for_a_first_one(model, inputs):
    alone = replace(CONFIG, alone=True).build().eval()
    alone.load_state_dict(model.state_dict())
    nothing = {name: torch.zeros_like(inputs[name]) for name in ("prev_BnD", "prev_t_B", "index_B")}
    made = call(alone, **inputs)
    assert torch.equal(made, call(model, **{**inputs, **nothing}))
    assert float(gap(made, call(model, **inputs))[1:].min()) > 1e-3
    assert torch.equal(call(alone, **inputs, prepare=True), made)


def test_a_sentence_longer_than_any_that_was_learned_is_read_as_far_as_there_are_places(model, inputs):
    tokens, mask = torch.randn(ROWS, 128, 7), torch.ones(ROWS, 128, dtype=torch.bool)
    long, cut = ({**inputs, "tokens_BLC": tokens[:, :n], "mask_BL": mask[:, :n]} for n in (128, 64))
    assert torch.equal(call(model, **long), call(model, **cut))


TURN = torch.tensor([0.0, 1.5, float("nan"), -1.5])


def test_a_turn_is_read_where_it_is_known(model, inputs):
    fresh = replace(CONFIG, heading_change=True).build().eval()
    assert fresh.load_state_dict(model.state_dict(), strict=False).missing_keys == ["course.weight"]
    # Fresh, it changes nothing; nor does it ever where nothing is told, or to who does not read it.
    plain = call(model, **inputs)
    assert torch.equal(call(fresh, **inputs, turned_B=TURN), plain)
    assert torch.equal(call(model, **inputs, turned_B=TURN), plain)
    network = awake(fresh.config)
    silent, heard = call(network, **inputs), call(network, **inputs, turned_B=TURN)
    # Not to have turned is something to know, too; more than a turn is not.
    for nothing in (torch.full((4,), float("nan")), torch.full((4,), 6.3)):
        assert torch.equal(call(network, **inputs, turned_B=nothing), silent)
    moved = gap(heard, silent)
    assert float(moved[2]) == 0
    assert float(moved[[0, 1, 3]].min()) > 1e-3
    assert float(gap(call(network, **inputs, turned_B=-TURN), heard)[1]) > 1e-3


def test_the_index_saturates(inputs):
    for largest in (1, 3):
        model = awake(replace(CONFIG, max_index=largest))
        for number, same in ((largest, True), (largest - 1, False)):
            index = torch.tensor([0, number, number, number])
            beyond = torch.tensor([0, 50, 60, 70])
            moved = gap(call(model, **{**inputs, "index_B": index}), call(model, **{**inputs, "index_B": beyond}))
            assert float(moved[0]) == 0
            assert (float(moved[1:].max()) < 1e-6) == same


def test_a_fresh_network_says_the_mean(inputs):
    """Zero in normalised features: neither noise nor the segment before gets through before anything is learned."""
    assert not call(CONFIG.build(), **inputs).any()


def test_a_forecast_goes_on_from_what_is_clean(inputs):
    """Last frame and last step, weighted frame by frame; faded by the noise in them, absent from first segments."""
    model = CONFIG.build()
    with torch.no_grad():
        model.forecast[0].fill_(1.0)
        model.forecast[1].copy_(torch.arange(1.0, 7)[:, None].expand(6, 5))
    made = call(model, **inputs)
    prev = inputs["prev_BnD"]
    last, step = prev[:, -1:], prev[:, -1:] - prev[:, -2:-1]
    line = last + step * torch.arange(1.0, 7)[None, :, None]
    faded = linear().alpha_bar[700].float()
    for row, share in ((0, 0.0), (1, 1.0), (2, 1.0), (3, faded)):
        torch.testing.assert_close(made[row], share * line[row], rtol=1e-4, atol=1e-5)


def test_noise_has_the_spectrum_that_the_network_keeps(model):
    noise = torch.randn(3, 6, 5, generator=torch.Generator().manual_seed(2))
    # Flat at first: another standard normal noise, turned within the frames.
    torch.testing.assert_close(model.colour(noise).norm(dim=1), noise.norm(dim=1), rtol=1e-5, atol=1e-5)
    dyed = awake(CONFIG)
    dyed.spectrum[:3] = 2.0
    assert torch.equal(dyed.colour(noise), colour(noise, dyed.spectrum))
    again = CONFIG.build()
    again.load_state_dict(dyed.state_dict())
    assert torch.equal(again.spectrum, dyed.spectrum)
    assert torch.equal(dyed.student().spectrum, dyed.spectrum)


def damping(frames=28, **settings):
    """How much of each frequency of what the network says is left, the data having a deviation of one in all."""
    model = SegmentTransformerConfig(features=3, frames=frames, text_dim=7, width=16, heads=2, hidden=32, **settings)
    network = model.build()
    network.spectrum.fill_(1.0)
    dct = dct_matrix(frames, torch.device("cpu"))
    # Row k of the matrix is the wave of frequency k.
    return torch.stack([(dct @ network._smoothed(wave[None, :, None].expand(1, frames, 3)))[0, :, 0] for wave in dct])


def test_smoothing_damps_each_frequency_by_what_the_data_has_of_it():
    kept = damping(smoothing=0.5)
    assert torch.allclose(kept, torch.eye(28) / (1 + 0.25) ** 0.5, atol=1e-5)
    assert torch.allclose(damping(), torch.eye(28), atol=1e-5)


def test_tremor_is_damped_above_a_third_of_the_highest_frequency_alone():
    plain, kept = damping(smoothing=0.3).diagonal(), damping(smoothing=0.3, tremor=1.0).diagonal()
    assert torch.allclose(kept[:5], plain[:5], atol=0.01)
    assert torch.allclose(kept[15:], torch.tensor(0.5**0.5), atol=0.01)
    assert (kept.diff() <= 1e-6).all()  # no edge to ring at
    assert torch.allclose(damping(smoothing=0.3, tremor=0.1), damping(smoothing=0.3), atol=1e-6)


def test_a_student_keeps_the_smoothing_of_its_teacher():
    config = SegmentTransformerConfig(features=3, frames=6, text_dim=7, width=16, heads=2, hidden=32, smoothing=0.3)
    student = replace(config, tremor=1.0).build().student()
    assert (student.config.smoothing, student.config.tremor, student.config.guided) == (0.3, 1.0, True)
