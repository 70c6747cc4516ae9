"""Keeping what other code made: only if nothing but the code is other, and its first repeat comes out the same."""

import json
from dataclasses import replace

import pytest

from moveset.errors import FormatError, InputError
from moveset.evaluation import same_code
from moveset.evaluation.confirm import confirm
from moveset.evaluation.items import open_items
from moveset.evaluation.job import Job, run
from moveset.evaluation.protocol import Protocol, Session, run_repeat
from moveset.evaluation.results import Results
from moveset.evaluation.table import Measured
from tests.bundles import tiny_bundle
from tests.evaluation.corpora import content_corpus
from tests.evaluation.judges import Oracle, Painter
from tests.evaluators import tiny_evaluator

PROTOCOL = Protocol(repeats=3, multimodality=0, group=8)


@pytest.fixture(scope="module")
def items(tmp_path_factory):
    return open_items(content_corpus(tmp_path_factory.mktemp("corpus") / "corpus.safetensors"), "test").limited(24)


def newer(code="moveset.evaluation.intervals"):
    """The same painter in other code."""
    painter = Painter()
    painter.code = (code,)
    return painter


def opened(items, out, generator, protocol=PROTOCOL):
    session = Session(protocol.fitted(items, True), items, generator, Oracle(items))
    return Results(session, out), lambda number: run_repeat(session, number)


@pytest.fixture
def there(items, tmp_path):
    results, make = opened(items, tmp_path, Painter())
    for number in range(3):
        results.add(make(number))
    return results.finish()


def only(make, numbers):
    """``make``, of these repeats alone."""

    def checked(number):
        assert number in numbers
        return make(number)

    return checked


def test_what_comes_out_the_same_is_kept(items, tmp_path, there):
    results, make = opened(items, tmp_path, newer())
    assert results.missing() == [0, 1, 2]
    said = confirm(results, only(make, {0}))
    assert said == "painter-test: the first repeat came out the same to the bit, so all 3 are kept"
    kept = results.finish()
    assert kept["kept"] == {"repeats": 3, **{name: there[name] for name in ("measures_sha256", "versions")},
                            "generator_sha256": there["generator_sha256"]}  # fmt: skip
    assert kept["generator_sha256"] != there["generator_sha256"]
    differ = {name for name in {*kept, *there} if kept.get(name) != there.get(name)}
    assert differ <= {"generator_sha256", "kept", "seconds", "seconds_per_item"}
    for name in ("seconds", "seconds_per_item"):
        assert kept[name] == pytest.approx(there[name], abs=0.11)
    assert json.loads(results.path.read_text()) == kept
    found = {"what": "Painter", "then": there["generator_sha256"], "now": kept["generator_sha256"], "by": results.name}
    assert json.loads((tmp_path / "same-code.json").read_text()) == {"same": [found]}
    assert Measured.of(kept, "kept").kept
    assert not Measured.of(there, "there").kept


def test_the_code_that_made_them_is_remembered_however_often_it_changes(items, tmp_path, there):
    results, make = opened(items, tmp_path, newer())
    confirm(results, make)
    results.finish()
    results, make = opened(items, tmp_path, newer("moveset.evaluation.paired"))
    confirm(results, only(make, {0}))
    last = results.finish()
    assert last["kept"]["generator_sha256"] == there["generator_sha256"]
    same = same_code.load(tmp_path)
    assert same.of(("Painter", there["generator_sha256"])) == same.of(("Painter", last["generator_sha256"]))
    assert same.of(("Painter", "0")) == ("Painter", "0")


def test_a_folder_without_its_repeats_has_them_back(items, tmp_path, there):
    for path in (tmp_path / "repeats").glob("*/*.json"):
        path.unlink()
    results, make = opened(items, tmp_path, Painter())
    confirm(results, only(make, {0}))
    again = results.finish()
    assert again["repeats"] == there["repeats"]
    assert "kept" not in again


def test_more_repeats_are_made_after_those_that_are_kept(items, tmp_path, there):
    results, make = opened(items, tmp_path, newer(), replace(PROTOCOL, repeats=5))
    confirm(results, only(make, {0}))
    assert results.missing() == [3, 4]
    for number in (3, 4):
        results.add(make(number))
    whole = results.finish()
    assert whole["repeats"][:3] == there["repeats"]
    assert (len(whole["repeats"]), whole["kept"]["repeats"]) == (5, 3)


@pytest.mark.parametrize("change", ["a digit", "a measure", "shortened"])
def test_what_comes_out_otherwise_is_made_anew(items, tmp_path, there, change):
    def changed(number):
        repeat = make(number)
        if change == "a digit":
            repeat["metrics"]["fid"] *= 1 + 1e-15
        elif change == "a measure":
            repeat["metrics"]["sway"] = 1.0
        else:
            repeat["shortened"] += 1
        return repeat

    results, make = opened(items, tmp_path, newer())
    said = confirm(results, changed)
    assert "the first repeat came out otherwise (" in said
    assert said.endswith("so every repeat is made")
    assert results.missing() == [1, 2]
    for number in (1, 2):
        results.add(make(number))
    assert "kept" not in results.finish()
    assert not (tmp_path / "same-code.json").exists()


def test_what_is_not_only_of_other_code_is_made_anew(items, tmp_path, there):
    other = newer()
    other.weights = lambda: {"paint.safetensors": "2"}
    results, make = opened(items, tmp_path, other)
    assert "is of other weights_sha256, weights, so every" in confirm(results, only(make, set()))
    assert results.missing() == [0, 1, 2]


def test_where_there_is_nothing_to_confirm(items, tmp_path):
    results, make = opened(items, tmp_path, Painter())
    assert confirm(results, only(make, set())) == "painter-test: no result to confirm, so every repeat is made"
    for number in range(3):
        results.add(make(number))
    assert confirm(results, only(make, set())) == "painter-test: every repeat is of this code already"


@pytest.mark.parametrize("repeats", [[], None, [3], [[]]])
def test_a_damaged_result_is_refused(items, tmp_path, there, repeats):
    results, make = opened(items, tmp_path, newer())
    results.path.write_text(json.dumps({**there, "repeats": repeats}))
    with pytest.raises(FormatError, match="is no result of an evaluation"):
        confirm(results, only(make, set()))


def test_making_everything_anew_forgets_what_was_kept(items, tmp_path, there):
    results, make = opened(items, tmp_path, newer())
    confirm(results, make)
    results.forget()
    for number in range(3):
        results.add(make(number))
    assert "kept" not in results.finish()


def test_a_job_keeps_its_result(tmp_path, monkeypatch):
    job = Job(
        model=str(tiny_bundle(tmp_path / "tiny")), data=content_corpus(tmp_path / "corpus.safetensors"),
        evaluator=str(tiny_evaluator(tmp_path / "judge")), protocol=Protocol(repeats=3, multimodality=0, group=8),
        items=24, device="cpu",
    )  # fmt: skip
    before, _ = run(job, tmp_path / "out", processes=1)
    monkeypatch.setattr("moveset.evaluation.results.code_sha256", lambda modules: "0" * 64)
    said = []
    after, _ = run(job, tmp_path / "out", processes=1, confirmed=True, say=said.append)
    assert "all 3 are kept" in said[0]
    assert after["repeats"] == before["repeats"]
    assert after["kept"]["measures_sha256"] == before["measures_sha256"]
    with pytest.raises(InputError, match="choose --no-resume or --confirm"):
        run(job, tmp_path / "out", again=True, confirmed=True)
    with pytest.raises(InputError, match="several processes cannot confirm"):
        run(job, tmp_path / "out", share=(0, 2), confirmed=True)
