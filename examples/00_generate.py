"""A sentence to a file that opens in Blender."""

from moveset import TextToMotion

t2m = TextToMotion.from_pretrained()
motion = t2m("a person does a cartwheel", seconds=4.0, seed=7).motion
motion.save("cartwheel.bvh")
motion.save("cartwheel.glb")
print(f"{len(motion)} frames; the right wrist at the end: {motion.joints[-1, motion.skeleton.index('right_wrist')]}")
