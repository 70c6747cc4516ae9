"""``moveset generate``: text in, motion files out."""

import json as jsonlib
import re
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from moveset.errors import InputError

if TYPE_CHECKING:
    from moveset.motion.clip import Motion
    from moveset.pipelines.text_to_motion import Generation

DEFAULT_OUTPUT = Path("motion.glb")


def generate(
    prompt: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="PROMPT …")] = (),
    *,
    output: Annotated[tyro.conf.UseAppendAction[tuple[Path, ...]], tyro.conf.arg(aliases=["-o"], metavar="FILE")] = (),
    seconds: Annotated[tyro.conf.UseAppendAction[tuple[float, ...]], tyro.conf.arg(metavar="S")] = (),
    model: Annotated[str, tyro.conf.arg(metavar="NAME")] = "motionpcm-small",
    steps: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    solver: Literal["pcm", "lcm", "teacher"] = "pcm",
    guidance: Annotated[float | None, tyro.conf.arg(metavar="W")] = None,
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    num: Annotated[int, tyro.conf.arg(metavar="N")] = 1,
    fps: Annotated[float | None, tyro.conf.arg(metavar="N")] = None,
    skeleton: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    in_place: tyro.conf.FlagCreatePairsOff[bool] = False,
    loop: tyro.conf.FlagCreatePairsOff[bool] = False,
    foot_lock: bool = True,
    prompts: Annotated[Path | None, tyro.conf.arg(metavar="FILE.jsonl")] = None,
    batch: Annotated[int, tyro.conf.arg(metavar="N")] = 1,
    device: Annotated[str, tyro.conf.arg(metavar="NAME")] = "auto",
    json: tyro.conf.FlagCreatePairsOff[bool] = False,
) -> int:
    """Turn text into motion files. Several prompts follow one another in one motion.

    Args:
        prompt: What the person does, such as "a person walks forward and waves".
        output: File to write: .bvh .glb .gltf .vrma .npz .amass.npz .npy .html .mp4 .gif or .png; give it several times
            for several files. Without it motion.glb is written. An .html is a page that plays the motion, offline.
        seconds: Duration of a clip; once for all prompts, or once for each. Without it the text decides.
        model: A shipped model (see `moveset models`) or a model folder.
        steps: Network evaluations a clip takes: 1, 2 or 4; by default 1 (50 for the teacher).
        solver: pcm: MotionPCM students. lcm: the one-step baseline. teacher: the model they were distilled from.
        guidance: How strongly the text is followed (w); by default the model's own choice.
        seed: The same seed gives the same bytes.
        num: Variants to make; variant k has the seed SEED + k and is written as NAME-k.
        fps: Frame rate of the files; the model works at 20.
        skeleton: Retarget to smpl, mixamo, vrm, ue5, hml22 or kit21.
        in_place: Without travel over the ground.
        loop: Blend the end into the beginning.
        foot_lock: Hold planted feet in place, and bodies above the floor.
        prompts: Bulk: a JSONL file or - (standard input), one {"prompt": …, "seconds": …, "seed": …, "name": …} a
            line; finished files are skipped, and under torchrun each process takes its share (of a file).
        batch: Bulk: clips evaluated at once; worth raising on a GPU.
        device: auto, cpu, cuda or mps.
        json: Print one JSON object on stdout and nothing else.
    """
    from moveset.cli.output import Postprocess, plan_outputs, write
    from moveset.pipelines.request import check_method, check_request
    from moveset.pipelines.text_to_motion import TextToMotion

    finish = Postprocess(fps=fps, skeleton=skeleton, in_place=in_place, loop=loop)
    t2m = TextToMotion.from_pretrained(model, device=device)
    method = check_method(t2m.bundle.config, solver, steps, guidance)
    outputs = output or (DEFAULT_OUTPUT,)
    if prompts is not None:
        if prompt or seconds or seed:
            raise InputError("with --prompts the prompts, seconds and seeds stand in the file; leave them out here")
        from moveset.cli.bulk import bulk

        return bulk(t2m, method, prompts, outputs, finish, num=num, batch=batch, foot_lock=foot_lock, json=json)

    if batch != 1:
        raise InputError("--batch is for many prompts from a file; give --prompts FILE.jsonl, or leave it out")
    if not prompt:
        raise InputError("no prompt was given; describe a motion, such as 'a person walks forward and waves'")
    requests = check_request(t2m.bundle.config, prompt, seconds or None, seed, num)
    names = [""] if num == 1 else [str(k) for k in range(num)]
    planned = plan_outputs(outputs, names)
    tell_unquoted(prompt)

    timings: Counter[str] = Counter()
    files: list[Path] = []
    for request, paths in zip(progress(requests), planned, strict=True):
        made = t2m.generate([request], method, foot_lock=foot_lock)[0]
        motion, export = write(made.motion, paths, finish, made.metadata)
        files += paths
        timings.update(made.timings_ms | {"export": export})
        if request is requests[0]:
            first, written = made, motion
    report = {
        "model": first.model,
        "prompts": list(first.prompts),
        "seed": seed,
        "steps": first.steps,
        "network_evaluations": first.network_evaluations,
        "frames": len(written),
        "fps": written.fps,
        "seconds": round(written.seconds, 3),
        "files": [str(path) for path in files],
        "timings_ms": stage_times(timings),
        "warnings": list(first.warnings),
        # On the spot all feet slide, and other bodies' are not known.
        "skating": skating(first, first.motions[0] if finish.in_place or finish.skeleton else written),
    }
    tell(report, json)
    return 0


def prepare(arguments: Sequence[str]) -> list[str]:
    """Let ``--seconds 3 2`` and ``-o a.bvh b.glb`` stand for the repeated flag, without swallowing a prompt.

    >>> prepare(["a person walks", "--seconds", "3", "2", "-o", "a.bvh", "b.glb", "then waves"])
    ['a person walks', '--seconds', '3', '--seconds', '2', '-o', 'a.bvh', '-o', 'b.glb', 'then waves']
    """
    # Without blanks any extension, so that a wrong one is refused; with blanks io.WRITABLE, which is slow to import.
    file = r"(?i)\S+\.(\w{3}|gltf|vrma|html)|[^\n]+\.(bvh|glb|gltf|vrma|npz|npy|html|mp4|gif|png)"
    more = {"--seconds": r"[\d.]+(e\d+)?", "-o": file, "--output": file}
    out: list[str] = []
    flag = ""
    for argument in arguments:
        if flag and out[-1] != flag and re.fullmatch(more[flag], argument):
            out.append(flag)
        elif not (flag and out[-1] == flag):
            flag = argument if argument in more else ""
        out.append(argument)
    return out


def progress(items: Sequence[Any]) -> Any:
    """The items behind a progress bar, which shows after two seconds where stderr is a terminal."""
    from tqdm import tqdm

    return tqdm(items, delay=2.0, disable=not sys.stderr.isatty(), unit="motion", leave=False)


def stage_times(timings: Counter[str]) -> dict[str, float]:
    """The contract's four stages; "export" is everything after decoding."""
    export = timings["finish"] + timings["export"]
    stages = {"text": timings["text"], "sample": timings["sample"], "decode": timings["decode"], "export": export}
    return {stage: round(spent, 2) for stage, spent in stages.items()}


def skating(made: "Generation", written: "Motion") -> dict[str, float]:
    """Share of frames with a sliding foot, as generated and as ``written``."""
    from moveset.motion.measures import skating as measure

    before, after = (float(measure(m.joints, m.fps, skeleton=m.skeleton)) for m in (made.raw[0], written))
    return {"before": round(before, 4), "after": round(after, 4)}


def tell_unquoted(prompts: Sequence[str]) -> None:
    """Say what several prompts without a blank are: a shell that was given no quotes makes them of one sentence."""
    if len(prompts) > 1 and not any(re.search(r"\s", text.strip()) for text in prompts):
        from moveset.pipelines.warnings import beginning

        print(
            f"moveset: {len(prompts)} prompts of a word each follow one another; one sentence is put in quotes: "
            f'"{beginning(" ".join(prompts), 60)}"',
            file=sys.stderr,
        )


def warn(warnings: Iterable[str]) -> None:
    """Print warnings where they disturb no output."""
    for warning in warnings:
        print(f"moveset: warning: {warning}", file=sys.stderr)


def tell(report: dict[str, Any], json: bool) -> None:
    """Print the report as one JSON object, or as a few lines for a person."""
    warn(report["warnings"])
    if json:
        print(jsonlib.dumps(report))
        return
    spent = ", ".join(f"{stage} {ms:.0f} ms" for stage, ms in report["timings_ms"].items())
    for file in report["files"]:
        print(file)
    print(
        f"{report['frames']} frames at {report['fps']:g} fps, {report['seconds']:g} s, seed {report['seed']}, {spent}"
    )
