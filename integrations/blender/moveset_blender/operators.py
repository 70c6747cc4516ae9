"""What buttons do: generate, import, retarget, and the list of prompts."""

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar

import bpy
from bpy.props import CollectionProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty
from bpy_extras.io_utils import ImportHelper

from . import server
from .armature import pose_same
from .files import read_take
from .retarget import retarget
from .scene import key, leave_modes, make_armature, read_rig, sample_take, scene_fps
from .take import MotionError, Take


class MovesetPrompt(bpy.types.PropertyGroup):
    """One sentence and how long it lasts."""

    text: StringProperty(name="Prompt", default="a person walks forward", maxlen=512)
    seconds: FloatProperty(
        name="Seconds", description="How long; 0 for as long as the sentence needs", default=0.0, min=0.0, max=60.0
    )


class MovesetSettings(bpy.types.PropertyGroup):
    """What the panel shows; kept in the scene."""

    server: StringProperty(name="Server", description="Start it with: moveset serve", default="http://127.0.0.1:8765")
    prompts: CollectionProperty(type=MovesetPrompt)
    steps: IntProperty(name="Steps", description="Network evaluations; 0 for the model's choice", min=0, max=1000)
    seed: IntProperty(name="Seed", description="-1 for another one each time", default=-1, min=-1)
    num: IntProperty(name="Variants", description="How many takes, each on its own armature", default=1, min=1, max=8)
    spacing: FloatProperty(name="Spacing", description="Metres between variants", default=1.5, min=0.0)
    target: EnumProperty(
        name="Onto",
        items=[
            ("NEW", "New armature", "An armature of the take's own joints"),
            ("ACTIVE", "Selected armature", "Retarget to the active armature"),
        ],
    )
    rate: EnumProperty(
        name="Keys",
        items=[
            ("SCENE", "Scene's frames", "A key on every frame of the scene"),
            ("TAKE", "Take's frames", "Keys at the take's own times, between frames of the scene where rates differ"),
            ("SET", "Set scene's rate", "Make the scene run at the take's rate"),
        ],
    )


def place_take(context: bpy.types.Context, take: Take, shift: float = 0.0) -> tuple[bpy.types.Object, list[str]]:
    """Put a take into the scene as the settings say.

    Returns:
        the armature that moves now, and sentences somebody should read.

    Raises:
        MotionError: no armature is selected, or the take does not go onto it.
    """
    settings = context.scene.moveset
    armature = context.active_object
    if settings.target == "ACTIVE" and (armature is None or armature.type != "ARMATURE"):
        raise MotionError("no armature is active; click the character's armature first, or choose New armature")
    if settings.rate == "SCENE":
        take = take.resampled(scene_fps(context.scene))
    leave_modes(context)
    if settings.target == "ACTIVE":
        rig = read_rig(context, armature)
        pose = retarget(take, rig)
    else:
        armature, joints = make_armature(context, take.skeleton, take.title[:40])
        rig = read_rig(context, armature)
        pose = pose_same(replace(take, skeleton=replace(take.skeleton, joints=joints)), rig)
        armature.location.x = shift
    return armature, key(context, armature, rig, pose, take.title, set_fps=settings.rate == "SET")


class MOVESET_OT_generate(bpy.types.Operator):
    """Ask the server for motion and put it into the scene"""

    bl_idname = "moveset.generate"
    bl_label = "Generate"
    bl_options: ClassVar = {"REGISTER", "UNDO"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask in the background; Blender stays usable and Escape gives up."""
        try:
            question = self._question(context)
        except MotionError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self._answer: server.Answer | MotionError | None = None
        self._thread = threading.Thread(target=self._ask, args=(question,), daemon=True)
        self._thread.start()
        self._timer = context.window_manager.event_timer_add(0.1, window=context.window)
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set("moveset: generating; Esc gives up")
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Wait for the answer."""
        if event.type != "ESC" and self._thread.is_alive():
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self._timer)
        context.workspace.status_text_set(None)
        if self._thread.is_alive():
            return {"CANCELLED"}
        return self._finish(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Ask and wait: from scripts and without a window."""
        try:
            self._ask(self._question(context))
        except MotionError as error:
            self._answer = error
        return self._finish(context)

    def _question(self, context: bpy.types.Context) -> dict[str, object]:
        """The arguments of ``server.generate``; read here, since other threads must not touch Blender's data."""
        settings = context.scene.moveset
        prompts = [(p.text.strip(), p.seconds or None) for p in settings.prompts if p.text.strip()]
        if not prompts:
            raise MotionError("there is no prompt; add one and say what the person does")
        if not server.is_this_machine(settings.server) and not bpy.app.online_access:
            raise MotionError("online access is switched off; allow it in Preferences > System, or use a local server")
        return {
            "url": settings.server,
            "prompts": prompts,
            "steps": settings.steps or None,
            "seed": None if settings.seed < 0 else settings.seed,
            "num": 1 if settings.target == "ACTIVE" else settings.num,
        }

    def _ask(self, question: dict[str, object]) -> None:
        try:
            self._answer = server.generate(**question)
        except MotionError as error:
            self._answer = error

    def _finish(self, context: bpy.types.Context) -> set[str]:
        done = told(self, lambda: self._placed(context))
        if done == {"FINISHED"}:
            self.report({"INFO"}, f"seed {', '.join(map(str, self._answer.seeds))}")
        return done

    def _placed(self, context: bpy.types.Context) -> list[str]:
        if isinstance(self._answer, MotionError):
            raise self._answer
        warnings = list(self._answer.warnings)
        for k, (take, seed) in enumerate(zip(self._answer.takes, self._answer.seeds, strict=True)):
            armature, more = place_take(context, take, k * context.scene.moveset.spacing)
            armature["moveset_prompt"], armature["moveset_seed"] = take.title, str(seed)
            warnings += more
        return warnings


def told(operator: bpy.types.Operator, work: Callable[[], list[str]]) -> set[str]:
    """Do what an operator is for, and report its error or its warnings."""
    try:
        warnings = work()
    except MotionError as error:
        operator.report({"ERROR"}, str(error))
        return {"CANCELLED"}
    for warning in warnings:
        operator.report({"WARNING"}, warning)
    return {"FINISHED"}


class MOVESET_OT_import_take(bpy.types.Operator, ImportHelper):
    """Put a take from a file into the scene: packets of a stream or clip (.mvst), or moveset's npz"""

    bl_idname = "moveset.import_take"
    bl_label = "Import take"
    bl_options: ClassVar = {"REGISTER", "UNDO"}
    filename_ext = ".mvst"
    filter_glob: StringProperty(default="*.mvst;*.npz", options={"HIDDEN"})

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Read the chosen file."""
        return told(self, lambda: place_take(context, read_take(self.filepath))[1])


class MOVESET_OT_retarget(bpy.types.Operator):
    """Make the active armature do what the other selected armature does"""

    bl_idname = "moveset.retarget"
    bl_label = "Retarget to active"
    bl_options: ClassVar = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Sample the one, key the other."""
        return told(self, lambda: self._retargeted(context))

    def _retargeted(self, context: bpy.types.Context) -> list[str]:
        target = context.active_object
        others = [o for o in context.selected_objects if o.type == "ARMATURE" and o != target]
        if target is None or target.type != "ARMATURE" or len(others) != 1:
            raise MotionError("select the armature that moves, then Shift-click the one that shall move likewise")
        leave_modes(context)
        take = sample_take(context, others[0])
        rig = read_rig(context, target)
        pose = retarget(take, rig)
        before = context.scene.frame_current
        context.scene.frame_set(round(others[0].animation_data.action.frame_range[0]))
        try:
            return key(context, target, rig, pose, take.title)
        finally:
            context.scene.frame_set(before)


class MOVESET_OT_prompt_add(bpy.types.Operator):
    """Add a sentence that follows the others"""

    bl_idname = "moveset.prompt_add"
    bl_label = "Add prompt"
    bl_options: ClassVar = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """One more, up to what a request may hold."""
        if len(context.scene.moveset.prompts) >= 8:
            self.report({"ERROR"}, "a take has at most 8 prompts; generate the rest as a second take")
            return {"CANCELLED"}
        context.scene.moveset.prompts.add()
        return {"FINISHED"}


class MOVESET_OT_prompt_remove(bpy.types.Operator):
    """Remove this sentence"""

    bl_idname = "moveset.prompt_remove"
    bl_label = "Remove prompt"
    bl_options: ClassVar = {"REGISTER", "UNDO"}
    index: IntProperty()

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Take it off the list."""
        context.scene.moveset.prompts.remove(self.index)
        return {"FINISHED"}


_CLASSES = (
    MovesetPrompt,
    MovesetSettings,
    MOVESET_OT_generate,
    MOVESET_OT_import_take,
    MOVESET_OT_retarget,
    MOVESET_OT_prompt_add,
    MOVESET_OT_prompt_remove,
)


def register() -> None:
    """Make the operators and the settings known to Blender."""
    for kind in _CLASSES:
        bpy.utils.register_class(kind)
    bpy.types.Scene.moveset = PointerProperty(type=MovesetSettings)


def unregister() -> None:
    """Take them back."""
    del bpy.types.Scene.moveset
    for kind in reversed(_CLASSES):
        bpy.utils.unregister_class(kind)
