"""Warnings on sentences that set nothing: how many known actions are warned of, and how many unknown ones are not.

    python benchmarks/familiarity.py --out docs/metrics/familiarity.json

``familiarity.txt`` has a sentence a line, behind "+" where the corpus shows that action, told in other words, and
behind "-" where it does not.
"""

import sys
from pathlib import Path
from typing import Any

from arguments import Parser, report_path, write_report
from moveset.errors import exit_code_of
from moveset.pipelines.model_config import DEFAULT_MODEL, ClipConfig
from moveset.pipelines.model_folder import ModelFolder
from moveset.pipelines.warnings import unfamiliar
from moveset.text.encoder import get_text_encoder


def main() -> None:
    """See the module."""
    parser = Parser(description=main.__doc__)
    parser.add_argument("--model", default=DEFAULT_MODEL, help="a shipped model of clips, or a folder")
    parser.add_argument("--sentences", type=Path, default=Path(__file__).with_suffix(".txt"))
    parser.add_argument("--out", type=report_path, required=True)
    given = parser.parse_args()
    folder: ModelFolder[Any] = ModelFolder.open(given.model, ClipConfig)
    encoder = get_text_encoder(folder.config.text_encoder)
    wrong: dict[str, list[str]] = {"false": [], "missed": []}
    count = {"+": 0, "-": 0}
    for line in given.sentences.read_text().splitlines():
        kind, sentence = line.split(" ", 1)
        count[kind] += 1
        warned = unfamiliar(folder, (sentence,), encoder.encode([sentence]).pooled)
        if bool(warned) == (kind == "+"):
            wrong["false" if warned else "missed"].append(sentence)
            print(f"{kind} {sentence}{': ' + warned[0] if warned else ''}")
    print(f"{len(wrong['false'])} of {count['+']} known warned of, {len(wrong['missed'])} of {count['-']} unknown not")
    write_report(given.out, {"model": folder.config.name, "known": count["+"], "unknown": count["-"], **wrong})


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
