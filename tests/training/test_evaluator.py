"""The evaluator learns which sentence belongs to which motion, resumes exactly, and its loss is what it says."""

import shutil
from dataclasses import replace

import pytest
import torch

from moveset.data.feature_store import FeatureStore
from moveset.errors import InputError
from moveset.evaluation.evaluator import Evaluator
from moveset.motion.features import get_codec
from moveset.training.engine import run
from moveset.training.evaluator import contrast
from moveset.training.export import EvaluatorExport, export
from moveset.training.tasks import load_recipe
from moveset.training.trained import load_trained
from tests.synthetic import synthetic_corpus
from tests.training.hml_folder import write_folder


def over_fitted(tiny_run, what, into, *settings, steps):
    """Losses of steps that are all of the first batch."""
    maker, losses = tiny_run.maker(what, *settings), []

    def make(loop):
        task = maker(loop)
        step = task.training_step

        def training_step(number, loop):
            metrics = step(1, loop)
            losses.append(float(metrics["loss"]))
            return metrics

        task.training_step = training_step
        return task

    config = load_recipe("tiny", what).engine
    run(make, replace(config, steps=steps, save_every=1000, validate_every=0), into)
    return losses


def test_the_movement_autoencoder_learns(tiny_run, tmp_path):
    losses = over_fitted(tiny_run, "movement", tmp_path / "run", "lr=0.01", "batch=8", steps=15)
    assert losses[-1] < 0.8 * losses[0]


def test_it_learns_what_belongs_together(tiny_run, tmp_path):
    losses = over_fitted(tiny_run, "evaluator", tmp_path / "run", "negatives=all", "batch=12", "lr=0.02", steps=40)
    assert losses[-1] < 0.5 * losses[0]


def test_statistics_and_the_frozen_encoder_are_in_the_checkpoint(tiny_run):
    found = load_trained(tiny_run.runs / "evaluator", "evaluator_ema")
    movement = load_trained(tiny_run.runs / "movement", "movement")
    for name, value in movement.module.encoder.state_dict().items():
        assert torch.equal(found.module.movement.state_dict()[name], value)
    groups = get_codec("hml").groups
    plain = FeatureStore(tiny_run.folder / "cache" / "features-hml").normalizer
    assert torch.equal(found.module.mean, plain.mean)
    torch.testing.assert_close(found.module.std[groups["root_yaw"]] * 5, plain.std[groups["root_yaw"]])
    torch.testing.assert_close(found.module.std[groups["positions"]], plain.std[groups["positions"]])
    assert Evaluator.open(tiny_run.model("t2m")).card.provenance["steps"] == 4


def test_who_starts_with_anothers_weights_has_its_own_statistics_and_encoder(tiny_run, tmp_path):
    """Else the judge that is exported would read features otherwise than it was trained to."""
    corpus = synthetic_corpus(tmp_path / "other.safetensors", clips=18, seed=5)
    movement = tmp_path / "movement"
    tiny_run.train("movement", movement, corpus=corpus, steps=1)
    init, sources = tiny_run.runs / "evaluator", {"teacher": movement}
    task, _ = tiny_run.train(
        "evaluator", tmp_path / "run", "lr=1e-9", corpus=corpus, sources=sources, init=init, steps=1
    )
    encoder = load_trained(movement, "movement").module.encoder.state_dict()
    for name in ("evaluator", "evaluator_ema"):
        made, old = (load_trained(folder, name).module for folder in (tmp_path / "run", init))
        assert torch.equal(made.mean, task.store.normalizer.mean)
        torch.testing.assert_close(made.std, task.store.normalizer.std / task.scale)
        assert not torch.allclose(made.mean, old.mean)
        assert all(torch.equal(value, encoder[key]) for key, value in made.movement.state_dict().items())
    made, old = (load_trained(folder, "evaluator").module.state_dict() for folder in (tmp_path / "run", init))
    learned = [key for key in made if not key.startswith("movement.") and key not in ("mean", "std")]
    assert all(torch.allclose(made[key], old[key], atol=1e-6) for key in learned)


def test_a_judge_has_the_sizes_of_the_movement_encoder_that_it_is_given(tiny_run, tmp_path):
    sizes = ("model.movement_width=32", "model.movement_latent=32")
    task, _ = tiny_run.train("evaluator", tmp_path / "evaluator", *sizes, steps=1)
    assert (task.config.model.movement_width, task.config.model.movement_latent) == (16, 16)


@pytest.mark.parametrize(
    ("what", "setting", "message"),
    [("movement", "window=400", "has 400 frames"), ("evaluator", "model.word_width=300", "set model.word_width=384")],
)
def test_what_no_judge_can_learn_of_is_refused(what, setting, message, tiny_run, tmp_path):
    with pytest.raises(InputError, match=message):
        tiny_run.train(what, tmp_path / what, setting)


def test_a_judge_reads_as_many_words_as_it_was_trained_with(tiny_run, tmp_path):
    tiny_run.train("evaluator", tmp_path / "e", "max_words=3", steps=1)
    what = EvaluatorExport(name="judge", runs={"evaluator": "e"})
    judge = Evaluator.open(export(what, None, tmp_path, tmp_path / "cache", tmp_path / "exported"))
    assert judge.words.read(["a person walks forward and then sits down", "go"])[2].tolist() == [3, 3]


def test_resuming_is_exact(tiny_run, tmp_path):
    shutil.copytree(tiny_run.runs / "evaluator" / "step_2", tmp_path / "run" / "step_2")
    tiny_run.train("evaluator", tmp_path / "run", steps=4, resume=True)
    one, other = (load_trained(folder, "evaluator") for folder in (tiny_run.runs / "evaluator", tmp_path / "run"))
    assert one.digest == other.digest


def test_a_public_folder_and_words_of_a_table_are_read_and_exported(tiny_run, tmp_path):
    corpus, table = write_folder(tmp_path / "hml"), tmp_path / "glove.txt"
    table.write_text("".join(f"{word} {k}.5 1 0\n" for k, word in enumerate(("sos", "eos", "unk", "a", "walk"))))
    given = (f"words=glove:{table}", "model.word_width=3", "model.speech_classes=15")
    tiny_run.train("movement", tmp_path / "movement", corpus=corpus, steps=1)
    sources = {"teacher": tmp_path / "movement"}
    for name, settings in (("plain", ()), ("e", given)):
        result = tiny_run.train("evaluator", tmp_path / name, *settings, corpus=corpus, sources=sources, steps=1)[1]
        assert result.step == 1
    what = EvaluatorExport(name="judge", runs={"evaluator": "e"})
    judge = Evaluator.open(export(what, None, tmp_path, tmp_path / "cache", tmp_path / "exported"))
    assert judge.words.vocabulary == ("sos", "eos", "unk", "a", "walk")
    with pytest.raises(InputError, match="parts of speech"):
        tiny_run.train("evaluator", tmp_path / "wrong", *given, steps=1)


def test_what_hides_motion_from_the_judge_hides_it_in_training_only(tiny_run, tmp_path):
    settings = ("blurred=true", "noise=0.2", "model.hidden_dropout=0.5")
    tiny_run.train("evaluator", tmp_path / "run", *settings, steps=1)
    judge = load_trained(tmp_path / "run", "evaluator_ema").module
    x_BFD, lengths_B = torch.randn(2, 40, judge.config.features), torch.tensor([40, 33])

    def spread() -> float:
        one, other = (judge.embed_motion(x_BFD, lengths_B) for _ in range(2))
        return float((one - other).abs().max())

    assert spread() == 0.0
    judge.train()
    assert spread() > 0.0


def test_contrast_by_hand():
    text, motion = torch.tensor([[0.0], [3.0], [7.0]]), torch.tensor([[1.0], [5.0], [7.0]])
    labels, pairs = ["a", "b", "a"], (1 + 4 + 0) / 3
    # Pairs of "a" with the other "a" are no negatives: left are (0,1) 5, (1,0) 2, (1,2) 4, (2,1) 2.
    loss, right = contrast(text, motion, labels, 10.0, None)
    assert float(loss) == pytest.approx(pairs + (25 + 64 + 36 + 64) / 4)
    assert float(right) == pytest.approx(2 / 3)
    # Rolled by one: sentence 0 against motion 1, 1 against 2, and 2 against 0, which is of its own label.
    loss, _ = contrast(text, motion, labels, 10.0, 1)
    assert float(loss) == pytest.approx(pairs + (25 + 36) / 2)
    # Nothing but one label: no negatives, and no number that is not one.
    assert float(contrast(text, motion, ["a"] * 3, 10.0, None)[0]) == pytest.approx(pairs)
    # Beyond the margin nothing pushes.
    assert float(contrast(text, motion + 100, ["a", "b", "c"], 10.0, 1)[0]) == pytest.approx(
        float((motion + 100 - text).square().mean())
    )
