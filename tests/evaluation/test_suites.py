"""Suites know their rows, find weights by name, say what is not there, and run the rest once, in order."""

import json
from itertools import pairwise
from pathlib import Path

import pytest

from moveset.errors import FormatError, InputError
from moveset.evaluation.published import tables
from moveset.evaluation.suites import CLIPS, REAL, STREAMS, Row, SuiteSettings, get_suite, run_suite
from moveset.pipelines.model_folder import shipped
from moveset.rdm.staircase import Staircase

SUITES = ("motionpcm", "rdm")


def folder(path: Path, name: str, networks: tuple[str, ...]) -> Path:
    """As much of a model folder as a suite looks at."""
    path.mkdir()
    (path / "config.json").write_text(json.dumps({"name": name, "models": dict.fromkeys(networks)}))
    return path


class Recorder:
    """Stands for the evaluation: returns what it was given."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, Path | None, int]] = []

    def __call__(self, row: Row, path: Path | None, repeats: int) -> str:
        self.calls.append((row.key, path, repeats))
        return row.key


@pytest.mark.parametrize("name", SUITES)
def test_rows_are_named_once_and_compared_with_rows_that_are_there(name: str):
    suite = get_suite(name)
    keys = [row.key for row in suite.rows]
    assert len(set(keys)) == len(keys)
    assert len({row.label for row in suite.rows}) == len(keys)
    assert {other for row in suite.rows for other in row.against} | set(suite.references) <= set(keys)
    assert keys[0] == REAL
    assert tables(name)


@pytest.mark.parametrize("name", SUITES)
def test_groups_are_not_torn_apart(name: str):
    groups = [row.group for row in get_suite(name).rows]
    changes = sum(a != b for a, b in pairwise(groups))
    assert changes == len(set(groups)) - 1


def test_the_papers_rows_are_all_there():
    keys = {name: {row.key for row in get_suite(name).rows} for name in SUITES}
    assert keys["motionpcm"] >= {
        "real", "vae", "teacher", "mld", "lcm-1", "lcm-2", "lcm-4", "pcm-1", "pcm-2", "pcm-4", "k20", "no-ema",
        "no-discriminator",
    }  # fmt: skip
    assert keys["rdm"] >= {
        "real", "motiondiffuse", "rdm-1", "light-rdm-1", "dip", "md-4", "md-7", "rdm-4", "rdm-7", "rdm-14",
        "rdm-pcm-1", "rdm-pcm-2", "disentangled",
    }  # fmt: skip


def test_several_steps_of_the_consistency_model_are_one_network():
    rows = {row.key: row for row in get_suite("motionpcm").rows}
    assert {(rows[f"lcm-{n}"].network, rows[f"lcm-{n}"].steps) for n in (1, 2, 4)} == {("lcm-1", n) for n in (1, 2, 4)}
    assert [rows[f"pcm-{n}"].network for n in (1, 2, 4)] == ["pcm-1", "pcm-2", "pcm-4"]


def test_staircases_are_those_that_the_sampler_knows():
    rows = [row for row in get_suite("rdm").rows if "start" in row.settings]
    calls = {}
    for row in rows:
        assert row.steps is not None
        calls[row.key] = Staircase(row.steps, 7, **row.settings).calls
    assert calls["disentangled"] == 10
    assert calls["triangle-7"] == 10 + 6 * 9 // 2
    assert calls["rdm-7"] == calls["rdm-7-alike"] == 70
    assert {row.key for row in rows} == {
        "rdm-7", "disentangled", "triangle-1", "triangle-2", "triangle-7", "parallelogram-4", "rdm-4", "rdm-7-alike",
        "rdm-14",
    }  # fmt: skip


def test_shipped_rows_are_evaluated_with_their_folders_and_the_others_are_not_trained():
    found, seen = Recorder(), []
    results = run_suite("motionpcm", SuiteSettings(repeats=7), found, seen.append)
    assert [entry.row for entry in results] == list(get_suite("motionpcm").rows)
    missing = {entry.row.key for entry in results if entry.missing}
    assert missing == {"mld", "reference", "k20", "no-ema", "no-discriminator"}
    assert all((entry.result is None) == (entry.row.key in missing) for entry in results)
    calls = {key: (path, repeats) for key, path, repeats in found.calls}
    assert calls["real"] == (None, 7)
    assert calls["pcm-1"] == (shipped()[CLIPS], 7)
    assert calls["teacher"] == (shipped()[CLIPS], 5)
    assert "PCM, 1 step, k = 20: no weights given" in seen
    assert "Teacher, 50 guided steps: 5 repeats" in seen


def test_fewer_repeats_than_a_row_would_have_at_most_are_kept():
    found = Recorder()
    run_suite("motionpcm", SuiteSettings(repeats=1, only=("teacher", "real")), found)
    assert [(key, repeats) for key, _, repeats in found.calls] == [("real", 1), ("teacher", 1)]


def test_given_folders_fill_rows_by_their_name(tmp_path: Path):
    found = Recorder()
    trained = folder(tmp_path / "a", f"{CLIPS}-k20", ("vae", "pcm-1"))
    results = run_suite("motionpcm", SuiteSettings((trained,), only=("k20", "no-ema")), found)
    assert [(entry.row.key, entry.missing) for entry in results] == [("k20", ""), ("no-ema", "no weights given")]
    assert found.calls == [("k20", trained, 20)]


def test_a_given_folder_takes_the_place_of_a_shipped_one_of_its_name(tmp_path: Path):
    found = Recorder()
    mine = folder(tmp_path / "a", STREAMS, ("rdm", "md"))
    results = run_suite("rdm", SuiteSettings((mine,), only=("rdm-7", "rdm-pcm-1")), found)
    assert [(entry.row.key, entry.missing) for entry in results] == [("rdm-7", ""), ("rdm-pcm-1", f"not in {STREAMS}")]
    assert found.calls == [("rdm-7", mine, 10)]


def test_folders_that_no_row_asks_for_become_rows(tmp_path: Path):
    found = Recorder()
    mine = folder(tmp_path / "a", "mine", ("vae", "length", "teacher", "pcm-2"))
    results = run_suite("motionpcm", SuiteSettings((mine,)), found)
    assert [entry.row.key for entry in results][-2:] == ["mine-teacher", "mine-pcm-2"]
    assert [(entry.row.steps, entry.row.group) for entry in results[-2:]] == [(50, "Others given"), (2, "Others given")]
    assert found.calls[-2:] == [("mine-teacher", mine, 5), ("mine-pcm-2", mine, 20)]


def test_what_cannot_be_is_refused_before_anything_runs(tmp_path: Path):
    found = Recorder()
    a, b = (folder(tmp_path / name, "same", ("pcm-1",)) for name in ("a", "b"))
    (tmp_path / "c").mkdir()
    broken = tmp_path / "d"
    broken.mkdir()
    (broken / "config.json").write_text("{")
    checkpoint = tmp_path / "step_3"
    checkpoint.mkdir()
    (checkpoint / "config.json").write_text('{"recipe": "tiny"}')
    for settings, error, message in (
        (SuiteSettings((a, b)), InputError, "both called 'same'"),
        (SuiteSettings((tmp_path / "c",)), InputError, "has no config.json"),
        (SuiteSettings((broken,)), FormatError, "is not JSON"),
        (SuiteSettings((checkpoint,)), FormatError, r"step_3/config\.json names no models"),
        (SuiteSettings(only=("pcm-8",)), InputError, "has no row 'pcm-8'"),
    ):
        with pytest.raises(error, match=message):
            run_suite("motionpcm", settings, found)
    with pytest.raises(InputError, match="'mdm' is no suite"):
        run_suite("mdm", SuiteSettings(), found)
    assert not found.calls
