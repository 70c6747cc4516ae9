"""Several sentences follow one another; the clips are joined without a pop, and the feet stay where they stand."""

from moveset import TextToMotion

t2m = TextToMotion.from_pretrained()
made = t2m(
    ["a person walks forward", "a person picks something up", "a person walks backwards"],
    seconds=[3.0, 2.5, 3.0],
    seed=3,
)
made.motion.save("timeline.glb")
print(f"{made.seconds:g} s from {made.network_evaluations} network evaluations")
