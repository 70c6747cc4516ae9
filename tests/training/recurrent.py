"""Tiny trainings of recurrent models: the corpus they share, and RDM-7, which students learn from."""

from contextlib import contextmanager
from dataclasses import replace

import pytest

from moveset.recipes import tiny
from moveset.training.engine import run
from moveset.training.tasks import Sources, task_maker, with_settings
from tests.training.segment_corpus import use_words, write_corpus


@contextmanager
def corpus_folder(factory):
    """A folder with a corpus, in whose trainings words stand for sentences."""
    with pytest.MonkeyPatch.context() as patch:
        use_words(patch)
        made = factory.mktemp("runs")
        write_corpus(made)
        yield made


def sources(folder, corpus=None):
    return Sources(
        corpus=corpus or folder / "corpus.safetensors", vae=folder / "vae", teacher=folder / "rdm-7",
        cache=folder / ("cache" if corpus is None else corpus.name),
    )  # fmt: skip


def trained(folder, what, into, *settings, corpus=None, resume=False, **engine):
    """A tiny training and the task it trained."""
    recipe, made = tiny.TRAINING[what](), []
    maker = task_maker(what, with_settings(recipe.task, settings), sources(folder, corpus))

    def make(loop):
        made.append(maker(loop))
        return made[0]

    given = {"steps": 3, "save_every": 100, "validate_every": 0, **engine}
    result = run(make, replace(recipe.engine, **given), into, resume)
    return made[0], result


def teacher(folder):
    """RDM-7, in its place in the folder."""
    return trained(folder, "rdm-7", folder / "rdm-7", steps=4, validate_every=4)


def tensors(task):
    return {
        f"{name}.{key}": value.clone()
        for name, module in {**task.modules(), **task.averages()}.items()
        for key, value in module.state_dict().items()
    }
