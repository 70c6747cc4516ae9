"""The panel in the sidebar of the 3-D view (press N)."""

import bpy


class MOVESET_PT_panel(bpy.types.Panel):
    """Prompts, settings, and what to do with them."""

    bl_label = "moveset"
    bl_idname = "MOVESET_PT_panel"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "moveset"

    def draw(self, context: bpy.types.Context) -> None:
        """Lay it out."""
        layout, settings = self.layout, context.scene.moveset
        layout.use_property_split = False
        for k, prompt in enumerate(settings.prompts):
            row = layout.row(align=True)
            row.prop(prompt, "text", text="")
            seconds = row.row(align=True)
            seconds.ui_units_x = 3.5
            seconds.prop(prompt, "seconds", text="")
            row.operator("moveset.prompt_remove", text="", icon="X").index = k
        layout.operator("moveset.prompt_add", icon="ADD")
        column = layout.column(align=True)
        column.use_property_split = True
        column.prop(settings, "steps")
        column.prop(settings, "seed")
        if settings.target == "NEW":
            column.prop(settings, "num")
        column.prop(settings, "rate")
        column.prop(settings, "target")
        big = layout.row()
        big.scale_y = 1.5
        big.operator("moveset.generate", icon="ARMATURE_DATA")
        layout.operator("moveset.import_take", icon="IMPORT")
        layout.operator("moveset.retarget", icon="CON_ARMATURE")
        layout.prop(settings, "server")


def register() -> None:
    """Show the panel."""
    bpy.utils.register_class(MOVESET_PT_panel)


def unregister() -> None:
    """Hide it."""
    bpy.utils.unregister_class(MOVESET_PT_panel)
