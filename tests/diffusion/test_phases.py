"""Edges, phases and jumps of the solver grid."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from moveset.diffusion.phases import PhaseGrid
from moveset.errors import InputError


@pytest.mark.parametrize(
    ("points", "phases", "edges"),
    [
        (10, 1, (0, 999)),
        (10, 2, (0, 499, 999)),
        (10, 4, (0, 199, 499, 699, 999)),
        (20, 1, (0, 999)),
        (20, 2, (0, 499, 999)),
        (20, 4, (0, 249, 499, 749, 999)),
        (40, 2, (0, 499, 999)),
        (40, 4, (0, 249, 499, 749, 999)),
        (50, 2, (0, 499, 999)),
        (50, 4, (0, 239, 499, 739, 999)),
    ],
)
def test_edges(points, phases, edges):
    assert PhaseGrid(points, phases).edges == edges


@given(st.sampled_from([n for n in range(1, 501) if 1000 % n == 0]), st.data())
def test_every_point_lies_in_the_phase_it_is_assigned_to(points, data):
    phases = data.draw(st.integers(1, min(points, 64)))
    grid, i = PhaseGrid(points, phases), torch.arange(points)
    starts = torch.tensor(grid.starts)
    # the definition: the largest m whose first index is not above i
    assert torch.equal(grid.phase(i), (starts[None] <= i[:, None]).sum(1) - 1)
    t, previous, low, high = grid.time(i), grid.previous(i), grid.lower(i), grid.upper(i)
    assert (low <= previous).all()
    assert (previous < t).all()
    assert (t <= high).all()
    assert torch.equal(grid.phase(grid.highest(i)), grid.phase(i))
    assert torch.equal(grid.time(grid.highest(i)), high)
    # the teacher's step reaches the edge exactly at the first point of each phase
    assert torch.equal(previous == low, torch.isin(i, starts))
    assert torch.equal(grid.below(t), low)
    assert torch.equal(grid.below(high), low)
    assert len(grid.jumps) == phases
    assert all(edge == 0 or edge in t.tolist() for edge in grid.edges)


@pytest.mark.parametrize(
    ("points", "phases"), [(0, 1), (-10, 1), (7, 1), (1000, 1), (2000, 1), (10, 0), (10, 11), (10, -1)]
)
def test_impossible_grids_are_refused(points, phases):
    with pytest.raises(InputError):
        PhaseGrid(points, phases)
