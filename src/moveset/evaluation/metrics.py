"""Text and motion embeddings to numbers: R-precision, FID, matching score, diversity, multimodality; joint errors.

Pure functions of embeddings in float64; whoever calls embeds, so no evaluator is known here. The sampling rules are
those of Guo et al. 2022 ("Generating Diverse and Natural 3D Human Motions from Text") as used by MLD and MotionLCM.

Shapes: M items, E embedding width, G groups of S items, T texts with n motions each, F frames, J joints.
"""

from collections.abc import Hashable, Sequence

import torch
from torch import Tensor

from moveset.errors import InputError

GROUP = 32


def group(
    labels: Sequence[Hashable] | None,
    count: int,
    generator: torch.Generator,
    size: int = GROUP,
    takes: Sequence[Hashable] | None = None,
) -> list[list[int]]:
    """Random groups of ``size`` items for R-precision, as many whole ones as can be made.

    An item is in one group at most. Without labels all items are shuffled and cut (so at most size - 1 are left over).
    With labels no two items of a group share one, because a text that also describes its neighbour's motion has no
    right answer. A label that more items have than there are groups then loses the surplus, at random. With takes no
    two items of a group are of one either, as far as swaps bring it (``apart``).

    Args:
        labels: one for each item, e.g. what its motion shows; None where every pairing may be judged.
        takes: one for each item, what it is cut from; None likewise.

    Raises:
        InputError: not a single whole group can be made, or there are not ``count`` labels.
    """
    if labels is not None and len(labels) != count:
        raise InputError(f"{count} items need {count} labels, not {len(labels)}")
    if size < 2 or count < size:
        raise InputError(f"R-precision needs groups of {size} (at least 2) items, and there are {count}; give more")
    if takes is not None:
        found = group(labels, count, generator, size)
        return apart(found, range(count) if labels is None else labels, takes)
    if labels is None:
        order = torch.randperm(count, generator=generator).tolist()
        return [order[k : k + size] for k in range(0, count - size + 1, size)]
    names = list(dict.fromkeys(labels))
    if len(names) < size:
        raise InputError(
            f"R-precision needs groups of {size} items of different labels, and the {count} items have {len(names)} "
            "distinct ones; give more items, of more kinds"
        )
    members: dict[Hashable, list[int]] = {name: [] for name in names}
    for item in torch.randperm(count, generator=generator).tolist():
        members[labels[item]].append(item)
    # G groups are possible where enough items remain after no label keeps more than G; that holds up to some G.
    groups = count // size
    while sum(min(len(items), groups) for items in members.values()) < groups * size:
        groups -= 1
    pool = [(name, item) for name in names for item in members[name][:groups]]
    chosen = torch.randperm(len(pool), generator=generator)[: groups * size].tolist()
    place = dict(zip(names, torch.randperm(len(names), generator=generator).tolist(), strict=True))
    # Dealt out label by label like cards: the at most G items of a label fall to different groups.
    dealt = [item for _, item in sorted((place[pool[k][0]], pool[k][1]) for k in chosen)]
    return [dealt[k::groups] for k in range(groups)]


def apart(groups: Sequence[Sequence[int]], labels: Sequence[Hashable], takes: Sequence[Hashable]) -> list[list[int]]:
    """Groups in which no two items are of one take, as far as swaps of two items can bring it.

    Labels of a group still differ. Items that were in no group may come into one in another's place.

    Args:
        groups: items by number, as ``group`` drew them.
        labels, takes: of every item.
    """
    used = {item for one in groups for item in one}
    *made, spare = [*(list(one) for one in groups), [k for k in range(len(takes)) if k not in used]]

    def fits(item: int, group: list[int], but: int) -> bool:
        return all(takes[k] != takes[item] and labels[k] != labels[item] for k in group if k != but)

    def trade(group: list[int], place: int) -> None:
        item = group[place]
        for other in (*made, spare):
            for there, candidate in enumerate(other):
                back = other is spare or (other is not group and fits(item, other, candidate))
                if back and fits(candidate, group, item):
                    group[place], other[there] = candidate, item
                    return

    for group in made:
        for place in range(len(group)):
            if any(takes[k] == takes[group[place]] for k in group[:place]):
                trade(group, place)
    return made


def r_precision(text_ME: Tensor, motion_ME: Tensor, groups: Sequence[Sequence[int]], top: int = 3) -> Tensor:
    """Share of texts whose own motion is among the 1, 2, … ``top`` nearest of its group, (top,) float64.

    Distances are Euclidean. Motions at exactly the same distance share the places they take, so that a model that
    always makes one motion gets k / 32, neither 0 nor 1.

    Raises:
        InputError: embeddings of different shapes or not finite, no groups, groups of different sizes or smaller than
            ``top``, or items that are not there.
    """
    distances = _distances(text_ME, motion_ME, groups)
    if not 1 <= top <= distances.shape[1]:
        raise InputError(f"top {top} is not within a group of {distances.shape[1]} items")
    own = distances.diagonal(dim1=1, dim2=2)[..., None]
    nearer = (distances < own).sum(-1).double()
    equal = (distances == own).sum(-1).double()
    ranks = torch.arange(1, top + 1, dtype=torch.float64)
    return ((ranks[:, None, None] - nearer) / equal).clamp(0.0, 1.0).mean(dim=(1, 2))


def matching_score(text_ME: Tensor, motion_ME: Tensor, groups: Sequence[Sequence[int]]) -> float:
    """Mean distance of a text and its own motion ("MM-Dist") over the items of the groups.

    Raises:
        InputError: as ``r_precision``.
    """
    return _distances(text_ME, motion_ME, groups).diagonal(dim1=1, dim2=2).mean().item()


def frechet_distance(a: Tensor, b: Tensor) -> float:
    """Squared Fréchet (2-Wasserstein) distance between Gaussians fitted to the rows of a (N, E) and b (M, E).

    |mean_a - mean_b|^2 + tr(A) + tr(B) - 2 tr((A B)^1/2), with sample covariances A and B (Dowson and Landau 1982;
    Heusel et al. 2017, arXiv 1706.08500). With centred rows X and Y, A = X'X / (N - 1) and B = Y'Y / (M - 1), the
    trace of the root is the sum of the singular values of X Y' / sqrt((N - 1) (M - 1)). No matrix root is taken: fewer
    rows than columns (singular covariances) need no added diagonal, and nothing imaginary is thrown away.

    Raises:
        InputError: fewer than two rows, different numbers of columns, or values that are not finite.

    >>> x = torch.tensor([[0.0, 1.0], [2.0, 0.0], [1.0, 5.0]])
    >>> round(frechet_distance(x, x), 9), round(frechet_distance(x, x + 3.0), 6)
    (0.0, 18.0)
    """
    if a.ndim != 2 or b.ndim != 2 or a.shape[1] != b.shape[1] or min(len(a), len(b)) < 2:
        raise InputError(
            f"a Fréchet distance needs two tables of features with at least 2 rows and equal columns, not "
            f"{tuple(a.shape)} and {tuple(b.shape)}"
        )
    a, b = _finite(a, 2, "motion"), _finite(b, 2, "motion")
    x, y = _triangle(a), _triangle(b)
    cross = torch.linalg.svdvals(x @ y.T).sum()
    distance = (a.mean(0) - b.mean(0)).square().sum() + x.square().sum() + y.square().sum() - 2.0 * cross
    return max(distance.item(), 0.0)


def diversity(motion_ME: Tensor, generator: torch.Generator, pairs: int = 300) -> float:
    """Mean distance of ``pairs`` pairs of motions, whatever their texts.

    Two lists of items are drawn independently, each without replacement, and paired in order; an item may so meet
    itself.

    Raises:
        InputError: fewer items than pairs, or embeddings that are not finite.
    """
    motion = _finite(motion_ME, 2, "motion")
    first, second = (_draw(len(motion), pairs, generator, "motions") for _ in range(2))
    return (motion[first] - motion[second]).norm(dim=-1).mean().item()


def multimodality(motion_TnE: Tensor, generator: torch.Generator, pairs: int = 10) -> float:
    """Mean distance of ``pairs`` pairs of motions made for one text, over all texts.

    Two lists of samples are drawn independently, each without replacement, and are the same for all texts; a sample
    may so meet itself.

    Raises:
        InputError: fewer samples of a text than pairs, or embeddings that are not finite.
    """
    motion = _finite(motion_TnE, 3, "motion")
    first, second = (_draw(motion.shape[1], pairs, generator, "motions of one text") for _ in range(2))
    return (motion[:, first] - motion[:, second]).norm(dim=-1).mean().item()


def mpjpe(a: Tensor, b: Tensor, *, aligned: bool = False) -> Tensor:
    """Mean distance of joints of a and b (..., F, J, 3), in their unit: one float64 value a clip.

    Args:
        aligned: move the root (joint 0) of every frame to one place first, so that only posture is compared.

    Raises:
        InputError: shapes that differ, or joints that are not finite.
    """
    if a.shape != b.shape or a.ndim < 3 or a.shape[-1] != 3:
        raise InputError(
            f"joint errors need two (..., F, J, 3) of one shape, not {tuple(a.shape)} and {tuple(b.shape)}"
        )
    a, b = a.double(), b.double()
    if aligned:
        a, b = a - a[..., :1, :], b - b[..., :1, :]
    apart = (a - b).norm(dim=-1).mean(dim=-1)
    if not torch.isfinite(apart).all():
        raise InputError("joint positions must be finite; repair or leave out the clips that are not")
    return apart.mean(dim=-1)


def _distances(text_ME: Tensor, motion_ME: Tensor, groups: Sequence[Sequence[int]]) -> Tensor:
    """(G, S, S) distances within each group, texts by motions."""
    text, motion = _finite(text_ME, 2, "text"), _finite(motion_ME, 2, "motion")
    if text.shape != motion.shape:
        raise InputError(
            f"every motion needs its own text in the same space: {len(text)} texts of width {text.shape[1]} do not fit "
            f"{len(motion)} motions of width {motion.shape[1]}"
        )
    sizes = sorted({len(g) for g in groups})
    if len(sizes) != 1 or sizes[0] < 1:
        raise InputError(f"groups must be of one size, not {sizes}; make them with metrics.group")
    index = torch.tensor([list(g) for g in groups])
    if not 0 <= int(index.min()) <= int(index.max()) < len(text):
        raise InputError(f"a group names item {int(index.max())}, and items are 0 to {len(text) - 1}")
    # Without the quadratic expansion, which would lose the digits of small distances.
    return torch.cdist(text[index], motion[index], compute_mode="donot_use_mm_for_euclid_dist")


def _triangle(rows: Tensor) -> Tensor:
    """(min(N, E), E) matrix R with R'R the sample covariance of rows (N, E)."""
    triangle: Tensor = torch.linalg.qr(rows - rows.mean(0), mode="r").R
    return triangle / (len(rows) - 1) ** 0.5


def _finite(values: Tensor, dims: int, what: str) -> Tensor:
    if values.ndim != dims or not values.numel():
        raise InputError(f"{what} embeddings must be a filled {dims}-dimensional table, not {tuple(values.shape)}")
    values = values.detach().double().cpu()
    if bad := int((~torch.isfinite(values).all(dim=-1)).sum()):
        raise InputError(
            f"{bad} of {values[..., 0].numel()} {what} embeddings are not finite; repair or drop those items"
        )
    return values


def _draw(count: int, wanted: int, generator: torch.Generator, what: str) -> Tensor:
    if not 1 <= wanted <= count:
        raise InputError(
            f"{wanted} pairs cannot be drawn without replacement from {count} {what}; ask for 1 to {count}"
        )
    return torch.randperm(count, generator=generator)[:wanted]
