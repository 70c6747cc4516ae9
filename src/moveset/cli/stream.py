"""``moveset stream``: motion without end, written and reported while it is made."""

import json as jsonlib
import signal
import statistics
import sys
import time
from collections import deque
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from moveset.cli.generate import prepare as prepare
from moveset.cli.generate import tell_unquoted, warn
from moveset.errors import InputError, MovesetError

if TYPE_CHECKING:
    from moveset.cli.prompt_lines import PromptLines
    from moveset.motion.clip import Motion
    from moveset.pipelines.motion_stream import MotionStream
    from moveset.pipelines.stream_batch import Segment
    from moveset.pipelines.stream_settings import StreamRequest

_NAP = 0.02  # seconds between two looks at signals and prompts while there is nothing to do


def stream(
    prompt: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="PROMPT …")] = (),
    *,
    output: Annotated[tyro.conf.UseAppendAction[tuple[Path, ...]], tyro.conf.arg(aliases=["-o"], metavar="FILE")] = (),
    seconds: Annotated[tyro.conf.UseAppendAction[tuple[float, ...]], tyro.conf.arg(metavar="S")] = (),
    total: Annotated[float | None, tyro.conf.arg(metavar="S")] = None,
    forever: tyro.conf.FlagCreatePairsOff[bool] = False,
    loop: tyro.conf.FlagCreatePairsOff[bool] = False,
    prompts: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    realtime: tyro.conf.FlagCreatePairsOff[bool] = False,
    model: Annotated[str, tyro.conf.arg(metavar="NAME")] = "rdm-small",
    network: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    steps: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    guidance: Annotated[float | None, tyro.conf.arg(metavar="W")] = None,
    start: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    lag: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    past_lag: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    seed_motion: Annotated[Path | None, tyro.conf.arg(name="from", metavar="CLIP")] = None,
    in_place: tyro.conf.FlagCreatePairsOff[bool] = False,
    foot_lock: bool = True,
    stages: bool = True,
    device: Annotated[str, tyro.conf.arg(metavar="NAME")] = "auto",
    json: tyro.conf.FlagCreatePairsOff[bool] = False,
) -> int:
    """Turn text into motion that goes on, a segment at a time. Several prompts follow one another.

    Args:
        prompt: What the person does, such as "a person walks forward"; the last one is held.
        output: File to write while it grows: .bvh .glb .npz or .html; give it several times for several files. What has
            been made so far is kept, however the stream ends.
        seconds: Duration of a prompt; once for all prompts, or once for each. Prompts change between two segments
            (every 1.4 s), so durations are rounded; without it a prompt lasts four segments, or what --total leaves
            it if that is less.
        total: Seconds to make in all; without it as long as the prompts last.
        forever: Go on until interrupted.
        loop: Begin again after the last prompt, with --total or --forever.
        prompts: Read more prompts while it runs, one a line, from a file, a named pipe (which never ends) or -
            (standard input). Each takes effect with the next segment, and of several that come between two segments the
            last; while they may still come, the motion is made in real time. Without --total or --forever the stream
            ends after the input does. What was said when is told by --json, not by the files. A list that is known
            beforehand is better given as PROMPTs with --seconds.
        realtime: Make a second of motion a second, one segment ahead, instead of as fast as possible.
        model: A shipped stream model (see `moveset models`) or a model folder.
        network: pcm-1: the student of one evaluation a segment (pcm-2, pcm-4: of more, in models that have them). rdm:
            the recurrent model itself. md: the autoregressive baseline. By default the model's own choice.
        steps: Evaluations a segment takes: picks a student, or sets the sampler of --network rdm or md.
        guidance: How strongly the text is followed (w); by default the model's own choice.
        start: --network rdm: steps that later segments are denoised for; the rest is inherited from their neighbour.
        lag: --network rdm, and students of several evaluations: steps that a segment is behind the one before it. All
            of its steps: each waits for a finished predecessor, and a new prompt shows with the next segment. Fewer:
            segments overlap.
        past_lag: --network rdm, where segments wait for each other: steps that the finished one is told to be ahead.
        seed: The same seed gives the same bytes.
        seed_motion: Go on from the end of this motion file (as `moveset convert` reads) of at least 1.4 s.
        in_place: Without travel over the ground.
        foot_lock: Hold planted feet in place.
        stages: Take a sentence apart that says what comes after what ("walks, then waves"); its parts share its time
            evenly. --no-stages says all of it all the time.
        device: auto, cpu, cuda or mps.
        json: Print one JSON object for every segment on stdout, and nothing else.
    """
    if not prompt and prompts is None:
        raise InputError("no prompt was given; describe a motion, such as 'a person walks forward and waves'")
    if not prompt and (seconds or loop):
        raise InputError("--seconds and --loop are for PROMPTs, those of --prompts last until the next; leave them out")
    if total is not None and forever:
        raise InputError("--total and --forever exclude each other; leave one out")
    if loop and total is None and not forever:
        raise InputError("--loop needs an end or none at all; give --total S or --forever")
    from moveset.cli.growing_files import GrowingFiles, plan_takes
    from moveset.cli.prompt_lines import PromptLines
    from moveset.io import load
    from moveset.io.process import noted_signals
    from moveset.pipelines.model_config import StreamConfig
    from moveset.pipelines.model_folder import ModelFolder
    from moveset.pipelines.motion_stream import MotionStream
    from moveset.pipelines.stream_settings import MAX_SECONDS, check_stream

    plan_takes(output)
    if total is not None and not 0.0 < total <= MAX_SECONDS:
        raise InputError(f"a total of {total:g} seconds is not in 0 to {MAX_SECONDS:g}; give a duration such as 60")
    bundle = ModelFolder.open(model, StreamConfig)
    check = partial(
        check_stream, bundle.config, prompt or None, loop=loop, seed=seed, network=network, steps=steps,
        guidance=guidance, start=start, lag=lag, past_lag=past_lag, foot_lock=foot_lock, stages=stages,
    )  # fmt: skip
    request = check(seconds or None)
    length = request.seconds if total is None else total
    if length <= request.seconds and not (seconds or loop or forever or prompts):
        # Nobody said how long each prompt lasts, but it ends: so that all of them come, and know of it.
        request = check([length * share / request.seconds for share in request.durations])
    with ExitStack() as stack:
        lines = None if prompts is None else PromptLines(prompts)
        begin = None if seed_motion is None else load(seed_motion)
        made = MotionStream(bundle, request, seed_motion=begin, device=device)
        limit = None if forever else total if total is not None else None if lines else request.seconds
        frames = None if limit is None else max(1, round(limit * bundle.config.fps))
        signals = stack.enter_context(noted_signals())
        notes = _notes(made, request) | (_said(made, request) if lines is None else {})
        files = stack.enter_context(GrowingFiles(output, made.codec.skeleton, bundle.config.fps, notes))
        tell_unquoted(prompt)
        if not (output or json):
            print("moveset: this motion is not kept; give -o FILE to write it, or --json to be told of it",
                  file=sys.stderr)  # fmt: skip
        _tell_durations(request, bundle.config.segment / bundle.config.fps)
        _tell_unseen(request, frames, bundle.config.segment)
        latencies = _run(
            made, files, lines, signals, frames=frames, forever=forever, realtime=realtime, in_place=in_place,
            json=json,
        )  # fmt: skip
    if not json:
        _summary(files, made, latencies)
    if signals[:1] == [signal.SIGTERM]:
        raise MovesetError("stopped by SIGTERM; what was made until then is in the files")
    if signals:
        raise KeyboardInterrupt
    return 0


def _run(
    made: "MotionStream", files: Any, lines: "PromptLines | None", signals: Sequence[int], *, frames: int | None,
    forever: bool, realtime: bool, in_place: bool, json: bool,
) -> Sequence[float]:  # fmt: skip
    """Segments until there is a reason to stop; the latencies of the last thousand."""
    from tqdm import tqdm

    latencies: deque[float] = deque(maxlen=1000)
    begun, done = time.monotonic(), 0
    each = made.bundle.config.segment
    warn(made.warnings)
    with tqdm(total=frames, delay=2.0, disable=None, unit="frame", leave=False) as bar:
        while frames is None or done < frames:
            live = lines is not None and not lines.ended
            if realtime or live:
                _wait(begun + (done - each) / made.codec.fps, signals)
            if signals:
                break
            if lines is not None:
                _tell(made, lines)
                if frames is None and not forever and lines.ended and done >= made.timeline.end * each:
                    break
            segment = next(made)
            motion = segment.motion if frames is None else segment.motion[: frames - done]
            files.append(_held_in_place(motion) if in_place else motion)
            done += len(motion)
            latencies.append(segment.latency_ms)
            if json:
                print(jsonlib.dumps(_row(segment, len(motion))), flush=True)
            bar.update(len(motion))
    return latencies


def _row(segment: "Segment", frames: int) -> dict[str, Any]:
    """The contract's line."""
    return {
        "segment": segment.number,
        "first_frame": segment.first_frame,
        "frames": frames,
        "prompt": segment.prompt,
        "latency_ms": segment.latency_ms,
        "network_evaluations": segment.network_evaluations,
    }


def _tell(made: "MotionStream", lines: "PromptLines") -> None:
    """Hand on the newest prompt that has been given since the last segment; say which ones it comes instead of."""
    found = lines.new()
    while found:
        text = found.pop()
        try:
            frame = made.prompt(text)
        except InputError as error:
            print(f"moveset: {' '.join(str(error).split())}", file=sys.stderr)
            continue
        print(f"moveset: from frame {frame}: {text}", file=sys.stderr)
        warn(made.warnings)
        if found:
            print(f"moveset: left out, since a newer prompt came: {' | '.join(found)}", file=sys.stderr)
        return


def _wait(until: float, signals: Sequence[int]) -> None:
    while not signals and (left := until - time.monotonic()) > 0:
        time.sleep(min(left, _NAP))


def _held_in_place(motion: "Motion") -> "Motion":
    root = motion.root.clone()
    root[:, [0, 2]] = 0.0
    return replace(motion, root=root)


def _notes(made: "MotionStream", request: "StreamRequest") -> dict[str, str | int | float]:
    """What the files tell about how they were made."""
    from moveset import __version__
    from moveset.pipelines.role import Role, named

    chosen = request.settings
    plan = {"start": chosen.start, "lag": chosen.lag, "past_lag": chosen.past_lag or chosen.lag}
    if chosen.one_by_one and named(chosen.network).role is not Role.DENOISER:
        plan = {}  # there is no other
    return {
        "generator": f"moveset {__version__}",
        "model": made.bundle.config.name,
        "seed": request.seed,
        "network": chosen.network,
        "steps": chosen.steps,
        **plan,
        "guidance": chosen.guidance,
    }


def _said(made: "MotionStream", request: "StreamRequest") -> dict[str, str]:
    """What was said, and from which second on, unless it is said again and again; files are begun before prompts that
    arrive later are known."""
    each, timeline = made.bundle.config.segment / made.bundle.config.fps, request.timeline
    said = {"prompt": " | ".join(timeline.prompts)}
    return said if timeline.loop else said | {"starts": " | ".join(f"{each * start:g}" for start in timeline.starts)}


def _tell_durations(request: "StreamRequest", each: float) -> None:
    """Say so where durations had to be rounded; the last prompt may be cut anywhere."""
    timeline = request.timeline
    inner = [count * each for count in request.counts][: None if timeline.loop else -1]
    asked = request.durations[: len(inner)]
    if any(abs(a - b) > 0.5 / 20 for a, b in zip(asked, inner, strict=True)):
        lasting = ", ".join(f"{s:g}" for s in inner)
        print(f"moveset: prompts change every {each:g} s, so they last {lasting} s", file=sys.stderr)


def _tell_unseen(request: "StreamRequest", frames: int | None, each: int) -> None:
    """Say which prompts, or stages of one, never come since the stream ends before them."""
    timeline = request.timeline
    unseen = [
        text
        for text, start in zip(timeline.prompts, timeline.starts, strict=True)
        if frames is not None and start * each >= frames
    ]
    if unseen:
        print(f"moveset: the stream ends before {', '.join(map(repr, unseen))}; make it longer", file=sys.stderr)


def _summary(files: Any, made: "MotionStream", latencies: Sequence[float]) -> None:
    for path in files.paths:
        print(path)
    fps = made.codec.fps
    spent = f", a segment in {statistics.median(latencies):.0f} ms" if latencies else ""
    print(f"{files.frames} frames at {fps:g} fps, {files.frames / fps:g} s, seed {made.seed}{spent}")
