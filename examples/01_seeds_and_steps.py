"""The same seed gives the same motion; variants differ; more steps cost more, and are not better."""

from moveset import TextToMotion

t2m = TextToMotion.from_pretrained()
four = t2m("a person kicks", seconds=3.0, seed=7, num=4)
third = t2m("a person kicks", seconds=3.0, seed=9)
print("variant 2 of seed 7 is seed 9:", bool((four.motions[2].rotations == third.motion.rotations).all()))

for steps in (1, 2, 4):
    made = t2m("a person runs", seed=7, steps=steps)
    spent = ", ".join(f"{stage} {ms:.1f} ms" for stage, ms in made.timings_ms.items())
    print(f"{steps} steps: {made.seconds:g} s of motion; {spent}")
