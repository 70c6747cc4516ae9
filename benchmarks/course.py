"""Does who walks get somewhere, straight, and does who turns or waves do it to the side that was said?

    python benchmarks/course.py motionpcm-small rdm-small --corpus data/corpus.safetensors --out course.json

Of every sentence so many motions as users get them, of seeds 0, 1, …, and takes of the corpus that are said to walk or
run. Medians over these, and between which values eight of ten are (``most``):

metres_a_second   from the first second to the last, along the ground
bends             degrees a second by which the way turns, to the left; of steps of a second, so that gaits do not count
turned            degrees by which the hips turn from the first frame to the last, to the left
arms              the left wrist's way beside both wrists', seen from the pelvis
right             the share of motions that go, stand, turn or wave as their sentence says (``EXPECTED``), or, of
                  another sentence that names a side, that are on it (``evaluation.sides``)
over_time         of streams of a minute and more: height, speed of joints, jerk and skating in the first and the last
                  minute, and what they change by in one (``motion.measures.windows``)
"""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import fmean, median
from typing import Any

import torch
from torch import Tensor

from arguments import Parser, at_least, between, report_path, sampled, write_report
from moveset.data.corpus import Corpus
from moveset.errors import exit_code_of
from moveset.evaluation.sides import named_side, on_named_side
from moveset.motion.clip import Motion
from moveset.motion.measures import jerk, skating, windows
from moveset.motion.sides import more_left, turned
from moveset.motion.skeleton import HML22
from moveset.pipelines.generator import Sampler, open_generator
from moveset.pipelines.request import Request

Row = Mapping[str, float]
#: What a motion of each sentence must do to be right.
EXPECTED: dict[str, Callable[[Row], bool]] = {
    "a person walks forward": lambda row: row["metres_a_second"] > 0.5 and abs(row["turned"]) < 30,
    "a person walks in a straight line": lambda row: row["metres_a_second"] > 0.5 and abs(row["turned"]) < 30,
    "a person runs": lambda row: row["metres_a_second"] > 1.5,
    "a person walks and turns left": lambda row: row["turned"] > 30,
    "a person walks and turns right": lambda row: row["turned"] < -30,
    "a person waves with the left hand": lambda row: row["arms"] > 0.6,
    "a person waves with the right hand": lambda row: row["arms"] < 0.4,
    "a person waves with both hands": lambda row: 0.3 < row["arms"] < 0.7,
    "a person stands still": lambda row: row["metres_a_second"] < 0.05 and row["lowest"] > 0.8,
}
TAKES = {"walk": "walks forward", "run": "runs"}


def measured(joints_FJ3: Tensor, fps: float) -> dict[str, float]:
    """Of one motion of more than two seconds."""
    arms = more_left(joints_FJ3[None], torch.tensor([len(joints_FJ3)]), HML22)[0, 0]
    return {
        "metres_a_second": float(_ground(joints_FJ3[-1, 0] - joints_FJ3[0, 0]).norm()) / (len(joints_FJ3) / fps),
        "bends": bends(joints_FJ3[:, 0], fps),
        "turned": turned(joints_FJ3, HML22) * 180 / torch.pi,
        "arms": (1 + float(arms)) / 2,
        "lowest": float(joints_FJ3[:, 0, 1].min()),
        "skating": float(skating(joints_FJ3, fps)),
        "jerk": float(jerk(joints_FJ3, fps)),
    }


def bends(root_F3: Tensor, fps: float) -> float:
    """Degrees a second by which a path turns to the left."""
    second = round(fps)
    travelled = _ground(root_F3[second:] - root_F3[:-second])
    step = torch.atan2(travelled[:, 0], travelled[:, 1]).diff()
    return float(torch.atan2(step.sin(), step.cos()).sum().rad2deg()) / (len(step) / fps)


def _ground(way_3: Tensor) -> Tensor:
    return way_3[..., [0, 2]]


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """Over the motions of a sentence."""
    found: dict[str, Any] = {"motions": len(rows)}
    for name in ("metres_a_second", "bends", "turned", "arms"):
        values = [row[name] for row in rows]
        ends = torch.tensor(values).quantile(torch.tensor([0.1, 0.9])).tolist()
        found[name] = {"median": round(median(values), 3), "most": [round(end, 3) for end in ends]}
    return found | {name: round(fmean(row[name] for row in rows), 3) for name in ("skating", "jerk")}


def made(
    model: str, network: str | None, steps: int | None, sentence: str, copies: int, seconds: float
) -> list[Motion]:
    """Motions of one sentence, seeds from 0 on."""
    generator = open_generator(model, network, Sampler(steps=steps), device="cpu")
    frames = round(seconds * generator.fps)
    return generator.generate([Request((sentence,), (frames,), seed) for seed in range(copies)])


def over_time(motions: Sequence[Motion]) -> dict[str, Any]:
    """How motions of equal length, a minute or more, change: means over them."""
    found = windows(torch.stack([motion.joints.float() for motion in motions]), motions[0].fps)
    minute = round(60 / found.seconds)
    rows = {}
    for name in ("height", "speed", "jerk", "skating"):
        values = getattr(found, name)
        change = {"first": values[:, :minute], "last": values[:, -minute:], "a_minute": found.drift(name)}
        rows[name] = {when: round(float(value.mean()), 4) for when, value in change.items()}
    return rows


def takes(corpus: Corpus, said: str, seconds: float) -> list[dict[str, float]]:
    """Of real clips of that long or longer that one of their sentences says it of, cut to it."""
    rows = []
    for k in corpus.indices(composed=False):
        if any(said in caption for caption in corpus.captions(k)):
            motion = corpus.motion(k)
            if len(motion.joints) >= seconds * motion.fps:
                rows.append(measured(motion.joints[: round(seconds * motion.fps)].float(), motion.fps))
    return rows


def main() -> None:
    """See the module."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "model", nargs="+", help="MODEL, MODEL:NETWORK or MODEL:NETWORK:STEPS; a shipped one, or a folder"
    )
    parser.add_argument("--sentences", nargs="*", default=list(EXPECTED))
    parser.add_argument("--copies", type=at_least(2), default=20)
    parser.add_argument("--seconds", type=between(3, 600), default=5.0)
    parser.add_argument("--corpus", type=Path, help="measure its walks and runs too")
    parser.add_argument("--out", type=report_path)
    given = parser.parse_args()
    torch.set_num_threads(1)
    found: dict[str, Any] = {}

    def note(name: str, row: dict[str, Any]) -> None:
        found[name] = row
        print(name, row, flush=True)

    if given.corpus:
        corpus = Corpus.open(given.corpus)
        for name, said in TAKES.items():
            note(f"takes: {name}", summary(takes(corpus, said, given.seconds)))
    for asked in given.model:
        for sentence in given.sentences:
            motions = made(*sampled(asked), sentence, given.copies, given.seconds)
            rows = [measured(motion.joints.float(), motion.fps) for motion in motions]
            right = {}
            if sentence in EXPECTED:
                right = {"right": fmean(map(EXPECTED[sentence], rows))}
            elif named := named_side(sentence):
                right = {"right": fmean(on_named_side(named, motion.joints.float(), HML22) for motion in motions)}
            longer = {"over_time": over_time(motions)} if given.seconds >= 60 else {}
            note(f"{asked}: {sentence}", summary(rows) | right | longer)
    if given.out:
        write_report(given.out, {"copies": given.copies, "seconds": given.seconds, "rows": found})


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
