"""How long motion takes: clips stage by stage, segments of streams, by length, by batch, and in a stream without end.

Everything is a *case* of ``interleaved``, so that what a report compares was run in turns. Milliseconds throughout.

text     sentence to token states              export   holding the feet, and writing a BVH file
sample   noise to latents                      first    a prompt never heard before to the segment it makes
decode   latents to rotations and root path    segment  the segment after that one
joints   positions of all joints

AITS, the papers' average inference time per sentence, is text + sample + decode of one clip at batch 1. Theirs ends at
features; what turns those into rotations is counted in here.
"""

import itertools
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from moveset.bench.flops import counted
from moveset.bench.interleaved import Case
from moveset.bench.machine import resident_mb
from moveset.pcm.sampler import item_noise
from moveset.pipelines.denoise import Denoise
from moveset.pipelines.model_config import ClipConfig
from moveset.pipelines.motion_stream import MotionStream
from moveset.pipelines.request import Method, Request, check_method
from moveset.pipelines.stream_batch import Segment
from moveset.pipelines.text_to_motion import TextToMotion

AITS = ("text", "sample", "decode")
CLIP_PARTS = (*AITS, "joints", "export")
STREAM_PARTS = ("first", "segment")
STRETCHES = 20
PROMPTS = (
    "a person walks forward and waves",
    "someone runs fast in a circle",
    "a man kicks with the right leg",
    "a person bows politely and steps back",
)
_PEOPLE = ("a person", "someone", "a man", "a woman", "an old man", "the actor")
_DEEDS = ("walks forward", "runs in a circle", "waves with the left hand", "bows politely", "kicks", "turns around")


def clip_methods(config: ClipConfig, teacher_steps: Sequence[int]) -> dict[str, Method]:
    """Everything that a folder can make clips by, its quickest first, by names such as "pcm-1" and "teacher-50"."""
    asked = [(solver, steps) for solver in ("pcm", "lcm") for steps in config.steps(solver)]
    asked += [("teacher", steps) for steps in teacher_steps if "teacher" in config.models]
    return {f"{solver}-{steps}": check_method(config, solver, steps) for solver, steps in asked}


def clip_case(t2m: TextToMotion, method: Method, frames: int, folder: Path, clips: int = 1) -> Case:
    """One sentence a call, to a file in a folder.

    Args:
        clips: that follow one another, each with a sentence of its own.
    """

    def run(call: int) -> Mapping[str, float]:
        prompts = tuple(PROMPTS[(call + k) % len(PROMPTS)] for k in range(clips))
        made = t2m.generate([Request(prompts, (frames,) * clips, seed=call)], method)[0]
        start = time.perf_counter()
        # A fresh copy: the motion remembers its joints, which holding the feet has asked for.
        _ = replace(made.raw[0]).joints
        middle = time.perf_counter()
        made.motion.save(folder / "clip.bvh")
        export = made.timings_ms["finish"] + (time.perf_counter() - middle) * 1e3
        found = {part: made.timings_ms[part] for part in AITS}
        return {**found, "joints": (middle - start) * 1e3, "export": export, "evaluations": made.network_evaluations}

    return run


def batch_case(t2m: TextToMotion, method: Method, frames: int, batch: int) -> Case:
    """As many different sentences as the batch, evaluated at once; milliseconds of one clip, feet held, no file."""

    def run(call: int) -> Mapping[str, float]:
        said = itertools.islice(sentences(call * batch), batch)
        requests = [Request((text,), (frames,), seed=call * batch + k) for k, text in enumerate(said)]
        start = time.perf_counter()
        t2m.generate(requests, method, batch=batch)
        return {"clip": (time.perf_counter() - start) * 1e3 / batch}

    return run


def stream_case(stream: MotionStream, said: Iterator[str]) -> Case:
    """A new prompt a call: the segments until the first that it makes, and the one after that."""

    def run(call: int) -> Mapping[str, float]:
        start = time.perf_counter()
        _told(stream, next(said))
        middle = time.perf_counter()
        segment = next(stream)
        end = time.perf_counter()
        evaluations = float(segment.network_evaluations)
        return {"first": (middle - start) * 1e3, "segment": (end - middle) * 1e3, "evaluations": evaluations}

    return run


def length_case(stream: MotionStream, segments: int, said: Iterator[str]) -> Case:
    """So many segments by one new prompt a call, text and all."""

    def run(call: int) -> Mapping[str, float]:
        start = time.perf_counter()
        _told(stream, next(said))
        for _ in range(segments - 1):
            next(stream)
        return {"motion": (time.perf_counter() - start) * 1e3}

    return run


def endless(stream: MotionStream, count: int, tick: Callable[[], object]) -> list[dict[str, float]]:
    """Time of a segment and memory of this process, in ``STRETCHES`` of one stream of about ``count`` segments."""
    size = max(1, count // STRETCHES)
    rows = []
    for made in range(0, count, size):
        spent = [segment.latency_ms for segment in itertools.islice(stream, size)]
        rows.append(
            {
                "segments": made + size,
                "median_ms": round(statistics.median(spent), 3),
                "min_ms": round(min(spent), 3),
                "memory_mb": round(resident_mb(), 1),
            }
        )
        tick()
    return rows


@torch.inference_mode()
def clip_operations(t2m: TextToMotion, method: Method, frames: int) -> dict[str, int]:
    """Operations of one clip by stage; text is the frozen encoder's, sample includes both halves of guidance."""
    bundle, prompt = t2m.bundle, PROMPTS[0]
    text = t2m.encoder.encode([prompt])
    denoise = Denoise(bundle, t2m.encoder, method, t2m.device)
    noise = item_noise([0], (1, *bundle.config.latent))[0]
    vae, lengths = bundle.module("vae", t2m.device), torch.tensor([frames], device=t2m.device)
    latents = denoise(noise, text, [frames])
    return {
        "text": counted(lambda: t2m.encoder.encode([prompt])),
        "sample": counted(lambda: denoise(noise, text, [frames])),
        "decode": counted(lambda: vae.decode(latents, lengths, frames)),
    }


def stream_operations(stream: MotionStream) -> dict[str, int]:
    """Operations of a segment whose prompt is known, flow and all, and of encoding a prompt."""
    return {
        "text": counted(lambda: stream.encoder.encode([PROMPTS[0]])),
        "segment": counted(lambda: next(stream)),
    }


def sentences(start: int = 0) -> Iterator[str]:
    """Sentences that differ, without end."""
    for k in itertools.count(start):
        person, deed = _PEOPLE[k % len(_PEOPLE)], _DEEDS[k // len(_PEOPLE) % len(_DEEDS)]
        yield f"{person} {deed} for the {k}th time"


def stream_row(stream: MotionStream) -> dict[str, Any]:
    s = stream.settings
    told = {name: getattr(s, name) for name in ("start", "lag", "past_lag", "eta", "guidance", "foot_lock", "stages")}
    return {"network": s.network, "steps": s.steps, "settings": {**told, "shape": "parallelogram"}}


def _told(stream: MotionStream, prompt: str) -> Segment:
    """The first segment of a prompt: what is in work of the one before has to be finished first."""
    stream.prompt(prompt)
    segment = next(stream)
    while segment.prompt != prompt:
        segment = next(stream)
    return segment
