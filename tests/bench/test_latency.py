"""The benchmark: how runs are paired, what is counted, what a report has. No test says how long anything takes."""

import json
import math
import os
import subprocess
import sys
from dataclasses import replace

import pytest
import torch
from torch import nn

from moveset.bench import latency, machine, page
from moveset.bench import processes as processes_module
from moveset.bench.flops import counted, counter
from moveset.bench.interleaved import interleave, summarise
from moveset.bench.processes import run_process
from moveset.bench.run import PARTS, Bench, Plan, shortest
from moveset.errors import MovesetError
from moveset.io.process import cores
from moveset.models.packed import PackedTimeConv
from moveset.pipelines.motion_stream import MotionStream
from moveset.pipelines.text_to_motion import TextToMotion
from moveset.text.packed_linear import PackedLinear, can_pack
from tests.bundles import tiny_bundle
from tests.streams import tiny_stream


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    root = tmp_path_factory.mktemp("models")
    return tiny_bundle(root / "clips"), tiny_stream(root / "streams")


@pytest.fixture(scope="module")
def plan(folders):
    clips, streams = map(str, folders)
    return shortest(Plan(clips=clips, streams=streams, teacher_steps=(2,)))


@pytest.fixture(scope="module")
def report(plan):
    """Everything but whole processes, which take seconds each."""
    return Bench(replace(plan, parts=tuple(p for p in PARTS if p != "processes"))).run()


def test_every_round_runs_every_case_and_bursts_lose_their_first_call():
    heard = []

    def case(name):
        return lambda call: heard.append((name, call)) or {"a": 1.0, "b": float(call)}

    ticks = []
    found = interleave(
        {name: case(name) for name in "xyz"}, 5, warmup=2, burst=3, tick=lambda: ticks.append(len(heard))
    )
    assert len(ticks) == 7 * 3
    rounds = [heard[k : k + 9] for k in range(0, len(heard), 9)]
    for k, calls in enumerate(rounds):
        # A case's burst is not interrupted; its calls are numbered on, so that no two are alike.
        assert [name for name, _ in calls[::3]] == [name for name, _ in calls[2::3]]
        assert sorted(calls) == [(name, 3 * k + i) for name in "xyz" for i in range(3)]
    assert len({tuple(name for name, _ in calls[::3]) for calls in rounds}) > 1
    assert [row["b"] for row in found["y"]] == [3 * k + i for k in range(2, 7) for i in (1, 2)]
    assert interleave({"x": case("x")}, 1, warmup=0, burst=1)["x"] == [{"a": 1.0, "b": 0.0}]


def test_ratios_are_of_pairs_and_survive_a_slow_moment():
    # Every round another speed, but always three times the first: medians of milliseconds could not tell.
    speeds = [1.0, 50.0, 2.0, 9.0]
    runs = {
        "one": [{"a": s, "b": s, "c": 7.0} for s in speeds],
        "three": [{"a": 3 * s, "b": 3 * s, "c": 1.0} for s in speeds],
    }
    found = summarise(runs, ("a", "b"), ("a", "b", "c"))
    assert found["one"]["ratio"] == 1.0
    assert found["three"]["ratio"] == 3.0
    assert found["one"]["median_ms"] == {"a": 5.5, "b": 5.5, "c": 7.0, "total": 11.0}
    assert found["one"]["min_ms"]["total"] == 2.0
    assert found["one"]["mean_ms"]["a"] == 15.5
    assert found["one"]["calls"] == 4


def test_operations_of_plain_and_packed_layers_are_those_of_their_definition():
    linear, conv = nn.Linear(6, 5), nn.Conv1d(4, 8, 3, padding=1)
    x, y = torch.randn(2, 7, 6), torch.randn(2, 4, 9)
    products = 2 * 2 * 7 * 6 * 5
    taps = 2 * 2 * 9 * 8 * 4 * 3
    with torch.inference_mode():
        assert counted(lambda: linear(x)) == products
        assert counted(lambda: conv(y)) == taps
        if can_pack("cpu"):
            packed = PackedLinear.of(linear)
            assert counted(lambda: packed(x)) == products
            assert counted(lambda: packed.plus(x, torch.zeros(2, 7, 5))) == products
            assert counted(lambda: PackedTimeConv(conv)(y.transpose(1, 2))) == taps
        lstm = nn.LSTM(6, 5, batch_first=True)
        assert counted(lambda: lstm(x)) == 2 * 2 * 7 * 4 * 5 * (6 + 5)
        on_cuda = counter().flop_registry[torch.ops.aten._cudnn_rnn]
        assert on_cuda(x.transpose(0, 1), [*lstm.parameters()], out_val=None) == 2 * 2 * 7 * 4 * 5 * (6 + 5)
        q = torch.randn(2, 1, 7, 6)
        attention = nn.functional.scaled_dot_product_attention
        assert counted(lambda: attention(q, q, q)) == 2 * (2 * 2 * 7 * 7 * 6)


def test_operations_grow_with_evaluations_and_streams_with_steps(report):
    clips, rows = report["operations"]["clips"], report["clips"]
    each = {name: found["sample"] / rows[name]["evaluations"] for name, found in clips.items()}
    # This network reads its text at every call; the teacher is the same without guidance by a number.
    assert each["pcm-1"] == each["pcm-2"] == each["pcm-4"] == each["lcm-1"]
    assert rows["teacher-2"]["evaluations"] == 4
    assert len({found["text"] for found in clips.values()}) == len({found["decode"] for found in clips.values()}) == 1
    streams = report["operations"]["streams"]
    assert streams["pcm-1"]["segment"] < streams["pcm-2"]["segment"] < streams["md"]["segment"]


def test_a_model_itself_is_timed_in_fewer_steps_too(plan):
    found = Bench(replace(plan, streams="rdm-small", parts=("streams",))).run()["streams"]
    assert {name: row["evaluations"] for name, row in found.items()} == {
        "rdm": 20, "pcm-1": 2, "rdm, 5 of 10 steps": 10, "rdm, 2 of 10 steps": 4
    }  # fmt: skip


def test_a_report_is_whole(report, plan):
    assert [part for part in PARTS if part in report] == [part for part in PARTS if part != "processes"]
    assert list(report["clips"]) == ["pcm-1", "pcm-2", "pcm-4", "lcm-1", "teacher-2"]
    assert [row["evaluations"] for row in report["clips"].values()] == [1, 2, 4, 1, 4]
    for row in report["clips"].values():
        assert row["calls"] == plan.rounds * (plan.burst - 1)
        assert set(row["median_ms"]) == {"text", "sample", "decode", "joints", "export", "total"}
        parts = sum(row["mean_ms"][part] for part in latency.AITS)
        assert math.isclose(row["mean_ms"]["total"], parts, abs_tol=0.01)
    # The default network comes first: ratios are to it.
    assert list(report["streams"]) == ["pcm-1", "rdm", "md", "pcm-2"]
    assert [row["evaluations"] for row in report["streams"].values()] == [2, 3, 6, 2]
    said = report["streams"]["rdm"]["settings"]
    assert [said[name] for name in ("start", "lag", "eta", "foot_lock", "shape")] == [3, 1, 0.0, True, "parallelogram"]
    assert set(report["clips"]["pcm-1"]["settings"]) == {"guidance", "foot_lock"}
    assert {k: [p["seconds"] for p in v] for k, v in report["lengths"].items()} == {
        "pcm-1, one clip": [2.0, 9.8],
        "pcm-1, clips in a row": [19.6],
        "stream pcm-1": [1.4, 4.2],
    }
    assert {name: list(row) for name, row in report["batches"].items()} == {
        "pcm-1": ["1", "2"],
        "teacher-2": ["1", "2"],
    }
    assert report["endless"][-1]["segments"] == plan.endless == 20
    assert json.loads(json.dumps(report)) == json.loads(json.dumps(report))


def test_a_report_says_on_what_and_not_on_whose(report):
    import platform

    assert report["machine"]["cores"] == cores()
    assert report["machine"]["threads"] == torch.get_num_threads()
    assert report["machine"]["torch"] == torch.__version__
    assert {"cpu", "python", "system", "waiting"} <= set(report["machine"])
    assert platform.node() not in json.dumps(report["machine"]).split('"')


def test_the_commands_of_processes_are_those_of_the_rows(plan, monkeypatch):
    asked = []

    def fake(arguments):
        asked.append(arguments)
        stream = {"first_segment_seconds": 0.5} if arguments[0] == "stream" else {}
        return {"seconds": float(len(asked)), "peak_mb": 100.0, **stream}

    monkeypatch.setattr(processes_module, "run_process", fake)
    found = Bench(replace(plan, parts=("processes",), count=2)).run()["processes"]
    assert list(found) == [
        "pcm-1",
        "pcm-2",
        "pcm-4",
        "lcm-1",
        "teacher",
        *(f"stream {n}" for n in ("pcm-1", "rdm", "md", "pcm-2")),
    ]
    assert asked[:9] == asked[9:] or [a[:-1] for a in asked[:9]] == [a[:-1] for a in asked[9:]]
    assert found["pcm-1"]["seconds"] == {"median": 5.5, "min": 1.0}
    assert "first_segment_seconds" in found["stream md"]
    said = " ".join(asked[1])
    assert "--solver pcm --steps 2 --seconds 9.8" in said
    assert "OUT" not in said
    assert "--network rdm" in " ".join(asked[6])


def test_the_longest_clip_of_any_frame_rate_is_within_its_limit():
    command = processes_module.clip_command("mine", "pcm", 1, 200 / 30, "cpu")
    assert float(command[command.index("--seconds") + 1]) == 200 / 30


def test_a_process_tells_its_time_and_its_own_memory(folders, tmp_path):
    # What this process holds is not in it.
    ballast = torch.ones(150_000_000)
    command = processes_module.stream_command(str(folders[1]), "pcm-1", 2.8, "cpu")
    found = run_process([part.replace("OUT", str(tmp_path)) for part in command])
    assert 0 < found["first_segment_seconds"] < found["seconds"]
    assert 50 < found["peak_mb"] < machine.peak_mb() - ballast.nbytes / 2e6
    assert (tmp_path / "stream.bvh").is_file()


def test_a_process_that_fails_is_no_measurement():
    with pytest.raises(MovesetError, match=r"`moveset models --nonsense` failed.*nonsense"):
        run_process(["models", "--nonsense"])


def test_memory_is_that_of_the_process():
    code = """
from moveset.bench.machine import peak_mb, resident_mb
before = peak_mb()
held = b"x" * 80_000_000
print(before, peak_mb(), resident_mb())
del held
print(peak_mb())
"""
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=os.environ)
    before, after, now, later = map(float, said.stdout.split())
    assert 75 < after - before < 100
    assert now <= after == later or math.isclose(after, later, rel_tol=0.02)


def test_a_prompt_is_measured_to_the_segment_that_it_makes(folders):
    stream = MotionStream.from_pretrained(folders[1], network="rdm", device="cpu")
    case = latency.stream_case(stream, latency.sentences())
    found = case(0)
    assert set(found) == {"first", "segment", "evaluations"}
    assert stream.timeline.prompts == (next(latency.sentences()),)
    assert next(stream).prompt == next(latency.sentences())


def test_sentences_differ():
    said = [s for s, _ in zip(latency.sentences(5), range(500), strict=False)]
    assert len(set(said)) == 500


def test_batches_are_of_different_sentences(folders, monkeypatch):
    t2m = TextToMotion.from_pretrained(folders[0], device="cpu")
    heard = []
    real = t2m.generate
    monkeypatch.setattr(
        t2m, "generate", lambda requests, *a, **k: heard.append((requests, k)) or real(requests, *a, **k)
    )
    method = latency.clip_methods(t2m.bundle.config, ())["pcm-2"]
    case = latency.batch_case(t2m, method, 40, 3)
    case(0)
    case(1)
    prompts = [request.prompts for requests, _ in heard for request in requests]
    assert len(set(prompts)) == 6
    assert all(k == {"batch": 3} for _, k in heard)


def test_the_page_has_every_part_and_keeps_published_numbers_apart(report, tmp_path):
    whole = report | {
        "processes": {"pcm-1": {"seconds": {"median": 2.5, "min": 2.25}, "peak_mb": {"median": 321.0, "min": 320.0}}}
    }
    path = tmp_path / "costs.json"
    written = page.write_page(whole, path)
    assert [p.name for p in written] == ["costs.json", "costs.md", "costs.png"]
    assert json.loads(path.read_text()) == json.loads(json.dumps(whole))
    text = path.with_suffix(".md").read_text()
    measured, published = text.split("## The paper's own numbers")
    headings = ("A clip of 9.8 s", "A stream, 1.4 s", "Time by length", "Time of one clip by batch", "Whole processes")
    for heading in (*headings, "Operations", "A stream without end"):
        assert f"## {heading}" in measured
    assert "(costs.png)" in measured
    assert "2.50 (2.25)" in measured
    assert "| MDM | 24.74 | 0.544±.044 |" in published
    assert "| MDM |" not in measured
    assert "not measured here" in published
    assert written[2].read_bytes()[:4] == b"\x89PNG"


def test_a_busy_machine_is_told(report):
    quiet, busy = ({**report, "load": {"before": b, "after": 9.0}} for b in (0.1, 3.0))
    assert "busy" not in page.machine(quiet)
    assert "**the machine was busy" in page.machine(busy)
    assert "load" not in page.machine({**report, "load": {"before": None, "after": None}})


def test_a_report_of_some_parts_has_a_page_too(report, tmp_path):
    some = {k: v for k, v in report.items() if k not in PARTS or k == "streams"}
    text = page.markdown(some)
    assert "## A stream" in text
    assert "## A clip" not in text
    bare = {k: v for k, v in report.items() if k not in PARTS}
    assert [p.name for p in page.write_page(bare, tmp_path / "x.json")] == ["x.json", "x.md"]
