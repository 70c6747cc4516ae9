"""Files of repeats: resumed, shared out, never mistaken for others, and the same result however they came to be."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from moveset.data.humanml3d import KIT
from moveset.errors import FormatError, InputError, MovesetError
from moveset.evaluation import results as results_module
from moveset.evaluation import run as running
from moveset.evaluation.protocol import Protocol, Session, run_repeat
from moveset.evaluation.results import Results, summary
from moveset.evaluation.run import EvaluationConfig, evaluate, open_session
from moveset.evaluation.samples import open_test_set
from tests.data.test_humanml3d import folder as humanml3d
from tests.evaluation.judges import Oracle, Painter
from tests.evaluators import tiny_evaluator

PROTOCOL = Protocol(repeats=4, multimodality=1, samples=10, group=8)


@pytest.fixture(scope="module")
def items(corpus):
    return open_test_set(corpus, "test").limited(24)


@pytest.fixture(scope="module")
def oracle(items):
    return Oracle(items)


def opened(items, oracle, out, protocol=PROTOCOL, generator=None):
    generator = generator or Painter()
    session = Session(protocol.fitted(items, True), items, generator, oracle)
    return session, Results(session, out)


@pytest.fixture(scope="module")
def repeats(items, oracle):
    """Of what ``opened`` opens, made once for all tests that are of files."""
    session = Session(PROTOCOL.fitted(items, True), items, Painter(), oracle)
    return [run_repeat(session, number) for number in range(4)]


def make(session, results, numbers):
    for number in numbers:
        results.add(run_repeat(session, number))


def whole(items, oracle, out, repeats):
    results = opened(items, oracle, out)[1]
    for repeat in repeats:
        results.add(repeat)
    return results.finish(), results


def same(a, b):
    """Whether two results are equal but for the time they took."""
    a, b = ({name: value for name, value in x.items() if not name.startswith("seconds")} for x in (a, b))
    return a == b


def timeless(path):
    text = Path(path).read_text()
    return [line for line in text.splitlines() if "seconds" not in line]


def test_a_result_says_what_it_is_of(items, oracle, tmp_path, repeats):
    result, results = whole(items, oracle, tmp_path, repeats)
    assert results.path == tmp_path / "painter-test.json"
    assert json.loads(results.path.read_text()) == result
    assert (result["model"], result["network"], result["steps"]) == ("painter", "paint", 1)
    assert (result["items"], result["labels"], result["groups"]) == (24, len(set(items.labels)), 3)
    assert result["data"]["name"] == "corpus.safetensors"
    assert len(result["repeats"]) == 4
    mean = sum(repeat["fid"] for repeat in result["repeats"]) / 4
    assert result["metrics"]["fid"]["mean"] == pytest.approx(mean)
    assert result["metrics"]["fid"]["interval"] > 0
    assert set(result["repeats"][0]) == set(result["metrics"])
    assert result["weights_sha256"]
    assert result["seconds_per_item"] >= 0


def test_the_same_seed_gives_the_same_bytes_but_for_the_time(items, oracle, tmp_path, repeats):
    one, a = whole(items, oracle, tmp_path / "a", repeats)
    session, b = opened(items, oracle, tmp_path / "b")
    make(session, b, (2, 0, 3, 1))
    assert same(one, b.finish())
    assert timeless(a.path) == timeless(b.path)


def test_the_time_of_an_item_is_that_of_the_quickest_repeat():
    """What else the machine does can only add to it."""
    repeats = [{"metrics": {}, "seconds": {"generating": spent, "all": spent + 1}} for spent in (30.0, 10.0, 50.0)]
    found = summary(repeats, 20)
    assert (found["seconds_per_item"], found["seconds"]) == (0.5, 93.0)


def test_an_interrupted_evaluation_goes_on(items, oracle, tmp_path, repeats):
    straight, _ = whole(items, oracle, tmp_path / "straight", repeats)
    session, results = opened(items, oracle, tmp_path / "halves")
    make(session, results, results.missing()[:2])
    assert results.finish() is None
    assert not results.path.exists()
    session, results = opened(items, oracle, tmp_path / "halves")
    assert (results.done, results.missing()) == ([0, 1], [2, 3])
    make(session, results, results.missing())
    assert same(results.finish(), straight)


def test_more_repeats_keep_those_that_are_there(items, oracle, tmp_path, repeats):
    whole(items, oracle, tmp_path, repeats)
    _, results = opened(items, oracle, tmp_path, replace(PROTOCOL, repeats=6))
    assert results.missing() == [4, 5]
    _, results = opened(items, oracle, tmp_path, replace(PROTOCOL, repeats=2))
    assert len(results.finish()["repeats"]) == 2


def test_other_settings_weights_data_and_judges_are_other_evaluations(items, oracle, tmp_path, repeats, monkeypatch):
    results = opened(items, oracle, tmp_path)[1]
    for repeat in repeats:
        results.add(repeat)
    for change in ({"seed": 1}, {"multimodality": 3}, {"group": 9}):
        assert opened(items, oracle, tmp_path, replace(PROTOCOL, **change))[1].done == []
    for what in ("weights", "describe"):
        other = Painter()
        monkeypatch.setattr(other, what, lambda: {"paint.safetensors": "2"})
        assert opened(items, oracle, tmp_path, generator=other)[1].done == []
    assert opened(replace(items, sha256="2" * 64), oracle, tmp_path)[1].done == []
    with monkeypatch.context() as patch:
        patch.setattr(results_module, "commit", lambda: "another")
        assert opened(items, oracle, tmp_path)[1].done == []
    monkeypatch.setattr(oracle, "sha256", "3" * 64, raising=False)
    assert opened(items, oracle, tmp_path)[1].done == []


def test_the_code_is_known_by_the_last_commit_and_by_what_is_not_committed(tmp_path, monkeypatch):
    def git(*arguments):
        subprocess.run(["git", "-c", "user.name=n", "-c", "user.email=e@x", *arguments], cwd=tmp_path, check=True)

    def now():
        results_module.commit.cache_clear()
        return results_module.commit()

    monkeypatch.setattr(results_module.moveset, "__file__", str(tmp_path / "package/__init__.py"))
    (tmp_path / "package").mkdir()
    (tmp_path / "package/__init__.py").write_text("a = 1\n")
    said = [now()]
    git("init", "-q")
    git("add", ".")
    said.append(now())
    git("commit", "-q", "-m", "first")
    said.append(now())
    (tmp_path / "notes.md").write_text("of something else\n")
    git("add", ".")
    assert now() == said[-1]
    for text in ("a = 2\n", "a = 3\n"):
        (tmp_path / "package/__init__.py").write_text(text)
        said.append(now())
    for text in ("b = 1\n", "b = 2\n"):
        (tmp_path / "package/new.py").write_text(text)
        said.append(now())
    assert said[0] == said[1] == f"version {results_module.moveset.__version__}"
    assert len(set(said)) == 6
    assert all(one.startswith(said[2] + "+") for one in said[3:])
    monkeypatch.undo()
    now()


def test_the_answer_to_another_question_stays(items, oracle, tmp_path, repeats, monkeypatch):
    whole(items, oracle, tmp_path, repeats)
    kept = (tmp_path / "painter-test.json").read_bytes()
    with pytest.raises(InputError, match=r"painter-test\.json is .* \(items 24 instead of 16.*give another --out"):
        opened(items.limited(16), oracle, tmp_path)
    with pytest.raises(InputError, match=r"\(seams 0\.0 instead of 1\.4\)"):
        opened(items, oracle, tmp_path, replace(PROTOCOL, seams=1.4))
    monkeypatch.setattr(oracle, "sha256", "3" * 64, raising=False)
    with pytest.raises(InputError, match=r"evaluator oracle \(00000000\) instead of oracle \(33333333\)"):
        opened(items, oracle, tmp_path)
    assert (tmp_path / "painter-test.json").read_bytes() == kept
    for damaged, message in (
        ("{}", "is no result of an evaluation"),
        ("[]", "no.* JSON object; delete it, or give ano"),
    ):
        (tmp_path / "painter-test.json").write_text(damaged)
        with pytest.raises(FormatError, match=message):
            opened(items, oracle, tmp_path)


@pytest.mark.parametrize("what", ["weights", "describe"])
def test_a_newer_answer_to_the_same_question_takes_the_place_of_the_older(
    items, oracle, tmp_path, repeats, monkeypatch, what
):
    older, _ = whole(items, oracle, tmp_path, repeats)
    other = Painter()
    monkeypatch.setattr(other, what, lambda: {"paint.safetensors": "2"})
    results = opened(items, oracle, tmp_path, generator=other)[1]
    for repeat in repeats:
        results.add(repeat)
    newer = results.finish()
    assert newer != older
    assert json.loads(results.path.read_text()) == newer


def test_making_everything_anew(items, oracle, tmp_path, repeats):
    whole(items, oracle, tmp_path, repeats)
    # Fewer than there are: none of the others may be taken for new when as many are asked for again.
    opened(items, oracle, tmp_path, replace(PROTOCOL, repeats=2))[1].forget()
    assert opened(items, oracle, tmp_path)[1].done == []


def test_a_damaged_repeat_is_named(items, oracle, tmp_path, repeats):
    _, results = whole(items, oracle, tmp_path, repeats)
    path = next((tmp_path / "repeats").glob("*/002.json"))
    for text in (path.read_text()[:50], "[]", '{"repeat": 1, "metrics": {"fid": 1}}', '{"repeat": 2}'):
        path.write_text(text)
        with pytest.raises(FormatError, match=r"002\.json is not what an evaluation wrote"):
            results.finish()


@pytest.mark.parametrize("out", ["/proc/nowhere", "file/below"])
def test_a_folder_that_cannot_be_written_to(items, oracle, tmp_path, out, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("")
    with pytest.raises(InputError, match="choose another --out"):
        opened(items, oracle, Path(out))


@pytest.fixture(scope="module")
def config(tmp_path_factory, corpus, tiny):
    folder = tmp_path_factory.mktemp("config")
    return EvaluationConfig(
        model=str(tiny),
        data=corpus,
        evaluator=str(tiny_evaluator(folder / "judge")),
        protocol=Protocol(repeats=3, multimodality=1, samples=10, group=8),
        items=24,
        device="cpu",
    )


@pytest.fixture(scope="module")
def alone(config, tmp_path_factory):
    return evaluate(config, tmp_path_factory.mktemp("alone"), processes=1)


def test_two_processes_make_the_same_table_as_one(config, alone, tmp_path):
    result, path = evaluate(config, tmp_path, processes=2)
    assert same(result, alone[0])
    assert timeless(path) == timeless(alone[1])


def test_ranks_of_torchrun_make_the_same_table_and_nothing_anew(config, alone, tmp_path):
    early, path = evaluate(config, tmp_path, share=(1, 2))
    assert early is None
    assert not path.exists()
    result, _ = evaluate(config, tmp_path, share=(0, 2))
    assert same(result, alone[0])
    for rank in range(2):
        with pytest.raises(InputError, match="give a fresh --out"):
            evaluate(config, alone[1].parent, share=(rank, 2), again=True)


def test_finished_work_makes_nothing(config, alone, monkeypatch):
    monkeypatch.setattr(running, "run_repeat", None)
    assert same(evaluate(config, alone[1].parent, processes=1)[0], alone[0])


class Helper:
    """Stands for another process."""

    def __init__(self, exitcode=None):
        self.exitcode = exitcode

    def is_alive(self):
        return self.exitcode is None

    def join(self, seconds):
        self.exitcode = 0

    def terminate(self):
        self.exitcode = self.exitcode or -15


def test_a_process_that_dies_ends_the_others_at_once(config, tmp_path, monkeypatch):
    helpers = [Helper(), Helper()]
    monkeypatch.setattr(running, "_start", lambda config, out, rank, world: helpers[rank - 1])

    def repeat(session, number, say):
        helpers[1].exitcode = 1
        say("motions", 1, 2)
        raise AssertionError("this repeat went on")

    monkeypatch.setattr(running, "run_repeat", repeat)
    with pytest.raises(MovesetError, match="process 2 of 3 ended with code 1; run again to resume"):
        evaluate(config, tmp_path, processes=3)
    assert helpers[0].exitcode == -15


def test_helpers_whose_repeats_are_another_evaluations_are_told_of(config, tmp_path, monkeypatch):
    monkeypatch.setattr(running, "_start", lambda config, out, rank, world: Helper())
    monkeypatch.setattr(running, "run_repeat", lambda session, number, say: {"repeat": number})
    with pytest.raises(MovesetError, match=r"1 of 3 repeats of tiny-pcm-1-test are not there.*changed meanwhile"):
        evaluate(config, tmp_path, processes=2)


def test_what_nobody_has_thought_of_is_told_with_its_repeat(config, tmp_path, monkeypatch):
    def repeat(session, number, say):
        raise KeyError("joints") if number == 1 else InputError("nothing can be judged")

    monkeypatch.setattr(running, "run_repeat", repeat)
    with pytest.raises(InputError, match=r"^nothing can be judged$"):
        evaluate(config, tmp_path, processes=1)
    with pytest.raises(MovesetError, match="repeat 1 of tiny-pcm-1-test failed: KeyError: 'joints'"):
        evaluate(config, tmp_path, share=(1, 2))


PARENT = """
import multiprocessing, os, time
from moveset.io.process import end_with_parent

def idle():
    end_with_parent()
    print("at work", flush=True)
    time.sleep(60)

if __name__ == "__main__":
    helper = multiprocessing.get_context("spawn").Process(target=idle, daemon=True)
    helper.start()
    helper.join()
"""


def test_helpers_end_with_the_process_that_started_them(tmp_path):
    (tmp_path / "parent.py").write_text(PARENT)
    with subprocess.Popen([sys.executable, tmp_path / "parent.py"], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout.readline() == "at work\n"
        parent.kill()
        # What it prints to is open for as long as either of them lives.
        assert parent.communicate(timeout=30) == ("", None)


def test_progress_is_told(config, tmp_path):
    heard, once = [], replace(config, protocol=Protocol(repeats=1, multimodality=0, group=8))
    evaluate(once, tmp_path, processes=1, progress=lambda *x: heard.append(x))
    assert heard[-1] == (1, 1, "0")
    assert any("motions 24/24" in stage for _, _, stage in heard)


def test_what_does_not_fit_is_refused_before_anything_is_made(config, tmp_path):
    few = replace(config, items=20, protocol=Protocol())
    with pytest.raises(InputError, match="20 items, and R-precision needs 32"):
        evaluate(few, tmp_path, processes=1)
    assert os.listdir(tmp_path) == []
    with pytest.raises(InputError, match=r"the 33 items have \d+ distinct ones; give more items, of more kinds"):
        open_session(replace(config, items=33, protocol=Protocol()))
    with pytest.raises(InputError, match="unknown evaluator"):
        open_session(replace(config, evaluator="nobody"))
    with pytest.raises(InputError, match="there is no corpus"):
        open_session(replace(config, data=tmp_path / "nothing"))
    with pytest.raises(InputError, match="batch 0"):
        open_session(replace(config, batch=0))
    with pytest.raises(InputError, match="0 processes"):
        evaluate(config, tmp_path, processes=0)


def test_a_model_of_another_skeleton_is_refused_before_anything_is_made(config, tmp_path):
    names = [str(k) for k in range(40)]
    folder = humanml3d(tmp_path, KIT, dict.fromkeys(names, 60), test=names)
    judge = tiny_evaluator(tmp_path / "judge", codec="kit", fps=12.5)
    with pytest.raises(InputError, match=r"tiny-pcm-1 moves 'hml22', and .* has 'kit21'; evaluate a mod"):
        open_session(replace(config, data=folder, evaluator=str(judge)))


def test_a_truncated_judge_is_refused(config, tmp_path):
    judge = tiny_evaluator(tmp_path / "judge")
    weights = judge / "model.safetensors"
    weights.write_bytes(weights.read_bytes()[:-1])
    with pytest.raises(FormatError):
        open_session(replace(config, evaluator=str(judge)))
