"""Do clips that are longer than takes of their action keep their pace and their feet?

    python benchmarks/long_clips.py --networks pcm-1 lcm-1 --out docs/training/long-clips.json

Of every sentence, length and network ``--copies`` clips, feet locked as users get them, measured as streams are
(``course.py``).
"""

import sys

from arguments import between, write_report
from clips import makers, parser
from course import measured
from moveset.errors import exit_code_of

SENTENCES = (
    "a person walks forward",
    "a person runs",
    "an old man walks",
    "a person waves with the left hand",
    "a person raises both hands",
)
SECONDS = (3.0, 4.0, 6.0, 9.8)


def main() -> None:
    """See the module."""
    asks = parser(__doc__, SENTENCES)
    asks.add_argument("--seconds", nargs="*", type=between(3, 9.8), default=list(SECONDS))
    given = asks.parse_args()
    rows = {}
    for network, make in makers(given).items():
        for sentence in given.sentences:
            for seconds in given.seconds:
                row = measured([motion.joints for motion in make(sentence, seconds=seconds)])
                rows[f"{network}: {sentence}, {seconds:g} s"] = row
                print(f"{network}: {sentence}, {seconds:g} s", row, flush=True)
    if given.out:
        write_report(given.out, {"copies": given.copies, "rows": rows})


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
