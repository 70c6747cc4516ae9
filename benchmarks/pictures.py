"""The sheets of filmstrips in the documents, of what ships: look at them before they are committed.

    python benchmarks/pictures.py --out docs/images
    python benchmarks/pictures.py --figures --out figures runs/small/models/*      # the papers' qualitative figures

``one-step.png``: sentences in one evaluation each. ``streams-after-four-minutes.png``: the last six seconds of streams
that were told one thing for that long. ``--figures`` draws MotionPCM's Figure 5 with its sentences, and RDM's Figures 4
(its sentence, 245 frames) and 5 (whose sentences are not printed: MotionPCM's) instead, by the models that ship and
those that are given; rows whose weights are not there are named and left out.
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
from moveset.evaluation.suites import chosen_rows
from moveset.io.filmstrip import filmstrip
from moveset.io.limits import atomic_write, make_folder
from moveset.motion.clip import Motion
from moveset.pipelines.generator import Sampler, open_generator
from moveset.pipelines.model_config import DEFAULT_MODEL, DEFAULT_STREAM
from moveset.pipelines.request import Request

CLIPS = (
    "a person walks forward", "a person sits down on a chair", "a person kicks with the right leg", "a person punches",
    "a person crawls", "a person does a cartwheel", "a person picks something up from the floor", "a person dances",
)  # fmt: skip
STREAMS = ("a person walks", "a person stands still", "a person runs")
FIVE = (
    "The rigs walk forward, then turn around, and continue walking before stopping where he started.",
    "A person walks with a limp leg.",
    "A man walks forward a few steps, raise his left hand to his face, then continue walking in a circle.",
)
#: By name: a suite, keys of its rows, sentences, seconds.
FIGURES = {
    "motionpcm-figure-5": ("motionpcm", ("mld", "lcm-1", "pcm-1"), FIVE, 9.8),
    "rdm-figure-4": ("rdm", ("md-7", "rdm-7", "md-4"), ("A person is dribbling with a basketball",), 12.25),
    "rdm-figure-5": ("rdm", ("rdm-1", "light-rdm-1", "motiondiffuse"), FIVE, 9.8),
}
SHOWN = 6.0
SECONDS = 4.0  # of a clip: actions are over by then
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


def figure(name: str, folders: list[Path]) -> Image.Image | None:
    """A figure of the papers, a strip for each sentence and model; None where there are no weights at all."""
    suite, keys, sentences, seconds = FIGURES[name]
    strips: dict[str, list[Image.Image]] = {sentence: [] for sentence in sentences}
    for row, folder, missing in chosen_rows(suite, folders, keys):
        if folder is None:
            print(f"{name}: {row.label}: {missing}", file=sys.stderr)
            continue
        made = open_generator(folder, row.network, Sampler(steps=row.steps, **row.settings), device="cpu")
        frames = round(seconds * made.fps)
        motions = made.generate([Request((sentence,), (frames,), 0) for sentence in sentences])
        for sentence, motion in zip(sentences, motions, strict=True):
            strips[sentence].append(filmstrip(motion, f"{row.label}: {sentence}"))
    every = [strip for of in strips.values() for strip in of]
    return sheet(every) if every else None


def main() -> None:
    """See the module."""
    parser = Parser(description=main.__doc__)
    parser.add_argument("--clips", default=DEFAULT_MODEL, help="a shipped model of clips, or a folder")
    parser.add_argument("--streams", default=DEFAULT_STREAM, help="a shipped stream, or a folder")
    parser.add_argument("--minutes", type=positive, default=4.0)
    parser.add_argument("--out", type=Path, required=True, help="a folder")
    parser.add_argument("--figures", action="store_true", help="the papers' figures instead")
    parser.add_argument("models", type=Path, nargs="*", help="model folders for the figures, besides what ships")
    given = parser.parse_args()
    check_folder(make_folder(given.out))
    torch.set_num_threads(1)
    if given.figures:
        made = {name: figure(name, given.models) for name in FIGURES}
        write({name: picture for name, picture in made.items() if picture}, given.out)
        return
    t2m = TextToMotion.from_pretrained(given.clips, device="cpu")
    pictures = {
        "one-step": sheet([filmstrip(t2m(text, seconds=SECONDS, steps=1, seed=7).motion, text) for text in CLIPS])
    }
    strips = []
    for text in STREAMS:
        stream = MotionStream.from_pretrained(given.streams, prompt=text, seed=3, device="cpu")
        strips.append(filmstrip(last_seconds(stream, given.minutes), text))
    pictures["streams-after-four-minutes"] = sheet(strips)
    write(pictures, given.out)


def write(pictures: dict[str, Image.Image], out: Path) -> None:
    """Pictures by name, as PNG."""
    for name, picture in pictures.items():
        with atomic_write(out / f"{name}.png") as file:
            # A palette: half the size, and nobody sees the difference.
            picture.quantize(256).save(file, format="PNG", optimize=True)
        print(out / f"{name}.png", flush=True)


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
