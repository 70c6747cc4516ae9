"""Laws and closed forms of the metrics of embeddings, and what each refuses."""

import math
from collections import Counter

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from moveset.errors import InputError
from moveset.evaluation import metrics


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def normal(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=seeded(seed), dtype=torch.float64)


def test_groups_without_labels_drop_only_what_makes_no_whole_group():
    groups = metrics.group(None, 100, seeded())
    assert [len(g) for g in groups] == [32, 32, 32]
    assert len({i for g in groups for i in g}) == 96
    assert groups != metrics.group(None, 100, seeded(1))
    assert groups == metrics.group(None, 100, seeded(0))


def test_every_item_is_used_where_labels_allow_it():
    """16 copies of each of 32 labels have one solution up to order: each group holds every label once."""
    labels = [k % 32 for k in range(512)]
    groups = metrics.group(labels, 512, seeded())
    assert sorted(i for g in groups for i in g) == list(range(512))
    assert all(sorted(labels[i] for i in g) == list(range(32)) for g in groups)


def test_a_label_that_many_items_share_loses_its_surplus_only():
    labels = ["walk"] * 1000 + list(range(62))
    groups = metrics.group(labels, len(labels), seeded())
    assert len(groups) == 2  # 62 others and two walks
    assert Counter(labels[i] for g in groups for i in g)["walk"] == 2


@given(st.lists(st.integers(0, 11), min_size=4, max_size=120), st.integers(0, 5))
@settings(max_examples=150, deadline=None)
def test_groups_are_lawful_and_as_many_as_possible(labels, seed):
    size = 4
    counts = Counter(labels)
    most = max(g for g in range(len(labels) + 1) if sum(min(c, g) for c in counts.values()) >= g * size)
    if most == 0:
        with pytest.raises(InputError, match="distinct"):
            metrics.group(labels, len(labels), seeded(seed), size)
        return
    groups = metrics.group(labels, len(labels), seeded(seed), size)
    assert len(groups) == most
    used = [i for g in groups for i in g]
    assert len(used) == len(set(used)) == size * most
    assert all(len({labels[i] for i in g}) == size for g in groups)


@pytest.mark.parametrize("labelled", [False, True])
def test_items_of_one_take_are_in_different_groups(labelled):
    """400 clips of 150 takes, some of which were cut often, as those of a corpus."""
    takes = [int(150 * (k / 400) ** 1.3) for k in range(400)]
    labels = [k % 120 for k in range(400)] if labelled else None
    for seed in range(5):
        groups = metrics.group(labels, 400, seeded(seed), takes=takes)
        assert len(groups) == 12
        assert len({k for one in groups for k in one}) == 12 * 32
        assert all(len({takes[k] for k in one}) == 32 for one in groups)
        assert labels is None or all(len({labels[k] for k in one}) == 32 for one in groups)


def test_labels_of_their_own_are_grouped_as_none():
    """Every pair of items meets as often as in plain shuffling: (size - 1) / (count - 1) of the time."""
    meetings = torch.zeros(12, 12)
    for seed in range(2000):
        for g in metrics.group(list(range(12)), 12, seeded(seed), 4):
            for i in g:
                meetings[i, [k for k in g if k != i]] += 1
    apart = meetings[~torch.eye(12, dtype=torch.bool)] / 2000
    assert (apart - 3 / 11).abs().max() < 5 * math.sqrt(3 / 11 * 8 / 11 / 2000)


@pytest.mark.parametrize(
    ("labels", "count", "message"),
    [
        (None, 31, r"groups of 32 .* there are 31"),
        (["a"] * 40, 40, r"the 40 items have 1 distinct"),
        (list(range(31)) + [0] * 9, 40, r"the 40 items have 31 distinct"),
        (["a"] * 39, 40, r"40 items need 40 labels, not 39"),
    ],
)
def test_too_few_items_or_labels_are_counted(labels, count, message):
    with pytest.raises(InputError, match=message):
        metrics.group(labels, count, seeded())


def test_shuffled_texts_hit_k_of_32_within_binomial_bounds():
    x = normal(3200, 8)
    order = torch.randperm(3200, generator=seeded(3))
    groups = metrics.group(None, 3200, seeded(1))
    rates = metrics.r_precision(x[order], x, groups)
    for k, rate in enumerate(rates.tolist(), 1):
        chance = k / 32
        assert abs(rate - chance) < 4 * math.sqrt(chance * (1 - chance) / 3200)


def test_one_motion_for_every_text_is_chance_exactly():
    """However ties are broken by an order of items, a collapsed model is neither rewarded nor punished."""
    text, motion = normal(64, 8), normal(1, 8).expand(64, 8)
    rates = metrics.r_precision(text, motion, metrics.group(None, 64, seeded()))
    assert rates.tolist() == pytest.approx([1 / 32, 2 / 32, 3 / 32])


def literal(text, motion, groups, top):
    """Distances by (a - b)^2 expanded, an argsort and a running 'or', in the order that the public code does it."""
    hits, trace = np.zeros(top), 0.0
    for g in groups:
        a, b = text[g].numpy(), motion[g].numpy()
        matrix = np.sqrt(np.maximum((a**2).sum(1)[:, None] - 2 * a @ b.T + (b**2).sum(1)[None], 0))
        trace += np.trace(matrix)
        order = matrix.argsort(axis=1)
        correct = np.zeros(len(g), dtype=bool)
        for k in range(top):
            correct |= order[:, k] == np.arange(len(g))
            hits[k] += correct.sum()
    count = sum(map(len, groups))
    return hits / count, trace / count


def test_equal_to_the_published_procedure():
    motion = normal(160, 16)
    text = motion + 1.2 * normal(160, 16, seed=1)
    groups = metrics.group(None, 160, seeded())
    hits, trace = literal(text, motion, groups, 3)
    assert 0.2 < hits[0] < hits[1] < hits[2] < 1.0
    assert metrics.r_precision(text, motion, groups).tolist() == pytest.approx(hits.tolist())
    assert metrics.matching_score(text, motion, groups) == pytest.approx(trace, rel=1e-9)


def test_neither_rotations_nor_the_order_of_items_matter():
    motion = normal(96, 6)
    text = motion + normal(96, 6, seed=1)
    groups = metrics.group(None, 96, seeded())
    rates, score = metrics.r_precision(text, motion, groups), metrics.matching_score(text, motion, groups)
    turn = torch.linalg.qr(normal(6, 6, seed=2)).Q
    torch.testing.assert_close(metrics.r_precision(text @ turn + 5, motion @ turn + 5, groups), rates)
    assert metrics.matching_score(text @ turn + 5, motion @ turn + 5, groups) == pytest.approx(score)
    order = torch.randperm(96, generator=seeded(4))
    place = order.argsort()
    moved = [place[torch.tensor(g)].flip(0).tolist() for g in groups]
    torch.testing.assert_close(metrics.r_precision(text[order], motion[order], moved), rates)


def test_text_asks_and_motions_answer():
    """Two motions at 0 and 1; both texts are nearest to the motion at 0. The other way round both would be right."""
    text, motion = torch.tensor([[0.0], [0.4]]), torch.tensor([[0.0], [1.0]])
    assert metrics.r_precision(text, motion, [[0, 1]], top=1).tolist() == [0.5]
    assert metrics.r_precision(motion, text, [[0, 1]], top=1).tolist() == [1.0]
    assert metrics.matching_score(text, motion, [[0, 1]]) == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("text", "motion", "groups", "message"),
    [
        (normal(40, 4), normal(39, 4), [[0, 1]], "40 texts of width 4 do not fit 39 motions"),
        (normal(40, 4), normal(40, 5), [[0, 1]], "of width 5"),
        (normal(40, 4), normal(40, 4).index_fill(0, torch.tensor([3, 5]), math.nan), [[0, 1]], "2 of 40 motion"),
        (normal(40, 4), normal(40, 4), [], "groups must be of one size"),
        (normal(40, 4), normal(40, 4), [[0, 1, 2], [3, 4]], r"\[2, 3\]"),
        (normal(40, 4), normal(40, 4), [[0, 1, 40]], "item 40"),
        (normal(40, 4), normal(40, 4), [[0, 1, -1]], "a group names item"),
        (normal(40, 4), normal(40, 4), [[0, 1]], "top 3"),
        (normal(40), normal(40), [[0, 1, 2]], "2-dimensional"),
    ],
)
def test_bad_embeddings_are_refused(text, motion, groups, message):
    with pytest.raises(InputError, match=message):
        metrics.r_precision(text, motion, groups)


def test_diversity_draws_each_list_without_replacement():
    """Distances on a line: two permutations of all of 0 … n - 1 are the only lists there are for n pairs."""
    n = 50
    x = torch.arange(n, dtype=torch.float64)[:, None]
    order = [torch.randperm(n, generator=g) for g in [seeded(7)] for _ in range(2)]
    expected = (order[0] - order[1]).abs().double().mean()
    assert metrics.diversity(x, seeded(7), pairs=n) == pytest.approx(float(expected))
    found = [metrics.diversity(x, seeded(s), pairs=n) for s in range(400)]
    assert np.mean(found) == pytest.approx((n * n - 1) / (3 * n), rel=0.01)  # self-pairs are possible


def test_diversity_of_a_gaussian_is_known():
    x = normal(5000, 1)
    assert metrics.diversity(x, seeded(), pairs=4000) == pytest.approx(2 / math.sqrt(math.pi), rel=0.05)


def test_multimodality_uses_the_same_samples_for_all_texts():
    one = normal(1, 30, 4)
    alone = metrics.multimodality(one, seeded(5))
    assert metrics.multimodality(one.expand(7, 30, 4) + 3.0, seeded(5)) == pytest.approx(alone)
    mixed = torch.cat((one, 10 * one))
    assert metrics.multimodality(mixed, seeded(5)) == pytest.approx(5.5 * alone)
    assert metrics.multimodality(one[:, :1].expand(1, 30, 4), seeded(5)) == 0.0


def test_as_many_pairs_as_motions_at_most():
    with pytest.raises(InputError, match=r"300 pairs .* from 299 motions"):
        metrics.diversity(normal(299, 4), seeded())
    with pytest.raises(InputError, match=r"10 pairs .* from 9 motions of one text"):
        metrics.multimodality(normal(5, 9, 4), seeded())
    with pytest.raises(InputError, match="1 of 400 motion"):
        metrics.diversity(normal(400, 4).index_fill(0, torch.tensor(1), math.inf), seeded())


def test_joint_errors_by_hand():
    a = normal(2, 10, 22, 3)
    b = a + torch.tensor([0.3, 0.0, 0.4])
    assert metrics.mpjpe(a, b).tolist() == pytest.approx([0.5, 0.5])
    assert metrics.mpjpe(a, b, aligned=True).tolist() == pytest.approx([0.0, 0.0])
    b[:, :, 5] += torch.tensor([0.0, 2.2, 0.0])
    assert metrics.mpjpe(a, b, aligned=True).tolist() == pytest.approx([0.1, 0.1])
    assert metrics.mpjpe(a[0], b[0]).shape == ()


def test_joints_that_cannot_be_compared_are_refused():
    a, b = normal(2, 10, 22, 3), normal(2, 10, 22, 3, seed=1)
    a[1, 4:] = math.nan
    with pytest.raises(InputError, match="finite"):
        metrics.mpjpe(a, b)
    with pytest.raises(InputError, match="one shape"):
        metrics.mpjpe(a, b[:1])
