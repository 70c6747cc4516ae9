"""``moveset evaluate``: how good is a model? The measures of the papers, with intervals."""

import json as jsonlib
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from moveset.cli.tables import How, print_results, results_folder, run_one, run_suite
from moveset.errors import InputError

if TYPE_CHECKING:
    from moveset.evaluation.run import EvaluationConfig


def evaluate(
    models: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="MODEL …")] = (),
    *,
    network: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    steps: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    guidance: Annotated[float | None, tyro.conf.arg(metavar="W")] = None,
    set: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="NAME=VALUE")] = (),
    split: Literal["test", "val", "rollout"] = "test",
    repeats: Annotated[int, tyro.conf.arg(metavar="N")] = 20,
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    multimodality: Annotated[int, tyro.conf.arg(metavar="N")] = 100,
    data: Annotated[Path, tyro.conf.arg(metavar="PATH")] = Path("data/corpus.safetensors"),
    evaluator: Annotated[str, tyro.conf.arg(metavar="NAME")] = "t2m-small",
    motions: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    prompts: Annotated[Path | None, tyro.conf.arg(metavar="FILE.jsonl")] = None,
    motions_fps: Annotated[float | None, tyro.conf.arg(metavar="N")] = None,
    items: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    composed: bool = True,
    mirrored: bool = True,
    foot_lock: bool = True,
    suite: Literal["motionpcm", "rdm"] | None = None,
    row: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="KEY")] = (),
    sanity: tyro.conf.FlagCreatePairsOff[bool] = False,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("results"),
    resume: bool = True,
    processes: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    batch: Annotated[int, tyro.conf.arg(metavar="N")] = 64,
    device: Annotated[str, tyro.conf.arg(metavar="NAME")] = "auto",
    json: tyro.conf.FlagCreatePairsOff[bool] = False,
) -> int:
    """Measure models against real motion: R-precision, FID, MM-Dist, diversity, multimodality, physical plausibility.

    Args:
        models: pcm, lcm, teacher, vae (what motionpcm-small holds), rdm, rdm-pcm (rdm-small), real, training, nearest
            (clips of the training split), or the name or folder of a model with --network.
        network: Which network of the model; by default the model's own choice.
        steps: Sampling steps; by default the network's own.
        guidance: How strongly the text is followed (w); by default the model's own choice.
        set: Streams: a setting of how they are sampled, such as eta=1, start=7, lag=1, past_lag=1 or stages=false, as
            for `moveset stream`, or shape=triangle, variance=beta or init_noise=shared; may be given several times.
        split: test, once, at the end; val for every choice; rollout: half a minute of changing prompts, in windows.
        repeats: How often captions, crops, noise and groups are drawn again; intervals are over these.
        seed: The same seed gives the same table.
        multimodality: Texts of which 30 motions are made in each repeat; 0 leaves it out, which is much faster.
        data: What `moveset data build` wrote, or a HumanML3D or KIT-ML folder.
        evaluator: A shipped evaluator, or the folder of one.
        motions: Judge a folder of .npy joint positions (frames, 22, 3) instead of a model.
        prompts: Their prompts as a JSONL file; by default prompts.jsonl or NAME.txt files in the folder.
        motions_fps: Their frame rate, if it is not 20.
        items: At most so many items, drawn at random, for a quick look.
        composed: Judge compositions of takes too, as well as takes.
        mirrored: Judge mirror images too.
        foot_lock: Judge motion as users get it, with planted feet held and bodies above the floor.
        suite: Evaluate all rows of a paper's tables, and write the tables; models are folders of more rows.
        row: Only this row of the suite; may be given several times.
        sanity: Check the evaluator itself: real, jittered, reversed and frozen motion, shuffled and wrong sentences.
        out: Where results go.
        resume: Keep repeats that are there already; --no-resume makes all of them anew.
        processes: Share the repeats among so many processes; by default as many as there are cores.
        batch: Motions evaluated at once; worth raising on a GPU.
        device: auto, cpu, cuda or mps.
        json: Print one JSON object on stdout and nothing else.
    """
    from moveset.evaluation.protocol import Protocol
    from moveset.evaluation.run import EvaluationConfig
    from moveset.pipelines.generator import Sampler
    from moveset.training.tasks import with_settings

    sampler = with_settings(Sampler(steps=steps, guidance=guidance), set)
    protocol = Protocol(split=split, repeats=repeats, seed=seed, multimodality=multimodality)
    common = EvaluationConfig(
        network=network, steps=sampler.steps, settings=tuple(sampler.given().items()), motions=motions, prompts=prompts,
        motions_fps=20.0 if motions_fps is None else motions_fps, data=data, evaluator=evaluator, protocol=protocol,
        composed=composed, mirrored=mirrored, items=items, foot_lock=foot_lock, batch=batch, device=device,
    )  # fmt: skip
    if motions is None and (prompts is not None or motions_fps is not None):
        raise InputError("--prompts and --motions-fps say what a folder of motions is; add --motions DIR")
    if row and suite is None:
        raise InputError(f"--row {row[0]} is a row of a suite; add --suite motionpcm or --suite rdm")
    if sanity and suite is not None:
        raise InputError("--sanity checks the evaluator itself; leave --suite out")
    how = How(out, resume, processes)
    if sanity:
        return _sanity(models, common, out, json)
    if suite is not None:
        return run_suite(suite, models, common, row, how, json)
    configs = _configs(models, common)
    done = []
    for config in configs:
        result, path = run_one(config, how)
        if result is None:
            print(f"moveset: other processes are still at work; the last one writes {path}", file=sys.stderr)
        else:
            done.append((result, path))
    print_results(done, json)
    return 0


def _sanity(models: Sequence[str], config: "EvaluationConfig", out: Path, json: bool) -> int:
    """What an evaluator says of motion that is known to be right or wrong."""
    import torch

    from moveset.evaluation.evaluator import Evaluator
    from moveset.evaluation.run import open_set
    from moveset.evaluation.sanity import sanity
    from moveset.io.limits import write_text
    from moveset.pipelines.device import pick_device

    if models or config.motions is not None or config.network or config.steps is not None or config.settings:
        raise InputError("--sanity checks the evaluator itself; leave models, what is set of them and --motions out")
    if config.protocol.split == "rollout":
        raise InputError("--sanity checks the evaluator on single motions; take --split test or val")
    judge, items = Evaluator.open(config.evaluator, pick_device(config.device)), open_set(config).items
    results_folder(out)
    report = sanity(judge, items, torch.Generator().manual_seed(config.protocol.seed))
    few = "" if config.items is None else f"-{config.items}-items"
    path = out / f"sanity-{judge.card.name}-{config.protocol.split}{few}.json"
    write_text(path, jsonlib.dumps(report.to_json(), indent=1) + "\n")
    print(jsonlib.dumps({**report.to_json(), "file": str(path)}) if json else report.to_markdown())
    return 0


def _configs(models: Sequence[str], common: "EvaluationConfig") -> "list[EvaluationConfig]":
    """One a model, each checked before any is evaluated."""
    from dataclasses import replace

    from moveset.evaluation.run import open_source

    if common.motions is not None:
        if models:
            raise InputError("--motions takes the place of a model; leave the model out")
        if common.network or common.steps is not None or common.settings:
            raise InputError("--motions are there already; leave --network, --steps and settings of models out")
        return [common]
    if not models:
        raise InputError("no model was given; give pcm, lcm, teacher, vae, rdm, rdm-pcm, real or a model folder")
    configs = [replace(common, model=model) for model in models]
    opened = [open_source(config) for config in configs]
    # Beside a model that samples, real motion and an autoencoder may stand with what is meant for the model.
    if (common.steps is not None or common.settings) and not any(generator.random for generator in opened):
        raise InputError(f"nothing is sampled for {' and '.join(models)}; leave --steps and settings out")
    if common.network and all(generator.network is None for generator in opened):
        raise InputError(f"real motion has no network {common.network!r}; add a model, or leave --network out")
    return configs
