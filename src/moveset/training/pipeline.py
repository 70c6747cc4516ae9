"""``moveset train all``: from data to exported models, one stage after the other, each resumable and skipped when done.

Stages are the trainings of a recipe, in its order, and its exports. A stage is done when it has all its steps under the
same key: a hash of its settings, its data, and the keys of the stages it needs. So nothing is kept that other settings
or other data would have made differently, and whatever is stopped goes on where it was.
"""

import hashlib
import json
import signal
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from multiprocessing import connection, get_context
from pathlib import Path
from typing import Any, cast

from moveset.data.dataset import Dataset, open_for_training
from moveset.data.glove_files import read_glove
from moveset.data.splits import Split
from moveset.errors import InputError, MovesetError
from moveset.io.limits import system_errors, write_text
from moveset.io.process import end_with_parent, noted_signals
from moveset.text.encoder import get_text_encoder
from moveset.training import checkpoint
from moveset.training.engine import EngineConfig, run
from moveset.training.export import Export, export
from moveset.training.fabric import chosen_device
from moveset.training.tasks import TASKS, Recipe, Sources, load_exports, load_recipes, task_maker

LOG = "train.log"


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One training, or one export.

    Args:
        name: of its folder.
        needs: stages that must be done before.
        task, engine: settings of a training.
        model: what is exported instead.
        hours: what it takes on one core of a laptop, for estimates; 0 where nobody knows.
    """

    name: str
    needs: tuple[str, ...]
    task: Any = None
    engine: EngineConfig | None = None
    model: Export | None = None
    hours: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where everything lies.

    Args:
        data: a corpus file, or a HumanML3D or KIT-ML folder.
        out: gets a folder of every training by its name, ``models/``, ``stages/``, ``cache/`` and ``train.log``.
    """

    data: Path
    out: Path

    def sources(self, name: str) -> Sources:
        """What a training reads."""
        return TASKS[name].sources(self.data, self.out)


@dataclass(frozen=True)
class Report:
    """What ``train_all`` did: names of stages by what became of them, and the exported folders."""

    trained: tuple[str, ...]
    skipped: tuple[str, ...]
    models: tuple[Path, ...]
    stopped_by: str | None = None


def stages(recipe: str, device: str = "auto", share: float = 1.0) -> tuple[Stage, ...]:
    """Those of a recipe, in order, with this share of their steps.

    Raises:
        InputError: no such recipe; a share that is not above 0 and at most 1; a device that cannot be used here.
    """
    chosen_device(device)
    if not 0.0 < share <= 1.0:
        raise InputError(f"the share {share} of all steps is not above 0 and at most 1; give one between, such as 0.1")
    trainings = tuple(_training(name, chosen, device, share) for name, chosen in load_recipes(recipe).items())
    models = tuple(
        Stage(name=f"export {model.name}", needs=tuple(model.runs.values()), model=model)
        for model in load_exports(recipe)
    )
    return trainings + models


def choose(every: Sequence[Stage], only: Sequence[str]) -> list[Stage]:
    """Those of some stages that are asked for: by a model with all that it needs, a name, or the beginning of names.

    Raises:
        InputError: none is meant.
    """
    by_name, found = {stage.name: stage for stage in every}, set[str]()
    for name in only:
        if (model := f"export {name}") in by_name:
            asked = _with_needs(model, by_name)
        else:
            asked = {name} & set(by_name) or {stage for stage in by_name if stage.startswith(name)}
        if not asked:
            known = ", ".join(one.removeprefix("export ") for one in by_name)
            raise InputError(f"there is no stage or model {name!r}; there are {known}")
        found |= asked
    return [stage for stage in every if not only or stage.name in found]


def _with_needs(name: str, by_name: Mapping[str, Stage]) -> set[str]:
    return {name}.union(*(_with_needs(needed, by_name) for needed in by_name[name].needs))


def _training(name: str, chosen: Recipe, device: str, share: float) -> Stage:
    steps, task = max(1, round(chosen.engine.steps * share)), chosen.task
    if hasattr(task, "warmup"):
        task = replace(task, warmup=round(task.warmup * share))
    engine = replace(chosen.engine, steps=steps, device=device)
    return Stage(name=name, needs=TASKS[name].needs, task=task, engine=engine, hours=chosen.hours * share)


def train_all(
    recipe: str,
    data: Path,
    out: Path,
    *,
    only: Sequence[str] = (),
    share: float = 1.0,
    device: str = "auto",
    jobs: int = 1,
    say: Callable[[str], None] | None = None,
) -> Report:
    """Train and export everything of a recipe.

    Args:
        data: a corpus file, or a HumanML3D or KIT-ML folder.
        only: names of models, with all that they need; of stages; or of their beginnings ("rdm"). What stages need
            must be done already.
        share: of the steps of every training, and of its warm-up.
        device: "auto", "cpu" or "cuda".
        jobs: trainings side by side, in processes of their own.
        say: told a line at a time what happens; by default stderr.

    Raises:
        InputError: no such stage; a folder that other settings or data made; a stage left out that is needed.
        MovesetError: a training failed.
    """
    if jobs < 1:
        raise InputError(f"{jobs} trainings side by side are none; give at least 1")
    every = stages(recipe, device, share)
    chosen = choose(every, only)
    place = Place(data=data, out=out)
    with system_errors(f"train in {out}", "give another folder", InputError):
        for folder in ("stages", "models"):
            (out / folder).mkdir(parents=True, exist_ok=True)
    keys = _keys(every, open_for_training(data))
    _check(every, chosen, keys, place)
    open_stages = [stage for stage in chosen if not _done(stage, keys, place)]
    _check_texts(open_stages)
    skipped = tuple(stage.name for stage in chosen if stage not in open_stages)
    log = _Log(out / LOG, open_stages, say)
    log(f"{recipe}: {len(open_stages)} of {len(chosen)} stages to do ({', '.join(skipped) or 'none'} done)")
    trainings, exports = ([stage for stage in open_stages if (stage.model is not None) == is_model] for is_model in
                          (False, True))  # fmt: skip
    if jobs == 1:
        trained, stopped = _one_by_one(trainings, keys, place, log)
    else:
        with noted_signals() as received:
            trained, stopped = _side_by_side(trainings, keys, place, log, jobs, received)
    models = [] if stopped else [_export(stage, keys, place, log) for stage in exports]
    log("stopped" if stopped else "all done")
    return Report(tuple(trained), skipped, tuple(models), stopped)


def _one_by_one(
    trainings: Sequence[Stage], keys: Mapping[str, str], place: Place, log: "_Log"
) -> tuple[list[str], str | None]:
    trained: list[str] = []
    for stage in trainings:
        log.begin(stage)
        if stopped := train_stage(stage, keys[stage.name], place):
            return trained, stopped
        log.end(stage)
        trained.append(stage.name)
    return trained, None


def _side_by_side(
    trainings: Sequence[Stage], keys: Mapping[str, str], place: Place, log: "_Log", jobs: int, received: Sequence[int]
) -> tuple[list[str], str | None]:
    """As many at once as there are jobs, each in a process of its own as soon as what it needs is done.

    A signal stops all of them: none goes on when this process has ended, however that was.
    """
    waiting, running, trained = list(trainings), dict[Any, tuple[Stage, Any]](), list[str]()
    spawn = get_context("spawn")
    try:
        while waiting or running:
            if received:
                return trained, signal.Signals(received[0]).name
            undone = {stage.name for stage in waiting} | {stage.name for stage, _ in running.values()}
            for stage in [stage for stage in waiting if not undone.intersection(stage.needs)][: jobs - len(running)]:
                waiting.remove(stage)
                log.begin(stage)
                process = spawn.Process(target=_in_a_process, args=(stage, keys[stage.name], place))
                process.start()
                running[process.sentinel] = stage, process
            for sentinel in connection.wait(list(running), _LOOK):
                if received:  # a training that did not note it has not failed
                    break
                stage, process = running.pop(sentinel)
                process.join()
                if process.exitcode == _STOPPED:
                    return trained, "SIGTERM"
                if process.exitcode:
                    raise MovesetError(f"{stage.name} failed with exit code {process.exitcode}; its error is above")
                log.end(stage)
                trained.append(stage.name)
        return trained, None
    finally:
        for _, process in running.values():
            process.terminate()  # which saves a checkpoint
        for _, process in running.values():
            process.join()


_STOPPED = 75
_LOOK = 0.5  # seconds between two looks at signals


def _in_a_process(stage: Stage, key: str, place: Place) -> None:
    end_with_parent()
    try:
        stopped = train_stage(stage, key, place)
    except MovesetError as error:
        print(f"{stage.name}: {error}", file=sys.stderr)
        sys.exit(1)
    sys.exit(_STOPPED if stopped else 0)


def train_stage(stage: Stage, key: str, place: Place) -> str | None:
    """One training to its end, from where it is; the signal that stopped it, if one did."""
    assert stage.engine is not None
    folder = place.out / stage.name
    _note(place, stage, key)
    result = run(task_maker(stage.name, stage.task, place.sources(stage.name)), stage.engine, folder, True)
    if result.stopped_by is None:
        _note(place, stage, key, finished=True)
    return result.stopped_by


def _export(stage: Stage, keys: Mapping[str, str], place: Place, log: "_Log") -> Path:
    assert stage.model is not None
    log.begin(stage)
    folder = place.out / "models" / stage.model.name
    export(stage.model, open_for_training(place.data), place.out, place.out / "cache", folder)
    _note(place, stage, keys[stage.name], finished=True)
    log.end(stage)
    return folder


def _keys(every: Iterable[Stage], dataset: Dataset) -> dict[str, str]:
    keys: dict[str, str] = {}
    motions = dataset.fingerprint
    told = [motions, _sentences(dataset)]
    for stage in every:
        engine = {} if stage.engine is None else asdict(stage.engine)
        how = {name: engine[name] for name in ("steps", "grad_clip", "seed") if name in engine}
        settings = asdict(stage.task if stage.model is None else stage.model)
        data = told if stage.model is not None or _reads(stage) else motions
        parts = [stage.name, settings, how, data, {name: keys[name] for name in stage.needs}]
        keys[stage.name] = hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()
    return keys


def _sentences(dataset: Dataset) -> str:
    """A hash of what is said in training and validation; motions, which may be gigabytes, have one of their own."""
    sha, splits = hashlib.sha256(), ("train", "val")
    for clip in (dataset.clip(item) for split in splits for item in dataset.split(cast(Split, split))):
        sha.update(repr((clip.captions, [part.captions for part in clip.parts], clip.tagged)).encode())
    return sha.hexdigest()


def _reads(stage: Stage) -> bool:
    """Whether a training reads sentences, or draws clips by them: those that name a side more often."""
    return any(hasattr(stage.task, name) for name in ("text_encoder", "words", "composed_share"))


def _check_texts(todo: Iterable[Stage]) -> None:
    """Raises InputError for a text encoder or words that are not here, before days of trainings that need none."""
    for encoder in {stage.task.text_encoder for stage in todo if hasattr(stage.task, "text_encoder")}:
        get_text_encoder(encoder)
    for words in {stage.task.words for stage in todo if hasattr(stage.task, "words")}:
        kind, _, table = words.partition(":")
        if kind == "glove":
            read_glove(Path(table))


def _check(every: Iterable[Stage], chosen: Sequence[Stage], keys: Mapping[str, str], place: Place) -> None:
    """Raises InputError for what is there by other settings or data, and for what is needed and neither there nor
    chosen."""
    by_name = {stage.name: stage for stage in every}
    for stage in chosen:
        noted, folder = _noted(place, stage), place.out / stage.name
        if stage.model is None and not noted and checkpoint.steps(folder):
            raise InputError(
                f"{folder} holds a training that was begun by itself, maybe by other settings or on other data; move "
                "it away, or give another folder"
            )
        if noted.get("key", keys[stage.name]) != keys[stage.name] and stage.model is None:
            raise InputError(
                f"{folder} was trained by other settings, on other data or on top of something else; remove it, or "
                "give another folder"
            )
        for name in stage.needs:
            if by_name[name] not in chosen and not _done(by_name[name], keys, place):
                raise InputError(f"{stage.name} needs {name}, which is not done; train it too")


def _done(stage: Stage, keys: Mapping[str, str], place: Place) -> bool:
    noted = _noted(place, stage)
    if noted.get("key") != keys[stage.name] or not noted.get("finished"):
        return False
    if stage.model is not None:
        return (place.out / "models" / stage.model.name).is_dir()
    assert stage.engine is not None
    return checkpoint.steps(place.out / stage.name)[-1:] == [stage.engine.steps]


def _note(place: Place, stage: Stage, key: str, **more: Any) -> None:
    write_text(place.out / "stages" / f"{stage.name}.json", json.dumps({"key": key, **more}, indent=1))


def _noted(place: Place, stage: Stage) -> dict[str, Any]:
    path = place.out / "stages" / f"{stage.name}.json"
    try:
        noted: dict[str, Any] = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return {}
    return noted


class _Log:
    """Lines of ``train.log``, told as they come: what begins, what is done, and how much is left."""

    def __init__(self, path: Path, todo: Sequence[Stage], say: Callable[[str], None] | None) -> None:
        self._path, self._say = path, say or (lambda line: print(line, file=sys.stderr))
        self._todo, self._began = {stage.name: stage for stage in todo}, dict[str, float]()
        self._spent = self._expected = 0.0

    def __call__(self, text: str) -> None:
        with open(self._path, "a") as file:
            file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {text}\n")
        self._say(text)

    def begin(self, stage: Stage) -> None:
        self._began[stage.name] = time.monotonic()
        self(f"{stage.name}: begins{self._left()}")

    def end(self, stage: Stage) -> None:
        took = (time.monotonic() - self._began[stage.name]) / 3600
        self._todo.pop(stage.name)
        if stage.hours:
            self._spent, self._expected = self._spent + took, self._expected + stage.hours
        self(f"{stage.name}: done in {_duration(took)}")

    def _left(self) -> str:
        """By what stages took so far, in terms of what was expected, and how long those that run have been running."""
        pace, now = (self._spent + _TRUSTED) / (self._expected + _TRUSTED), time.monotonic()
        whole = {stage.name: stage.hours * pace for stage in self._todo.values()}
        run = {name: (now - began) / 3600 for name, began in self._began.items() if name in whole}
        hours = sum(max(0.0, took - run.get(name, 0.0)) for name, took in whole.items())
        return f", about {_duration(hours)} of one core left" if hours else ""


_TRUSTED = 0.5  # hours that pass before the pace says more than the recipe: a stage of a minute says little


def _duration(hours: float) -> str:
    """
    >>> _duration(0.01), _duration(0.5), _duration(2.26)
    ('36 s', '30 min', '2 h 16 min')
    """
    seconds = round(hours * 3600)
    if seconds < 90:
        return f"{seconds} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"
