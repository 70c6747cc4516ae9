"""From a run folder to an evaluator's folder."""

import argparse
import sys
from pathlib import Path

from moveset.data.glove_files import read_glove
from moveset.data.humanml3d import HUMANML3D, KIT
from moveset.errors import exit_code_of
from moveset.evaluation.evaluator import DEFAULT_EVALUATOR, Evaluator, EvaluatorCard
from moveset.text.encoder import get_text_encoder
from moveset.text.glove import GloveWords
from moveset.text.words import TokenWords, Words
from moveset.training import frozen


def pack_evaluator(run: Path, out: Path, name: str = DEFAULT_EVALUATOR) -> Path:
    """Write the evaluator that ``moveset train evaluator`` left in ``run`` to the folder ``out``.

    Raises:
        InputError: there is no checkpoint, or ``out`` cannot be written.
        FormatError: it is damaged.
    """
    found = frozen.load(run, "evaluator_ema")
    task, step = found.task, int(found.path.name.removeprefix("step_"))
    provenance = {"steps": step, "movement": "frozen", "weights_sha256": found.digest}
    kind, _, table = task["words"].partition(":")
    words: Words
    if kind == "glove":
        words, said = GloveWords(*read_glove(Path(table))), kind
    else:
        words, said = TokenWords(get_text_encoder(task["words"]), task["max_words"]), task["words"]
    fps = KIT.fps if task["codec"] == KIT.codec else HUMANML3D.fps
    card = EvaluatorCard(name=name, codec=task["codec"], fps=fps, words=said, provenance=provenance)
    return Evaluator(card, found.module, words).save(out, half=True)


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run", type=Path, default=Path("runs/small/evaluator"))
    parser.add_argument("--name", default=DEFAULT_EVALUATOR)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    print(pack_evaluator(given.run, given.out, given.name))


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
