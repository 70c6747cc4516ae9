"""Tiny trainings of recurrent models; the folder they share is a fixture (``conftest``)."""

from dataclasses import replace

from moveset.recipes import tiny
from moveset.training.engine import run
from moveset.training.tasks import Sources, task_maker, with_settings


def sources(folder, corpus=None):
    return Sources(
        corpus=corpus or folder / "corpus.safetensors", vae=folder / "vae", teacher=folder / "rdm-7",
        cache=folder / ("cache" if corpus is None else corpus.name),
    )  # fmt: skip


def trained(folder, what, into, *settings, corpus=None, resume=False, init=(), **engine):
    """A tiny training and the task it trained."""
    recipe, made = tiny.TRAINING[what](), []
    maker = task_maker(what, with_settings(recipe.task, settings), sources(folder, corpus))

    def make(loop):
        made.append(maker(loop))
        return made[0]

    given = {"steps": 3, "save_every": 100, "validate_every": 0, **engine}
    result = run(make, replace(recipe.engine, **given), into, resume, init)
    return made[0], result


def tensors(task):
    return {
        f"{name}.{key}": value.clone()
        for name, module in {**task.modules(), **task.averages()}.items()
        for key, value in module.state_dict().items()
    }
