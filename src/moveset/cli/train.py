"""``moveset train``: train or distil a model by a recipe."""

import os
import signal
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from moveset.errors import InputError
from moveset.training.tasks import TASKS, load_exports, load_recipe, task_maker, with_settings

if TYPE_CHECKING:
    from moveset.training.engine import TrainResult

What = Literal[
    "all", "movement", "evaluator", "length", "sides", "vae", "decoder", "teacher", "mld-vae", "mld", "lcm-1", "pcm-1",
    "pcm-2", "pcm-4", "pcm-1-k20", "pcm-1-no-ema", "pcm-1-no-discriminator", "rdm-1", "rdm-4", "rdm-7", "rdm-14",
    "md-4", "md-7", "md-7-alone", "rdm-student", "rdm-student-2", "light-rdm-1", "motiondiffuse", "dip", "export",
]  # fmt: skip


def train(
    what: tyro.conf.Positional[What],
    *,
    recipe: Literal["small", "paper", "tiny"] = "small",
    resume: tyro.conf.FlagCreatePairsOff[bool] = False,
    init: tyro.conf.UseAppendAction[tuple[Path, ...]] = (),
    folder: Path | None = None,
    corpus: Path = Path("data/corpus.safetensors"),
    raw: Path | None = None,
    out: Path | None = None,
    only: tyro.conf.UseAppendAction[tuple[str, ...]] = (),
    share: float = 1.0,
    jobs: int = 1,
    tables: tyro.conf.FlagCreatePairsOff[bool] = False,
    vae: Path | None = None,
    teacher: Path | None = None,
    steps: int | None = None,
    seed: int | None = None,
    device: Literal["auto", "cpu", "cuda", "mps"] | None = None,
    devices: int | None = None,
    precision: Literal["auto", "32-true", "bf16-mixed"] | None = None,
    threads: int | None = None,
    workers: int | None = None,
    save_every: int | None = None,
    validate_every: int | None = None,
    log_every: int | None = None,
    keep_last: int | None = None,
    keep_every: int | None = None,
    tensorboard: bool | None = None,
    set: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="NAME=VALUE")] = (),
) -> int:
    """Train a model; everything not given is as the recipe says.

    SIGTERM and Ctrl-C save a checkpoint and stop, with the exit code 143 or 130; --resume continues exactly where it
    was. Several processes: `torchrun --nproc-per-node 2 -m moveset.cli train …`, or --devices 2.

    Args:
        what: all: every training of the recipe and all of its models, one after the other; what is done is skipped.
            vae: the autoencoder. decoder: more of its decoder, with its latents kept. teacher: the latent diffusion
            model. mld-vae, mld: both with one latent token. lcm-1, pcm-N: students of N steps. rdm-N: the recurrent
            model, of endless streams, with the longest clip in N segments; rdm-7 ships. light-rdm-1: rdm-1 with
            Light-T2M's network. rdm-student: a recurrent model with few steps. md-N, motiondiffuse, dip: what it is
            compared with. pcm-1-k20, pcm-1-no-…, md-7-alone, rdm-student-2: another with one setting changed, for the
            tables.
            movement, evaluator: the judge of them all, in two stages. length: how long a sentence lasts. sides: which
            of left and right it names. export: no training: model folders of all of the recipe's models whose networks
            are there.
        recipe: small: what ships. paper: the published sizes. tiny: seconds, to try the machinery.
        resume: Continue from the latest checkpoint in the folder, or start if there is none.
        init: Checkpoint or run folder whose weights to start with. May be given several times: what the first lacks,
            such as a discriminator, comes from the next.
        folder: Where checkpoints and logs go; by default runs/RECIPE/WHAT. Of export: where model folders go; by
            default runs/RECIPE/models.
        corpus: What `moveset data build` wrote, or a HumanML3D or KIT-ML folder.
        raw: Of all: the archives that the corpus is built from first, if it is not there, as by `moveset data build`.
        out: Of all: where runs, models and the log go; by default runs/RECIPE.
        only: Of all: a model by its whole name, such as rdm-small, with all that it needs; a stage; or the beginning
            of the names of several stages, such as rdm; may be given several times.
        share: Of all: this share of the steps of every training, to see soon how far it gets.
        jobs: Of all: trainings side by side.
        tables: Of all: evaluate the models, too, and write the papers' tables to OUT/results.
        vae: Checkpoint or run folder of the autoencoder; by default runs/RECIPE/vae, or runs/RECIPE/mld-vae for mld.
        teacher: Checkpoint or run folder of the teacher; by default runs/RECIPE/teacher, or runs/RECIPE/rdm-7
            for rdm-student, runs/RECIPE/movement for evaluator.
        steps: Steps in all.
        seed: Of everything random.
        device: Where to compute.
        devices: Processes on this machine, each with its own batch.
        precision: bf16-mixed: bfloat16 where it is safe. auto: that on a device or processor with instructions for it.
        threads: CPU threads, 0 for torch's choice.
        workers: Processes that make batches ahead, for networks of segments on a GPU.
        save_every: Steps between checkpoints.
        validate_every: Steps between validations, 0 for none.
        log_every: Steps between lines in metrics.jsonl.
        keep_last: Checkpoints to keep.
        keep_every: Keep those at multiples of this too, 0 for none.
        tensorboard: Write TensorBoard events besides metrics.jsonl.
        set: Change one number of the recipe, such as lr=1e-3 or model.layers=4; may be given several times.
    """
    from moveset.training.engine import run

    given: dict[str, Any] = {
        "steps": steps, "seed": seed, "devices": devices, "precision": precision, "threads": threads,
        "workers": workers, "save_every": save_every, "validate_every": validate_every, "log_every": log_every,
        "keep_last": keep_last, "keep_every": keep_every, "tensorboard": tensorboard,
    }  # fmt: skip
    runs = Path("runs") / recipe
    if what in ("all", "export"):
        of_one = given | {"init": init or None, "vae": vae, "teacher": teacher, "set": set or None}
        _refuse(of_one | {"folder": folder if what == "all" else None}, f"is of one training, not of {what!r}")
    if what != "all":
        of_all = {"share": share if share != 1.0 else None, "jobs": jobs if jobs != 1 else None}
        _refuse(
            of_all | {"raw": raw, "out": out, "only": only or None, "tables": tables or None},
            f"is of 'all', not of {what!r}",
        )
    if what == "all":
        return _all(recipe, out or runs, corpus, raw, only, share, device or "auto", jobs, tables)
    if what == "export":
        _refuse({"device": device, "resume": resume or None}, "is of trainings, not of 'export'")
        return _export(recipe, runs, corpus, folder or runs / "models")
    unneeded = {"vae": None if TASKS[what].vae else vae, "teacher": None if TASKS[what].teacher else teacher}
    _refuse(unneeded, f"is of trainings that stand on one, not of {what!r}")
    folder, given["device"] = folder or runs / what, device
    chosen = load_recipe(recipe, what)
    engine = replace(chosen.engine, **{name: value for name, value in given.items() if value is not None})
    config = with_settings(chosen.task, set)
    sources = TASKS[what].sources(corpus, runs)
    sources = replace(sources, vae=vae or sources.vae, teacher=teacher or sources.teacher)

    result = run(task_maker(what, config, sources, set), engine, folder, resume, init)
    # torchrun says RANK; --devices tells the processes that it starts LOCAL_RANK only.
    if not int(os.environ.get("RANK") or os.environ.get("LOCAL_RANK") or 0):
        print(_summary(what, result, engine.steps), file=sys.stderr)
    return _code(result.stopped_by)


def _code(stopped_by: str | None) -> int:
    """What a shell makes of the signal that stopped a training: what stands on it must not begin."""
    return 128 + signal.Signals[stopped_by] if stopped_by else 0


def _refuse(given: Mapping[str, Any], why: str) -> None:
    """Raises InputError for what would be ignored: all that is not None."""
    if foreign := [name.replace("_", "-") for name, value in given.items() if value is not None]:
        raise InputError(f"--{foreign[0]} {why}; leave it out")


def _all(
    recipe: str, out: Path, corpus: Path, raw: Path | None, only: Sequence[str], share: float, device: str, jobs: int,
    tables: bool,
) -> int:  # fmt: skip
    """Data, trainings, models and tables."""
    from moveset.data.build import build_corpus
    from moveset.io.process import cores
    from moveset.training.pipeline import choose, stages, train_all

    chosen = choose(stages(recipe, device, share), only)  # what is wrong with these is said before minutes of data
    judge = _judge(recipe)
    if tables and f"export {judge}" not in {stage.name for stage in chosen} and not (out / "models" / judge).is_dir():
        raise InputError(f"--tables needs the evaluator; give --only {judge}, too")
    if raw is not None and corpus.is_dir():
        raise InputError(f"--raw builds a corpus file, and {corpus} is a folder, used as it is; leave --raw out")
    if raw is not None and not corpus.is_file():
        build_corpus(raw, corpus, workers=cores())
    report = train_all(recipe, corpus, out, only=only, share=share, device=device, jobs=jobs)
    if report.stopped_by:
        return _code(report.stopped_by)
    for model in report.models:
        print(model)
    if tables:
        _tables(recipe, corpus, out, jobs)
    return 0


def _judge(recipe: str) -> str:
    """The name of the recipe's evaluator."""
    return next(model.name for model in load_exports(recipe) if "evaluator" in model.runs)


def _tables(recipe: str, corpus: Path, out: Path, jobs: int) -> None:
    """Each suite of those models of the recipe that are there, where there are any."""
    from moveset.cli.tables import How, run_suite
    from moveset.evaluation.run import EvaluationConfig
    from moveset.training.export import BaselineExport, ClipExport, StreamExport

    models = out / "models"
    common = EvaluationConfig(data=corpus, evaluator=str(models / _judge(recipe)))
    for suite, kinds in (("motionpcm", ClipExport), ("rdm", StreamExport | BaselineExport)):
        made = [models / model.name for model in load_exports(recipe) if isinstance(model, kinds)]
        if there := [str(folder) for folder in made if folder.is_dir()]:
            how = How(out=out / "results", resume=True, processes=jobs)
            run_suite(suite, there, common, (), how, False, alone=True)


def _export(recipe: str, runs: Path, corpus: Path, folder: Path) -> int:
    """Every model of the recipe whose networks are there; the others are named."""
    from moveset.data.dataset import open_for_training
    from moveset.training import checkpoint
    from moveset.training.export import export

    dataset, made = open_for_training(corpus), 0
    for model in load_exports(recipe):
        if lacking := [run for run in model.runs.values() if not checkpoint.steps(runs / run)]:
            print(f"{model.name}: not made, for nothing is trained in {runs / lacking[0]}", file=sys.stderr)
            continue
        print(export(model, dataset, runs, runs / "cache", folder / model.name))
        made += 1
    if not made:
        raise InputError(f"{runs} has all networks of none of the recipe's models; train them first")
    return 0


def _summary(what: str, result: "TrainResult", steps: int) -> str:
    numbers = ", ".join(f"{name} {value:.4g}" for name, value in result.validation.items())
    ending = f"stopped by {result.stopped_by} at step {result.step} of {steps}" if result.stopped_by else "done"
    return f"{what}: {ending}; {result.checkpoint or 'nothing to save yet'}{f' ({numbers})' if numbers else ''}"
