"""The interval of a paired difference covers the truth as often as it says, also where items hang together."""

import pytest
import torch

from moveset.errors import InputError
from moveset.evaluation.paired import paired_difference


def test_coverage_with_items_that_hang_together():
    """60 groups of 5 items that share most of their noise: an interval over items would cover far too seldom."""
    generator = torch.Generator().manual_seed(0)
    covered = naive = 0
    for trial in range(200):
        shared = torch.randn(60, 1, generator=generator).expand(60, 5)
        own = torch.randn(60, 5, generator=generator)
        difference = (0.3 + shared + 0.3 * own).flatten()
        groups = [k // 5 for k in range(300)]
        found = paired_difference(difference, torch.zeros(300), groups, draws=500, seed=trial)
        covered += found.low <= 0.3 <= found.high
        items = paired_difference(difference, torch.zeros(300), range(300), draws=500, seed=trial)
        naive += items.low <= 0.3 <= items.high
    assert covered >= 178  # 95 % of 200 is 190, and three deviations are 9
    assert naive < 160


def test_groups_of_unequal_size_weigh_by_their_items():
    found = paired_difference([1.0, 1.0, 1.0, 0.0], [0.0] * 4, ["p", "p", "p", "q"])
    assert found.mean == pytest.approx(0.75)
    assert not found.clear


def test_clear_only_without_zero():
    assert paired_difference([1.0, 2.0, 1.5], [0.0] * 3, range(3)).clear
    assert paired_difference([0.0] * 3, [1.0, 2.0, 1.5], range(3)).clear


@pytest.mark.parametrize(
    ("a", "b", "groups"), [([1.0], [0.0], [0]), ([1.0, 2.0], [0.0], [0, 1]), ([1.0, 2.0], [0.0, 1.0], [0])]
)
def test_unpaired_results_are_refused(a, b, groups):
    with pytest.raises(InputError, match="paired"):
        paired_difference(a, b, groups)
