"""What the physical measures say of real motion: the values that generated motion is compared with.

    python benchmarks/physical_reference.py --out docs/metrics/physical.json

Takes as they are stored, and as an evaluation sees them (HumanML3D features of them and joints of these);
stored ones by source, too.
Means over takes, each weighing the same, and the median and 95th percentile over takes. Seams are where a stream of
28-frame segments would have them.
"""

import json
import sys
from pathlib import Path

import torch
from torch import Tensor

from arguments import SPLITS, Parser, report_path, write_report
from moveset.data.corpus import Corpus
from moveset.errors import InputError, exit_code_of
from moveset.motion.features import get_codec
from moveset.motion.measures import boundary_jerk, measure, skating

SEGMENT = 28
SHORTEST = 24


def measured(clips: list[Tensor], fps: float) -> dict[str, list[float]]:
    """Each measure of each clip."""
    out: dict[str, list[float]] = {}
    for joints in clips:
        for name, found in measure(joints, fps).items():
            out.setdefault(name, []).append(float(found))
        out.setdefault("skating_window_5", []).append(float(skating(joints, fps, window=5)))
    return out


def seams(clips: list[Tensor], fps: float) -> dict[str, float]:
    """Boundary jerk of all clips that are long enough for a seam: none of them has one there."""
    long = [clip for clip in clips if len(clip) > SEGMENT + 4]
    found = [boundary_jerk(joints, fps, range(SEGMENT, len(joints), SEGMENT)) for joints in long]
    a, b = (float(torch.stack([getattr(one, side) for one in found]).mean()) for side in ("near", "elsewhere"))
    return {"takes": len(long), "near": a, "elsewhere": b, "ratio": a / b}


def summary(clips: list[Tensor], fps: float) -> dict:
    """Mean, median and 95th percentile over clips, by measure."""
    out: dict = {
        "takes": len(clips),
        "minutes": sum(map(len, clips)) / fps / 60,
        "longest_s": max(map(len, clips)) / fps,
    }
    for name, values in measured(clips, fps).items():
        x = torch.tensor(values, dtype=torch.float64)
        out[name] = {"mean": float(x.mean()), "median": float(x.median()), "p95": float(x.quantile(0.95))}
    return out | {"boundary_jerk": seams(clips, fps)}


def rounded(value):
    """Five digits."""
    if isinstance(value, dict):
        return {k: rounded(v) for k, v in value.items()}
    return float(f"{value:.5g}") if isinstance(value, float) else value


def main() -> None:
    """See the module."""
    parser = Parser()
    parser.add_argument("--corpus", type=Path, default=Path("data/corpus.safetensors"))
    parser.add_argument("--splits", nargs="+", choices=SPLITS, default=["train", "val", "test"])
    parser.add_argument("--out", type=report_path)
    given = parser.parse_args()
    corpus, codec = Corpus.open(given.corpus), get_codec("hml")
    rows: dict = {}
    for split in given.splits:
        takes = [k for k in corpus.indices(split, composed=False) if corpus.records[k].frames >= SHORTEST]
        if not takes:
            raise InputError(f"{given.corpus} has no {split} takes of {SHORTEST} or more frames; leave the split out")
        motions = [corpus.motion(k) for k in takes]
        stored = [m.joints for m in motions]
        seen = [codec.joints(codec.encode(m).double()).float() for m in motions]
        sources = [corpus.records[k].source for k in takes]
        for name, clips in (("stored", stored), ("through hml features", seen)):
            rows[f"{split}, {name}"] = summary(clips, codec.fps)
            for source in dict.fromkeys(sources if name == "stored" else ()):
                own = [c for c, s in zip(clips, sources, strict=True) if s == source]
                rows[f"{split}, {name}, {source}"] = summary(own, codec.fps)
    rows = rounded(rows)
    print(json.dumps(rows, indent=1))
    if given.out:
        write_report(given.out, rows)


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
