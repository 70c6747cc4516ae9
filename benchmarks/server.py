"""What the server costs beside generation: transport of a segment, and how many streams it holds in real time.

    python benchmarks/server.py --out server.json              # transport, ten streams, and the ramp
    python benchmarks/server.py --streams 10 --no-ramp         # only whether ten streams are sustained

Starts ``moveset serve`` as a process of its own and plays streams from this one, over loopback. On a busy machine the
figures are those of the business: run it alone.

- Transport: from a client's acknowledgement to the packet that it brings about, less the time in the server's line and
  the time of making the segment, as the server tells them. What remains is both ways through both event loops.
- Sustained: clients that play at the model's frame rate from their first packet on and acknowledge four times a second;
  a stream runs dry when it should show a frame that has not come.
- Held: streams are added until one runs dry; the largest number at which none did.
"""

import argparse
import asyncio
import json
import statistics
import subprocess
import sys
import time
import urllib.request
from dataclasses import dataclass, field
from typing import Any

from arguments import Parser, at_least, library, positive, report_path, write_report
from moveset.bench.machine import describe_machine
from moveset.errors import InputError, exit_code_of
from moveset.io.packets import HEADER

PROMPTS = ("a person walks forward", "a person waves with the left hand", "a man runs fast", "a person bows")
_ACKNOWLEDGE = 0.25  # seconds between two acknowledgements
_INSTALL = "pip install 'moveset[serve]'"
_SETTLE = 2.0  # seconds within which clients of a level begin, one after the other


@dataclass
class Played:
    """What one client saw."""

    segments: int = 0
    dry: int = 0
    least_ahead: float = float("inf")
    latency_ms: list[float] = field(default_factory=list)
    queue_ms: list[float] = field(default_factory=list)


class Server:
    """``moveset serve`` as a process; a ``with`` block."""

    def __init__(self, streams: int, model: str | None) -> None:
        command = [sys.executable, "-m", "moveset.cli", "serve", "--no-open", "--port", "0", "--streams", str(streams)]
        self._process = subprocess.Popen(
            command + (["--model", model] if model else []), stdout=subprocess.PIPE, text=True
        )

    def __enter__(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if "serves at" not in line:
            raise InputError("the server did not start, for what it said above")
        url = line.split()[3].rstrip("/")
        while not json.load(urllib.request.urlopen(f"{url}/healthz"))["ready"]:
            time.sleep(0.1)
        return url

    def __exit__(self, *error: object) -> None:
        self._process.terminate()
        self._process.wait(60)


def connected(url: str) -> Any:
    """A connection to a stream of the server's, for ``async with``."""
    websockets = library("websockets", _INSTALL)
    return websockets.connect(f"ws{url.removeprefix('http')}/v1/stream", max_size=2**22)


async def transport(url: str, segments: int) -> dict[str, Any]:
    """Milliseconds a segment spends on its way, one stream alone."""
    found, sizes = [], []
    async with connected(url) as ws:
        await ws.recv()
        await ws.send(json.dumps({"type": "start", "prompt": PROMPTS[0], "seed": 1, "buffer": 1.0}))
        told, frames, asked = {}, 0, 0.0
        while len(found) < segments:
            got = await ws.recv()
            now = time.perf_counter()
            if isinstance(got, str):
                told = json.loads(got)
                continue
            frames += HEADER.unpack_from(got)[3]
            sizes.append(len(got))
            if asked:
                found.append((now - asked) * 1e3 - told["latency_ms"] - told["queue_ms"])
            await asyncio.sleep(0.05)
            asked = time.perf_counter()
            await ws.send(json.dumps({"type": "played", "frame": frames}))
    return {
        "segments": segments,
        "bytes": max(sizes),
        "median_ms": round(statistics.median(found), 3),
        "p95_ms": round(sorted(found)[int(0.95 * (len(found) - 1))], 3),
        "max_ms": round(max(found), 3),
    }


async def play(url: str, number: int, wait: float, until: float, steps: int | None, buffer: float) -> Played:
    """One client that plays in real time."""
    await asyncio.sleep(wait)
    seen, frames, begun = Played(), 0, 0.0
    async with connected(url) as ws:
        await ws.recv()
        prompt = PROMPTS[number % len(PROMPTS)]
        await ws.send(json.dumps({"type": "start", "prompt": prompt, "seed": number, "steps": steps, "buffer": buffer}))
        fps, acknowledged = 20.0, 0.0
        while (now := time.perf_counter()) < until:
            try:
                got = await asyncio.wait_for(ws.recv(), _ACKNOWLEDGE)
            except TimeoutError:
                got = None
            now = time.perf_counter()
            if isinstance(got, bytes):
                fps = HEADER.unpack_from(got)[5]
                begun = begun or now
                ahead = frames / fps - (now - begun)
                if frames and ahead < 0:
                    seen.dry += 1
                    begun -= ahead  # it waited for this packet
                if frames:
                    seen.least_ahead = min(seen.least_ahead, ahead)
                frames += HEADER.unpack_from(got)[3]
                seen.segments += 1
            elif got is not None and (message := json.loads(got))["type"] == "segment":
                seen.latency_ms.append(message["latency_ms"])
                seen.queue_ms.append(message["queue_ms"])
            elif got is not None and message["type"] in ("error", "stopped"):
                raise SystemExit(f"the server refused: {message}")
            if begun and now - acknowledged > _ACKNOWLEDGE:
                acknowledged = now
                await ws.send(json.dumps({"type": "played", "frame": min(frames, int((now - begun) * fps))}))
        if begun and frames / fps < now - begun:
            seen.dry += 1
    return seen


async def level(url: str, streams: int, seconds: float, steps: int | None, buffer: float) -> dict[str, Any]:
    """Some streams at once, for some seconds."""
    until = time.perf_counter() + _SETTLE + seconds
    waits = [_SETTLE * k / streams for k in range(streams)]
    seen = await asyncio.gather(*(play(url, k, waits[k], until, steps, buffer) for k in range(streams)))
    latencies = sorted(ms for one in seen for ms in one.latency_ms)
    queues = sorted(ms for one in seen for ms in one.queue_ms)
    return {
        "streams": streams,
        "seconds": seconds,
        "segments": sum(one.segments for one in seen),
        "dry": sum(one.dry for one in seen),
        "least_ahead_s": round(min(one.least_ahead for one in seen), 3),
        "median_latency_ms": round(statistics.median(latencies), 2),
        "p95_latency_ms": round(latencies[int(0.95 * (len(latencies) - 1))], 2),
        "median_queue_ms": round(statistics.median(queues), 2),
        "sustained": all(one.dry == 0 and one.segments > 1 for one in seen),
    }


async def ramp(url: str, most: int, seconds: float, steps: int | None, buffer: float) -> dict[str, Any]:
    """Doubles the streams until one runs dry, then halves the interval."""
    levels, good, bad = [], 0, most + 1
    streams = min(4, most)
    while bad - good > max(1, good // 10):
        levels.append(await level(url, streams, seconds, steps, buffer))
        print(json.dumps(levels[-1]), file=sys.stderr)
        good, bad = (streams, bad) if levels[-1]["sustained"] else (good, streams)
        streams = min(2 * streams, most) if bad > most else (good + bad) // 2
        if good == most or streams == good:
            break
    return {"held": good, "levels": levels}


async def measure(given: argparse.Namespace, url: str) -> dict[str, Any]:
    """Everything that was asked for."""
    found: dict[str, Any] = {"transport": await transport(url, given.segments)}
    found["sustained"] = await level(url, given.streams, given.seconds, given.steps, given.buffer)
    if not given.no_ramp:
        found["ramp"] = await ramp(url, given.most, given.seconds, given.steps, given.buffer)
    return found


def main() -> None:
    """Measure, and print JSON."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=report_path)
    parser.add_argument("--model", help="a stream model; by default the shipped one")
    parser.add_argument("--steps", type=at_least(1))
    parser.add_argument("--streams", type=at_least(1), default=10)
    parser.add_argument("--seconds", type=positive, default=30.0, help="of each level")
    parser.add_argument("--buffer", type=positive, default=2.0)
    parser.add_argument("--segments", type=at_least(1), default=100, help="for the transport")
    parser.add_argument("--most", type=at_least(1), default=256, help="streams at which the ramp ends")
    parser.add_argument("--no-ramp", action="store_true")
    given = parser.parse_args()
    library("websockets", _INSTALL)
    with Server(max(given.most, given.streams), given.model) as url:
        found = asyncio.run(measure(given, url))
    settings = {"steps": given.steps, "buffer": given.buffer, "model": given.model}
    report = {"machine": describe_machine(), "settings": settings, **found}
    # Printed first: what took minutes to measure must not be lost to a disk that has filled up meanwhile.
    print(json.dumps(report, indent=1), flush=True)
    if given.out:
        write_report(given.out, report)


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
