"""The grid of RDM's experiments: variants differ in what they are named by, points are kept, curves have intervals."""

import json
import shutil
import sys
from argparse import Namespace
from types import SimpleNamespace

import pytest

from moveset.evaluation.intervals import Interval
from moveset.rdm.staircase import Staircase
from moveset.training.tasks import load_recipe, with_settings
from tests.evaluation.corpora import content_corpus
from tests.samplers import calls


@pytest.fixture
def grid():
    import rdm_grid

    return rdm_grid


def differing(one, other, path=""):
    """Names of fields in which two configurations differ."""
    for name in one.__dataclass_fields__:
        ours, theirs = getattr(one, name), getattr(other, name)
        if hasattr(ours, "__dataclass_fields__") and type(ours) is type(theirs):
            yield from differing(ours, theirs, f"{path}{name}.")
        elif ours != theirs:
            yield path + name


def test_variants_differ_from_each_other_in_what_they_are_named_by(grid):
    made = {k: with_settings(load_recipe("small", v.what).task, v.settings) for k, v in grid.VARIANTS.items()}
    flow = made["entangled-published"].flow
    assert (flow.blocks, flow.hidden, flow.log_scale, made["anchored"].depth_cap) == (6, 256, 0.1, 6)
    told = {"heading_change", "heading_noise", "model.heading_change"}
    for one, other, names in (
        ("anchored", "anchored-identity", {"flow", "depth_cap"}),
        ("anchored", "entangled", {"grid.entangled"}),
        ("anchored-identity", "entangled-identity", {"grid.entangled"}),
        ("entangled", "joint", {"joint", "weight", "jacobian"}),
        ("entangled", "entangled-published", {"flow.blocks", "flow.hidden"}),
        ("entangled-published", "entangled-free", {"flow.log_scale"}),
        ("anchored", "anchored-bare", told),
        ("md", "md-bare", told),
        ("md", "md-alone", {"md_condition"}),
        ("anchored-identity", "md", {"grid.condition", "grid.clean_share"}),
        ("entangled-pcm-4", "entangled-pcm-4-overlapping", {"overlapping", "context_noise_rollout"}),
    ):
        assert set(differing(made[one], made[other])) == names, (one, other)
    assert [made[f"entangled-pcm-{k}"].phases for k in (1, 2, 4)] == [1, 2, 4]
    steps = {v.what: load_recipe("small", v.what).engine.steps for v in grid.VARIANTS.values()}
    assert steps["rdm-7"] == steps["md-7"]


def test_every_point_of_the_paper_is_there_once(grid):
    found = list(grid.points(grid.VARIANTS["anchored"], grid.STEPS))
    assert len({point.name for point in found}) == len(found) == 33
    late = [(p.start, p.variance) for p in found if (p.steps, p.shape) == (1000, "triangle")]
    assert late == [(r, variance) for variance in ("posterior", "beta") for r in (7, 100, 500, 900, 1000)]
    assert [p.name for p in grid.points(grid.VARIANTS["md"], (10, 1000))] == [
        "K10-R10-parallelogram", "K1000-R1000-parallelogram-posterior", "K1000-R1000-parallelogram-beta"
    ]  # fmt: skip
    for variant, names in (
        ("entangled-pcm-1", ["K1-R1-parallelogram"]),
        ("entangled-pcm-4", ["K4-R4-parallelogram", "K4-R4-parallelogram-overlapping"]),
        ("entangled-pcm-4-overlapping", ["K4-R4-parallelogram", "K4-R4-parallelogram-overlapping"]),
    ):
        assert [p.name for p in grid.points(grid.VARIANTS[variant], grid.STEPS)] == names


def test_a_student_is_trained_after_its_teacher_and_exported_with_it(grid, tmp_path, monkeypatch):
    ran, exported = [], []
    monkeypatch.setattr(grid, "run", lambda make, engine, folder, resume: (ran.append((folder.name, engine)), Ran)[1])
    monkeypatch.setattr(grid, "export", lambda what, *_: exported.append(what))
    monkeypatch.setattr(grid, "open_for_training", lambda path: None)
    Ran = SimpleNamespace(stopped_by=None)
    settings = {"recipe": "tiny", "set": ["root=2"], "train_steps": 3, "student_steps": 2, "device": "cpu"}
    given = Namespace(out=tmp_path, corpus=tmp_path, **settings)
    grid.trained("entangled-pcm-2", 5, given)
    assert [name for name, _ in ran] == ["entangled.5", "entangled-pcm-2.5"]
    assert [(engine.seed, engine.steps) for _, engine in ran] == [(5, 3), (5, 2)]
    assert [what.runs for what in exported] == [
        {"rdm": "entangled.5"}, {"rdm": "entangled.5", "pcm-2": "entangled-pcm-2.5"}
    ]  # fmt: skip
    assert [what.guidance for what in exported] == [{"rdm": 0.0}, {"rdm": 0.0, "pcm-2": 0.0}]
    Ran.stopped_by = "SIGINT"
    with pytest.raises(KeyboardInterrupt):
        grid.trained("md", 0, given)


def test_points_that_are_there_are_kept_and_curves_have_intervals(grid, tiny_streams, tmp_path, monkeypatch, capsys):
    corpus, out = content_corpus(tmp_path / "corpus.safetensors", split="val"), tmp_path / "grid"
    for name in ("anchored.0", "anchored.1", "md.0"):  # trained already
        shutil.copytree(tiny_streams, out / "models" / name)
    real, asked = [], []

    def evaluate(config, folder, **how):
        """The first point in earnest, and of the others the same with another FID."""
        asked.append(config.name)
        if not real:
            real.append(grid_evaluate(config, folder, **how)[0])
            return
        result = json.loads(json.dumps(real[0]))
        result["settings"] |= dict(config.settings)
        result["metrics"]["fid"]["mean"] += len(asked)
        (folder / f"{config.name}.json").write_text(json.dumps(result))

    grid_evaluate = grid.evaluate
    monkeypatch.setattr(grid, "evaluate", evaluate)

    def run(*more):
        given = ["--corpus", str(corpus), "--out", str(out), "--steps", "2", "--device", "cpu", *more]
        monkeypatch.setattr(sys, "argv", ["rdm_grid.py", *given])
        grid.main()
        return json.loads((out / "curves.json").read_text())

    found = run("--variants", "anchored", "--seeds", "2")
    assert [(c["R"], c["shape"]) for c in found["curves"]] == [
        (1, "parallelogram"), (1, "triangle"), (2, "parallelogram"), (2, "triangle")
    ]  # fmt: skip
    for curve in found["curves"]:
        assert curve["calls"] == calls(Staircase(2, 7, curve["R"], curve["shape"]))
        seeds = [values["fid"] for values in curve["seeds"].values()]
        assert len(seeds) == 2
        assert curve["metrics"]["fid"] == Interval.of(seeds).to_json()
        assert {"r3", "jerk", "boundary_jerk"} <= set(curve["metrics"])
        assert bool(curve["minus_whole"]) == (curve["R"] < 2)
    late, whole = (found["curves"][at]["seeds"] for at in (0, 2))
    expected = Interval.of([late[seed]["fid"] - whole[seed]["fid"] for seed in late])
    assert found["curves"][0]["minus_whole"]["fid"] == expected.to_json()
    asked.clear()
    run("--variants", "anchored", "--seeds", "1", "--first-seed", "1")
    assert not asked
    more = run("--variants", "md", "anchored", "--seeds", "1")
    assert asked == ["md.0.K2-R2-parallelogram"]
    assert more["curves"][:4] == found["curves"]
    assert [(c["variant"], c["lag"], c["calls"]) for c in more["curves"][4:]] == [("md", 2, 14)]
    of_md, of_anchored = (more["curves"][at]["seeds"]["0"]["fid"] for at in (4, 2))
    assert [(c["base"], bool(c["minus_base"])) for c in more["curves"][3:]] == [("", False), ("anchored", True)]
    assert more["curves"][4]["minus_base"]["fid"] == Interval.of([of_md - of_anchored]).to_json()
    before = (out / "curves.json").read_bytes()
    run("--plot")
    assert (out / "curves.json").read_bytes() == before
    for metric in ("fid", "r3"):
        assert (out / f"curves-{metric}.svg").read_text().count("<use") > 10
    assert "anchored                 K2-R1-triangle" in capsys.readouterr().out
    with pytest.raises(grid.InputError, match="was made with repeats 1, not 2; give another --out"):
        run("--repeats", "2")
