"""Do clips stop that are told to, does who stands stay, and does who takes steps take as many as are said?

    python benchmarks/stops.py --networks pcm-1 pcm-4 --out docs/training/stops.json

Of every sentence and network ``--copies`` clips of the length that is read from it, feet locked as users get them.
Steps are feet that come down (``motion.footfalls``).
"""

import argparse
import sys
from collections import Counter
from typing import Any

import torch

from arguments import Parser, at_least, report_path, write_report
from moveset.errors import exit_code_of
from moveset.evaluation import physical
from moveset.motion.clip import Motion
from moveset.motion.footfalls import footfalls
from moveset.pipelines.bundle import DEFAULT_MODEL
from moveset.pipelines.request import check_method, check_request
from moveset.pipelines.text_to_motion import TextToMotion

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


def _asked(network: str) -> dict[str, Any]:
    """What a network is called by: "pcm-4" are four steps of "pcm"."""
    solver, _, steps = network.partition("-")
    return {"solver": solver, "steps": int(steps) if steps.isdigit() else None}


def _measured(motions: tuple[Motion, ...]) -> dict[str, Any]:
    pace = [motion.root[:, [0, 2]].diff(dim=0).norm(dim=1) * motion.fps for motion in motions]
    feet = [physical.measure(motion.joints.float(), motion.fps).mean() for motion in motions]
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
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default=DEFAULT_MODEL, help="a shipped model of clips, or a folder")
    parser.add_argument("--networks", nargs="*", default=["pcm-1"])
    parser.add_argument("--sentences", nargs="*", default=list(SENTENCES))
    parser.add_argument("--copies", type=at_least(1), default=24)
    parser.add_argument("--out", type=report_path)
    given = parser.parse_args()
    torch.set_num_threads(1)
    model = TextToMotion.from_pretrained(given.model, device="cpu")
    asked = {network: _asked(network) for network in given.networks}
    for sentence in given.sentences:
        check_request(model.bundle.config, sentence, None, 0, given.copies)
    for method in asked.values():
        check_method(model.bundle.config, method["solver"], method["steps"], None)
    rows = {}
    for network, method in asked.items():
        for sentence in given.sentences:
            row = _measured(model(sentence, num=given.copies, **method).motions)
            rows[f"{network}: {sentence}"] = row
            print(f"{network}: {sentence}", row, flush=True)
    if given.out:
        write_report(given.out, {"copies": given.copies, "rows": rows})


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
