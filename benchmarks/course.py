"""Does a stream keep its course? How fast straight walks turn, how far those who stand wander, and how feet slide.

    python benchmarks/course.py --networks rdm md pcm-1 --corpus data/corpus.safetensors \\
        --out docs/streaming/course.json

Of every sentence ``--copies`` streams of ``--seconds``, as users get them: held without an end, or ``--timed``.
Turning is what the direction in which the root travels within a second changes by, from the first second to the last,
per second: the median of its size, and of itself (left is positive), which tells a stream that sways from one that
circles, and between which values eight of ten are. How far somebody has turned from the first frame to the last is what
the hips have. Real takes of the corpus are measured likewise.
"""

import argparse
import statistics
import sys
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from arguments import Parser, at_least, between, report_path, write_report
from moveset.data.corpus import Corpus
from moveset.errors import exit_code_of
from moveset.motion.measures import jerk, skating
from moveset.motion.skeleton import HML22
from moveset.pipelines.stream_bundle import DEFAULT_STREAM, StreamBundle
from moveset.pipelines.stream_group import StreamGroup
from moveset.pipelines.stream_settings import check_stream

SENTENCES = (
    "a person walks forward",
    "a person walks in a straight line",
    "a person runs",
    "a person walks and turns left",
    "a person walks and turns right",
    "a person stands still",
    "a person waves with both hands",
)
SECONDS = 10.0
FPS = 20.0


def turning(root_F3: Tensor) -> float:
    """Degrees a second, to the left positive, by which a path turns; steps of a second, so that gaits do not count."""
    travelled = (root_F3[int(FPS) :] - root_F3[: -int(FPS)])[:, [0, 2]]
    course_F = torch.atan2(travelled[:, 0], travelled[:, 1])
    return _change(course_F) / ((len(course_F) - 1) / FPS)


def turned(joints_FJ3: Tensor) -> float:
    """Degrees, to the left positive, by which the hips have turned from the first frame to the last."""
    across_F2 = (joints_FJ3[:, HML22.index("left_hip")] - joints_FJ3[:, HML22.index("right_hip")])[:, [0, 2]]
    return _change(torch.atan2(-across_F2[:, 1], across_F2[:, 0]))


def _change(angle_F: Tensor) -> float:
    """Degrees by which an angle in radians changes in all, which may be more than once around."""
    step = angle_F.diff()
    return float(torch.atan2(step.sin(), step.cos()).sum().rad2deg())


def measured(clips: list[Tensor]) -> dict[str, Any]:
    """Of joints (F, J, 3) of each clip, more than a second long."""
    turns = [turning(joints[:, 0]) for joints in clips]
    ends = [turned(joints) for joints in clips]
    away = [float((joints[-1, 0] - joints[0, 0])[[0, 2]].norm()) / (len(joints) / FPS) for joints in clips]
    return {
        "clips": len(clips),
        "turning": round(statistics.median(map(abs, turns)), 2),
        "turning_left": round(statistics.median(turns), 2),
        "turning_left_most": [round(float(torch.tensor(turns).quantile(share)), 2) for share in (0.1, 0.9)],
        "turned": round(statistics.median(ends), 1),
        "turned_most": [round(float(torch.tensor(ends).quantile(share)), 1) for share in (0.1, 0.9)],
        "metres_a_second": round(statistics.median(away), 3),
        "skating": round(statistics.mean(float(skating(joints.float(), FPS)) for joints in clips), 3),
        "jerk": round(statistics.mean(float(jerk(joints.float(), FPS)) for joints in clips), 1),
    }


def streams(
    bundle: StreamBundle,
    network: str,
    sentence: str,
    copies: int,
    seconds: float = SECONDS,
    past_lag: int | None = None,
    timed: bool = False,
) -> list[Tensor]:
    """Joints (F, J, 3) of so many streams of one sentence; ``past_lag`` is the model's own by default.

    Networks that read it are told where in these seconds a segment lies if they are ``timed``.
    """
    request = check_stream(bundle.config, sentence, seconds, network=network, past_lag=past_lag)
    group = StreamGroup(bundle, request.settings, device="cpu")
    lanes = [group.open(sentence, seed) for seed in range(copies)]
    if timed:
        for lane in lanes:
            lane.line = request.timeline
    pieces = [group.advance(lanes) for _ in range(round(seconds * FPS / bundle.config.segment))]
    return [torch.cat([piece[k].segment.motion.joints for piece in pieces]) for k in range(copies)]


def takes(corpus: Corpus) -> dict[str, dict[str, Any]]:
    """Real walks, runs and walks with a turn of three seconds or more."""
    found: dict[str, list[Tensor]] = {"walk": [], "run": [], "walk-turn-left": []}
    for k in corpus.indices(composed=False):
        record = corpus.records[k]
        if record.contents[0] in found and len(record.contents) == 1 and record.frames >= 3 * FPS:
            found[record.contents[0]].append(corpus.motion(k).joints)
    return {f"real: {content}": measured(clips) for content, clips in found.items() if clips}


def main() -> None:
    """See the module."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default=DEFAULT_STREAM, help="a shipped stream, or a folder")
    parser.add_argument("--networks", nargs="*", default=["pcm-1"])
    parser.add_argument("--sentences", nargs="*", default=list(SENTENCES))
    parser.add_argument("--copies", type=at_least(1), default=24)
    parser.add_argument("--seconds", type=between(3, 600), default=SECONDS)
    parser.add_argument("--past-lag", type=at_least(1), help="of rdm; all of its steps tell a finished past clean")
    parser.add_argument("--timed", action="store_true", help="the sentence ends with the seconds")
    parser.add_argument("--corpus", type=Path, help="measure its walks and runs too")
    parser.add_argument("--out", type=report_path)
    given = parser.parse_args()
    torch.set_num_threads(1)
    bundle = StreamBundle.find(given.model)
    for network in given.networks:
        for sentence in given.sentences:
            check_stream(bundle.config, sentence, network=network, past_lag=given.past_lag)
    rows = takes(Corpus.open(given.corpus)) if given.corpus else {}
    for name, row in rows.items():
        print(name, row, flush=True)
    for network in given.networks:
        for sentence in given.sentences:
            made = streams(bundle, network, sentence, given.copies, given.seconds, given.past_lag, given.timed)
            row = measured(made)
            rows[f"{network}: {sentence}"] = row
            print(f"{network}: {sentence}", row, flush=True)
    if given.out:
        asked = {"past_lag": given.past_lag, "timed": given.timed}
        told = {name: value for name, value in asked.items() if value}
        write_report(given.out, {"copies": given.copies, "seconds": given.seconds, **told, "rows": rows})


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
