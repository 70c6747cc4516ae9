"""Run by a Python that has bpy: import a file into Blender and write the joints' world positions, frame by frame.

Arguments: the .glb or .bvh, a JSON list of joint names, frames a second, where to write an npy (F, J, 3), metres, Y up.
"""

import json
import sys

import numpy as np


def main(source, names, fps, target):
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = round(float(fps))
    if source.endswith(".bvh"):
        bpy.ops.import_anim.bvh(filepath=source, global_scale=0.01, axis_forward="-Z", axis_up="Y")
    else:
        bpy.ops.import_scene.gltf(filepath=source)
    armature = next(thing for thing in bpy.data.objects if thing.type == "ARMATURE")
    first, last = (round(x) for x in armature.animation_data.action.frame_range)
    frames = []
    for frame in range(first, last + 1):
        scene.frame_set(frame)
        posed = armature.evaluated_get(bpy.context.evaluated_depsgraph_get())
        heads = [posed.matrix_world @ posed.pose.bones[name].head for name in json.loads(names)]
        # Blender is Z up and shows what faces +Z in glTF as facing -Y.
        frames.append([(p.x, p.z, -p.y) for p in heads])
    np.save(target, np.array(frames))
    if source.endswith(".glb"):
        for thing in [t for t in bpy.data.objects if t.name.startswith("Icosphere")]:
            bpy.data.objects.remove(thing)
        bpy.ops.export_scene.gltf(filepath=target.replace(".npy", "-again.glb"), export_format="GLB")


if __name__ == "__main__":
    main(*sys.argv[1:])
