"""One motion in every format, at another frame rate, on another skeleton, and read back."""

from moveset import TextToMotion, load
from moveset.motion.retarget import retarget

motion = TextToMotion.from_pretrained()("a person dances", seconds=4.0, seed=1).motion
for suffix in ("bvh", "glb", "npz", "npy", "png", "gif"):
    print(motion.save(f"dance.{suffix}"))
retarget(motion.resampled(60), "mixamo").save("dance-mixamo.bvh")
print(f"read back: {len(load('dance.bvh'))} frames, {len(load('dance-mixamo.bvh'))} at 60 fps")
