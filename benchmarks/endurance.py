"""Does who walks go on walking? Many streams of a sentence, half minute by half minute.

    python benchmarks/endurance.py --out docs/streaming/endurance.json

A stream is told its own past, so it may slide into another manner of what it was told and stay there: a walk that
becomes a shuffle after two minutes. One stream of a sentence (``rollout.py``) may miss that, and so do distances of
short sequences. Of every sentence ``--copies`` streams of ``--minutes``, as users get them. Pace is what the root
travels over the ground within a second, in a straight line; jerk, in m/s³, is how lively those are who stay where they
are. "flagging" is the share of streams whose last half minute has less than 60 % of the median pace of the sentence's
first half minute, or of its jerk where that pace is below 0.3 m/s.
"""

import json
import sys

import torch
from torch import Tensor

from arguments import Parser, at_least, positive, report_path, write_report
from course import FPS, streams
from moveset.errors import exit_code_of
from moveset.motion.measures import jerk_sizes
from moveset.pipelines.stream_bundle import DEFAULT_STREAM, StreamBundle
from moveset.pipelines.stream_settings import check_stream

SENTENCES = (
    "a person walks", "a person walks forward", "someone walks at a normal pace", "a person runs", "an old man walks",
    "a person walks backward", "a person waves with both hands", "a person raises both hands", "a person dances salsa",
    "a person punches",
)  # fmt: skip
TRAVELLING = 0.3
HALF_MINUTE = int(30 * FPS)
FLAGGING = 0.6


def paces(joints_FJ3: Tensor) -> Tensor:
    """Metres a second by half minute."""
    root = joints_FJ3[:, 0, [0, 2]]
    travelled = (root[int(FPS) :] - root[: -int(FPS)]).norm(dim=-1)
    return by_half_minute(travelled)


def by_half_minute(values_F: Tensor) -> Tensor:
    """Means; of what is left at the end if it is half of one or more."""
    parts = values_F.split(HALF_MINUTE)
    return torch.stack([part.mean() for part in parts if len(part) >= HALF_MINUTE // 2])


def measured(clips: list[Tensor]) -> dict[str, object]:
    """Of joints (F, J, 3) of streams of one sentence."""
    pace = torch.stack([paces(joints) for joints in clips])
    jerk = torch.stack([by_half_minute(jerk_sizes(joints, FPS)) for joints in clips])
    judged = pace if pace[:, 0].median() >= TRAVELLING else jerk
    quartiles = torch.quantile(pace, torch.tensor([0.25, 0.5, 0.75], dtype=pace.dtype), dim=0)
    return {
        "streams": len(clips),
        "pace": {
            name: [round(float(value), 2) for value in row]
            for name, row in zip(("lower quartile", "median", "upper quartile"), quartiles, strict=True)
        },
        "last": sorted(round(float(value), 2) for value in pace[:, -1]),
        "jerk": [round(float(value), 1) for value in jerk.median(dim=0).values],
        "last_jerk": sorted(round(float(value), 1) for value in jerk[:, -1]),
        "flagging": round(float((judged[:, -1] < FLAGGING * judged[:, 0].median()).double().mean()), 3),
    }


def main() -> None:
    """See the module."""
    parser = Parser(description=main.__doc__)
    parser.add_argument("--model", default=DEFAULT_STREAM, help="a shipped stream, or a folder")
    parser.add_argument("--networks", nargs="*", default=["pcm-1"])
    parser.add_argument("--sentences", nargs="*", default=list(SENTENCES))
    parser.add_argument("--copies", type=at_least(1), default=24)
    parser.add_argument("--minutes", type=positive, default=5.0)
    parser.add_argument("--out", type=report_path)
    given = parser.parse_args()
    torch.set_num_threads(1)
    bundle, rows = StreamBundle.find(given.model), {}
    for network in given.networks:
        for sentence in given.sentences:
            check_stream(bundle.config, sentence, network=network)
    for network in given.networks:
        for sentence in given.sentences:
            clips = streams(bundle, network, sentence, given.copies, 60 * given.minutes)
            rows[f"{network}: {sentence}"] = found = measured(clips)
            print(f"{network}: {sentence}", json.dumps(found), flush=True)
    if given.out:
        report = {"model": bundle.config.name, "minutes": given.minutes, "rows": rows}
        write_report(given.out, report)


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
