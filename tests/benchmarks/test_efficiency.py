"""The efficiency benchmark: counts have closed forms, networks are those of the recipes, the report is whole."""

import json
import sys
from collections import Counter
from dataclasses import replace

import pytest
import torch

from moveset.recipes import paper, small


@pytest.fixture
def methods():
    import efficiency_methods

    return efficiency_methods


def row(methods, label):
    return next(found for found in methods.ROWS if found.label.startswith(label))


def test_the_networks_are_those_of_the_recipes(methods):
    made, published = methods.SIZES["small"], methods.SIZES["paper"]
    for segments, frames in ((4, 49), (7, 28), (14, 14)):
        ours, theirs = small.rdm(segments).task, paper.train_rdm(segments).task
        assert row(methods, f"RDM-{segments}").frames == frames == ours.grid.frames
        assert made.segment(frames) == replace(ours.model, features=269, frames=frames, text_dim=384)
        assert made.flow == replace(ours.flow, features=269, text_dim=384)
        # The published table is KIT-ML's; that all 77 positions are read changes no cost.
        assert published.segment(frames) == replace(theirs.model, features=251, read_padding=True)
        assert published.flow == replace(theirs.flow, features=251)
    assert made.dip == replace(small.dip().task.model, features=269)
    assert made.volume == replace(small.motiondiffuse().task.model, features=269)
    assert published.volume == replace(paper.train_motiondiffuse().task.model, features=251, read_padding=True)


# Calls, waves at K = 10 and 50 by hand: RDM K + (N - 1)(N + 2) / 2, K + (N - 1) R and N K in K + N - 1 waves, unless
# there are fewer steps than segments (RDM-14: 10 + 10 + 9 + … + 1); MD N K; DiP 5 chunks, twice with guidance.
BY_HAND = {
    "RDM-4, triangle": ((19, 13), (59, 53)),
    "RDM-7, triangle": ((37, 16), (77, 56)),
    "RDM-14, triangle": ((65, 20), (154, 63)),
    "RDM-7, parallelogram": ((34, 16), (152, 56)),
    "RDM-7, full": ((70, 16), (350, 56)),
    "MD-7": ((70, 70), (350, 350)),
    "DiP": ((100, 50), (500, 250)),
    "MotionDiffuse": ((10, 10), (50, 50)),
}


@pytest.mark.parametrize("label", BY_HAND)
def test_closed_forms(methods, label):
    found = [methods.expected(methods.SIZES["small"], row(methods, label), steps) for steps in (10, 50)]
    assert tuple((counts["network"], counts["waves"]) for counts in found) == BY_HAND[label]


@pytest.fixture
def tiny(methods):
    return methods.Methods(methods.SIZES["tiny"])


@pytest.mark.parametrize("label", ["RDM-14, triangle", "DiP"])
def test_counts_and_operations_do_not_depend_on_the_plan(methods, tiny, label):
    from efficiency_tally import Meter

    chosen = row(methods, label)
    units = []
    for steps in (2, 4):
        # The run itself raises where its counts differ from the expected ones.
        meter = Meter()
        tally = tiny.run(chosen, steps, meter=meter)
        units.append(meter.units(tally.calls))
        should = methods.expected(tiny.size, chosen, steps)
        assert {name: should[name] for name in meter.rows} == dict(meter.rows)
        assert sum(width for width, _ in tally.marks) == should["network"]
    assert units[0] == units[1]
    assert set(units[0]) >= {"network", "text"}


def test_lengths_are_run_in_every_round(methods):
    import efficiency

    for plan in (efficiency.PLANS["small"], efficiency.ON_GPU):
        every, first = plan.cells()
        asked = {(cell.row.label, cell.steps, cell.frames) for cell in every if cell.batch == 1}
        rows = [row.label for row in efficiency.LENGTH_ROWS if row.model != "DiP"]
        assert asked >= {(label, k, frames) for label in rows for k in (10, 50, 100) for frames in plan.lengths}
        assert asked >= {("DiP", 10, frames) for frames in plan.lengths}
        assert not set(every) & set(first)


def test_a_count_that_is_off_ends_the_run(methods, tiny, monkeypatch):
    honest = methods.expected
    monkeypatch.setattr(methods, "expected", lambda *a: honest(*a) + Counter(network=1))
    with pytest.raises(RuntimeError, match=r"counted, expected: {'network': \(8, 9\)}"):
        tiny.run(row(methods, "MD-4"), 2)


def test_an_application_of_the_flow_costs_what_its_layers_say(methods, tiny):
    from efficiency_tally import Meter

    meter = Meter()
    tally = tiny.run(row(methods, "RDM-7, full"), 2, meter=meter)
    c = tiny.size.flow
    half = c.features // 2
    lstm = 4 * c.hidden * (half + c.text_context + c.index_context + c.hidden)
    rest = c.hidden * c.hidden + c.hidden * 2 * half
    units = meter.units(tally.calls)
    assert units["flow"] == 2 * 28 * c.blocks * (lstm + rest)
    assert units["flow text"] == 2 * c.text_dim * c.text_context


def test_a_call_costs_what_the_layers_of_the_published_network_say(methods):
    from efficiency_tally import Meter

    methods = methods.Methods(replace(methods.SIZES["paper"], volume=replace(methods.SIZES["paper"].volume, layers=1)))
    from efficiency_methods import Row

    meter = Meter()
    tally = methods.run(Row("MotionDiffuse"), 2, meter=meter)
    # One of the eight layers: see the segment denoiser's own tests, where the eight make 9.93 GFLOP.
    frame = 7 * 512**2 + 3 * 512 * 64 + 2 * 512 * 1024 + 2 * 251 * 512
    token = 2 * 256 * 512 + 512 * 64
    assert meter.units(tally.calls)["network"] == 2 * (
        196 * frame + 77 * token + 3 * 2048 * 1024 + 512 * 2048 + 2048**2
    )


def test_an_estimate_adds_the_waves():
    from efficiency import estimate
    from efficiency_methods import SIZES, TRIANGLE, Row, expected

    # K = 8 of four segments: nine single waves and six more calls in waves of two or three.
    chosen, cost = Row("RDM-4", TRIANGLE), {1: 1.0, 2: 1.5, 3: 2.0}
    plan = [1, 1, 1, 1, 1, 2, 2, 3, 2, 2, 1]
    should = expected(SIZES["tiny"], chosen, 8)
    assert sum(plan) == should["network"]
    assert len(plan) == should["waves"]
    assert estimate(cost, chosen, 8, should) == sum(cost[width] for width in plan)
    # A width that was not seen costs in proportion.
    assert estimate({1: 1.0}, chosen, 8, should) == should["network"]
    assert estimate({2: 3.0}, Row("DiP"), 10, expected(SIZES["tiny"], Row("DiP"), 10)) == 50 * 3.0


@pytest.mark.usefixtures("methods")
def test_the_report_is_whole_and_keeps_the_published_numbers_apart(tmp_path, monkeypatch, capsys):
    import efficiency

    out, threads = tmp_path / "efficiency", torch.get_num_threads()
    out.with_suffix(".json").write_text("{}")
    monkeypatch.setattr(sys, "argv", f"efficiency.py --size tiny --threads {threads} --out {out}".split())
    efficiency.main()
    found = json.loads(out.with_suffix(".json").read_text())["tiny"]
    assert len(found["rows"]) == 14
    for line in found["rows"]:
        two, three, four = (line["columns"][k] for k in "234")
        assert two["counted"]
        assert (
            two["time"]["1"]["runs"] == three["time"]["1"]["runs"] == two["time"]["2"]["runs"] == found["rounds"] == 1
        )
        assert not four["counted"]
        assert set(four["time"]["1"]) == set(three["time"]["2"]) == {"estimate_ms"}
        # One step more costs every sampler the same again, beyond the steps that a short triangle has not got.
        if "triangle" not in line["label"] and "parallelogram" not in line["label"]:
            costs = [sum(entry["operations"].values()) for entry in (two, three, four)]
            assert costs[2] - costs[1] == costs[1] - costs[0] > 0
    for item in found["lengths"]:
        # One round: the ratio is that of its two runs, and has no interval.
        own = next(dip for dip in found["lengths"] if (dip["label"], dip["steps"]) == ("DiP", 2)
                   and dip["frames"] == item["frames"])  # fmt: skip
        ratio = own["median_ms"] / item["median_ms"]
        assert item["times_as_fast"] == {"mean": pytest.approx(ratio, rel=0.05), "interval": None}
    ends = {(item["label"], item["steps"], item["frames"]) for item in found["lengths"]}
    assert ends >= {("DiP", 3, 240), ("RDM-14, triangle R = N", 2, 196)}
    text = out.with_suffix(".md").read_text()
    assert capsys.readouterr().out.strip() == text.strip()
    measured, published = text.split("## The paper's own numbers")
    assert "1276.71" in published
    assert "Published" not in measured
    assert "≈" in measured
    assert out.with_suffix(".png").stat().st_size > 10_000


@pytest.mark.usefixtures("methods")
def test_memory_is_that_of_a_process_of_its_own():
    import efficiency
    from moveset.bench.machine import peak_mb

    # What this process holds besides is not in it.
    ballast = torch.ones(100_000_000)
    (held,) = efficiency.peaks("tiny", 2, 1, [13])
    assert 50 < held["libraries_mb"] <= held["peak_mb"] < peak_mb() - ballast.nbytes / 2e6
    assert (held["steps"], held["batch"]) == (2, 1)
