"""What ``make demo`` runs: a few sentences in one, two and four steps, as BVH, GLB, filmstrip and GIF, with timings.

A model folder may be given as argument.
"""

import sys
import time
from pathlib import Path

from moveset import Generation, TextToMotion, save

OUT = Path("out")
FILES, PICTURES = ("bvh", "glb"), ("png", "gif")
PROMPTS = {
    "walk": "a person walks forward",
    "wave": "a person waves with the right hand",
    "run": "a person runs forward",
    "turn": "an old man walks forward and turns left",
    "raise": "a woman raises both hands",
    "walk-wave": "a person walks forward, then waves with the left hand",
}
SEED = 7


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
    for name, prompt in PROMPTS.items():
        for steps in t2m.bundle.config.steps("pcm"):
            made = t2m(prompt, steps=steps, seed=SEED)
            spent = [*made.timings_ms.values()]
            spent += [write(made, OUT / f"{name}-{steps}", formats) for formats in (FILES, PICTURES)]
            made_files += len(FILES + PICTURES)
            times = "".join(f"{ms:>10.1f}" for ms in spent)
            print(f"{f'{name}-{steps}':<10}{made.seconds:>8.2f}{steps:>6}{times}  {prompt}", flush=True)
            for warning in made.warnings:
                print(f"    note: {warning}")
    print(
        f"\n{made_files} files in {OUT}/. Open a .png or a .gif to look, a .bvh or a .glb in Blender (File > Import)."
    )
    print("Try your own: .venv/bin/moveset generate 'a person …' -o my.glb")


def write(made: Generation, stem: Path, formats: tuple[str, ...]) -> float:
    """Write a motion in several formats; the milliseconds it took."""
    start = time.perf_counter()
    for suffix in formats:
        save(made.motion, stem.with_suffix(f".{suffix}"), metadata=made.metadata)
    return (time.perf_counter() - start) * 1e3


if __name__ == "__main__":
    main()
