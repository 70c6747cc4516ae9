"""Every training and every model folder of the recipe "tiny", made once a process from motions by formulas."""

import os
import pickle
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from moveset.data.segments import SegmentSet
from moveset.io.process import locked, noted_signals
from moveset.training import pipeline
from moveset.training.engine import EngineConfig, run
from moveset.training.pipeline import Place, Report, train_all
from moveset.training.tasks import load_recipe, task_maker, with_settings
from tests.synthetic import synthetic_corpus


@contextmanager
def briefly_validated() -> Iterator[None]:
    """Segments are validated 16 at a time instead of 128, which is most of what tiny trainings cost."""
    batch = SegmentSet.batch
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            SegmentSet, "batch", lambda found, size, *drawn: batch(found, 16 if size == 128 else size, *drawn)
        )
        yield


def forked() -> None:
    """Trainings side by side are in processes that are forked, and told everything as those that start anew are."""
    fork = get_context("fork")

    def process(target: Callable[..., None], args: tuple) -> Any:
        return fork.Process(target=target, args=pickle.loads(pickle.dumps(args)))

    pipeline.get_context = lambda _: SimpleNamespace(Process=process)


def side_by_side(corpus: str, out: str, only: list[str]) -> None:
    """Two trainings at once."""
    forked()
    report = train_all("tiny", Path(corpus), Path(out), only=only, jobs=2, say=lambda line: None)
    assert sorted(report.trained) == sorted(only)


def side_by_side_until_a_signal(corpus: str, out: str, only: list[str]) -> None:
    """The same, of trainings that wait for one, which this process alone gets as soon as all have begun."""
    begun, ended = ([Path(out, f"{name}.{what}") for name in only] for what in ("begun", "ended"))

    def until_a_signal(stage: pipeline.Stage, key: str, place: Place) -> str:
        with noted_signals() as received:
            Path(out, f"{stage.name}.begun").touch()
            while not received:
                time.sleep(0.01)
        Path(out, f"{stage.name}.ended").touch()
        return "SIGTERM"

    def tell() -> None:
        while not all(path.exists() for path in begun):
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGTERM)

    pipeline.train_stage = until_a_signal
    forked()
    threading.Thread(target=tell, daemon=True).start()
    report = train_all("tiny", Path(corpus), Path(out), only=only, jobs=2, say=lambda line: None)
    assert (report.stopped_by, report.trained) == ("SIGTERM", ())
    assert all(path.exists() for path in ended)


def side_by_side_without_end(corpus: str, out: str, only: list[str]) -> None:
    """Two trainings that never end, each in its folder."""

    def never_ending(stage: pipeline.Stage, key: str, place: Place) -> None:
        with locked(Path(out, stage.name)):
            Path(out, f"{stage.name}.begun").touch()
            time.sleep(600)

    pipeline.train_stage = never_ending
    forked()
    train_all("tiny", Path(corpus), Path(out), only=only, jobs=2, say=lambda line: None)


@dataclass(frozen=True)
class TinyRun:
    """Read only: a corpus, a folder of every training, ``models/``, ``stages/``, ``cache/`` and ``train.log``.

    Args:
        folder: of all of it.
        report: what was made.
        lines: what was said meanwhile.
    """

    folder: Path
    report: Report
    lines: tuple[str, ...]

    @classmethod
    def make(cls, folder: Path) -> "TinyRun":
        corpus, lines = synthetic_corpus(folder / "corpus.safetensors", clips=24, seed=0), list[str]()
        with briefly_validated():
            return cls(folder, train_all("tiny", corpus, folder, say=lines.append), tuple(lines))

    @property
    def corpus(self) -> Path:
        return self.folder / "corpus.safetensors"

    @property
    def runs(self) -> Path:
        return self.folder

    def model(self, name: str) -> Path:
        """The folder of "motionpcm", "rdm", "t2m" or a baseline."""
        return self.folder / "models" / f"{name}-tiny"

    def maker(self, what: str, *settings: str, corpus: Path | None = None, **sources: Path) -> Callable[..., Any]:
        """What ``engine.run`` needs to train something on top of these runs, or of other ``sources``."""
        found = Place(data=self.corpus, out=self.folder).sources(what)
        if corpus:
            found = replace(found, corpus=corpus, cache=corpus.parent / "cache")
        return task_maker(what, with_settings(load_recipe("tiny", what).task, settings), replace(found, **sources))

    def train(
        self, what: str, into: Path, *settings: str, corpus: Path | None = None, sources: dict[str, Path] | None = None,
        resume: bool = False, init: Any = (), **engine: Any,
    ) -> Any:  # fmt: skip
        """A few steps of a training, by default three without validation: the task that it trained, and the result."""
        maker, made = self.maker(what, *settings, corpus=corpus, **(sources or {})), []

        def make(loop):
            made.append(maker(loop))
            return made[0]

        config: EngineConfig = load_recipe("tiny", what).engine
        given = {"steps": 3, "save_every": 100, "validate_every": 0, **engine}
        result = run(make, replace(config, **given), into, resume, init)
        return made[0], result
