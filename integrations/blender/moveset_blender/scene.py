"""What ends up in Blender: armatures made and read, actions keyed."""

import bpy
import numpy as np
from mathutils import Vector

from . import quaternions as quat
from .armature import Pose, Rig, bones_of, from_blender, turn_from_blender
from .retarget import facing
from .roles import find_roles
from .take import MotionError, Skeleton, Take


def scene_fps(scene: bpy.types.Scene) -> float:
    """Frames a second of a scene."""
    return scene.render.fps / scene.render.fps_base


def set_scene_fps(scene: bpy.types.Scene, fps: float) -> None:
    """Make a scene run at a rate, whole or not."""
    scene.render.fps = max(1, round(fps))
    scene.render.fps_base = scene.render.fps / fps


def make_armature(
    context: bpy.types.Context, skeleton: Skeleton, name: str
) -> tuple[bpy.types.Object, tuple[str, ...]]:
    """An armature of a skeleton at rest, standing at the world's origin, linked, selected and active.

    Returns:
        it, and its bones' names in the order of the joints: Blender cuts names that are too long for it.
    """
    leave_modes(context)
    bones = bones_of(skeleton)
    armature = bpy.data.objects.new(name, bpy.data.armatures.new(name))
    context.collection.objects.link(armature)
    for other in context.selected_objects:
        other.select_set(False)
    context.view_layer.objects.active = armature
    armature.select_set(True)
    bpy.ops.object.mode_set(mode="EDIT")
    made: list[bpy.types.EditBone] = []
    for j, parent in enumerate(skeleton.parents):
        bone = armature.data.edit_bones.new(skeleton.joints[j])
        bone.head, bone.tail = Vector(bones.heads[j]), Vector(bones.tails[j])
        bone.align_roll(Vector(bones.rolls[j]))
        if parent >= 0:
            bone.parent = made[parent]
        made.append(bone)
    names = tuple(bone.name for bone in made)
    bpy.ops.object.mode_set(mode="OBJECT")
    return armature, names


def leave_modes(context: bpy.types.Context) -> None:
    """Object mode, from whichever mode the active object is in."""
    if context.active_object is not None and context.active_object.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")


def read_rig(context: bpy.types.Context, armature: bpy.types.Object) -> Rig:
    """An armature at rest in the world.

    Raises:
        MotionError: it is scaled differently along its axes, or mirrored.
    """
    context.view_layer.update()
    turn, _ = _turn_and_scale(armature)
    bones = _ordered(armature)
    turns = np.array([turn @ np.array(bone.matrix_local.to_3x3()) for bone in bones]).reshape(-1, 3, 3)
    index = {bone.name: j for j, bone in enumerate(bones)}
    whole = np.array(armature.matrix_world.to_3x3())
    return Rig(
        armature.name,
        tuple(index),
        tuple(index[bone.parent.name] if bone.parent else -1 for bone in bones),
        np.array([whole @ np.array(bone.head_local) for bone in bones]),
        quat.normalize(quat.from_matrix(turns)),
    )


def key(
    context: bpy.types.Context, armature: bpy.types.Object, rig: Rig, pose: Pose, title: str, *, set_fps: bool = False
) -> list[str]:
    """Give an armature a new action that holds a pose, from the scene's current frame on.

    Args:
        set_fps: make the scene run at the pose's rate.

    Returns:
        sentences that somebody should read: what may get in the motion's way.

    Raises:
        MotionError: a bone that has to move cannot.
    """
    mover = armature.data.bones[rig.bones[pose.mover]]
    stiff = [rig.bones[j] for j in pose.turned if not armature.data.bones[rig.bones[j]].use_inherit_rotation]
    if stiff:
        raise MotionError(f"bones that do not inherit rotation: {', '.join(stiff)}; switch it on in their Relations")
    if (mover.parent and mover.use_connect) or not mover.use_local_location:
        raise MotionError(f"the bone {mover.name} cannot travel; make it unconnected, with Local Location on")

    if set_fps:
        set_scene_fps(context.scene, pose.fps)
    moved = {j for k in pose.turned for j in _with_ancestors(rig, k)}
    for j in moved:
        bone = armature.pose.bones[rig.bones[j]]
        bone.matrix_basis.identity()
        bone.rotation_mode = "QUATERNION"
    bound = [rig.bones[j] for j in sorted(moved) if armature.pose.bones[rig.bones[j]].constraints]

    _, scale = _turn_and_scale(armature)
    start = context.scene.frame_current
    frames = start + np.arange(len(pose.path)) * (scene_fps(context.scene) / pose.fps)
    curves = _new_action(armature, title)
    for j, turns in pose.turned.items():
        bone = armature.pose.bones[rig.bones[j]]
        _curve(curves, bone, "rotation_quaternion", frames, turns[:, [3, 0, 1, 2]])
    _curve(curves, armature.pose.bones[mover.name], "location", frames, pose.location / scale)
    context.scene.frame_end = max(context.scene.frame_end, int(np.ceil(frames[-1])))
    return [f"{', '.join(bound)} have constraints, which may override the motion"] if bound else []


def sample_take(context: bpy.types.Context, armature: bpy.types.Object) -> Take:
    """What an armature does in its action, a frame of the scene at a time, as a take on the joints with known names.

    Raises:
        MotionError: no action, bones of unknown names, not upright at rest.
    """
    if not (armature.animation_data and armature.animation_data.action):
        raise MotionError(f"{armature.name} has no action to take over; generate or import motion onto it first")
    scene, before = context.scene, context.scene.frame_current
    first, last = (round(x) for x in armature.animation_data.action.frame_range)
    # It may be moved and turned as a whole: its way begins where it stands at first, the way it looks there.
    scene.frame_set(first)
    try:
        return _sampled(context, armature, range(first, last + 1))
    finally:
        scene.frame_set(before)


def _sampled(context: bpy.types.Context, armature: bpy.types.Object, span: range) -> Take:
    rig = read_rig(context, armature)
    found = find_roles(rig.bones, rig.parents, armature.name)
    look = facing(rig, found)
    role_of = {bone: role for role, bone in found.items()}
    order = sorted(role_of, key=lambda bone: (bone != found["pelvis"], bone))
    joints = tuple(role_of[bone] for bone in order)
    parents = [-1]
    for bone in order[1:]:
        above = next((order.index(a) for a in _with_ancestors(rig, bone)[1:] if a in role_of), 0)
        parents.append(above)
    heads = from_blender(quat.rotate(look, rig.heads[order]))
    skeleton = Skeleton(armature.name, joints, tuple(parents), heads - heads[np.maximum(parents, 0)])

    begun = np.array(armature.matrix_world.translation)
    turns, path = [], []
    for frame in span:
        context.scene.frame_set(frame)
        posed = armature.evaluated_get(context.evaluated_depsgraph_get())
        turn, _ = _turn_and_scale(posed)
        now = [np.array(posed.pose.bones[rig.bones[j]].matrix.to_3x3().normalized()) for j in order]
        turns.append(quat.mul(quat.from_matrix(turn @ np.array(now)), quat.inv(rig.turns[order])))
        path.append(np.array(posed.matrix_world @ posed.pose.bones[rig.bones[order[0]]].head) - begun)
    world = turn_from_blender(quat.mul(quat.mul(look, np.array(turns)), quat.inv(look)))
    local = world.copy()
    local[:, 1:] = quat.mul(quat.inv(world[:, parents[1:]]), world[:, 1:])
    root = from_blender(quat.rotate(look, np.array(path)))
    return Take(skeleton, scene_fps(context.scene), root, quat.normalize(local), armature.name)


def _turn_and_scale(armature: bpy.types.Object) -> tuple[np.ndarray, float]:
    """(3, 3) rotation of an armature in the world, and its scale."""
    whole = np.array(armature.matrix_world.to_3x3())
    scales = np.linalg.norm(whole, axis=0)
    if scales.min() < 1e-6 or scales.max() > 1.001 * scales.min() or np.linalg.det(whole) < 0:
        raise MotionError(f"{armature.name} is scaled unevenly or mirrored; apply its scale (Object > Apply > Scale)")
    return whole / scales, float(scales.mean())


def _ordered(armature: bpy.types.Object) -> list[bpy.types.Bone]:
    """Its bones, parents before their children."""
    return sorted(armature.data.bones, key=lambda bone: len(bone.parent_recursive))


def _with_ancestors(rig: Rig, j: int) -> list[int]:
    line = [j]
    while rig.parents[line[-1]] >= 0:
        line.append(rig.parents[line[-1]])
    return line


def _new_action(armature: bpy.types.Object, title: str) -> bpy.types.bpy_struct:
    """A fresh action on an armature: what its curves and groups belong to. What it did before is kept."""
    data = armature.animation_data or armature.animation_data_create()
    if data.action:
        data.action.use_fake_user = True
    action = bpy.data.actions.new(title[:60])
    data.action = action
    if bpy.app.version < (4, 4, 0):
        return action
    slot = action.slots.new("OBJECT", armature.name)
    data.action_slot = slot
    return action.layers.new("Layer").strips.new(type="KEYFRAME").channelbag(slot, ensure=True)


def _curve(
    curves: bpy.types.bpy_struct, bone: bpy.types.PoseBone, channel: str, frames: np.ndarray, values: np.ndarray
) -> None:
    """Curves of one channel: values (F, n) at frames (F,), straight from key to key."""
    group = curves.groups.get(bone.name) or curves.groups.new(bone.name)
    for i in range(values.shape[1]):
        curve = curves.fcurves.new(bone.path_from_id(channel), index=i)
        curve.group = group
        points = curve.keyframe_points
        points.add(len(frames))
        points.foreach_set("co", np.stack((frames, values[:, i]), axis=1).ravel().astype(np.float32))
        # 1 is LINEAR: with a key on every frame of the take, curved handles could only overshoot.
        points.foreach_set("interpolation", np.ones(len(frames), dtype=np.int32))
        curve.update()
