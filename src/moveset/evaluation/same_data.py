"""Which data were seen to be the same but for rounding: what two processors built of the same takes.

A corpus is made by floating-point arithmetic, and on another processor the last bits of it are others; so is the
sha256 by which results know it, and no table would hold rows of both. Real motion decides: where the first repeat of
the row that judges it, measured anew, has the same items and texts, and every measure to within ``confirm.RELATIVE``,
the data are taken for the same. It is written down beside the results, as what code gives the same is
(``same_code``).
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

from moveset.errors import FormatError, InputError, exit_code_of
from moveset.evaluation import same_code
from moveset.evaluation.confirm import far
from moveset.evaluation.evaluator import DEFAULT_EVALUATOR
from moveset.evaluation.job import Job, open_session
from moveset.evaluation.protocol import Protocol, run_repeat
from moveset.evaluation.results import REMEDY, head
from moveset.evaluation.suites import REAL
from moveset.io.limits import read_limited
from moveset.io.manifest import json_object

_ALIKE = ("items", "distinct_texts", "labels", "evaluator")


def same_data(folder: Path, data: Path, evaluator: str = DEFAULT_EVALUATOR) -> str:
    """Compare real motion of ``data`` with the result of real motion in a folder of results; what was found.

    Raises:
        InputError: no such result, or data on which real motion measures otherwise.
        FormatError: the result or the data are damaged.
    """
    path = folder / f"{REAL}-test.json"
    if not path.is_file():
        raise InputError(f"{folder} has no {path.name}; evaluate real motion there first")
    there = json_object(read_limited(path), path, REMEDY)
    try:
        before, protocol, first = there["data"]["sha256"], Protocol(**there["protocol"]), there["repeats"][0]
    except (KeyError, TypeError, IndexError) as error:
        raise FormatError(f"{path} is no result of an evaluation ({error!r}); {REMEDY}") from error
    session = open_session(Job(model=REAL, data=data, evaluator=evaluator, protocol=replace(protocol, repeats=1)))
    now = head(session)
    if now["data"]["sha256"] == before:
        return f"{data} is what {path} was measured on"
    if other := [name for name in _ALIKE if now[name] != there[name]]:
        raise InputError(
            f"{data} has other {', '.join(other)} than what {path} was measured on; build that corpus anew"
        )
    if differs := far(first, run_repeat(session, 0)["metrics"]):
        raise InputError(
            f"real motion of {data} measures otherwise than {path} has it ({differs}); these are other data"
        )
    same_code.note_data(folder, before, now["data"]["sha256"], path.stem)
    return f"real motion of {data} measures as {path} has it: the same but for rounding"


def main() -> None:
    """Command line: ``python -m moveset.evaluation.same_data RESULTS/SUITE … --data CORPUS``."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("folders", type=Path, nargs="+", help="folders of a suite's results")
    parser.add_argument("--data", type=Path, default=Path("data/corpus.safetensors"), help="the corpus at hand")
    parser.add_argument("--evaluator", default=DEFAULT_EVALUATOR, help="who judged")
    given = parser.parse_args()
    for folder in given.folders:
        print(same_data(folder, given.data, given.evaluator))


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
