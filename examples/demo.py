"""What ``make demo`` runs: a few sentences in one, two and four steps, as BVH, GLB, filmstrip and GIF, with timings.

A model folder may be given as argument.
"""

import sys
import time
from pathlib import Path

from moveset import TextToMotion, save

OUT = Path("out")
FORMATS = ("bvh", "glb", "png", "gif")
PROMPTS = {
    "walk": "a person walks forward",
    "wave": "a person waves with the right hand",
    "run": "someone runs fast",
    "bow": "a person bows politely",
    "kick": "a man kicks with the right leg",
    "dance": "a person is dancing happily",
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
    print(
        f"{'file':<12}{'seconds':>8}{'steps':>6}{'text':>8}{'sample':>8}{'decode':>8}{'feet':>8}{'export':>8}  prompt"
    )
    files = 0
    for name, prompt in PROMPTS.items():
        for steps in t2m.bundle.config.steps("pcm"):
            made = t2m(prompt, steps=steps, seed=SEED)
            start = time.perf_counter()
            for suffix in FORMATS:
                save(made.motion, OUT / f"{name}-{steps}.{suffix}", metadata=made.metadata)
            files += len(FORMATS)
            spent = [*made.timings_ms.values(), (time.perf_counter() - start) * 1e3]
            times = "".join(f"{ms:>8.1f}" for ms in spent)
            print(f"{name + '-' + str(steps):<12}{made.seconds:>8.2f}{steps:>6}{times}  {prompt}")
            for warning in made.warnings:
                print(f"    note: {warning}")
    print(f"\n{files} files in {OUT}/: {', '.join('.' + suffix for suffix in FORMATS)}. Open a .png or a .gif to look,")
    print(
        "a .bvh or a .glb in Blender (File > Import). Try your own: .venv/bin/moveset generate 'a person …' -o my.glb"
    )


if __name__ == "__main__":
    main()
