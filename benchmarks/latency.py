"""How long one sentence takes, stage by stage: warm medians of interleaved bursts, paired ratios, and cold processes.

    python benchmarks/latency.py --threads 2 --rounds 20 --json latency.json

One round runs every method, in an order that changes, so that a busy moment of the machine hits all of them; ratios are
medians of ratios within a round. Each runs for a burst of four sentences, the first of which is not counted: it is the
one that finds the caches full of another network's weights, while who uses a model calls it again and again. Quote
minima beside medians: one foreign busy core slows small OpenMP kernels many times over. Run it on a quiet machine
without OMP_WAIT_POLICY: threads that sleep between kernels cost a third more there. A sentence becomes 196 frames
(9.8 s) at batch 1.

    text    sentence to token states            decode   latents to features to rotations and root path
    sample  noise to latents                    joints   forward kinematics of all frames
    feet    foot locking                        export   writing a BVH file
"""

import argparse
import json
import os
import platform
import random
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

PROMPTS = (
    "a person walks forward and waves",
    "someone runs fast in a circle",
    "a man kicks with the right leg",
    "a person bows politely and steps back",
)
STAGES = ("text", "sample", "decode", "joints", "feet", "export")
CORE = ("text", "sample", "decode", "joints")
BASE = "pcm-1"
BURST = len(PROMPTS)


def methods(config):
    """(label, keyword arguments of a call) of everything the model folder can do."""
    found = [(f"pcm-{n}", {"steps": n}) for n in config.steps("pcm")]
    found += [(f"lcm-{n}", {"solver": "lcm", "steps": n}) for n in config.steps("lcm")]
    return found + ([("teacher-50", {"solver": "teacher", "steps": 50})] if "teacher" in config.models else [])


def measure(t2m, call, prompt, seed, folder):
    """Milliseconds of every stage of one sentence."""
    config = t2m.bundle.config
    made = t2m(prompt, seconds=config.max_frames / config.fps, seed=seed, **call)
    start = time.perf_counter()
    joints = replace(made.raw[0]).joints  # a fresh copy: foot locking has worked these out before
    middle = time.perf_counter()
    made.motion.save(folder / "clip.bvh")
    end = time.perf_counter()
    if joints.shape[0] != config.max_frames:
        raise RuntimeError(f"a clip has {joints.shape[0]} frames instead of {config.max_frames}")
    spent = dict(made.timings_ms)
    spent["feet"] = spent.pop("finish")
    return {**spent, "joints": (middle - start) * 1e3, "export": (end - middle) * 1e3}


def warm(t2m, rounds, warmup):
    """Per method a list of stage times: ``BURST`` - 1 entries a round."""
    order = methods(t2m.bundle.config)
    runs = {label: [] for label, _ in order}
    shuffle = random.Random(0)
    with tempfile.TemporaryDirectory() as name:
        for k in range(-warmup, rounds):
            shuffle.shuffle(order)
            for label, call in order:
                for i in range(BURST):
                    # Another prompt comes first, and is not counted, in every round.
                    prompt, seed = PROMPTS[(k + i) % len(PROMPTS)], max(k, 0) * BURST + i
                    spent = measure(t2m, call, prompt, seed, Path(name))
                    if k >= 0 and i > 0:
                        runs[label].append(spent)
    return runs


def summary(runs):
    """Medians and minima of each stage and of the sum that the goal is about, and ratios to one step."""
    out = {}
    for label, rows in runs.items():
        core = [sum(row[stage] for stage in CORE) for row in rows]
        base = [sum(row[stage] for stage in CORE) for row in runs[BASE]]
        stages = {s: [row[s] for row in rows] for s in STAGES} | {"text+sample+decode+joints": core}
        out[label] = {
            "median_ms": {s: round(statistics.median(v), 2) for s, v in stages.items()},
            "min_ms": {s: round(min(v), 2) for s, v in stages.items()},
            "ratio_to_pcm-1": round(statistics.median(a / b for a, b in zip(core, base, strict=True)), 2),
            "frames_per_second": round(196e3 / statistics.median(core)),
        }
    return out


def cold(model, count):
    """Seconds of whole `moveset generate` processes, import to written file."""
    spent = []
    with tempfile.TemporaryDirectory() as name:
        command = [sys.executable, "-m", "moveset.cli", "generate", PROMPTS[0], "--seconds", "9.8", "--model", model]
        for _ in range(count):
            start = time.perf_counter()
            subprocess.run([*command, "-o", str(Path(name) / "clip.bvh")], check=True, capture_output=True)
            spent.append(time.perf_counter() - start)
    return {"median_s": round(statistics.median(spent), 2), "min_s": round(min(spent), 2), "runs": count}


def main():
    """Measure, print a table, and write JSON where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default="motionpcm-small")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--warmup", type=int, default=3, help="rounds that are not counted")
    parser.add_argument("--cold", type=int, default=5, help="cold processes to time")
    parser.add_argument("--json", type=Path, help="file for the results")
    args = parser.parse_args()

    import torch

    from moveset import TextToMotion

    torch.set_num_threads(args.threads)
    t2m = TextToMotion.from_pretrained(args.model, device=args.device)
    results = summary(warm(t2m, args.rounds, args.warmup))
    print(f"{'warm, ms: median (min)':<24}" + "".join(f"{s:>16}" for s in (*STAGES, "core")) + f"{'ratio':>8}")
    for label, row in results.items():
        cells = [
            f"{m:.1f} ({low:.1f})" for m, low in zip(row["median_ms"].values(), row["min_ms"].values(), strict=True)
        ]
        print(f"{label:<24}" + "".join(f"{cell:>16}" for cell in cells) + f"{row['ratio_to_pcm-1']:>8}")
    report = {
        "model": args.model,
        "machine": {"cpu": _cpu(), "cores": os.cpu_count(), "python": platform.python_version()},
        "torch": torch.__version__,
        "threads": args.threads,
        "device": str(t2m.device),
        "rounds": args.rounds,
        "calls": args.rounds * (BURST - 1),
        "warm": results,
    }
    if args.cold:
        report["cold"] = cold(args.model, args.cold)
        print(f"cold process: median {report['cold']['median_s']} s, min {report['cold']['min_s']} s")
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
