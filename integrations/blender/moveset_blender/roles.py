"""Which bone plays which part. A *role* is a joint of hml22 ("left_knee"); ``joint_names`` tells them by names."""

from collections.abc import Sequence

from .joint_names import recognise
from .take import MotionError


def find_roles(bones: Sequence[str], parents: Sequence[int], owner: str = "the armature") -> dict[str, int]:
    """Role -> index of the bone that plays it, by names and tree.

    Args:
        bones: their names, parents before their children.
        parents: index of each bone's parent; -1 where it has none.
        owner: what the bones belong to, for the sentence of the error.

    Raises:
        MotionError: pelvis, hips, knees or ankles are not recognised.
    """
    found = recognise(bones, parents)
    if found.missing:
        raise MotionError(
            f"{owner} has no bone recognisable as {', '.join(found.missing)}; rename its bones, as Mixamo or VRM do"
        )
    return found.roles
