"""``moveset data``: build, inspect and export training data; import the published evaluators."""

import json as jsonlib
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from moveset.errors import InputError

if TYPE_CHECKING:
    from moveset.data.corpus import Corpus


def build(
    *,
    raw: Path = Path("data/raw"),
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("data/corpus.safetensors"),
    workers: int | None = None,
    sources: str = "cmu,cmu-more,more-mocap",
    compositions: int = 3000,
    keep_work: tyro.conf.FlagCreatePairsOff[bool] = False,
    json: tyro.conf.FlagCreatePairsOff[bool] = False,
) -> int:
    """Build a corpus from motion capture; an interrupted build continues where it stopped.

    Args:
        raw: Folder with the archives of motion capture, or what they unpack to, and humanml3d-cmu.jsonl.
        output: The corpus to write; a report is written beside it.
        workers: Processes (default: one a core).
        sources: Of cmu, cmu-more, more-mocap and bandai-namco, separated by commas. Without the last, which is for
            non-commercial use only, the result is free for any use.
        compositions: Training clips to add: one action after another, bent ways, other paces.
        keep_work: Keep the imported takes, for a faster next build.
        json: Print one JSON object on stdout and nothing else.
    """
    from moveset.data.build import build_corpus
    from moveset.data.raw import SOURCES
    from moveset.data.summary import rejections

    wanted = tuple(name.strip() for name in sources.split(","))
    if unknown := [name for name in wanted if name not in SOURCES]:
        raise InputError(f"there is no source {unknown[0]!r}; use some of {', '.join(SOURCES)}")
    cores = os.cpu_count() or 1
    workers = cores if workers is None else workers
    if not 1 <= workers <= 4 * cores:
        raise InputError(f"{workers} workers on {cores} cores; use 1 to {4 * cores}")
    if not 0 <= compositions <= 100_000:
        raise InputError(f"{compositions} compositions are not in [0, 100000]; 3000 is usual")
    if output.suffix != ".safetensors":
        raise InputError(f"a corpus is a .safetensors file, not {output.name!r}; choose such a name")
    begin = time.monotonic()
    report = build_corpus(
        raw,
        output,
        workers=workers,
        sources=wanted,
        compositions=compositions,
        keep_work=keep_work,
    )
    took = time.monotonic() - begin
    if json:
        print(
            jsonlib.dumps(
                {
                    "corpus": report.corpus,
                    "takes": report.takes,
                    "clips": report.clips,
                    "compositions": report.compositions,
                    "hours": round(report.seconds / 3600, 3),
                    "rejected": report.rejected,
                    "seconds": round(took, 1),
                }
            )
        )
        return 0
    print(
        f"{report.corpus}: {report.clips} clips ({report.seconds / 3600:.2f} h) of {report.takes} takes and "
        f"{report.compositions} compositions, in {took:.0f} s"
    )
    if report.rejected:
        print(f"left out: {len(report.rejected)} takes (each with its reason in {report.corpus}.report.json)")
        for reason, count in rejections(output).items():
            print(f"{count:5d}  {reason}")
    return 0


def info(
    corpus: tyro.conf.Positional[Path] = Path("data/corpus.safetensors"),
    *,
    captions: int = 2,
    sheets: Path | None = None,
    json: tyro.conf.FlagCreatePairsOff[bool] = False,
) -> int:
    """Show what a corpus, or a HumanML3D or KIT-ML folder, holds.

    Args:
        corpus: A file made by `moveset data build`, or a folder with new_joint_vecs and texts.
        captions: Sentences to show per source.
        sheets: Draw filmstrips of ten clips of every source into this folder, each under its sentence.
        json: Print one JSON object on stdout and nothing else.
    """
    if captions < 0:
        raise InputError(f"{captions} sentences of each source cannot be shown; give 0 or more")
    if corpus.is_dir():
        if sheets is not None:
            raise InputError("sheets are drawn of a corpus file only; leave --sheets away for a folder")
        return _folder_info(corpus, captions, json)
    from moveset.data.corpus import Corpus
    from moveset.data.summary import rejections, summarize, write_sheets

    opened = Corpus.open(corpus)
    summary = {**summarize(opened), "rejected": rejections(corpus)}
    if json:
        print(jsonlib.dumps({"corpus": str(corpus), **summary}))
    else:
        _print_summary(corpus, summary, opened, captions)
    if sheets is not None:
        print(f"drew {len(write_sheets(opened, sheets))} sheets into {sheets}", file=sys.stderr)
    return 0


def export(
    corpus: tyro.conf.Positional[Path],
    output: tyro.conf.Positional[Path],
    *,
    format: Literal["humanml3d", "kit-ml"] = "humanml3d",
    json: tyro.conf.FlagCreatePairsOff[bool] = False,
) -> int:
    """Write a corpus as a HumanML3D or KIT-ML folder, for `moveset train`, `moveset evaluate` and whatever reads those.

    Args:
        corpus: A file made by `moveset data build`.
        output: The folder to make.
        format: humanml3d: 263 features at 20 fps. kit-ml: 251 at 12.5 fps.
        json: Print one JSON object on stdout and nothing else.
    """
    from moveset.data.corpus import Corpus
    from moveset.data.humanml3d import HUMANML3D, KIT, HumanML3D
    from moveset.data.humanml3d_writer import write_humanml3d

    if corpus.is_dir():
        raise InputError(
            f"{corpus} is a folder; give the file that 'moveset data build' wrote, such as corpus.safetensors"
        )
    layout = KIT if format == "kit-ml" else HUMANML3D
    write_humanml3d(Corpus.open(corpus), output, layout, progress=not json)
    made = HumanML3D.open(output)
    splits = {name: len(names) for name, names in made.splits.items()}
    if json:
        print(jsonlib.dumps({"folder": str(output), "layout": layout.name, "clips": len(made), "splits": splits}))
    else:
        print(f"{output}: {len(made)} motions; " + ", ".join(f"{name} {count}" for name, count in splits.items()))
    return 0


def import_evaluator(
    checkpoints: tyro.conf.Positional[Path],
    glove: tyro.conf.Positional[Path],
    output: tyro.conf.Positional[Path],
    *,
    dataset: Literal["t2m", "kit"] | None = None,
    statistics: Path | None = None,
    bias: float | None = None,
    json: tyro.conf.FlagCreatePairsOff[bool] = False,
) -> int:
    """Make an evaluator's folder of the published checkpoints of HumanML3D or KIT-ML.

    Nothing in them is run; use the result as `moveset evaluate … --evaluator OUTPUT`.

    Args:
        checkpoints: Their folder, with t2m/text_mot_match/model/finest.tar and t2m/Comp_v6_KLD005/meta (or kit).
        glove: Folder with our_vab_data.npy, our_vab_idx.pkl and our_vab_words.pkl, or a GloVe text file.
        output: The folder to make.
        dataset: Which one, where both are there.
        statistics: Folder with mean.npy and std.npy, if not that of the published generator.
        bias: What the standard deviations of root and contacts are still to be divided by: 25 for Std.npy of the data
            set. The published std.npy has it in it.
        json: Print one JSON object on stdout and nothing else.
    """
    from moveset.evaluation.official import import_official, read_official

    made = import_official(read_official(checkpoints, dataset, statistics=statistics, bias=bias), glove)
    made.save(output)
    weights = sum(p.numel() for p in made.module.parameters())
    if json:
        facts = {"codec": made.card.codec, "parameters": weights, "provenance": dict(made.card.provenance)}
        print(jsonlib.dumps({"evaluator": str(output), "name": made.card.name, **facts}))
    else:
        print(f"{output}: {made.card.name}, {weights:,} parameters, {made.card.provenance['words']} words")
    return 0


def _print_summary(path: Path, summary: dict[str, Any], corpus: "Corpus", captions: int) -> None:
    print(f"{path}: {summary['clips']} clips, {summary['hours']:.2f} h, {summary['compositions']} compositions")
    print("                  clips   hours  with sentences   hours  sentences")
    for name, row in (*summary["splits"].items(), *summary["sources"].items()):
        told = f"{row['told']:>16}{row['told_hours']:>8.2f}{row['sentences']:>11}"
        print(f"  {name:<15}{row['clips']:>6}{row['hours']:>8.2f}{told}")
        clips = [i for i, r in enumerate(corpus.records) if r.source == name and r.captions and r.kind == "take"]
        for clip in clips[:: max(1, len(clips) // max(captions, 1))][:captions]:
            print(f"        {corpus.captions(clip)[0]}")
    print(f"  {summary['sentences']} distinct sentences; clips that say a verb:")
    said = [f"{verb} {count}" for verb, count in summary["verbs"].items()]
    for start in range(0, len(said), 12):
        print(f"    {', '.join(said[start : start + 12])}")
    print("  length (frames):")
    most = max(summary["lengths"].values())
    for label, count in summary["lengths"].items():
        print(f"    {label:>8} {count:>6} {'█' * round(40 * count / most)}")
    if summary["rejected"]:
        print("  left out:")
        for reason, count in summary["rejected"].items():
            print(f"    {count:>5}  {reason}")


def _folder_info(folder: Path, captions: int, json: bool) -> int:
    from moveset.data.humanml3d import HumanML3D

    data = HumanML3D.open(folder)
    splits = {name: len(names) for name, names in data.splits.items()}
    missing = [name for name in ("Mean.npy", "Std.npy") if not (folder / name).is_file()]
    if json:
        found = {"folder": str(folder), "layout": data.layout.name, "clips": len(data), "splits": splits}
        print(jsonlib.dumps({**found, "missing": missing}))
        return 0
    print(f"{folder}: {len(data)} motions of the {data.layout.name} kind ({data.layout.features} features)")
    print("  " + ", ".join(f"{name} {count}" for name, count in splits.items()))
    if missing:
        print(f"  {' and '.join(missing)} missing; restore what trainings and evaluations need")
    for name in data.names[:captions]:
        for caption in data.captions(name)[:captions]:
            print(f"        {name}: {caption.text}")
    return 0


data = {"build": build, "info": info, "export": export, "import-evaluator": import_evaluator}
