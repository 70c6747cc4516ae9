"""Which joint plays which part: read from a file, and shown with the reasons."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from moveset.errors import FormatError

if TYPE_CHECKING:
    from moveset.motion.clip import Motion

_LARGEST = 2**20


def read_joint_map(path: Path) -> Mapping[str, str]:
    """Role -> name of the joint that plays it ("" for none), from a JSON object such as ``{"left_hip": "Thigh_L"}``.

    Raises:
        InputError: the file cannot be read.
        FormatError: it holds something else.
    """
    from moveset.io.limits import read_limited

    try:
        found = json.loads(read_limited(path, _LARGEST))
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path} is not JSON ({error}); write an object of parts and joints") from error
    if not isinstance(found, dict) or not all(isinstance(name, str | None) for name in found.values()):
        raise FormatError(f'{path} is no object of parts and joints; write one such as {{"left_hip": "Thigh_L"}}')
    return {str(role): name or "" for role, name in found.items()}


def joint_map_text(motion: "Motion") -> str:
    """What was recognised of a body, why, and how it stands; for people.

    Raises:
        InputError: no legs are recognised.
    """
    from moveset.motion.reference import find_reference
    from moveset.motion.rigs import recognised
    from moveset.motion.skeleton import HML22

    skeleton = motion.skeleton
    found, reference = recognised(skeleton), find_reference(motion)
    lines = [f"{skeleton.name}: {len(skeleton)} joints, names: {found.family}; how it stands: {reference.how}"]
    for role in HML22.joints:
        joint = skeleton.joints[found.roles[role]] if role in found.roles else "-"
        lines.append(f"  {role:<15} {joint:<32} {found.reasons.get(role, '')}".rstrip())
    if rest := [name for j, name in enumerate(skeleton.joints) if j not in set(found.roles.values())]:
        lines.append(f"  no part: {', '.join(rest)}")
    return "\n".join(lines)
