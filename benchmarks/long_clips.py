"""Do clips that are longer than takes of their action keep their pace and their feet?

    python benchmarks/long_clips.py --networks pcm-1 lcm-1 --out docs/training/long-clips.json

Of every sentence, length and network ``--copies`` clips, feet locked as users get them, measured as streams are
(``course.py``).
"""

import argparse
import sys
from typing import Any

import torch

from arguments import Parser, at_least, between, report_path, write_report
from course import measured
from moveset.errors import exit_code_of
from moveset.pipelines.bundle import DEFAULT_MODEL
from moveset.pipelines.request import check_method, check_request
from moveset.pipelines.text_to_motion import TextToMotion

SENTENCES = (
    "a person walks forward",
    "a person runs",
    "an old man walks",
    "a person waves with the left hand",
    "a person raises both hands",
)
SECONDS = (3.0, 4.0, 6.0, 9.8)


def _asked(network: str) -> dict[str, Any]:
    """What a network is called by: "pcm-4" are four steps of "pcm"."""
    solver, _, steps = network.partition("-")
    return {"solver": solver, "steps": int(steps) if steps.isdigit() else None}


def main() -> None:
    """See the module."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", default=DEFAULT_MODEL, help="a shipped model of clips, or a folder")
    parser.add_argument("--networks", nargs="*", default=["pcm-1"])
    parser.add_argument("--sentences", nargs="*", default=list(SENTENCES))
    parser.add_argument("--seconds", nargs="*", type=between(3, 9.8), default=list(SECONDS))
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
            for seconds in given.seconds:
                made = model(sentence, seconds=seconds, num=given.copies, **method)
                row = measured([motion.joints for motion in made.motions])
                rows[f"{network}: {sentence}, {seconds:g} s"] = row
                print(f"{network}: {sentence}, {seconds:g} s", row, flush=True)
    if given.out:
        write_report(given.out, {"copies": given.copies, "rows": rows})


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
