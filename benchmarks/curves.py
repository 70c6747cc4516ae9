"""The training curves of a folder of runs as one picture and one small JSON, from their ``metrics.jsonl``.

python benchmarks/curves.py --runs runs/small --out results
"""

import json
import sys
from pathlib import Path

import matplotlib

from arguments import Parser, report_path, write_report
from moveset.errors import FormatError, InputError, exit_code_of

matplotlib.use("Agg")
from matplotlib import pyplot as plt

PANELS = {
    "vae": ("train", "loss", "VAE: training loss"),
    "vae ": ("val", "mpjpe_mm", "VAE: val MPJPE (mm, root-aligned)"),
    "decoder": ("val", "mpjpe_mm", "decoder refinement: val MPJPE (mm)"),
    "teacher": ("train", "loss", "teacher: noise prediction MSE"),
    "teacher ": ("val", "loss", "teacher: val MSE (average)"),
    "lcm-1": ("train", "loss", "LCM-1: pseudo-Huber"),
    "pcm-1": ("train", "consistency", "PCM-1: pseudo-Huber"),
    "pcm-1 ": ("train", "discriminator", "PCM-1: discriminator hinge"),
    "lcm-1 ": ("train", "trajectory", "LCM-1: distance to the teacher's whole way"),
    "pcm-1  ": ("train", "trajectory", "PCM-1: distance to the teacher's whole way"),
    "pcm-2 ": ("train", "trajectory", "PCM-2: distance to a phase's whole way"),
    "pcm-4 ": ("train", "trajectory", "PCM-4: distance to a phase's whole way"),
    "pcm-2": ("train", "consistency", "PCM-2: pseudo-Huber"),
    "pcm-4": ("train", "consistency", "PCM-4: pseudo-Huber"),
    "rdm-7": ("train", "error", "RDM-7: error of the clean segment"),
    "rdm-7 ": ("val", "error", "RDM-7: val error (average)"),
    "rdm-7  ": ("train", "flow", "RDM-7: flow's reconstruction"),
    "md-7": ("val", "error", "MD-7: val error (average)"),
    "rdm-student": ("train", "consistency", "RDM student, 1 step: pseudo-Huber"),
    "rdm-student ": ("val", "ema_gap", "RDM student, 1 step: distance to teacher"),
    "movement": ("val", "reconstruction", "evaluator, movement: val L1"),
    "evaluator": ("val", "nearest", "evaluator: val share of sentences nearest to their motion"),
}


def points(path: Path, split: str, name: str) -> list[tuple[int, float]]:
    """(step, value) of one metric."""
    try:
        rows = [json.loads(line) for line in path.read_text().splitlines()]
        return [(row["step"], row[name]) for row in rows if row["split"] == split and name in row]
    except (ValueError, KeyError, TypeError) as error:
        raise FormatError(f"{path} is no log of a training ({error!r}); leave it out") from error


def main() -> None:
    """See the module."""
    parser = Parser()
    parser.add_argument("--runs", type=Path, default=Path("runs/small"))
    parser.add_argument("--out", type=Path, default=Path("results"))
    given = parser.parse_args()
    # Its folder must be one that can be written to.
    report = report_path(str(given.out / "curves.json"))
    logs = {k: given.runs / k.strip() / "metrics.jsonl" for k in PANELS}
    curves = {k: points(logs[k], *PANELS[k][:2]) for k in PANELS if logs[k].is_file()}
    # A training with a setting left off does not log what belongs to it.
    curves = {k: curve for k, curve in curves.items() if curve}
    if not curves:
        raise InputError(f"{given.runs} holds no run with a metrics.jsonl; give a folder of runs")
    figure, axes = plt.subplots(2, -(-len(curves) // 2), figsize=(3.2 * -(-len(curves) // 2), 5), squeeze=False)
    kept = {}
    for axis, (run, curve) in zip(axes.flat, curves.items(), strict=False):
        split, name, title = PANELS[run]
        axis.plot(*zip(*curve, strict=True), lw=1)
        axis.set_title(title, fontsize=8)
        axis.tick_params(labelsize=7)
        axis.grid(alpha=0.3)
        every = max(1, len(curve) // 50)
        kept[f"{run.strip()}/{split}/{name}"] = [[step, round(value, 5)] for step, value in curve[::every]]
    for axis in axes.flat[len(curves) :]:
        axis.set_visible(False)
    figure.tight_layout()
    figure.savefig(given.out / "curves.png", dpi=110)
    write_report(report, kept, indent=None)


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
