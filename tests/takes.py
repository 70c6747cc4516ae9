"""Real takes as motions on their floor, as a corpus has them."""

from moveset.data import bandai_namco, cmu, posture
from moveset.data.takes import TakeRef
from moveset.motion.clip import Motion


def motion_of(ref: TakeRef) -> Motion:
    """The longest clean run of a take of the Bandai-Namco set or of CMU, not levelled."""
    reader = bandai_namco if ref.source.startswith("bandai") else cmu
    run = max(reader.read_take(ref).runs, key=len)
    return posture.on_floor(run.rotations, run.root, posture.floor_of(run.rotations, run.root))
