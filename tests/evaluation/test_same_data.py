"""Corpora that two processors built: the same but for rounding, and what must not be taken for that."""

import json
from dataclasses import replace
from functools import cache
from shutil import copytree

import pytest
import torch

from moveset.data.synthetic import synthetic_motion
from moveset.errors import FormatError, InputError
from moveset.evaluation import same_code
from moveset.evaluation.confirm import far
from moveset.evaluation.job import Job, run
from moveset.evaluation.protocol import Protocol
from moveset.evaluation.same_data import main, same_data
from moveset.evaluation.suites import REAL
from tests.bundles import tiny_bundle
from tests.evaluation import corpora
from tests.evaluators import tiny_evaluator

PROTOCOL = Protocol(repeats=2, multimodality=0, group=8)


@pytest.fixture(scope="module")
def judge(tmp_path_factory):
    return str(tiny_evaluator(tmp_path_factory.mktemp("judge") / "judge"))


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    return str(tiny_bundle(tmp_path_factory.mktemp("model") / "tiny"))


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Builds the corpus on a processor by which roots are elsewhere on the floor, by so much of where they are."""

    @cache
    def build(differs=0.0, frames=corpora.FRAMES):
        def motion(kind, frames, seed):
            made = synthetic_motion(kind, frames, seed=seed)
            return replace(made, root=made.root * torch.tensor([1 + differs, 1.0, 1 + differs], dtype=made.root.dtype))

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(corpora, "synthetic_motion", motion)
            return corpora.content_corpus(tmp_path_factory.mktemp("built") / "corpus.safetensors", frames=frames)

    return build


@pytest.fixture(scope="module")
def measured(built, judge, tiny, tmp_path_factory):
    """Results of real motion and of a model on the corpus of one processor."""
    folder = tmp_path_factory.mktemp("measured") / "out"
    job = Job(model=REAL, data=built(), evaluator=judge, protocol=PROTOCOL)
    run(job, folder, processes=1)
    run(replace(job, model=tiny, device="cpu"), folder, processes=1)
    return folder


@pytest.fixture
def out(measured, tmp_path):
    """A copy of those results that a test may change."""
    return copytree(measured, tmp_path / "out")


def test_another_processors_corpus_is_the_same_data(built, judge, tiny, out, monkeypatch, capsys):
    there = json.loads((out / "real-test.json").read_text())
    other = built(1e-7)
    job = Job(model=tiny, data=other, evaluator=judge, protocol=PROTOCOL, device="cpu")
    with pytest.raises(InputError, match="the result of another evaluation \\(data"):
        run(job, out, processes=1)
    monkeypatch.setattr("sys.argv", ["same_data", str(out), "--data", str(other), "--evaluator", judge])
    main()
    assert "the same but for rounding" in capsys.readouterr().out
    after, _ = run(job, out, processes=1)
    shas = [result["data"]["sha256"] for result in (there, after)]
    assert shas[0] != shas[1]
    same = same_code.load(out)
    assert same.data(shas[0]) == same.data(shas[1])
    assert same.data("another") == "another"


def test_a_result_is_confirmed_on_the_same_data(built, judge, tiny, out):
    before = json.loads(next(out.glob("tiny*.json")).read_text())
    other = built(1e-7)
    same_data(out, other, judge)
    said = []
    job = Job(model=tiny, data=other, evaluator=judge, protocol=PROTOCOL, device="cpu")
    after, _ = run(job, out, processes=1, confirmed=True, say=said.append)
    assert said == [f"{next(out.glob('tiny*.json')).stem}: the first repeat came out the same but for rounding, as the "
                    "data are, so all 2 are kept"]  # fmt: skip
    assert after["repeats"] == before["repeats"]


@pytest.mark.parametrize(
    ("differs", "options", "words"),
    [(1e-2, {}, "measures otherwise than"), (0.0, {"frames": 44}, "measures otherwise than")],
)
def test_other_data_are_refused(built, judge, out, differs, options, words):
    with pytest.raises(InputError, match=words):
        same_data(out, built(differs, **options), judge)
    assert same_code.load(out).parents == {}


def test_who_judges_must_be_the_same_and_real_motion_there(built, judge, out, tmp_path):
    other = built(1e-7)
    with pytest.raises(InputError, match="has other evaluator"):
        same_data(out, other, str(tiny_evaluator(tmp_path / "another", seed=5)))
    there = json.loads((out / "real-test.json").read_text())
    (out / "real-test.json").write_text(json.dumps(there | {"items": 5}))
    with pytest.raises(InputError, match="has other items"):
        same_data(out, other, judge)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"has no real-test\.json"):
        same_data(tmp_path / "empty", other, judge)
    (out / "real-test.json").write_text('{"data": {}}')
    with pytest.raises(FormatError, match="no result of an evaluation"):
        same_data(out, other, judge)


def test_rounding_is_a_hundred_thousandth():
    assert far({"fid": 1.0, "r1": 0.5}, {"fid": 1.000009, "r1": 0.5}) == ""
    assert far({"fid": 1.0}, {"fid": 1.00002}) == "fid 1.00002 instead of 1.0"
    assert far({"fid": 1.7e-13}, {"fid": -2e-13}) == ""
    assert far({"fid": 1.0}, {}) == "fid None instead of 1.0"
    assert far({"jerk": float("nan")}, {"jerk": 1.0}) != ""
