"""One repeat: what is drawn, who reads what, and that every measure is of the right things."""

import math

import pytest
import torch

from moveset.errors import InputError
from moveset.evaluation import metrics
from moveset.evaluation.generators import Given, Reconstruction
from moveset.evaluation.metrics import frechet_distance
from moveset.evaluation.motion_files import folder_motions
from moveset.evaluation.protocol import Protocol, Session, encoded, physical, random_of, run_repeat, seed_of
from moveset.evaluation.samples import open_test_set
from moveset.motion.features import get_codec
from moveset.motion.measures import jerk, measure
from moveset.pipelines.model_config import ClipConfig
from moveset.pipelines.model_folder import ModelFolder
from tests.evaluation.corpora import motion_folder
from tests.evaluation.judges import Oracle, Painter
from tests.motions import wander
from tests.training.hml_folder import write_folder

QUICK = Protocol(repeats=2, multimodality=0)


def session(items, generator, evaluator, protocol=QUICK):
    return Session(protocol.fitted(items, generator.random), items, generator, evaluator)


def test_an_oracle_finds_all_real_motion_and_its_physical_measures_are_those_of_its_joints(items, oracle):
    found = run_repeat(session(items, Given("real"), oracle), 0)
    assert (found["groups"], found["shortened"]) == (2, 0)
    found = found["metrics"]
    assert [found[name] for name in ("r1", "r2", "r3", "mm_dist")] == [1.0, 1.0, 1.0, 0.0]
    assert found["fid"] == pytest.approx(0.0, abs=1e-6)
    assert "multimodality" not in found
    measured = [measure(item.joints(), 20.0) for item in items.items]
    for name in ("skating", "jerk", "floating", "penetration", "root_drift"):
        values = [one[name] for one in measured]
        assert found[name] == pytest.approx(float(torch.stack(values).double().mean()), rel=1e-6)


def test_noise_is_found_by_chance(items, oracle):
    one = session(items, Painter(), oracle)
    rates = [run_repeat(one, k)["metrics"]["r3"] for k in range(4)]
    assert sum(rates) / 4 < 0.25  # 3 / 32 on average


def test_numbers_are_those_of_the_pure_functions(items, oracle):
    painter = Painter()
    found = run_repeat(session(items, painter, oracle), 1)["metrics"]
    draws = items.draw(random_of(QUICK, 1, "items"))
    made = encoded(painter.generate(painter.asked[: len(draws)], 20.0), items.codec)
    motion, text = oracle.embed_motions(made), oracle.embed_texts([d.caption for d in draws])
    groups = metrics.group(items.labels, len(draws), random_of(QUICK, 1, "groups"), takes=items.takes)
    assert found["r1"] == pytest.approx(metrics.r_precision(text, motion, groups)[0].item())
    assert found["mm_dist"] == pytest.approx(metrics.matching_score(text, motion, groups))
    real = oracle.embed_motions([d.features() for d in draws])
    assert found["fid"] == pytest.approx(frechet_distance(real, motion))


def test_lengths_are_the_items(items, oracle):
    painter = Painter()
    run_repeat(session(items, painter, oracle), 0)
    assert [one.frames for one in painter.asked] == [item.rows + 1 for item in items.items]
    assert len({one.seed for one in painter.asked}) == len(items)


def test_a_repeat_depends_on_its_number_and_the_seed_alone(items, oracle):
    def values(number, of):
        return run_repeat(of, number)["metrics"]

    one = session(items, Painter(), oracle)
    third = values(3, one)
    assert third != values(2, one)
    assert third == values(3, session(items, Painter(), oracle, Protocol(repeats=9, multimodality=0)))
    assert third != values(3, session(items, Painter(), oracle, Protocol(repeats=2, multimodality=0, seed=1)))


def test_multimodality_makes_many_of_each_text(items, oracle):
    painter = Painter()
    protocol = Protocol(multimodality=5, samples=12)
    found = run_repeat(session(items, painter, oracle, protocol), 0)["metrics"]
    more = painter.asked[len(items) :]
    assert len(more) == 60
    assert all(one.parts == more[12 * (k // 12)].parts for k, one in enumerate(more))
    assert len({one.parts[0][0] for one in more}) == 5
    assert len({one.seed for one in painter.asked}) == len(painter.asked)
    motion = oracle.embed_motions(encoded(painter.generate(more, 20.0), items.codec)).view(5, 12, -1)
    expected = metrics.multimodality(motion, random_of(protocol, 0, "pairs"), 10)
    assert found["multimodality"] == pytest.approx(expected)


def test_too_much_is_reduced_and_too_little_refused(items):
    fitted = Protocol(multimodality=100, diversity=300).fitted(items, random=True)
    assert (fitted.multimodality, fitted.diversity) == (80, 80)
    assert Protocol().fitted(items, random=False).multimodality == 0
    with pytest.raises(InputError, match="has 31 items, and R-precision needs 32"):
        Protocol().fitted(items.limited(31), random=True)


@pytest.mark.parametrize("wrong", [{"repeats": 0}, {"seed": -1}, {"samples": 9}, {"group": 2}])
def test_protocols_out_of_range(wrong):
    with pytest.raises(InputError):
        Protocol(**wrong)


def test_real_motion_is_read_once_where_it_does_not_change(items):
    oracle = Oracle(items)
    one = session(items, Painter(), oracle)
    run_repeat(one, 0)
    assert oracle.seen == 2 * len(items)
    run_repeat(one, 1)
    assert oracle.seen == 3 * len(items)


def test_seeds_are_keyed():
    assert len({seed_of(QUICK, k, name) for k in range(5) for name in ("a", "b")}) == 10
    assert all(0 <= seed_of(QUICK, k, "a") < 2**63 for k in range(100))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda made: made[3].fill_(math.nan), "not finite"),
        (lambda made: made.__setitem__(0, made[0][:, :21]), r"judges \(frames, 22, 3\)"),
        (lambda made: made.__setitem__(0, made[0][:4]), "at least 5"),
    ],
)
def test_garbage_is_refused(items, oracle, spoil, message):
    with pytest.raises(InputError, match=message):
        run_repeat(session(items, Painter(spoil), oracle), 0)


def test_an_evaluator_of_other_features_is_refused(items, tmp_path):
    kit = Oracle(items)
    object.__setattr__(kit, "card", type(kit.card)(name="kit", codec="kit"))
    with pytest.raises(InputError, match="judges 'kit' features"):
        session(items, Painter(), kit)


def test_jerk_at_seams_is_of_the_seams():
    smooth = wander(100, seed=1).joints
    torn = smooth.clone()
    torn[28:] += 0.05
    codec = get_codec("hml")
    before, after = physical([smooth], codec, 1.4), physical([torn], codec, 1.4)
    assert after["boundary_jerk"] > 2 * before["boundary_jerk"]
    assert after["boundary_jerk"] > 2 * after["jerk"]
    both = physical([smooth, torn], codec, 1.4)
    assert both == pytest.approx({name: (before[name] + after[name]) / 2 for name in before})
    assert "boundary_jerk" not in physical([smooth], codec)
    assert "boundary_jerk" not in physical([smooth[:29]], codec, 1.4)
    assert before["jerk"] == pytest.approx(float(jerk(smooth, 20.0)))


def test_reconstructions_have_joint_errors(items, oracle, tiny):
    bundle = ModelFolder(tiny, ClipConfig)
    found = run_repeat(session(items, Reconstruction(bundle, device="cpu"), oracle), 0)["metrics"]
    assert 0 < found["mpjpe_aligned"] < found["mpjpe"] < 5


def test_given_motion_is_judged_by_its_own_prompts(items, tmp_path):
    own = folder_motions(motion_folder(tmp_path / "motions"), None, 20.0)
    judge = Oracle(own)
    one = session(items, Given("motions", own), judge)
    found = run_repeat(one, 0)
    assert found["metrics"]["r1"] == 1.0
    assert found["metrics"]["fid"] > 0.1  # against the corpus, not against itself
    assert one.judged is own


def test_folders_are_cropped_anew_in_every_repeat(tmp_path):
    items = open_test_set(write_folder(tmp_path / "data"), "train")
    judge = Oracle(items)
    protocol = Protocol(group=4, multimodality=0)
    one = session(items, Given("real"), judge, protocol)
    found = [run_repeat(one, k)["metrics"] for k in range(2)]
    assert found[0]["fid"] == pytest.approx(0.0, abs=1e-6)
    painter = Painter()
    run_repeat(session(items, painter, judge, protocol), 0)
    assert all((one.frames - 1) % 4 == 0 for one in painter.asked)
