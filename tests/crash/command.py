"""The real command line, with the tiny task in the place of the autoencoder: arguments as after ``moveset``."""

import sys
import types

from moveset.cli.__main__ import main
from moveset.training import tasks
from moveset.training.engine import EngineConfig
from tests.training.tiny_task import TinyConfig, TinyTask

ENGINE = EngineConfig(steps=20, save_every=1000, validate_every=0, device="cpu", threads=1, tensorboard=False)


def make(config, sources, loop):
    return TinyTask(config, loop)


def run(arguments: list[str]) -> int:
    """The exit code of the command line."""
    recipe = tasks.Recipe(task=TinyConfig(), engine=ENGINE)
    sys.modules["moveset.recipes.tiny"] = types.SimpleNamespace(TRAINING={"vae": lambda: recipe})
    tasks.TASKS["vae"] = tasks.Trainable("tests.crash.command:make")
    return main(arguments)
