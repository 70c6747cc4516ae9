"""Run by a Python that has bpy: put takes into a scene with the add-on and write what Blender then shows.

Arguments: the add-on's parent folder, a folder with the takes and for the results, the address of a server or "".
Writes joints.npz (name -> heads in the world, metres, Blender's axes) and said.json (name -> what was reported).
"""

import json
import math
import sys
from pathlib import Path

import numpy as np


def heads(armature, joints, frames):
    """(F, J, 3) heads of an armature's bones in the world."""
    import bpy

    seen = []
    for frame in frames:
        whole = math.floor(frame + 1e-6)
        bpy.context.scene.frame_set(whole, subframe=max(0.0, frame - whole))
        posed = armature.evaluated_get(bpy.context.evaluated_depsgraph_get())
        seen.append([tuple(posed.matrix_world @ posed.pose.bones[joint].head) for joint in joints])
    return np.array(seen)


def character(name, source, seed, place, size=1.0):
    """An armature with the joints of a take, bones along other directions, in a scaled and turned object."""
    import bpy
    from mathutils import Matrix, Vector
    from moveset_blender.armature import bones_of

    bones, skeleton = bones_of(source.skeleton), source.skeleton
    random = np.random.default_rng(seed)
    armature = bpy.data.objects.new(name, bpy.data.armatures.new(name))
    bpy.context.collection.objects.link(armature)
    bpy.context.view_layer.objects.active = armature
    # As an FBX comes in: Y up and centimetres inside, turned and scaled outside.
    inside = Matrix.Rotation(math.radians(-90), 3, "X") * (100.0 * size)
    bpy.ops.object.mode_set(mode="EDIT")
    made = []
    for j, parent in enumerate(skeleton.parents):
        bone = armature.data.edit_bones.new(skeleton.joints[j])
        bone.head = inside @ Vector(bones.heads[j])
        bone.tail = bone.head + 7.0 * Vector(random.normal(size=3)).normalized()
        bone.roll = random.uniform(-3, 3)
        bone.parent = made[parent] if parent >= 0 else None
        made.append(bone)
    bpy.ops.object.mode_set(mode="OBJECT")
    armature.matrix_world = (
        Matrix.Translation(place[:3])
        @ Matrix.Rotation(place[3], 4, "Z")
        @ Matrix.Rotation(math.radians(90), 4, "X")
        @ Matrix.Scale(0.01, 4)
    )
    return armature


def activate(*armatures):
    """Select armatures; the last one is active."""
    import bpy

    for thing in bpy.context.selected_objects:
        thing.select_set(False)
    for armature in armatures:
        armature.select_set(True)
    bpy.context.view_layer.objects.active = armatures[-1]


def main(parent, folder, url):
    import bpy

    sys.path.insert(0, parent)
    import moveset_blender
    from moveset_blender.armature import to_blender
    from moveset_blender.files import read_take
    from moveset_blender.hml22 import HML22
    from moveset_blender.scene import sample_take

    folder = Path(folder)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    moveset_blender.register()
    scene, settings = bpy.context.scene, bpy.context.scene.moveset
    shown, said = {}, {"version": bpy.app.version_string}

    def attempt(name, operator, **arguments):
        try:
            said[name] = sorted(operator(**arguments))
        except RuntimeError as error:
            said[name] = str(error)

    # The take's own rate, between frames of the scene, and on frames of the scene.
    for rate, fps in (("SET", 24), ("TAKE", 24), ("SCENE", 30)):
        scene.render.fps, scene.render.fps_base, settings.rate = fps, 1.0, rate
        scene.frame_set(5)
        attempt(f"import {rate}", bpy.ops.moveset.import_take, filepath=str(folder / "walk.npz"))
        armature, take = bpy.context.active_object, read_take(folder / "walk.npz")
        said[f"fps {rate}"] = scene.render.fps / scene.render.fps_base
        said[f"end {rate}"] = scene.frame_end
        step = scene.render.fps / take.fps if rate != "SCENE" else 1.0
        count = len(take.root) if rate != "SCENE" else len(take.resampled(30).root)
        shown[rate] = heads(armature, take.skeleton.joints, 5 + step * np.arange(count))
    scene.render.fps, settings.rate = 20, "SCENE"
    for name in ("stream.mvst", "mixamo.npz", "ue5.npz"):
        scene.frame_set(1)
        attempt(name, bpy.ops.moveset.import_take, filepath=str(folder / name))
        take = read_take(folder / name)
        shown[name] = heads(bpy.context.active_object, take.skeleton.joints, 1 + np.arange(len(take.root)))
    curves = bpy.context.active_object
    said["bones"] = {
        bone.name: [*bone.matrix_local.col[1][:3], *bone.matrix_local.col[2][:3]] for bone in curves.data.bones
    }

    # Onto somebody's character, and from an armature onto another.
    scene.frame_set(1)
    settings.target = "ACTIVE"
    for name in ("mixamo", "ue5"):
        rig = read_take(folder / f"{name}.npz")
        scene.frame_set(1)
        hero = character(f"Hero {name}", rig, 3, (2.0, -1.0, 0.0, 0.7), 1.3)
        activate(hero)
        attempt(f"onto {name}", bpy.ops.moveset.import_take, filepath=str(folder / "stream.mvst"))
        shown[f"onto {name}"] = heads(hero, rig.skeleton.joints, 1 + np.arange(60))
    sampled = sample_take(bpy.context, hero)
    said["sampled"] = [sampled.fps, len(sampled.root)]
    rig = read_take(folder / "mixamo.npz")
    other = character("Other", rig, 4, (0.0, 0.0, 0.0, 0.0))
    activate(hero, other)
    scene.frame_set(9)
    attempt("retarget", bpy.ops.moveset.retarget)
    shown["retarget"] = heads(other, rig.skeleton.joints, 1 + np.arange(60))
    before = other.animation_data.action
    attempt("again", bpy.ops.moveset.import_take, filepath=str(folder / "stream.mvst"))
    said["kept"] = before.use_fake_user and other.animation_data.action != before

    # The way of an armature that is moved and turned as a whole, whatever frame the scene is at.
    settings.target = "NEW"
    scene.frame_set(1)
    bpy.ops.moveset.import_take(filepath=str(folder / "stream.mvst"))
    whole = bpy.context.active_object
    for frame, aside, turn in ((1, 2.0, 0.0), (60, 5.0, 1.2)):
        whole.location.x, whole.rotation_euler.z = aside, turn
        whole.keyframe_insert("location", frame=frame)
        whole.keyframe_insert("rotation_euler", frame=frame)
    scene.frame_set(40)
    sampled = sample_take(bpy.context, whole)
    said["frame"] = scene.frame_current
    shown["moved"] = heads(whole, sampled.skeleton.joints, 1 + np.arange(60))
    shown["moved, sampled"] = to_blender(sampled.world()[1]) + np.array((2.0, 0.0, 0.0))
    # Blender cuts long names.
    scene.frame_set(1)
    attempt("long", bpy.ops.moveset.import_take, filepath=str(folder / "long.npz"))
    take = read_take(folder / "long.npz")
    joints = [joint.encode()[:63].decode() for joint in take.skeleton.joints]
    shown["long"] = heads(bpy.context.active_object, joints, 1 + np.arange(len(take.root)))
    settings.target = "ACTIVE"

    # What goes wrong.
    empty = bpy.data.objects.new("Empty", bpy.data.armatures.new("Empty"))
    bpy.context.collection.objects.link(empty)
    activate(empty)
    settings.rate, scene.render.fps = "SET", 24
    attempt("empty", bpy.ops.moveset.import_take, filepath=str(folder / "stream.mvst"))
    said["fps left"] = scene.render.fps
    settings.rate, scene.render.fps = "SCENE", 20
    activate(other)
    attempt("alone", bpy.ops.moveset.retarget)
    hero.scale = (0.01, 0.02, 0.01)
    activate(hero)
    attempt("uneven", bpy.ops.moveset.import_take, filepath=str(folder / "stream.mvst"))
    hero.scale = (0.01, 0.01, 0.01)
    other.pose.bones["mixamorig:LeftLeg"].constraints.new("COPY_ROTATION")
    other.data.bones["mixamorig:RightArm"].use_inherit_rotation = False
    activate(other)
    attempt("stiff", bpy.ops.moveset.import_take, filepath=str(folder / "stream.mvst"))
    attempt("no file", bpy.ops.moveset.import_take, filepath=str(folder / "gone.mvst"))
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    bpy.context.collection.objects.link(camera)
    activate(camera)
    attempt("camera", bpy.ops.moveset.import_take, filepath=str(folder / "stream.mvst"))
    attempt("no prompt", bpy.ops.moveset.generate)

    # From a server.
    settings.target, settings.seed, settings.num, settings.steps = "NEW", 5, 2, 1
    bpy.ops.moveset.prompt_add()
    bpy.ops.moveset.prompt_add()
    settings.prompts[0].text, settings.prompts[0].seconds = "a person walks forward", 2.0
    settings.prompts[1].text, settings.prompts[1].seconds = "someone waves with the left hand", 1.5
    settings.server = "http://127.0.0.1:9"
    attempt("no server", bpy.ops.moveset.generate)
    settings.server = "http://192.0.2.1:8765"
    attempt("elsewhere", bpy.ops.moveset.generate)
    if url:
        settings.server = url
        scene.frame_set(1)
        there = set(bpy.data.objects)
        attempt("generate", bpy.ops.moveset.generate)
        new = sorted(set(bpy.data.objects) - there, key=lambda thing: thing.location.x)
        for k, armature in enumerate(new):
            said[f"seed {k}"] = armature["moveset_seed"]
            shown[f"generated {k}"] = heads(armature, HML22.joints, 1 + np.arange(70))
        settings.steps = 3
        attempt("three steps", bpy.ops.moveset.generate)
    bpy.ops.moveset.prompt_remove(index=0)
    said["prompts"] = [prompt.text for prompt in settings.prompts]
    moveset_blender.unregister()
    np.savez(folder / "joints.npz", **shown)
    (folder / "said.json").write_text(json.dumps(said))


if __name__ == "__main__":
    main(*sys.argv[1:])
