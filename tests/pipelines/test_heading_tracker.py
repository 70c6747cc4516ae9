"""How far streams have turned since their sentences began, against the plain sum over all segments."""

import json

import pytest
import torch

from moveset.pipelines.heading_tracker import HeadingTracker

MEAN, STD, YAW = torch.tensor([9.0, 0.1]), torch.tensor([9.0, 2.0]), slice(1, 2)


def course(window):
    return HeadingTracker(YAW, MEAN, STD, window)


@pytest.mark.parametrize("window", [1, 3, 50])
def test_it_is_the_sum_since_the_sentence_began(window):
    """Three streams whose sentences begin at different segments; estimates change while segments are in work."""
    draws = torch.Generator().manual_seed(0)
    begins = [[0, 5, 6, 19], [0], [0, 1, 2, 3, 17]]
    kept, turns = course(window), torch.zeros(3, 24, dtype=torch.float64)
    for segment in range(24):
        began = [max(b for b in line if b <= segment) for line in begins]
        behind_B = torch.tensor([segment - b for b in began])
        expected = [float(turns[row, b:segment].sum()) for row, b in enumerate(began)]
        assert kept.turned(segment, behind_B).tolist() == pytest.approx(expected, abs=1e-4)
        for in_work in range(max(segment - window, 0), segment + 1):
            made = torch.randn(3, 4, 2, generator=draws)
            earlier = [max(b for b in line if b <= in_work) for line in begins]
            kept.made(in_work, made, torch.tensor([in_work - b for b in earlier]))
            turns[:, in_work] = (made[..., 1].double() * 2 + 0.1).sum(dim=1)
    assert len(kept._turns) <= window + 1  # constant memory


def test_it_goes_on_from_its_state():
    whole, behind = course(2), 0
    for segment in range(9):
        behind = segment if segment < 4 else segment - 4
        if segment == 6:
            again = course(2).restored(json.loads(json.dumps(whole.state())))
        for one in (whole, *((again,) if segment >= 6 else ())):
            one.made(segment, torch.full((1, 4, 2), 0.1 * segment), torch.tensor([behind]))
    at = torch.tensor([behind + 1])
    assert torch.equal(whole.turned(9, at), again.turned(9, at))
