"""Suites know their rows, find weights by name, and say what is not there."""

import json
from itertools import pairwise
from pathlib import Path

import pytest

from moveset.errors import FormatError, InputError
from moveset.evaluation.published import tables
from moveset.evaluation.suites import CLIPS, REAL, STREAMS, chosen_rows, get_suite
from moveset.pipelines.model_folder import shipped
from moveset.rdm.staircase import Staircase
from tests.samplers import calls

SUITES = ("motionpcm", "rdm")


def folder(path: Path, name: str, networks: tuple[str, ...], **more: object) -> Path:
    """As much of a model folder as a suite looks at."""
    path.mkdir()
    (path / "config.json").write_text(json.dumps({"name": name, "models": dict.fromkeys(networks), **more}))
    return path


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


def test_staircases_are_those_that_the_sampler_knows():
    stairs = {}
    for row in get_suite("rdm").rows:
        if "start" in row.settings:
            assert row.steps is not None
            shown = {key: value for key, value in row.settings.items() if key != "past_lag"}
            stairs[row.key] = Staircase(row.steps, 7, **shown)
    assert calls(stairs["disentangled"]) == 10
    assert calls(stairs["triangle-7"]) == 10 + 6 * 9 // 2
    assert calls(stairs["rdm-7"]) == 70
    # One segment after the other, whatever a folder's own lag is.
    assert stairs["sequential"].end(6) == stairs["noisy-past"].end(6) == 70


def test_rows_have_their_shipped_folders_or_no_weights():
    chosen = {row.key: (folder, missing) for row, folder, missing in chosen_rows("motionpcm")}
    assert list(chosen) == [row.key for row in get_suite("motionpcm").rows]
    assert {key for key, (_, missing) in chosen.items() if missing} == {
        "mld", "k20", "no-ema", "no-discriminator"
    }  # fmt: skip
    assert chosen["real"] == (None, "")
    assert chosen["pcm-1"] == (shipped()[CLIPS], "")
    assert chosen["k20"] == (None, "no weights given")
    alone = {row.key: (folder, missing) for row, folder, missing in chosen_rows("motionpcm", alone=True)}
    assert alone["real"] == (None, "")
    assert {missing for key, (_, missing) in alone.items() if key not in ("real", "training", "nearest")} == {
        "no weights given"
    }


def test_given_folders_fill_rows_by_their_name(tmp_path: Path):
    trained = folder(tmp_path / "a", "motionpcm-k20-paper", ("vae", "pcm-1"))
    found = chosen_rows("motionpcm", (trained,), ("k20", "no-ema"))
    assert [(row.key, path, missing) for row, path, missing in found] == [
        ("k20", trained, ""), ("no-ema", None, "no weights given")
    ]  # fmt: skip


def test_a_given_folder_takes_the_place_of_a_shipped_one_of_its_name(tmp_path: Path):
    mine = folder(tmp_path / "a", STREAMS, ("rdm", "md"))
    found = chosen_rows("rdm", (mine,), ("rdm-7", "rdm-pcm-1"))
    assert [(row.key, path, missing) for row, path, missing in found] == [
        ("rdm-7", mine, ""), ("rdm-pcm-1", None, f"not in {STREAMS}")
    ]  # fmt: skip


def test_folders_that_no_row_asks_for_become_rows(tmp_path: Path):
    mine = folder(tmp_path / "a", "mine", ("vae", "length", "teacher", "pcm-2"))
    found = chosen_rows("motionpcm", (mine,))[-2:]
    assert [(row.key, path) for row, path, _ in found] == [("mine-teacher", mine), ("mine-pcm-2", mine)]
    assert [(row.steps, row.group, row.times(20)) for row, _, _ in found] == [
        (50, "Others given", 5), (2, "Others given", 20)
    ]  # fmt: skip


@pytest.mark.parametrize("name", SUITES)
def test_all_folders_of_a_recipe_may_be_given(tmp_path: Path, name: str):
    made = [
        folder(tmp_path / "a", "motionpcm-small", ("vae", "teacher", "pcm-1")),
        folder(tmp_path / "b", "md-7-small", ("rdm", "md")),
        folder(tmp_path / "c", "dip-small", ("denoiser",)),
        tmp_path / "d",
    ]
    made[-1].mkdir()
    (made[-1] / "config.json").write_text(json.dumps({"name": "t2m-small", "task": "evaluator", "model": {}}))
    assert [row.key for row, _, _ in chosen_rows(name, made)] == [row.key for row in get_suite(name).rows]


def test_rows_of_given_folders_take_the_steps_that_a_folder_says(tmp_path: Path):
    mine = folder(tmp_path / "a", "mine", ("rdm", "md", "pcm-1"), sampler_steps=20)
    assert [row.steps for row, _, _ in chosen_rows("rdm", (mine,))[-3:]] == [20, 20, 1]
    broken = folder(tmp_path / "b", "broken", ("rdm",), sampler_steps="many")
    with pytest.raises(FormatError, match="sampler_steps 'many'"):
        chosen_rows("rdm", (broken,))


def test_what_cannot_be_is_refused(tmp_path: Path):
    a, b = (folder(tmp_path / name, "same", ("pcm-1",)) for name in ("a", "b"))
    files = {"broken": "{", "step_3": '{"recipe": "tiny"}'}
    for name, text in files.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "config.json").write_text(text)
    (tmp_path / "c").mkdir()
    for suite, given, only, error, message in (
        ("motionpcm", (a, b), (), InputError, "both called 'same'"),
        ("motionpcm", (tmp_path / "c",), (), InputError, "has no config.json"),
        ("motionpcm", (tmp_path / "broken",), (), FormatError, "is not JSON"),
        ("motionpcm", (tmp_path / "step_3",), (), FormatError, r"step_3/config\.json names no models"),
        ("motionpcm", (), ("pcm-8",), InputError, "has no row 'pcm-8'"),
        ("mdm", (), (), InputError, "'mdm' is no suite"),
    ):
        with pytest.raises(error, match=message):
            chosen_rows(suite, given, only)
