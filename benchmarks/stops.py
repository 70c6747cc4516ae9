"""Do clips stop that are told to, does who stands stay, and does who takes steps take as many as are said?

    python benchmarks/stops.py --networks pcm-1 pcm-4 --out docs/training/stops.json

Of every sentence and network ``--copies`` clips of the length that is read from it, feet locked as users get them.
Steps are feet that come down (``motion.footfalls``).
"""

import sys
from collections import Counter
from typing import Any

import torch

from arguments import write_report
from clips import makers, parser
from moveset.errors import exit_code_of
from moveset.motion import measures
from moveset.motion.clip import Motion
from moveset.motion.footfalls import footfalls

SENTENCES = (
    "a person stands still",
    "a person waits",
    "a person walks forward and stops",
    "an old man walks and stops",
    "a person runs and stops",
    "a person walks backwards and stops",
    "a person turns left and stops",
    "a person walks in a circle and stops",
    "a person walks, stops, then walks on",
    "a person takes a step forward",
    "a person takes two steps forward",
    "a person takes three steps forward",
    "a person takes four steps forward",
    "a person takes five steps forward",
    "a person takes six steps forward",
    "a person takes two steps back",
    "a person takes four steps back",
    "an old man takes three steps",
    "a person takes two steps forward and waves with the right hand",
)
_SECOND = 20  # frames


def _measured(motions: tuple[Motion, ...]) -> dict[str, Any]:
    pace = [motion.root[:, [0, 2]].diff(dim=0).norm(dim=1) * motion.fps for motion in motions]
    feet = [measures.measure(motion.joints.float(), motion.fps).mean() for motion in motions]
    taken = Counter(len(footfalls(motion)) for motion in motions)
    return {
        "clips": len(motions),
        "seconds": round(sum(motion.seconds for motion in motions) / len(motions), 2),
        "first_second": round(float(torch.stack([x[:_SECOND].mean() for x in pace]).mean()), 2),
        "last_second": round(float(torch.stack([x[-_SECOND:].mean() for x in pace]).mean()), 3),
        "last_second_most": round(float(torch.stack([x[-_SECOND:].mean() for x in pace]).max()), 3),
        "steps": {str(count): taken[count] for count in sorted(taken)},
        "skating": round(sum(one["skating"] for one in feet) / len(feet), 3),
        "jerk": round(sum(one["jerk"] for one in feet) / len(feet), 1),
    }


def main() -> None:
    """See the module."""
    given = parser(__doc__, SENTENCES).parse_args()
    rows = {}
    for network, make in makers(given).items():
        for sentence in given.sentences:
            row = _measured(make(sentence))
            rows[f"{network}: {sentence}"] = row
            print(f"{network}: {sentence}", row, flush=True)
    if given.out:
        write_report(given.out, {"copies": given.copies, "rows": rows})


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
