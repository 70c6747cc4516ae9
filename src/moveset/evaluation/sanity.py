"""Is an evaluator fit to judge? What it says of real motion, of broken motion, and of wrong sentences.

Every check says what was found, what was expected and whether it holds (Guo et al. 2022 train such an evaluator; the
checks are ours). Distances of broken motion are FIDs of one random half of the items against the other half broken,
the mean over several halvings, so that two unbroken halves are the scale's honest zero: fewer items or more dimensions
lift all of them alike.
M items, F rows of features (F frames of joints and one more), D features.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.evaluation.evaluator import Evaluator
from moveset.evaluation.metrics import GROUP, frechet_distance, group, matching_score, r_precision
from moveset.evaluation.samples import Item, of_all
from moveset.motion.features import get_codec
from moveset.motion.hml import HmlCodec

JITTER = (0.005, 0.01, 0.02, 0.04)
SLIDE = 0.5
HALVINGS = 8
#: Broken motion must be this much further from real motion than real motion is.
MARGIN = 1.1
#: Real motion must be found this many times as often as by chance, or the evaluator hardly reads.
ABOVE_CHANCE = 5.0


@dataclass(frozen=True)
class Check:
    """One check: its name, what was found, what was expected in words, and whether it holds."""

    name: str
    value: float
    expected: str
    passed: bool


@dataclass(frozen=True)
class SanityReport:
    """All checks of one evaluator.

    Args:
        items, texts, labels: how many items, distinct sentences drawn, and distinct labels (None: items have none).
        groups: whole groups of 32 that R-precision was measured in.
        checks: in the order of measuring.
    """

    evaluator: str
    items: int
    texts: int
    labels: int | None
    groups: int
    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        return all(check.passed for check in self.checks)

    def to_json(self) -> dict[str, object]:
        return {**asdict(self), "passed": self.passed}

    def to_markdown(self) -> str:
        """A table with a line of counts above and the verdict below."""
        labels = "" if self.labels is None else f", {self.labels} labels"
        rows = [f"| {c.name} | {c.value:.3f} | {c.expected} | {'yes' if c.passed else '**no**'} |" for c in self.checks]
        failed = sum(not check.passed for check in self.checks)
        verdict = "All checks hold." if not failed else f"{failed} of {len(self.checks)} checks do not hold."
        return "\n".join(
            (
                f"Evaluator {self.evaluator}: {self.items} items, {self.texts} distinct texts{labels}, {self.groups} "
                f"groups of {GROUP}.",
                "",
                "| check | found | expected | holds |",
                "|---|---|---|---|",
                *rows,
                "",
                verdict,
            )
        )


def sanity(evaluator: Evaluator, items: Sequence[Item], generator: torch.Generator) -> SanityReport:
    """Run all checks on real items; the same generator state gives the same report.

    Raises:
        InputError: too few items or labels for one group of 32 or for two halves, an item without a sentence, or what
            the evaluator refuses.
    """
    if silent := sum(not item.captions for item in items):
        raise InputError(f"{silent} of {len(items)} items have no sentence; leave them out")
    labels, takes = of_all([item.label for item in items]), of_all([item.take for item in items])
    groups = group(labels, len(items), generator, takes=takes)
    captions = [item.captions[int(torch.randint(len(item.captions), (1,), generator=generator))] for item in items]
    features = [item.features() for item in items]
    text, motion = evaluator.embed_texts(captions), evaluator.embed_motions(features)
    return SanityReport(
        evaluator=evaluator.card.name,
        items=len(items),
        texts=len(set(captions)),
        labels=None if labels is None else len(set(labels)),
        groups=len(groups),
        checks=(
            *_texts(text, motion, groups, generator),
            *_broken(evaluator, features, motion, generator),
        ),
    )


def _texts(text: Tensor, motion: Tensor, groups: list[list[int]], generator: torch.Generator) -> list[Check]:
    """Do texts find their motions, and only theirs?"""
    trials = sum(map(len, groups))
    size = len(groups[0])
    rates = r_precision(text, motion, groups).tolist()
    found = [
        Check(f"R-precision@{k}, real", rate, f"at least {floor:.3f}, {ABOVE_CHANCE:g} times chance", rate >= floor)
        for k, rate in enumerate(rates, 1)
        for floor in (min(ABOVE_CHANCE * k / size, 0.9),)
    ]
    # Any pairing is as likely as any other, so this is chance whatever the evaluator: it tests groups and ranks.
    shuffled = r_precision(text[torch.randperm(len(text), generator=generator)], motion, groups, top=1).item()
    bound = 4.0 * math.sqrt((size - 1) / size**2 / trials)
    low, high = max(1 / size - bound, 0.0), 1 / size + bound
    found.append(
        Check("R-precision@1, shuffled texts", shuffled, f"1/{size}, {low:.3f} to {high:.3f}", low <= shuffled <= high)
    )
    # The next text of the same group: never of the same label.
    wrong = text.clone()
    for members in groups:
        wrong[members] = text[members[1:] + members[:1]]
    true, apart = matching_score(text, motion, groups), matching_score(wrong, motion, groups)
    rate = r_precision(wrong, motion, groups, top=1).item()
    return [
        *found,
        Check("MM-Dist, real", true, f"below that of wrong texts, {apart:.3f}", true < apart),
        Check("R-precision@1, wrong texts", rate, f"below real and at most {high:.3f}", rate < min(rates[0], high)),
    ]


def _broken(evaluator: Evaluator, features: list[Tensor], real: Tensor, generator: torch.Generator) -> list[Check]:
    """Does broken motion lie further from real motion than other real motion does?"""
    codec = get_codec(evaluator.card.codec)
    if not isinstance(codec, HmlCodec):
        raise InputError(f"sanity checks break joints of 'hml' or 'kit' features, not of {evaluator.card.codec!r}")
    clips = [_with_one_more(codec.joints(f.double())) for f in features]
    halvings = [torch.randperm(len(clips), generator=generator).tensor_split(2) for _ in range(HALVINGS)]

    def between_halves(broken: Tensor) -> float:
        found = [frechet_distance(real[first], broken[second]) for first, second in halvings]
        return sum(found) / len(found)

    def distance(change: Callable[[Tensor], Tensor]) -> float:
        """FID of real halves and the other halves after a change of their joints (F + 1, J, 3)."""
        made = codec.encode_clips([change(joints) for joints in clips])
        return between_halves(evaluator.embed_motions(made))

    zero = between_halves(real)
    again = distance(lambda joints: joints)
    trace = float(real.var(dim=0).sum())
    found = [
        Check("FID, two real halves", zero, f"below the spread of real motion, {trace:.3f}", zero < trace),
        # Joints become features once more: broken motion goes this way, so it must not cost anything itself.
        Check("FID, two real halves, re-encoded", again, f"within 10 % of {zero:.3f}", abs(again - zero) <= 0.1 * zero),
    ]
    before = again
    for sigma in JITTER:
        noise = torch.Generator().manual_seed(int(torch.randint(2**31, (1,), generator=generator)))
        value = distance(lambda joints, s=sigma, g=noise: joints + s * torch.randn(joints.shape, generator=g))  # type: ignore[misc]
        found.append(Check(f"FID, jitter of {1000 * sigma:g} mm", value, f"above {before:.3f}", value > before))
        before = value
    changes: dict[str, Callable[[Tensor], Tensor]] = {
        "time reversed": lambda joints: joints.flip(0),
        "frozen in the middle pose": lambda joints: joints[len(joints) // 2].expand_as(joints),
        f"sliding at {SLIDE:g} m/s": lambda joints: joints + _slide(len(joints), codec.fps).to(joints),
    }
    for name, change in changes.items():
        value = distance(change)
        found.append(Check(f"FID, {name}", value, f"above {MARGIN * again:.3f}", value > MARGIN * again))
    return found


def _slide(frames: int, fps: float) -> Tensor:
    """(F, 1, 3) a glide of the whole body along +X."""
    metres = torch.arange(frames, dtype=torch.float64) * SLIDE / fps
    return torch.stack((metres, torch.zeros_like(metres), torch.zeros_like(metres)), dim=-1)[:, None]


def _with_one_more(joints: Tensor) -> Tensor:
    """(F + 1, J, 3): encoding takes a frame away, so the last step is made twice."""
    return torch.cat((joints, 2 * joints[-1:] - joints[-2:-1]))
