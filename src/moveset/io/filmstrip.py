"""A motion on one page: poses side by side."""

import json
import math
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
from PIL import Image, ImageDraw
from PIL.PngImagePlugin import PngInfo

from moveset.errors import FormatError
from moveset.io.limits import atomic_write, read_limited
from moveset.io.render import BACKGROUND, INK, Painter, fitted, font, three_quarter_view
from moveset.motion import rotations
from moveset.motion.clip import Motion

_PANEL = (208, 300)
_HEADER, _FOOTER = 54, 34
_WAYS = "forward", "forward left", "left", "backward left", "backward", "backward right", "right", "forward right"
_RULE, _FAINT = (222, 225, 230), (120, 128, 140)


def filmstrip(motion: Motion, caption: str = "", poses: int = 9) -> Image.Image:
    """The picture: a caption, up to ``poses`` panels from the first frame to the last, and the time of each.

    The left arm and leg are orange, the right ones blue; the floor is tiled in half metres; a violet line on it is the
    way of the last four seconds.
    """
    width, height = _PANEL
    frames = telling_frames(motion, poses)
    painter = Painter(motion, three_quarter_view(motion, width, height, frames=frames), frames)
    sheet = Image.new("RGB", (width * len(frames), _HEADER + height + _FOOTER), BACKGROUND)
    draw = ImageDraw.Draw(sheet)
    for column, frame in enumerate(frames):
        left = column * width
        sheet.paste(painter.frame(column), (left, _HEADER))
        if column:
            draw.line((left, _HEADER + 12, left, _HEADER + height - 12), fill=_RULE)
        label = f"{frame / motion.fps:.2f} s"
        draw.text((left + width / 2, _HEADER + height + 6), label, font=font(15), fill=_FAINT, anchor="ma")
    facts = f"{travel_in_words(motion)} · {len(motion)} frames at {motion.fps:g} fps"
    draw.text((sheet.width - 18, 20), facts, font=font(15), fill=_FAINT, anchor="ra")
    room = sheet.width - 54 - draw.textlength(facts, font=font(15))
    draw.text((18, 14), fitted(caption or "motion", 22, room), font=font(22), fill=INK)
    return sheet


def travel_in_words(motion: Motion) -> str:
    """How far the root gets, in which direction as seen from the first pose, and how far the body turns meanwhile.

    >>> from moveset.motion.skeleton import HML22
    >>> path = torch.tensor([[0.0, 1.0, 0.0], [0.0, 1.0, -2.0]])
    >>> travel_in_words(Motion(rotations.identity(2, 22), path, 20.0, HML22))
    '2.0 m backward'
    """
    first = rotations.heading(motion.rotations[0, 0])
    x, _, z = rotations.rotate(rotations.inv(first), motion.root[-1] - motion.root[0]).tolist()
    distance = math.hypot(x, z)
    words = "on the spot"
    if distance >= 0.3:
        octant = round(math.degrees(math.atan2(x, z)) / 45.0) % 8
        words = f"{distance:.1f} m {_WAYS[octant]}"
    yaw = rotations.heading_angle(motion.rotations[:, 0])
    steps = torch.remainder(yaw.diff() + math.pi, 2 * math.pi) - math.pi
    turn = round(math.degrees(float(steps.sum())) / 5) * 5
    return words if abs(turn) < 30 else f"{words}, turns {abs(turn)}° {'left' if turn > 0 else 'right'}"


def telling_frames(motion: Motion, poses: int) -> list[int]:
    """The first frame, the last, and between them one of each stretch of equal length: that which differs most in pose
    from the one before, so that a kick between two evenly spaced moments is not lost.
    """
    if len(motion) <= poses:
        return list(range(len(motion)))
    upright = rotations.inv(rotations.heading(motion.rotations[:, 0]))
    pose = rotations.rotate(upright[:, None], motion.joints - motion.joints[:, :1])
    chosen = [0]
    for low, high in pairwise(torch.linspace(1, len(motion) - 1, poses - 1).round().long().tolist()):
        apart = (pose[low:high] - pose[chosen[-1]]).norm(dim=-1).mean(dim=-1)
        chosen.append(low + int(apart.argmax()))
    return [*chosen, len(motion) - 1]


def write_filmstrip(motion: Motion, path: str | Path, *, caption: str = "", metadata: str = "") -> None:
    """Write a PNG filmstrip; ``metadata`` (JSON) goes into a text chunk named "moveset".

    Raises:
        InputError: the path cannot be written to.
    """
    info = PngInfo()
    info.add_itxt("moveset", metadata or "{}")
    with atomic_write(path) as file:
        filmstrip(motion, caption).save(file, format="PNG", pnginfo=info)


def filmstrip_metadata(path: str | Path) -> dict[str, Any]:
    """The metadata of a PNG that ``write_filmstrip`` wrote; empty for others.

    Raises:
        InputError: the file cannot be read.
        FormatError: it is no PNG or its metadata is damaged.
    """
    try:
        with Image.open(BytesIO(read_limited(path)), formats=["PNG"]) as picture:
            found = json.loads(picture.info.get("moveset", "{}"))
    except (OSError, ValueError, SyntaxError, RecursionError, Image.DecompressionBombError) as error:
        raise FormatError(f"{path}: it is no PNG with readable metadata ({error}); write it again") from error
    return found if isinstance(found, dict) else {}
