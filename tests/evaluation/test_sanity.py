"""The checks of an evaluator, on evaluators whose strengths and blind spots are known by construction."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass

import pytest
import torch

from moveset.errors import InputError
from moveset.evaluation.evaluator import EvaluatorCard
from moveset.evaluation.sanity import JITTER, sanity
from moveset.motion.features import get_codec
from tests.motions import shaken, wander

LABELS, COPIES = 36, 4
HML = get_codec("hml")
BROKEN = {"FID, time reversed", "FID, frozen in the middle pose", "FID, sliding at 0.5 m/s"}


@dataclass(frozen=True)
class RealClip:
    captions: tuple[str, ...]
    label: tuple[str, ...] | None
    features: Callable[[], torch.Tensor]
    take: None = None


@pytest.fixture(scope="module")
def items():
    """Four takes each of 36 ways to move."""
    found = []
    for label in range(LABELS):
        motion = wander(49, label, turn=0.2 * (label % 5))
        for copy in range(COPIES):
            features = HML.encode(shaken(motion, 100 * label + copy, degrees=2.0, metres=0.01))
            said = (f"way {label}", f"the way called {label}")
            found.append(RealClip(said, (str(label),), lambda features=features: features))
    return found


class Descriptor:
    """Embeds motions by how they move on average, and texts as the mean of the motions they stand for."""

    card = EvaluatorCard(name="descriptor")

    def __init__(self, items):
        self.prototypes = {}
        for label in {item.label for item in items}:
            own = [item for item in items if item.label == label]
            mean = self.embed_motions([item.features() for item in own]).mean(0)
            self.prototypes |= {caption: mean for item in own for caption in item.captions}

    def describe(self, x):
        """Root steps, planar places of joints, and mean and size of joint velocities; (F, 263) to (E,)."""
        velocities = x[:, HML.groups["velocities"]]
        return torch.cat((10 * x[:, :4].mean(0), x[:, 4:67].mean(0), 20 * velocities.mean(0), 20 * velocities.std(0)))

    def embed_motions(self, features):
        return torch.stack([self.describe(x.double()) for x in features])

    def embed_texts(self, captions):
        return torch.stack([self.prototypes[caption] for caption in captions])


class Deaf(Descriptor):
    """Texts mean nothing to it."""

    def embed_texts(self, captions):
        generator = torch.Generator().manual_seed(0)
        return torch.randn(len(captions), 4 + 63 + 66 + 66, generator=generator, dtype=torch.float64)


class Timeless(Descriptor):
    """Sees which poses there are, not in which order, and not where the root goes."""

    def describe(self, x):
        return torch.cat((x[:, 3:67].mean(0), x[:, 3:67].std(0)))


class Guessing(Descriptor):
    """Numbers that have nothing to do with what it is given."""

    calls = 0

    def embed_motions(self, features):
        self.calls += 1
        generator = torch.Generator().manual_seed(self.calls)
        return torch.randn(len(features), 8, generator=generator, dtype=torch.float64)


def run(judge, items, seed=0):
    return sanity(judge(items), items, torch.Generator().manual_seed(seed))


def value(report, name):
    [check] = [check for check in report.checks if check.name == name]
    return check.value


def failed(report):
    return {check.name for check in report.checks if not check.passed}


@pytest.fixture(scope="module")
def report(items):
    return run(Descriptor, items)


@pytest.fixture(scope="module")
def timeless(items):
    return run(Timeless, items)


def test_an_evaluator_that_sees_and_reads_holds(report):
    assert failed(report) == set()
    assert report.passed
    assert (report.items, report.labels, report.groups) == (LABELS * COPIES, LABELS, 4)
    assert LABELS < report.texts <= 2 * LABELS
    assert value(report, "R-precision@1, real") > 0.8
    assert abs(value(report, "R-precision@1, shuffled texts") - 1 / 32) < 4 * math.sqrt(31 / 32**2 / 128)
    rising = [value(report, f"FID, jitter of {1000 * sigma:g} mm") for sigma in JITTER]
    assert rising == sorted(rising)
    assert rising[0] > value(report, "FID, two real halves") > 0


def test_blind_spots_are_found(items, timeless):
    for report, expected in (
        (run(Deaf, items), {f"R-precision@{k}, real" for k in (1, 2, 3)}),
        (timeless, {"FID, time reversed", "FID, sliding at 0.5 m/s"}),
        (run(Guessing, items), {"R-precision@1, real", *BROKEN}),
    ):
        assert expected <= failed(report)
        assert not report.passed


def test_the_same_seed_gives_the_same_report(items, report):
    assert run(Descriptor, items) == report
    assert run(Descriptor, items, seed=1) != report


def test_items_without_labels_are_grouped_freely(items):
    plain = [RealClip(item.captions, None, item.features) for item in items]
    report = sanity(Descriptor(items), plain, torch.Generator().manual_seed(0))
    assert (report.labels, report.groups) == (None, 4)
    assert value(report, "R-precision@1, real") > 0.5  # a text may describe several of its group


def test_report_reads_as_a_table_and_as_json(timeless):
    report = timeless
    text = report.to_markdown()
    assert text.startswith(f"Evaluator descriptor: {LABELS * COPIES} items, ")
    assert text.count("\n| ") == 1 + len(report.checks)
    assert text.count("**no**") == len(failed(report)) > 0
    assert text.endswith(f"{len(failed(report))} of {len(report.checks)} checks do not hold.")
    stored = json.loads(json.dumps(report.to_json()))
    assert stored["passed"] is False
    assert [check["name"] for check in stored["checks"]] == [check.name for check in report.checks]


def test_what_cannot_be_judged_is_refused(items):
    generator = torch.Generator().manual_seed(0)
    with pytest.raises(InputError, match="there are 31"):
        sanity(Descriptor(items), items[:31], generator)
    with pytest.raises(InputError, match="have 10 distinct"):
        sanity(Descriptor(items), items[: 10 * COPIES], generator)
    silent = [RealClip((), item.label, item.features) if k < 2 else item for k, item in enumerate(items)]
    with pytest.raises(InputError, match="2 of 144 items have no sentence"):
        sanity(Descriptor(items), silent, generator)
