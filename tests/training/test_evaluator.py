"""The evaluator learns which sentence belongs to which motion, resumes exactly, and its loss is what it says."""

from dataclasses import replace

import pytest
import torch

from moveset.data.feature_store import FeatureStore
from moveset.errors import InputError
from moveset.evaluation.evaluator import Evaluator
from moveset.motion.features import get_codec
from moveset.recipes import tiny
from moveset.training import evaluator as training
from moveset.training.engine import run
from moveset.training.evaluator import contrast
from moveset.training.export import EvaluatorExport, export
from moveset.training.tasks import Sources, task_maker, with_settings
from moveset.training.trained import load_trained
from tests.training.hml_folder import write_folder
from tests.training.segment_corpus import Words, write_corpus

WORDS = ("model.word_width=8", "max_words=16")


@pytest.fixture(scope="module", autouse=True)
def words():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "get_text_encoder", lambda name: Words())
        patch.setattr("moveset.training.export.get_text_encoder", lambda name: Words())
        patch.setattr("moveset.evaluation.evaluator.get_text_encoder", lambda name: Words())
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("judge")
    write_corpus(made)
    trained(made, "movement", steps=2)
    return made


def trained(folder, what, *settings, into=None, resume=False, corpus="corpus.safetensors", wrap=None, **engine):
    recipe = tiny.TRAINING[what]()
    sources = Sources(corpus=folder / corpus, vae=folder, teacher=folder / "movement", cache=folder / f"cache-{corpus}")
    maker = task_maker(what, with_settings(recipe.task, settings), sources)
    given = {"save_every": 1000, "validate_every": 0, "log_every": 1000, **engine}
    return run(wrap(maker) if wrap else maker, replace(recipe.engine, **given), into or folder / what, resume)


def packed_evaluator(folder):
    what = EvaluatorExport(name="judge", runs={"evaluator": "e"})
    return export(what, None, folder, folder, folder / "packed")


def over_fitted(folder, what, *settings, steps=20):
    """Losses of steps that are all of the first batch."""
    losses = []

    def always_the_first(maker):
        def make(loop):
            task = maker(loop)
            step = task.training_step

            def training_step(number, loop):
                metrics = step(1, loop)
                losses.append(float(metrics["loss"]))
                return metrics

            task.training_step = training_step
            return task

        return make

    trained(folder, what, *settings, into=folder / f"one-batch-{what}", wrap=always_the_first, steps=steps)
    return losses


def test_the_movement_autoencoder_learns(folder):
    losses = over_fitted(folder, "movement", "lr=0.01", "batch=8")
    assert losses[-1] < 0.8 * losses[0]


def test_it_learns_what_belongs_together(folder):
    losses = over_fitted(folder, "evaluator", *WORDS, "negatives=all", "batch=12", "lr=0.01")
    assert losses[-1] < 0.5 * losses[0]


def test_statistics_and_the_frozen_encoder_are_in_the_checkpoint(folder):
    trained(folder, "evaluator", *WORDS, into=folder / "e", steps=2)
    found, movement = load_trained(folder / "e", "evaluator_ema"), load_trained(folder / "movement", "movement")
    for name, value in movement.module.encoder.state_dict().items():
        assert torch.equal(found.module.movement.state_dict()[name], value)
    groups = get_codec("hml").groups
    plain = FeatureStore(folder / "cache-corpus.safetensors/features-hml").normalizer
    assert torch.equal(found.module.mean, plain.mean)
    torch.testing.assert_close(found.module.std[groups["root_yaw"]] * 5, plain.std[groups["root_yaw"]])
    torch.testing.assert_close(found.module.std[groups["positions"]], plain.std[groups["positions"]])
    packed = packed_evaluator(folder)
    assert Evaluator.open(packed).card.provenance["steps"] == 2


def test_resuming_is_exact(folder):
    trained(folder, "evaluator", *WORDS, into=folder / "whole", steps=6)
    trained(folder, "evaluator", *WORDS, into=folder / "parts", steps=6, save_every=3)
    for later in (folder / "parts").glob("step_6"):
        later.rename(folder / "set-aside")
    trained(folder, "evaluator", *WORDS, into=folder / "parts", steps=6, resume=True)
    one, other = (load_trained(folder / name, "evaluator") for name in ("whole", "parts"))
    assert one.digest == other.digest


def test_a_public_folder_is_read(folder):
    write_folder(folder / "hml")
    trained(folder, "movement", corpus="hml", into=folder / "hml-movement", steps=2)
    result = trained(folder, "evaluator", *WORDS, corpus="hml", into=folder / "hml-evaluator", steps=2)
    assert result.step == 2


def test_words_of_a_table_are_read_and_packed(folder, tmp_path):
    write_folder(tmp_path / "hml")
    table = tmp_path / "glove.txt"
    table.write_text("".join(f"{word} {k}.5 1 0\n" for k, word in enumerate(("sos", "eos", "unk", "a", "walk"))))
    given = (f"words=glove:{table}", "model.word_width=3", "model.speech_classes=15")
    movement = trained(tmp_path, "movement", corpus="hml", steps=1)
    trained(tmp_path, "evaluator", *given, corpus="hml", into=tmp_path / "e", steps=2)
    judge = Evaluator.open(packed_evaluator(tmp_path))
    assert movement.step == 1
    assert judge.words.vocabulary == ("sos", "eos", "unk", "a", "walk")
    with pytest.raises(InputError, match="parts of speech"):
        trained(folder, "evaluator", *given, into=folder / "wrong", steps=1)


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
