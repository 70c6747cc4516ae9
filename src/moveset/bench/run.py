"""What ``moveset bench`` measures, in which order, and its report as JSON.

A report says what it was measured on; every table in it is one set of interleaved runs, and every ratio is to the first
row of its table, in the same rounds.
"""

import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any

from moveset import __version__
from moveset.bench import latency
from moveset.bench.interleaved import Case, interleave, summarise
from moveset.bench.machine import describe_machine, load
from moveset.bench.processes import clip_command, processes, stream_command
from moveset.errors import InputError
from moveset.pipelines.model_config import StreamConfig
from moveset.pipelines.model_folder import ModelFolder
from moveset.pipelines.motion_stream import MotionStream
from moveset.pipelines.role import is_student
from moveset.pipelines.stream_settings import check_stream, offered_steps
from moveset.pipelines.text_to_motion import TextToMotion

FORMAT = 1
PARTS = ("clips", "streams", "lengths", "batches", "operations", "processes", "endless")
#: Makes the progress of a part: from its name and number of ticks to what is called at each.
Progress = Callable[[str, int], Callable[[], object]]


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What is measured.

    Args:
        rounds: that count, of clips and streams; lengths and batches, which are longer, have a third of them.
        burst: calls of a case in a round; the first does not count.
        clip_seconds: lengths of single clips, where the model makes such.
        joined: clips of the greatest length that follow one another.
        segments: lengths of streams, in segments.
        batches: clips evaluated at once.
        count: processes of each command.
        endless: segments of the long stream.
    """

    clips: str = "motionpcm-small"
    streams: str = "rdm-small"
    parts: tuple[str, ...] = PARTS
    rounds: int = 20
    warmup: int = 2
    burst: int = 4
    teacher_steps: tuple[int, ...] = (10, 50)
    clip_seconds: tuple[float, ...] = (2.0, 4.0, 6.0, 8.0)
    joined: tuple[int, ...] = (2, 4, 6)
    segments: tuple[int, ...] = (1, 3, 7, 14, 28, 42)
    batches: tuple[int, ...] = (1, 2, 4, 8, 16, 32)
    count: int = 5
    endless: int = 2000
    device: str = "cpu"

    def __post_init__(self) -> None:
        if unknown := [part for part in self.parts if part not in PARTS]:
            raise InputError(f"unknown part {unknown[0]!r} of the benchmark; choose from {', '.join(PARTS)}")
        for name, value, most in (("rounds", self.rounds, 10_000), ("processes", self.count, 1000)):
            if not 1 <= value <= most:
                raise InputError(f"{value} {name} are not in 1 to {most}; 20 rounds and 5 processes are usual")
        if not 1 <= self.endless <= 1_000_000:
            raise InputError(f"{self.endless} segments are not in 1 to 1000000; 2000 are usual")

    @property
    def fewer(self) -> int:
        """Rounds of what takes long."""
        return max(1, self.rounds // 3)


def shortest(plan: Plan) -> Plan:
    """The least that runs every part."""
    return replace(
        plan, rounds=1, warmup=1, burst=2, teacher_steps=plan.teacher_steps[:1], clip_seconds=plan.clip_seconds[:1],
        joined=plan.joined[:1], segments=plan.segments[:2], batches=plan.batches[:2], count=1,
        endless=min(plan.endless, 20),
    )  # fmt: skip


class Bench:
    """One run of a plan.

    Raises:
        InputError: no such model, or no such device.
        FormatError: a damaged model folder.
    """

    def __init__(self, plan: Plan, progress: Progress = lambda name, count: lambda: None) -> None:
        self.plan, self._progress = plan, progress
        self.t2m = TextToMotion.from_pretrained(plan.clips, device=plan.device)
        self.bundle = ModelFolder.open(plan.streams, StreamConfig)
        config = self.t2m.bundle.config
        self.frames, self.fps = config.max_frames, config.fps
        self.methods = latency.clip_methods(config, plan.teacher_steps)
        # The network that ships as the default comes first: ratios are to it.
        default = check_stream(self.bundle.config).settings.network
        self.networks = (default, *(name for name in self.bundle.config.denoisers if name != default))
        self._said = latency.sentences(1_000_000)

    def run(self) -> dict[str, Any]:
        start, before = time.perf_counter(), load()
        measured = {part: getattr(self, f"_{part}")() for part in PARTS if part in self.plan.parts}
        return {
            "format": FORMAT,
            "moveset": __version__,
            "date": date.today().isoformat(),
            "machine": {**describe_machine(), "device": str(self.t2m.device)},
            "load": {"before": before, "after": load()},
            "wall_seconds": round(time.perf_counter() - start, 1),
            "plan": asdict(self.plan),
            "models": {
                "clips": {"name": self.t2m.bundle.config.name, "frames": self.frames, "fps": self.fps},
                "streams": {
                    "name": self.bundle.config.name,
                    "frames": self.bundle.config.segment,
                    "fps": self.bundle.config.fps,
                },
            },
            **measured,
        }

    def _clips(self) -> dict[str, Any]:
        """By method: AITS with its parts, and export."""
        with tempfile.TemporaryDirectory() as folder:
            cases = {
                name: latency.clip_case(self.t2m, method, self.frames, Path(folder))
                for name, method in self.methods.items()
            }
            runs = self._interleave("clips", cases, self.plan.rounds, self.plan.burst)
        rows = summarise(runs, latency.AITS, latency.CLIP_PARTS)
        for name, method in self.methods.items():
            rows[name] |= {
                "network": method.network,
                "steps": method.steps,
                "evaluations": runs[name][-1]["evaluations"],
                "settings": {"guidance": method.guidance, "foot_lock": True},
            }
        return rows

    def _streams(self) -> dict[str, Any]:
        """By network, of the default one in fewer steps too: time to the first segment of a new prompt, and of the
        segments after it."""
        streams = {name: self._stream(name) for name in self.networks}
        default = self.networks[0]
        if not is_student(default):  # students are networks of their own
            own, *fewer = sorted(offered_steps(self.bundle.config), reverse=True)
            streams |= {f"{default}, {k} of {own} steps": self._stream(default, k) for k in fewer}
        cases = {name: latency.stream_case(stream, self._said) for name, stream in streams.items()}
        runs = self._interleave("streams", cases, self.plan.rounds, self.plan.burst)
        rows = summarise(runs, latency.STREAM_PARTS[1:], latency.STREAM_PARTS)
        for name, stream in streams.items():
            rows[name] |= {**latency.stream_row(stream), "evaluations": runs[name][-1]["evaluations"]}
        return rows

    def _lengths(self) -> dict[str, list[dict[str, float]]]:
        """By "clip" (one clip), "clips" (several in a row) and "stream", of the first method and network: time by
        length."""
        name, method = next(iter(self.methods.items()))
        config, stream = self.t2m.bundle.config, self._stream(self.networks[0])
        frames = [n for s in self.plan.clip_seconds if config.min_frames <= (n := round(s * self.fps)) < self.frames]
        segment = self.bundle.config.segment / self.bundle.config.fps
        with tempfile.TemporaryDirectory() as folder:
            cases: dict[str, Case] = {}
            lengths: dict[str, tuple[str, float]] = {}
            for n in (*frames, self.frames):
                cases[f"clip {n}"] = _whole(latency.clip_case(self.t2m, method, n, Path(folder)))
                lengths[f"clip {n}"] = (f"{name}, one clip", n / self.fps)
            for k in self.plan.joined:
                cases[f"clips {k}"] = _whole(latency.clip_case(self.t2m, method, self.frames, Path(folder), clips=k))
                lengths[f"clips {k}"] = (f"{name}, clips in a row", k * self.frames / self.fps)
            for k in self.plan.segments:
                cases[f"segments {k}"] = latency.length_case(stream, k, self._said)
                lengths[f"segments {k}"] = (f"stream {self.networks[0]}", k * segment)
            found = summarise(self._interleave("lengths", cases, self.plan.fewer, 2), ("motion",))
        curves: dict[str, list[dict[str, float]]] = {}
        for key, (label, seconds) in lengths.items():
            times = {k: found[key][k]["total"] for k in ("median_ms", "min_ms")}
            curves.setdefault(label, []).append({"seconds": round(seconds, 3), **times})
        return curves

    def _batches(self) -> dict[str, Any]:
        """By method, the quickest student and the quickest teacher: milliseconds of one clip by batch, and ratios to
        one alone."""
        teachers = [name for name, method in self.methods.items() if method.solver == "teacher"]
        names = (next(iter(self.methods)), *teachers[:1])
        curves = {}
        for name in names:
            cases = {
                str(size): latency.batch_case(self.t2m, self.methods[name], self.frames, size)
                for size in self.plan.batches
            }
            curves[name] = summarise(self._interleave(f"batches of {name}", cases, self.plan.fewer, 2), ("clip",))
        return curves

    def _operations(self) -> dict[str, Any]:
        tick = self._progress("operations", len(self.methods) + len(self.networks))
        found: dict[str, Any] = {"clips": {}, "streams": {}}
        for name, method in self.methods.items():
            found["clips"][name] = latency.clip_operations(self.t2m, method, self.frames)
            tick()
        for network in self.networks:
            stream = self._stream(network)
            next(stream)
            found["streams"][network] = latency.stream_operations(stream)
            tick()
        return found

    def _processes(self) -> dict[str, Any]:
        """Cold starts and peak memory of the command line, by method and network."""
        plan, seconds = self.plan, self.frames / self.fps
        once = {method.network: method for method in self.methods.values()}  # not again at other steps
        commands: dict[str, Sequence[str]] = {
            name: clip_command(plan.clips, m.solver, m.steps, seconds, plan.device) for name, m in once.items()
        }
        for network in self.networks:
            commands[f"stream {network}"] = stream_command(plan.streams, network, seconds, plan.device)
        tick = self._progress("processes", len(commands) * plan.count)
        return processes(commands, plan.count, tick)

    def _endless(self) -> list[dict[str, float]]:
        tick = self._progress("endless", latency.STRETCHES)
        return latency.endless(self._stream(self.networks[0]), self.plan.endless, tick)

    def _stream(self, network: str, steps: int | None = None) -> MotionStream:
        request = check_stream(self.bundle.config, network=network, steps=steps)
        return MotionStream(self.bundle, request, device=self.plan.device, encoder=self.t2m.encoder)

    def _interleave(self, part: str, cases: Mapping[str, Case], rounds: int, burst: int) -> Any:
        tick = self._progress(part, (rounds + self.plan.warmup) * len(cases))
        return interleave(cases, rounds, warmup=self.plan.warmup, burst=burst, tick=tick)


def _whole(case: Case) -> Case:
    """The same work as one number, without writing a file."""
    return lambda call: {"motion": sum(v for part, v in case(call).items() if part in latency.AITS)}
