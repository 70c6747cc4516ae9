"""Motions as one HTML file that plays them: offline, in any browser, with nothing but itself.

The file holds the player (``viewer/``, 0.6 MB) and its motions as packets (half a kilobyte a frame). It asks for
nothing from anywhere: its Content-Security-Policy allows one script, known by its hash, and no connection at all. What
people wrote (prompts, titles) is data in it, never markup.
"""

import base64
import hashlib
import html
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import torch

from moveset.errors import FormatError, InputError
from moveset.io import Metadata
from moveset.io.limits import (
    MAX_BYTES,
    MAX_JOINT_NAME,
    MAX_JOINTS,
    MAX_NUMBER,
    atomic_write,
    plain_text,
    read_limited,
)
from moveset.io.packets import HEADER, MAGIC, VERSION, frame_rows, pack_packet, skeleton_json, unpack_packets
from moveset.motion.clip import Motion
from moveset.motion.retarget import retarget
from moveset.motion.rigs import as_skeleton
from moveset.motion.skeleton import Skeleton

_OPENS, _CLOSES = '<script type="application/json" id="moveset-page">', "</script>"
_TAIL = f"{_CLOSES}\n</body>\n</html>\n"
FRAMES_BEGIN, FRAMES_END = b', "data": [""\n', b"]}]}]}" + _TAIL.encode()
_FORMAT = 1


@dataclass(frozen=True, eq=False)
class Shown:
    """A motion on a page.

    Args:
        title: what it is called where several are side by side.
        prompts: what was said, and the frame from which on.
    """

    motion: Motion
    title: str = ""
    prompts: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True, eq=False)
class Scene:
    """Motions on one skeleton that are seen side by side.

    Args:
        title: its line in the page's list.
        takes: at least one.
        note: a second, smaller line.
    """

    title: str
    takes: tuple[Shown, ...]
    note: str = ""


def write_html(path: str | Path, scenes: Sequence[Scene], *, title: str = "", metadata: Metadata | None = None) -> Path:
    """Write a page of motions, whole or not at all.

    Args:
        scenes: what can be chosen on it; for one there is no list.
        title: of the page; else that of the first scene.
        metadata: what to remember with it.

    Raises:
        InputError: nothing to show, motions on different skeletons side by side, more than can be read back, or a path
            that cannot be written to.
    """
    return _written(path, [_encoded(html_page(scenes, title=title, metadata=metadata))])


def html_page(scenes: Sequence[Scene], *, title: str = "", metadata: Metadata | None = None) -> str:
    """The text of a page; arguments and errors as for ``write_html``, but for its size and place."""
    if not scenes:
        raise InputError("a page needs at least one motion; give one")
    title = title or scenes[0].title or "Motion"
    page = {
        "format": _FORMAT,
        "title": title,
        "scenes": [_scene(scene) for scene in scenes],
        "metadata": dict(metadata or {}),
    }
    return _page_head(title) + for_script(page) + _TAIL


def save_html(motion: Motion, path: str | Path, *, metadata: Metadata) -> Path:
    """Write a page of one motion; the prompt of its metadata is its title, and ``starts`` when each part of it begins.

    Raises:
        InputError: more than can be read back, or a path that cannot be written to.
    """
    return _written(path, [open_page(motion.skeleton, motion.fps, metadata), *frame_lines(motion), FRAMES_END])


def open_page(skeleton: Skeleton, fps: float, metadata: Metadata) -> bytes:
    """A page of one motion up to its frames, which may come while it is made: ``frame_lines``, then ``FRAMES_END``."""
    title = title_of(metadata)
    page = for_script({"format": _FORMAT, "title": title or "Motion", "metadata": dict(metadata)})
    scene = for_script({"title": title, "note": "", "skeleton": skeleton_json(skeleton)})
    take = for_script({"title": "", "prompts": prompts_of(metadata, fps)})
    begun = f'{page[:-1]}, "scenes": [{scene[:-1]}, "takes": [{take[:-1]}'
    return _encoded(_page_head(title or "Motion") + begun) + FRAMES_BEGIN


def frame_lines(motion: Motion, first_frame: int = 0) -> list[bytes]:
    """A line for each frame, all of one length: a packet in base64."""
    rows, joints = frame_rows(motion), len(motion.skeleton)
    heads = (HEADER.pack(MAGIC, VERSION, joints, 1, first_frame + k, motion.fps, 0.0, 0) for k in range(len(rows)))
    return [b',"' + base64.b64encode(head + row.tobytes()) + b'"\n' for head, row in zip(heads, rows, strict=True)]


def title_of(metadata: Metadata) -> str:
    """A line that says what is seen: the prompts in their order."""
    return str(metadata.get("prompt") or "").replace(" | ", ", then ")


def prompts_of(metadata: Metadata, fps: float) -> list[dict[str, str | int]]:
    """What was said from which frame on; all at once where the metadata do not tell the seconds.

    >>> prompts_of({"prompt": "walk | wave", "starts": "0 | 2.5"}, 20.0)
    [{'text': 'walk', 'firstFrame': 0}, {'text': 'wave', 'firstFrame': 50}]
    """
    texts = str(metadata.get("prompt") or "").split(" | ")
    starts = re.findall(r"\d+(?:\.\d+)?", str(metadata.get("starts") or ""))
    if len(starts) != len(texts):
        texts, starts = [title_of(metadata)], ["0"]
    return [{"text": text, "firstFrame": round(float(s) * fps)} for text, s in zip(texts, starts, strict=True) if text]


def inline_player(motion: Motion) -> str:
    """A frame for notebooks with a page of one motion in it, kept apart from the notebook's own page."""
    page = html.escape(html_page([Scene("", (Shown(motion),))]), quote=True)
    # The script must arrive to the letter whatever encoding the notebook's page has, or its hash is another.
    page = page.encode("ascii", "xmlcharrefreplace").decode()
    return (
        f'<iframe srcdoc="{page}" title="Motion player" sandbox="allow-scripts allow-downloads" allow="fullscreen" '
        'loading="lazy" style="width:100%;height:480px;border:0;border-radius:12px"></iframe>'
    )


def read_html(path: str | Path) -> Motion:
    """The first motion of a page that ``write_html`` made.

    Raises:
        InputError: the file cannot be read.
        FormatError: it is no such page, or a damaged one.
    """
    page = _read_page(path)
    try:
        scene = page["scenes"][0]
        told, data = scene["skeleton"], scene["takes"][0]["data"]
        data = [data] if isinstance(data, str) else data
        packets = b"".join(base64.b64decode(part, validate=True) for part in data)
        joints = tuple(plain_text(name, MAX_JOINT_NAME) for name in told["joints"][:MAX_JOINTS])
        parents = tuple(int(parent) for parent in told["parents"][:MAX_JOINTS])
        offsets = torch.tensor(told["offsets"][:MAX_JOINTS], dtype=torch.float32)
        if not (offsets.abs() <= MAX_NUMBER).all():
            raise ValueError("bones of no length, or of an absurd one")
        skeleton = as_skeleton(plain_text(told["name"], 64), joints, parents, offsets)
    except (LookupError, TypeError, ArithmeticError, ValueError, RuntimeError, AttributeError, InputError) as error:
        raise FormatError(f"{path} is a damaged page of motions; make it again") from error
    return unpack_packets(packets, skeleton=skeleton).motion


def html_metadata(path: str | Path) -> dict[str, Any]:
    """What a page was told to remember.

    Raises:
        InputError: the file cannot be read.
        FormatError: it is no page of motions, or a damaged one.
    """
    found = _read_page(path).get("metadata")
    return found if isinstance(found, dict) else {}


def _page_head(title: str) -> str:
    """The page up to its data: the policy and the player, which looks for data when the page is complete."""
    digest = base64.b64encode(hashlib.sha256(player_script().encode()).digest()).decode()
    policy = f"default-src 'none'; script-src 'sha256-{digest}'; img-src data: blob:; media-src blob:; base-uri 'none'"
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}; form-action \'none\'">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n<meta name="generator" content="moveset">\n'
        f"<title>{html.escape(title)}</title>\n</head>\n<body>\n"
        "<noscript>This page plays motions with JavaScript and WebGL.</noscript>\n"
        f"<script>{player_script()}</script>\n{_OPENS}"
    )


def for_script(value: Any) -> str:
    """JSON that cannot end the element it stands in.

    >>> for_script("</script><!--")
    '"\\\\u003c/script>\\\\u003c!--"'
    """
    return json.dumps(value).replace("<", "\\u003c")


@cache
def player_script() -> str:
    """The player as one classic script, made from ``viewer/``."""
    return (resources.files("moveset") / "viewer" / "player" / "player.js").read_text("utf-8")


def _scene(scene: Scene) -> dict[str, Any]:
    skeletons = [shown.motion.skeleton for shown in scene.takes]
    if not skeletons or any(skeletons[0].order_in(skeleton) is None for skeleton in skeletons):
        raise InputError(f"the scene {scene.title!r} needs motions on one skeleton; retarget them, or make two scenes")
    return {
        "title": scene.title,
        "note": scene.note,
        "skeleton": skeleton_json(skeletons[0]),
        "takes": [
            {
                "title": shown.title,
                "prompts": [{"text": text, "firstFrame": frame} for text, frame in shown.prompts],
                "data": base64.b64encode(pack_packet(retarget(shown.motion, skeletons[0]))).decode(),
            }
            for shown in scene.takes
        ],
    }


def _encoded(page: str) -> bytes:
    # A command line's bytes that are no text come as lone surrogates, which UTF-8 does not know.
    return page.encode("utf-8", "replace")


def _written(path: str | Path, page: Sequence[bytes]) -> Path:
    size = sum(map(len, page))
    if size > MAX_BYTES:
        raise InputError(
            f"{path} would have {size / 2**20:.0f} MB, more than the limit of {MAX_BYTES / 2**20:g} MB; put fewer or "
            "shorter motions on a page"
        )
    with atomic_write(path) as file:
        file.writelines(page)
    return Path(path)


def _read_page(path: str | Path) -> dict[str, Any]:
    text = read_limited(path).decode("utf-8", "replace")
    found = re.search(re.escape(_OPENS) + "(.*?)" + re.escape(_CLOSES), text, re.DOTALL)
    try:
        page = json.loads(found[1]) if found else None
    except (ValueError, RecursionError):
        page = None
    if not isinstance(page, dict) or page.get("format") != _FORMAT:
        raise FormatError(f"{path} is no page of motions, or a damaged one; give one that moveset wrote")
    return page
