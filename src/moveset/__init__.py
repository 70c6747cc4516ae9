"""Text to human motion on an ordinary computer. This is the public API and nothing else.

>>> import moveset
>>> sorted(moveset.__all__)
['Generation', 'Motion', 'MotionStream', 'Skeleton', 'TextToMotion', 'load', 'save']
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from moveset.io import load, save
    from moveset.motion.clip import Motion
    from moveset.motion.skeleton import Skeleton
    from moveset.pipelines.motion_stream import MotionStream
    from moveset.pipelines.text_to_motion import Generation, TextToMotion

__version__ = "0.1.0"
__all__ = ["Generation", "Motion", "MotionStream", "Skeleton", "TextToMotion", "load", "save"]

_HOME = {
    "Generation": "moveset.pipelines.text_to_motion",
    "Motion": "moveset.motion.clip",
    "MotionStream": "moveset.pipelines.motion_stream",
    "Skeleton": "moveset.motion.skeleton",
    "TextToMotion": "moveset.pipelines.text_to_motion",
    "load": "moveset.io",
    "save": "moveset.io",
}


def __getattr__(name: str) -> Any:
    # Imported when first used: `moveset --help` must not wait for torch.
    if name not in _HOME:
        raise AttributeError(f"module 'moveset' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
