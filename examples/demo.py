"""What ``make demo`` runs: sentences as clips in one, two and four steps, and a stream that turns from one to the next.

All as BVH, GLB, filmstrip and GIF, with timings, and one page, out/index.html, that plays everything. A model folder
for the clips may be given as argument.
"""

import sys
import time
from collections.abc import Mapping
from itertools import islice
from pathlib import Path

import torch

from moveset import Motion, MotionStream, TextToMotion, save
from moveset.io.html import Scene, Shown, write_html

OUT = Path("out")
FILES, PICTURES = ("bvh", "glb"), ("png", "gif")
PROMPTS = {
    "walk": "a person walks forward",
    "sit": "a person sits down on a chair",
    "jump": "a person jumps forward",
    "kick": "a person kicks with the right leg",
    "punch": "a person punches",
    "crawl": "a person crawls",
    "cartwheel": "a person does a cartwheel",
    "pick-up": "a person picks something up from the floor",
}
STREAM = ("a person walks forward", "a person stands still", "a person sits down", "a person stands up")
SEED = 0
SECONDS = 5.0  # of a clip: by themselves some sentences last twice as long as what they tell of


def main() -> None:
    """Make every prompt in every number of steps and print what was made and how long it took."""
    OUT.mkdir(exist_ok=True)
    t2m = TextToMotion.from_pretrained(*sys.argv[1:2])
    # The first call reads weights and warms torch up; it would only blur the table.
    for steps in t2m.bundle.config.steps("pcm"):
        t2m("a person stands", seconds=4.0, steps=steps)
    print(f"{t2m.bundle.config.name}, seed {SEED}; times in ms\n")
    columns = ("text", "sample", "decode", "feet", "files", "pictures")
    print(f"{'file':<10}{'seconds':>8}{'steps':>6}" + "".join(f"{column:>10}" for column in columns) + "  prompt")
    made_files = 0
    scenes = []
    for name, prompt in PROMPTS.items():
        takes = []
        for steps in t2m.bundle.config.steps("pcm"):
            made = t2m(prompt, seconds=SECONDS, steps=steps, seed=SEED)
            spent = [*made.timings_ms.values()]
            spent += [
                write(made.motion, OUT / f"{name}-{steps}", formats, made.metadata) for formats in (FILES, PICTURES)
            ]
            made_files += len(FILES + PICTURES)
            takes.append(Shown(made.motion, f"{steps} step{'s' * (steps > 1)}", ((prompt, 0),)))
            times = "".join(f"{ms:>10.1f}" for ms in spent)
            print(f"{f'{name}-{steps}':<10}{made.seconds:>8.2f}{steps:>6}{times}  {prompt}", flush=True)
            for warning in made.warnings:
                print(f"    note: {warning}")
        scenes.append(Scene(prompt, tuple(takes), "side by side: " + ", ".join(take.title for take in takes)))
    live, files = stream()
    page = write_html(OUT / "index.html", [*scenes, live], title="moveset: what it made just now")
    print(
        f"\n{made_files + files} files in {OUT}/: .bvh and .glb for Blender (File > Import), .png and .gif to look at."
    )
    print(f"All of it plays in one page, offline: open {page.resolve()} in a browser.")
    print("Try your own: .venv/bin/moveset generate 'a person …' -o my.glb")


def stream() -> tuple[Scene, int]:
    """One motion of four sentences, three segments each, and the number of its files."""
    live = MotionStream.from_pretrained(prompt=STREAM, seconds=4.2, seed=SEED)
    segments = list(islice(live, 3 * len(STREAM)))
    spent = sorted(segment.latency_ms for segment in segments)[len(segments) // 2]
    motion = Motion(
        torch.cat([segment.motion.rotations for segment in segments]).float(),
        torch.cat([segment.motion.root for segment in segments]).float(),
        live.codec.fps,
        live.codec.skeleton,
    )
    said = {"prompt": ", then ".join(STREAM), "seed": SEED, "model": live.bundle.config.name}
    write(motion, OUT / "stream", FILES + PICTURES, said)
    seconds = motion.seconds / len(segments)
    speed = f"{spent:.1f} ms a segment of {seconds:.1f} s, {1e3 * seconds / spent:.0f} times as fast as it plays"
    print(f"\nstream: {motion.seconds:.1f} s, {speed}")
    for segment in segments[::3]:
        print(f"    from frame {segment.first_frame}: {segment.prompt}")
    prompts = tuple((segment.prompt, segment.first_frame) for segment in segments[::3])
    return Scene("a stream", (Shown(motion, prompts=prompts),), ", ".join(STREAM)), len(FILES + PICTURES)


def write(
    motion: Motion, stem: Path, formats: tuple[str, ...], metadata: Mapping[str, str | int | float | None]
) -> float:
    """Write a motion in several formats; the milliseconds it took."""
    start = time.perf_counter()
    for suffix in formats:
        save(motion, stem.with_suffix(f".{suffix}"), metadata=metadata)
    return (time.perf_counter() - start) * 1e3


if __name__ == "__main__":
    main()
