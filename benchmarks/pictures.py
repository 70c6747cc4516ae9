"""The sheets of filmstrips in the documents, of what ships: look at them before they are committed.

    python benchmarks/pictures.py --out docs/images

``one-step.png``: sentences in one evaluation each. ``streams-after-four-minutes.png``: the last six seconds of streams
that were told one thing for that long.
"""

import math
import sys
from collections import deque
from itertools import chain, islice
from pathlib import Path

import torch
from PIL import Image

from arguments import Parser, positive
from moveset import MotionStream, TextToMotion
from moveset.cli.output import check_folder
from moveset.errors import exit_code_of
from moveset.io.filmstrip import filmstrip
from moveset.io.limits import atomic_write
from moveset.motion.clip import Motion
from moveset.pipelines.model_config import DEFAULT_MODEL, DEFAULT_STREAM

CLIPS = (
    "a person walks forward, then waves with the left hand", "an old man walks forward and turns left",
    "a person runs forward", "a woman raises both hands",
)  # fmt: skip
STREAMS = ("a person walks", "a person waves with both hands", "an old man walks")
SHOWN = 6.0
WIDTH = 1400


def sheet(strips: list[Image.Image]) -> Image.Image:
    """Strips of one width below one another, ``WIDTH`` wide."""
    joined = Image.new("RGB", (strips[0].width, sum(strip.height for strip in strips)))
    top = 0
    for strip in strips:
        joined.paste(strip, (0, top))
        top += strip.height
    return joined.resize((WIDTH, round(WIDTH * joined.height / joined.width)), Image.Resampling.LANCZOS)


def last_seconds(stream: MotionStream, minutes: float) -> Motion:
    """The last ``SHOWN`` seconds of a stream of so many minutes."""
    first = next(stream).motion
    frames, wanted = len(first), int(SHOWN * first.fps)
    pieces = (segment.motion for segment in islice(stream, round(60 * minutes * first.fps / frames)))
    kept = deque(chain((first,), pieces), maxlen=math.ceil(wanted / frames))
    shown = slice(-wanted, None)
    rotations, root = torch.cat([m.rotations for m in kept]), torch.cat([m.root for m in kept])
    return Motion(rotations[shown], root[shown], first.fps, first.skeleton)


def main() -> None:
    """See the module."""
    parser = Parser(description=main.__doc__)
    parser.add_argument("--clips", default=DEFAULT_MODEL, help="a shipped model of clips, or a folder")
    parser.add_argument("--streams", default=DEFAULT_STREAM, help="a shipped stream, or a folder")
    parser.add_argument("--minutes", type=positive, default=4.0)
    parser.add_argument("--out", type=Path, required=True, help="a folder")
    given = parser.parse_args()
    check_folder(given.out)
    torch.set_num_threads(1)
    t2m = TextToMotion.from_pretrained(given.clips, device="cpu")
    pictures = {"one-step": sheet([filmstrip(t2m(text, steps=1, seed=7).motion, text) for text in CLIPS])}
    strips = []
    for text in STREAMS:
        stream = MotionStream.from_pretrained(given.streams, prompt=text, seed=3, device="cpu")
        strips.append(filmstrip(last_seconds(stream, given.minutes), text))
    pictures["streams-after-four-minutes"] = sheet(strips)
    for name, picture in pictures.items():
        with atomic_write(given.out / f"{name}.png") as file:
            # A palette: half the size, and nobody sees the difference.
            picture.quantize(256).save(file, format="PNG", optimize=True)
        print(given.out / f"{name}.png", flush=True)


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
