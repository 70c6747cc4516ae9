"""What is to be evaluated, in plain values that another process can be handed; opening it; and sharing out the work."""

import multiprocessing
import sys
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import torch

from moveset.data.dataset import open_dataset
from moveset.data.splits import Split
from moveset.errors import InputError, MovesetError, fail
from moveset.evaluation.evaluator import DEFAULT_EVALUATOR, Evaluator
from moveset.evaluation.generators import Generated, Given, Reconstruction, Source
from moveset.evaluation.nearest import NearestClip
from moveset.evaluation.protocol import Protocol, Session, run_repeat
from moveset.evaluation.results import Results
from moveset.evaluation.rollout import run_rollout
from moveset.evaluation.samples import TestSet, open_test_set
from moveset.evaluation.suites import NEAREST, REAL, TRAINING
from moveset.io.process import cores, end_with_parent
from moveset.pipelines.device import pick_device, threads
from moveset.pipelines.generator import Sampler, open_generator
from moveset.pipelines.model_config import DEFAULT_MODEL, DEFAULT_STREAM, ClipConfig
from moveset.pipelines.model_folder import ModelFolder

if TYPE_CHECKING:
    from multiprocessing.context import SpawnProcess

#: Short names of what ships: model and network.
SHORT = {
    REAL: (REAL, None),
    TRAINING: (TRAINING, None),
    NEAREST: (NEAREST, None),
    "vae": (DEFAULT_MODEL, "vae"),
    "teacher": (DEFAULT_MODEL, "teacher"),
    "lcm": (DEFAULT_MODEL, "lcm"),
    "pcm": (DEFAULT_MODEL, "pcm"),
    "rdm": (DEFAULT_STREAM, "rdm"),
    "rdm-pcm": (DEFAULT_STREAM, "pcm-1"),
}
MAX_PROCESSES, MAX_CORES = 8, 256

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, kw_only=True)
class EvaluationConfig:
    """One model under one protocol.

    Args:
        model: a short name, a shipped model, a model folder, "real", "training" (as many items of that split, with
            sentences of their own), or "nearest" (``evaluation.nearest``).
        network: of the folder; "pcm" and "lcm" mean the student of ``steps``.
        steps: of the sampler; None for the network's own.
        settings: guidance, and start, lag, past_lag, eta, variance, eps_scale, time_shift, init_noise, shape and
            stages of a stream, where they are not the folder's own.
        motions: a folder of joints to judge instead of a model.
        prompts: its prompts, a JSONL file; None looks in the folder.
        data: a corpus, or a HumanML3D or KIT-ML folder.
        evaluator: a shipped one, or a folder.
        composed, mirrored: of a corpus, take compositions and mirror images too.
        items: at most so many items; None for all.
        foot_lock: judge motion with planted feet held, as users get it.
        name: of the result; None for that of model, network, settings and split.
    """

    model: str = REAL
    network: str | None = None
    steps: int | None = None
    settings: tuple[tuple[str, str | int | float], ...] = ()
    motions: Path | None = None
    prompts: Path | None = None
    motions_fps: float = 20.0
    data: Path = Path("data/corpus.safetensors")
    evaluator: str = DEFAULT_EVALUATOR
    protocol: Protocol = field(default_factory=Protocol)
    composed: bool = True
    mirrored: bool = True
    items: int | None = None
    foot_lock: bool = True
    batch: int = 64
    device: str = "auto"
    name: str | None = None


def open_session(config: EvaluationConfig) -> Session:
    """Everything that a configuration names, opened and checked.

    Raises:
        InputError: something does not exist, or does not fit.
        FormatError: something is damaged.
    """
    if not 1 <= config.batch <= 4096:
        raise InputError(f"batch {config.batch} is not in 1 to 4096; give 64 on a CPU, more on a GPU")
    generator, items = open_source(config), open_set(config)
    evaluator = Evaluator.open(config.evaluator, pick_device(config.device))
    if isinstance(generator, Given) and generator.items is not None:
        # FID depends on how many there are.
        given = generator.items.limited(len(items)) if generator.slug == TRAINING else generator.items
        generator.items = _as_read(given, evaluator.card.max_frames)
    judged: TestSet = (generator.items if isinstance(generator, Given) else None) or items
    _check_fit(generator, judged, items)
    return Session(config.protocol.fitted(judged, generator.random), items, generator, evaluator)


def _as_read(given: TestSet, most: int) -> TestSet:
    """Given motions, with how many of them an evaluator of so many frames reads in part."""
    long = sum(item.rows > most for item in given.items)
    note = {f"what lies behind frame {most} of a motion, which the evaluator does not read": long} if long else {}
    return replace(given, dropped={**given.dropped, **note})


def _check_fit(generator: Source, judged: TestSet, items: TestSet) -> None:
    """What no repeat could judge is refused before anything is made or written.

    Raises:
        InputError: motions or a model on another skeleton than the data.
    """
    if isinstance(generator, Generated) and generator.skeleton != items.codec.skeleton.name:
        raise InputError(
            f"{generator.slug} moves {generator.skeleton!r}, and {items.name} has {items.codec.skeleton.name!r}; "
            "evaluate a model that was trained on that skeleton"
        )
    if judged.codec.name != items.codec.name:
        raise InputError(
            f"{judged.name} has joints of {judged.codec.skeleton.name!r}, and {items.name} of "
            f"{items.codec.skeleton.name!r}; a folder of motions is judged by HumanML3D's evaluators alone"
        )


def open_set(config: EvaluationConfig) -> TestSet:
    """The real motion that models are judged by, no more items of it than were asked for.

    Raises:
        InputError: there is none of this split, or a number of items below 1.
        FormatError: damaged data.
    """
    if config.items is not None and config.items < 1:
        raise InputError(f"{config.items} items are fewer than 1; leave --items out for all of them")
    long = config.protocol.split == "rollout"
    of = cast(Split, "test" if long else config.protocol.split)
    items = open_test_set(config.data, of, long=long, composed=config.composed, mirrored=config.mirrored)
    return items if config.items is None else items.limited(config.items)


def open_source(config: EvaluationConfig) -> Source:
    """What is judged.

    Raises:
        InputError: no such model, network, steps or setting, or one that cannot be rolled out where that is asked for.
        FormatError: a damaged folder.
    """
    source = _source(config)
    short = isinstance(source, Reconstruction | NearestClip) or (isinstance(source, Given) and source.items is not None)
    if short and config.protocol.split == "rollout":
        raise InputError(f"{source.slug} cannot be rolled out; evaluate a model that makes motion, or real motion")
    return source


def _source(config: EvaluationConfig) -> Source:
    if config.motions is not None:
        from moveset.evaluation.motion_files import folder_motions

        given = folder_motions(config.motions, config.prompts, config.motions_fps)
        # A folder that happens to be called so must not be taken for the data's own motion.
        return Given(f"{given.name}-motions" if given.name in (REAL, TRAINING) else given.name, given)
    model, network = SHORT.get(config.model, (config.model, None))
    network = config.network or network
    if model == REAL:
        return Given(REAL)
    if model == TRAINING:
        learned = open_test_set(config.data, "train", composed=config.composed, mirrored=config.mirrored)
        return Given(TRAINING, learned)
    if model == NEAREST:
        return NearestClip(open_dataset(config.data))
    if network == "vae":
        return Reconstruction(ModelFolder.open(model, ClipConfig), device=config.device, batch=config.batch)
    sampler = Sampler(steps=config.steps, **dict(config.settings))  # type: ignore[arg-type]
    made = open_generator(model, network, sampler, foot_lock=config.foot_lock, batch=config.batch, device=config.device)
    return Generated(made)


def evaluate(
    config: EvaluationConfig,
    out: Path,
    *,
    share: tuple[int, int] = (0, 1),
    processes: int | None = None,
    again: bool = False,
    progress: Progress = lambda done, count, stage: None,
) -> tuple[dict[str, Any] | None, Path]:
    """Evaluate; the result (None if other processes of torchrun are still at work) and the path of its file.

    Args:
        share: rank and number of the processes of torchrun, each of which makes its share of the repeats.
        processes: that share the repeats on this machine otherwise; None for as many as there are cores.
        again: make every repeat anew, although it is there; not with other processes of torchrun.
        progress: told of progress: repeats done, repeats in all, and what is being done.

    Raises:
        InputError: something does not exist, does not fit, or cannot be judged.
        FormatError: something is damaged.
        MovesetError: a process died, or read other code, weights or data than this one.
    """
    if processes is not None and not 1 <= processes <= MAX_CORES:
        raise InputError(f"{processes} processes are not in 1 to {MAX_CORES}; as many as there are cores is best")
    if again and share[1] > 1:
        # Whoever is first done would take what another has still to delete for new.
        raise InputError("several processes cannot make everything anew together; give a fresh --out instead")
    session, on_cpu = open_session(config), pick_device(config.device).type == "cpu"
    results, (rank, world) = Results(session, out, config.name), share
    if again:
        results.forget()
    # Small networks gain little by more threads, and so sums come out the same however the work is shared.
    with threads(1) if on_cpu else nullcontext():
        if world == 1 and (processes or on_cpu):
            world = max(1, min(processes or min(cores(), MAX_PROCESSES), len(results.missing())))
        helpers = [_start(config, out, k, world) for k in range(1, world)] if share[1] == 1 else []
        try:

            def attend(done: int, count: int, stage: str) -> None:
                # Told often, so that nobody waits for a whole share of repeats to hear that another has failed.
                for number, helper in enumerate(helpers, start=1):
                    if helper.exitcode:
                        raise MovesetError(
                            f"process {number} of {world} ended with code {helper.exitcode}; run again to resume"
                        )
                progress(done, count, stage)

            work(session, results, rank, world, attend)
            for helper in helpers:
                while helper.is_alive():
                    helper.join(0.5)
                    attend(len(results.done), results.repeats, "others")
            if helpers:
                attend(len(results.done), results.repeats, "others")
        finally:
            for helper in helpers:
                helper.terminate()
    result = results.finish()
    if result is None and share[1] == 1:
        missing = len(results.missing())
        raise MovesetError(
            f"{missing} of {results.repeats} repeats of {results.name} are not there, although all processes are done: "
            "code, weights or data changed meanwhile; run again"
        )
    return result, results.path


def work(session: Session, results: Results, rank: int, world: int, progress: Progress) -> None:
    """The repeats of one process of several that are not there yet; raises what ``make`` does."""
    for number in results.missing(rank, world):
        results.add(make(session, results, number, progress))
        progress(len(results.done), results.repeats, str(number))


def make(session: Session, results: Results, number: int, progress: Progress) -> dict[str, Any]:
    """One repeat.

    Raises:
        MovesetError: something that cannot be judged, or that nobody has thought of, in which repeat.
    """

    def tell(stage: str, done: int, count: int) -> None:
        progress(len(results.done), results.repeats, f"{number}: {stage} {done}/{count}")

    try:
        return (run_rollout if session.protocol.split == "rollout" else run_repeat)(session, number, tell)
    except MovesetError:
        raise
    except Exception as error:
        said = f"{type(error).__name__}: {error} (MOVESET_DEBUG=1 shows where)"
        raise MovesetError(f"repeat {number} of {results.name} failed: {said}") from error


def _start(config: EvaluationConfig, out: Path, rank: int, world: int) -> "SpawnProcess":
    process = multiprocessing.get_context("spawn").Process(target=_help, args=(config, out, rank, world), daemon=True)
    process.start()
    return process


def _help(config: EvaluationConfig, out: Path, rank: int, world: int) -> None:
    """What a process that was started does; what goes wrong is said in one line."""
    end_with_parent()
    torch.set_num_threads(1)
    try:
        session = open_session(config)
        work(session, Results(session, out, config.name), rank, world, lambda done, count, stage: None)
    except MovesetError as error:
        sys.exit(fail(str(error), error.exit_code))
    except KeyboardInterrupt:
        sys.exit(130)
