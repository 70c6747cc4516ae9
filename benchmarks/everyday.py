"""Filmstrips of everyday sentences, to be looked at: does everybody do what is said?

    python benchmarks/everyday.py --out sheets --model runs/small/models/motionpcm-small

``everyday.txt`` has a sentence a line; the second half is in no caption of the corpus, word for word.
"""

import sys
from pathlib import Path

import torch

from arguments import Parser, positive
from moveset import TextToMotion
from moveset.cli.output import check_folder
from moveset.errors import exit_code_of
from moveset.io.filmstrip import filmstrip
from moveset.io.limits import atomic_write, make_folder
from moveset.pipelines.model_config import DEFAULT_MODEL
from pictures import sheet

STRIPS = 8  # on a sheet


def main() -> None:
    """See the module."""
    parser = Parser(description=main.__doc__)
    parser.add_argument("--model", default=DEFAULT_MODEL, help="a shipped model of clips, or a folder")
    parser.add_argument("--solver", default="pcm", help="pcm, lcm or teacher")
    parser.add_argument("--steps", type=int, default=1)
    parser.add_argument("--guidance", type=float, help="the folder's own by default")
    parser.add_argument("--seconds", type=positive, default=5.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sentences", type=Path, default=Path(__file__).with_suffix(".txt"), help="a line each")
    parser.add_argument("--out", type=Path, required=True, help="a folder")
    given = parser.parse_args()
    check_folder(make_folder(given.out))
    torch.set_num_threads(1)
    t2m = TextToMotion.from_pretrained(given.model, device="cpu")
    how = {"solver": given.solver, "steps": given.steps, "guidance": given.guidance, "seed": given.seed}
    sentences = [line for line in given.sentences.read_text().splitlines() if line]
    for first in range(0, len(sentences), STRIPS):
        strips = [
            filmstrip(t2m(text, seconds=given.seconds, **how).motion, text)
            for text in sentences[first : first + STRIPS]
        ]
        path = given.out / f"{given.solver}-{given.steps}-{first // STRIPS}.png"
        with atomic_write(path) as file:
            sheet(strips).quantize(256).save(file, format="PNG", optimize=True)
        print(path, flush=True)


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
