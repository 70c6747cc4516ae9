"""How long a segment of a stream takes, by every network of a folder, and what an endless one does to time and memory.

    python benchmarks/stream.py --threads 2 --json stream.json
    python benchmarks/stream.py --from-scratch        # the shipped sizes with random weights: times, but no motion

first       from a prompt that was never heard to the segment it makes: encoding, sampling, decoding, foot locking
segment     the same for the segments after it, in rounds that run every network once, in an order that changes
drift       one long stream by the default network: time of a segment and memory of the process along the way

Medians and minima; × is seconds of motion made in a second. Foreign load on a core multiplies small kernels' times, so
read the minima first, and run it on a quiet machine.
"""

import argparse
import itertools
import json
import os
import platform
import random
import statistics
import tempfile
import time
from pathlib import Path

WORDS = ("walks forward", "runs in a circle", "waves with the left hand", "bows politely", "kicks", "turns around")
PEOPLE = ("a person", "someone", "a man", "a woman", "an old man", "the actor")


def prompts(start):
    """Sentences that differ."""
    for k in itertools.count(start):
        yield f"{PEOPLE[k % len(PEOPLE)]} {WORDS[k // len(PEOPLE) % len(WORDS)]} for the {k}th time"


def rounds(streams, count, warmup):
    """Milliseconds of first and later segments by network, one entry a round."""
    found = {name: {"first": [], "segment": [], "evaluations": []} for name in streams}
    order, shuffle, said = list(streams), random.Random(0), prompts(0)
    for k in range(-warmup, count):
        shuffle.shuffle(order)
        for name in order:
            stream, prompt = streams[name], next(said)
            start = time.perf_counter()
            stream.prompt(prompt)
            segment = next(stream)
            # A staircase has segments of the old prompt in work, which have to be finished first.
            while segment.prompt != prompt:
                segment = next(stream)
            first = (time.perf_counter() - start) * 1e3
            start = time.perf_counter()
            segment = next(stream)
            if k >= 0:
                found[name]["first"].append(first)
                found[name]["segment"].append((time.perf_counter() - start) * 1e3)
                found[name]["evaluations"].append(segment.network_evaluations)
    return found


def summary(found, streams):
    """Medians, minima and times real time of every network."""
    out = {}
    for name, rows in found.items():
        settings, config = streams[name].settings, streams[name].bundle.config
        median, lowest = statistics.median(rows["segment"]), min(rows["segment"])
        seconds = config.segment / config.fps
        out[name] = {
            "steps": settings.steps,
            "start": settings.start,
            "lag": settings.lag,
            "evaluations": statistics.median(rows["evaluations"]),
            "first_ms": {"median": round(statistics.median(rows["first"]), 2), "min": round(min(rows["first"]), 2)},
            "segment_ms": {"median": round(median, 2), "min": round(lowest, 2)},
            "times_real_time": {"median": round(seconds / median * 1e3, 1), "best": round(seconds / lowest * 1e3, 1)},
        }
    return out


def drift(stream, count, points=20):
    """Time of a segment and memory of the process, in ``points`` stretches of a stream of ``count`` segments."""
    size = max(1, count // points)
    rows = []
    for k in range(0, count, size):
        spent = [segment.latency_ms for segment in itertools.islice(stream, size)]
        rows.append(
            {
                "segments": k + size,
                "median_ms": round(statistics.median(spent), 2),
                "min_ms": round(min(spent), 2),
                "memory_mb": round(resident(), 1),
            }
        )
    return rows


def resident():
    """Megabytes of memory that the process has now."""
    import resource

    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
    except OSError:  # elsewhere the most it ever had is all that is told
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if platform.system() == "Darwin" else 1e3)


def from_scratch(folder):
    """A folder of the sizes that ship, with random weights."""
    import torch

    from moveset.motion.features import get_codec
    from moveset.pipelines.stream_bundle import StreamConfig, save_stream_bundle
    from moveset.recipes.small import TRAINING

    dim = get_codec("native").dim
    task = TRAINING["rdm-7"]().task
    torch.manual_seed(0)
    denoiser = task.model.build()
    modules = {"rdm": denoiser, "md": task.model.build(), "flow": task.flow.build()}
    modules |= {f"pcm-{k}": denoiser.student() for k in (1, 2, 4)}
    config = StreamConfig(name="from-scratch", network="pcm-1", guidance={f"pcm-{k}": 1.0 for k in (1, 2, 4)})
    # No spread at all: random weights would tear a body apart, and the time of foot locking depends on its feet.
    normalizer = {"feature_mean": _standing(dim), "feature_std": torch.full((dim,), 1e-3)}
    return save_stream_bundle(folder / "from-scratch", config, modules, normalizer, ["nothing"], torch.ones(1, 384))


def _standing(dim):
    import torch

    from moveset.motion import rotations
    from moveset.motion.clip import Motion
    from moveset.motion.features import get_codec
    from moveset.motion.skeleton import HML22

    root = torch.tensor([[0.0, -float(HML22.rest_positions[:, 1].min()), 0.0]]).repeat(2, 1)
    return get_codec("native").encode(Motion(rotations.identity(2, len(HML22)), root))[0]


def main():
    """Measure, print a table, and write JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="rdm-small")
    parser.add_argument("--from-scratch", action="store_true", help="time the shipped sizes with random weights")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--warmup", type=int, default=5)
    parser.add_argument("--segments", type=int, default=2000, help="length of the long stream; 0 leaves it out")
    parser.add_argument("--json", type=Path, help="file for the results")
    args = parser.parse_args()

    import torch

    from moveset import MotionStream
    from moveset.pipelines.stream_bundle import StreamBundle
    from moveset.pipelines.stream_settings import check_stream
    from moveset.text.encoder import get_text_encoder

    torch.set_num_threads(args.threads)
    with tempfile.TemporaryDirectory() as name:
        bundle = StreamBundle.find(from_scratch(Path(name)) if args.from_scratch else args.model)
        encoder = get_text_encoder(bundle.config.text_encoder, device=args.device)

        def stream(network):
            request = check_stream(bundle.config, network=network)
            return MotionStream(bundle, request, device=args.device, encoder=encoder)

        streams = {network: stream(network) for network in bundle.config.denoisers}
        results = summary(rounds(streams, args.rounds, args.warmup), streams)
        print(f"{'ms: median (min)':<18}{'K':>4}{'R':>4}{'calls':>7}{'first':>18}{'segment':>18}{'× real time':>16}")
        for network, row in results.items():
            first, segment, times = row["first_ms"], row["segment_ms"], row["times_real_time"]
            print(
                f"{network:<18}{row['steps']:>4}{row['start']:>4}{row['evaluations']:>7g}"
                f"{first['median']:>9.1f} ({first['min']:.1f})".ljust(51)
                + f"{segment['median']:>9.1f} ({segment['min']:.1f})".ljust(18)
                + f"{times['median']:>9.0f} ({times['best']:.0f})"
            )
        report = {
            "model": bundle.config.name,
            "machine": {"cpu": _cpu(), "cores": os.cpu_count(), "python": platform.python_version()},
            "torch": torch.__version__,
            "threads": args.threads,
            "device": args.device,
            "rounds": args.rounds,
            "segment_seconds": bundle.config.segment / bundle.config.fps,
            "networks": results,
        }
        if args.segments:
            report["drift"] = drift(stream(None), args.segments)
            for row in (report["drift"][0], report["drift"][-1]):
                print(f"after {row['segments']} segments: {row['median_ms']} ms each, {row['memory_mb']} MB")
    if args.json:
        args.json.write_text(json.dumps(report, indent=1) + "\n")


def _cpu():
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.machine()


if __name__ == "__main__":
    main()
