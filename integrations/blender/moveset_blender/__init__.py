"""moveset in Blender: motion from a sentence into the scene, takes from files, retargeting to the armature in use.

Modules that touch Blender are ``scene``, ``operators`` and ``panel``; all others know numpy and the standard library
alone and can be imported, and are tested, without Blender.
"""


def register() -> None:
    """Called by Blender when the add-on is switched on."""
    # Here and not above, so that the mathematics can be imported where there is no bpy.
    from . import operators, panel

    operators.register()
    panel.register()


def unregister() -> None:
    """Called by Blender when the add-on is switched off."""
    from . import operators, panel

    panel.unregister()
    operators.unregister()
