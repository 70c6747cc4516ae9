"""What can be trained, by name; nothing is imported before it is asked for."""

import dataclasses
import difflib
import importlib
import json
import math
import operator
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args

from moveset.errors import InputError

if TYPE_CHECKING:
    from moveset.training.engine import EngineConfig, Loop, Task
    from moveset.training.export import Export


@dataclass(frozen=True)
class Trainable:
    """One thing that can be trained.

    Args:
        target: module and class, which is called with (task config, Sources, Loop).
        vae: the autoencoder that it needs.
        teacher: what else must be trained before.
    """

    target: str
    vae: str = ""
    teacher: str = ""

    @property
    def needs(self) -> tuple[str, ...]:
        """Names of what must be trained before."""
        return tuple(name for name in (self.vae, self.teacher) if name)

    def sources(self, corpus: Path, runs: Path) -> "Sources":
        """Where it finds them, if every training has a folder by its name."""
        vae, teacher = runs / (self.vae or "vae"), runs / (self.teacher or "teacher")
        return Sources(corpus=corpus, vae=vae, teacher=teacher, cache=runs / "cache")


_RDM = Trainable("moveset.training.rdm:RDMTask")
_PCM = Trainable("moveset.training.distillation:PCMTask", vae="vae", teacher="teacher")
#: Trainings like another but for one setting: MotionPCM's Table 2, and rows of RDM's table.
VARIANTS = {
    "pcm-1-k20": ("pcm-1", "points=50"),
    "pcm-1-no-ema": ("pcm-1", "ema=0"),
    "pcm-1-no-discriminator": ("pcm-1", "adversarial=0"),
    "md-7-alone": ("md-7", "md_condition=none"),
    "rdm-student-2": ("rdm-student", "phases=2"),
}
TASKS = {
    "movement": Trainable("moveset.training.evaluator:MovementTask"),
    "evaluator": Trainable("moveset.training.evaluator:EvaluatorTask", teacher="movement"),
    "length": Trainable("moveset.training.length:LengthTask"),
    "sides": Trainable("moveset.training.sides:SidesTask"),
    "vae": Trainable("moveset.training.vae:VAETask"),
    "decoder": Trainable("moveset.training.vae:DecoderTask", vae="vae"),
    "teacher": Trainable("moveset.training.teacher:TeacherTask", vae="vae"),
    "mld-vae": Trainable("moveset.training.vae:VAETask"),
    "mld": Trainable("moveset.training.teacher:TeacherTask", vae="mld-vae"),
    "lcm-1": Trainable("moveset.training.distillation:LCMTask", vae="vae", teacher="teacher"),
    **dict.fromkeys(("pcm-1", "pcm-2", "pcm-4"), _PCM),
    **dict.fromkeys(("rdm-1", "rdm-4", "rdm-7", "rdm-14", "light-rdm-1", "md-4", "md-7", "motiondiffuse"), _RDM),
    "rdm-student": Trainable("moveset.training.rdm_distillation:RDMStudentTask", teacher="rdm-7"),
    "dip": Trainable("moveset.training.dip:DiPTask"),
}
TASKS |= {name: TASKS[original] for name, (original, _) in VARIANTS.items()}
RECIPES = ("small", "paper", "tiny")

Config = TypeVar("Config")


@dataclass(frozen=True, kw_only=True)
class Sources:
    """Where a task finds what it learns from.

    Args:
        corpus: the motions and captions.
        vae: run folder or checkpoint of the autoencoder; tasks after it need one.
        teacher: run folder or checkpoint of what was trained before: the students' teacher, the evaluator's movement
            autoencoder.
        cache: folder for features and latents that are computed once.
    """

    corpus: Path
    vae: Path
    teacher: Path
    cache: Path


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """What to train and how to run it: ``moveset.recipes.NAME.TRAINING[WHAT]()`` returns one.

    Args:
        hours: what that takes on one core of a laptop; 0 where nobody knows.
    """

    task: Any
    engine: "EngineConfig"
    hours: float = 0.0


def variants(training: Mapping[str, Callable[[], Recipe]]) -> dict[str, Callable[[], Recipe]]:
    """The trainings of ``VARIANTS`` whose originals are here: the same start, steps, seed and everything else."""

    def changed(make: Callable[[], Recipe], setting: str) -> Recipe:
        chosen = make()
        return dataclasses.replace(chosen, task=with_settings(chosen.task, [setting]))

    there = {name: of for name, of in VARIANTS.items() if of[0] in training}
    return {name: partial(changed, training[original], setting) for name, (original, setting) in there.items()}


def load_recipes(name: str) -> dict[str, Recipe]:
    """Every training of a recipe, in order.

    Raises:
        InputError: there is no such recipe.
    """
    if name not in RECIPES:
        raise InputError(f"there is no recipe {name!r}; choose one of {', '.join(RECIPES)}")
    module = importlib.import_module(f"moveset.recipes.{name}")
    training: dict[str, Callable[[], Recipe]] = module.TRAINING
    hours: dict[str, float] = getattr(module, "HOURS", {})
    return {what: dataclasses.replace(make(), hours=hours.get(what, 0.0)) for what, make in training.items()}


def load_recipe(name: str, what: str) -> Recipe:
    """The recipe of that name for that task.

    Raises:
        InputError: there is none.
    """
    found = load_recipes(name)
    if what not in found:
        raise InputError(f"the recipe {name!r} has nothing for {what!r}; it has {', '.join(found)}")
    return found[what]


def load_exports(name: str) -> "tuple[Export, ...]":
    """The folders that networks of a recipe make, ``moveset.recipes.NAME.EXPORTS``."""
    exports: tuple[Export, ...] = importlib.import_module(f"moveset.recipes.{name}").EXPORTS
    return exports


def task_maker(what: str, config: Any, sources: Sources, settings: Iterable[str] = ()) -> "Callable[[Loop], Task]":
    """What ``engine.run`` needs to build the task.

    Args:
        settings: those of ``with_settings`` that somebody asked for; when the task is built, one that it has no use for
            is an InputError.

    Raises:
        InputError: there is no such task.
    """
    if what not in TASKS:
        raise InputError(f"{what!r} cannot be trained; choose one of {', '.join(TASKS)}")
    module, _, name = TASKS[what].target.partition(":")
    make = getattr(importlib.import_module(module), name)

    def made(loop: "Loop") -> "Task":
        task: Task = make(config, sources, loop)
        for setting in settings:
            path = setting.partition("=")[0]
            asked, kept = (operator.attrgetter(path)(each) for each in (config, task.config))
            if path in task.unused or asked not in (kept, "auto"):
                follows = "" if path in task.unused else f": there it is {kept!r}, by what it stands on"
                raise InputError(f"{setting!r} is no setting of {what!r}{follows}; leave it out")
        return task

    return made


def with_settings(config: Config, settings: Iterable[str]) -> Config:
    """A copy of a frozen dataclass with fields replaced by ``NAME=VALUE``; names of nested ones are joined by dots.

    A value is read as JSON, and as a string where it is none; null leaves out what may be left out, such as a flow.

    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class Example:
    ...     lr: float = 1e-3
    ...     guidance: tuple[float, float] = (1.0, 2.5)
    >>> with_settings(Example(), ["lr=1", "guidance=[1, 4]"])
    Example(lr=1.0, guidance=(1.0, 4.0))

    Raises:
        InputError: there is no such field, or the value is of another type.
    """
    for setting in settings:
        name, equals, text = setting.partition("=")
        if not equals:
            raise InputError(f"the setting {setting!r} is not of the form NAME=VALUE; write for example lr=1e-3")
        try:
            value = json.loads(text)
        except ValueError:
            value = text
        config = _replaced(config, name.split("."), value, setting)
    return config


def _replaced(config: Any, path: list[str], value: Any, setting: str) -> Any:
    found = dataclasses.fields(config) if dataclasses.is_dataclass(config) else ()
    fields = {field.name: field.type for field in found if field.init}
    if path[0] not in fields:
        near = difflib.get_close_matches(path[0], fields, n=1)
        remedy = f"did you mean {near[0]!r}?" if near else f"choose one of {', '.join(fields) or 'nothing'}"
        raise InputError(f"{setting!r}: {type(config).__name__} has no setting {path[0]!r}; {remedy}")
    old = getattr(config, path[0])
    if len(path) > 1:
        return dataclasses.replace(config, **{path[0]: _replaced(old, path[1:], value, setting)})
    types = get_args(fields[path[0]])
    if old is None and any(map(dataclasses.is_dataclass, types)) and value is not None:
        raise InputError(f"{setting!r}: there is none here, and a setting cannot make one; leave it out")
    if value is not None or type(None) not in types:
        value = _as_type_of(old, value, setting)
    return dataclasses.replace(config, **{path[0]: value})


def _as_type_of(old: Any, value: Any, setting: str) -> Any:
    if isinstance(old, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"{setting!r} is no finite number; give one, such as {old!r}")
    if isinstance(old, tuple) and isinstance(value, list):
        if len(value) != len(old):
            raise InputError(f"{setting!r} has {len(value)} values but must have {len(old)}, such as {list(old)}")
        return tuple(_as_type_of(old[0], item, setting) for item in value)
    if isinstance(old, Path) and isinstance(value, str):
        return Path(value)
    if old is not None and type(value) is not type(old):
        raise InputError(f"{setting!r} is {type(value).__name__} but must be {type(old).__name__}, such as {old!r}")
    return value
