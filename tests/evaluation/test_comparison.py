"""What two rows were given alike cancels in the difference of their repeats."""

from pathlib import Path

import pytest
import torch

from moveset.evaluation.columns import ALL
from moveset.evaluation.comparison import compare, verdict
from moveset.evaluation.intervals import Interval
from moveset.evaluation.markdown import markdown
from moveset.evaluation.table import load_table
from tests.evaluation.results import result_json, suite_folder

SHARED = [0.31, 0.18, 0.27, 0.22, 0.35, 0.25]


def row(fid: list[float]) -> dict:
    found = Interval.of(fid)
    return result_json({"fid": (found.mean, found.half_width)}) | {"repeats": [{"fid": value} for value in fid]}


def test_a_small_difference_that_is_always_there_shows():
    rows = {"a": {"fid": SHARED}, "b": {"fid": [v - 0.01 for v in SHARED]}}
    one, other = (Interval.of(values["fid"]) for values in rows.values())
    assert other.mean + other.half_width > one.mean - one.half_width
    (found,) = compare(rows, {"a": (), "b": ("a",)})
    assert (found.row, found.reference, found.repeats) == ("b", "a", len(SHARED))
    assert found.differences["fid"].mean == pytest.approx(-0.01)
    assert verdict(ALL["fid"], found.differences["fid"]) == "better"


@pytest.mark.parametrize("repeats", [3, 20])
def test_pairing_covers_the_truth_as_often_as_it_says(repeats: int):
    """Rows that share most of their noise: the interval of the difference holds the true one in 95 of 100 trials."""
    generator, covered = torch.Generator().manual_seed(0), 0
    for _ in range(400):
        shared, *own = torch.randn(3, repeats, generator=generator, dtype=torch.float64)
        rows = {"a": {"fid": (shared + 0.1 * own[0]).tolist()}, "b": {"fid": (shared + 0.1 * own[1] + 0.3).tolist()}}
        (found,) = compare(rows, {"b": ("a",)})
        difference = found.differences["fid"]
        covered += abs(difference.mean - 0.3) <= difference.half_width
    assert 0.92 <= covered / 400 <= 0.98


@pytest.mark.parametrize(
    ("metric", "mean", "said"), [("r1", 0.1, "better"), ("r1", -0.1, "worse"), ("fid", 0.1, "worse"), ("fid", 0.0, "")]
)
def test_which_way_is_better(metric: str, mean: float, said: str):
    assert verdict(ALL[metric], Interval(mean, 0.05)) == said
    assert verdict(ALL[metric], Interval(mean, 0.1)) == ""  # touching zero


def test_only_what_both_have_is_compared():
    rows = {
        "a": {"fid": SHARED, "r1": SHARED, "diversity": SHARED},
        "b": {"fid": SHARED[:2], "mm_dist": SHARED[:2], "diversity": SHARED[:2]},
        "single": {"fid": SHARED[:1]},
    }
    (found,) = compare(rows, {"b": ("a", "b", "gone"), "single": ("a",), "gone": ("a",)})
    assert (found.row, found.reference, found.repeats) == ("b", "a", 2)
    assert found.differences == {"fid": Interval(0.0, 0.0)}  # diversity has no better way, but a nearest one


def test_a_report_says_what_differs(tmp_path: Path):
    results = {"lcm-1": row(SHARED), "pcm-1": row([v - 0.01 for v in SHARED]), "pcm-4": row([v + 0.02 for v in SHARED])}
    text = markdown(load_table(suite_folder(tmp_path, "motionpcm", results)))
    part = text.split("What differs")[1].split("## ")[0]
    assert "| PCM, 1 step − LCM, 1 step | 6 | **−0.010 ± 0.000** |" in part
    assert "| PCM, 4 steps − LCM, 1 step | 6 | <u>+0.020 ± 0.000</u> |" in part
