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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import torch

from moveset.errors import FormatError, InputError
from moveset.io.limits import MAX_BYTES, MAX_JOINTS, atomic_write, read_limited
from moveset.io.packets import pack_packet, skeleton_json, unpack_packets
from moveset.motion.clip import Motion
from moveset.motion.rigs import as_skeleton

_OPENS, _CLOSES = '<script type="application/json" id="moveset-page">', "</script>"
_FORMAT = 1


@dataclass(frozen=True, eq=False)
class Shown:
    """A motion on a page.

    Args:
        motion: what moves.
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


def write_html(
    path: str | Path,
    scenes: Sequence[Scene],
    *,
    title: str = "",
    metadata: Mapping[str, str | int | float | None] | None = None,
) -> Path:
    """Write a page of motions, whole or not at all.

    Args:
        path: where to.
        scenes: what can be chosen on it; for one there is no list.
        title: of the page; else that of the first scene.
        metadata: what to remember with it.

    Raises:
        InputError: nothing to show, motions on different skeletons side by side, more than can be read back, or a path
            that cannot be written to.
    """
    # A command line's bytes that are no text come as lone surrogates, which UTF-8 does not know.
    page = html_page(scenes, title=title, metadata=metadata).encode("utf-8", "replace")
    if len(page) > MAX_BYTES:
        raise InputError(
            f"{path} would have {len(page) / 2**20:.0f} MB, more than the limit of {MAX_BYTES / 2**20:g} MB; put fewer "
            "or shorter motions on a page"
        )
    with atomic_write(path) as file:
        file.write(page)
    return Path(path)


def html_page(
    scenes: Sequence[Scene], *, title: str = "", metadata: Mapping[str, str | int | float | None] | None = None
) -> str:
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
    return page_head(title) + for_script(page) + page_tail()


def save_html(motion: Motion, path: str | Path, *, metadata: Mapping[str, str | int | float | None]) -> Path:
    """Write a page of one motion; the prompt of its metadata is its title, and ``starts`` when each part of it begins.

    Raises:
        InputError: as for ``write_html``.
    """
    prompt = str(metadata.get("prompt") or "")
    texts = prompt.split(" | ") if prompt else []
    starts = re.findall(r"[0-9.]+", str(metadata.get("starts") or "0"))
    if len(starts) != len(texts):
        texts, starts = [text for text in (prompt.replace(" | ", ", then "),) if text], ["0"]
    frames = [round(float(start) * motion.fps) for start in starts]
    shown = Shown(motion, prompts=tuple(zip(texts, frames, strict=False)))
    title = prompt.replace(" | ", ", then ")
    return write_html(path, [Scene(title, (shown,))], title=title, metadata=metadata)


def inline_player(motion: Motion, *, height: int = 480) -> str:
    """A frame for notebooks with a page of one motion in it, kept apart from the notebook's own page."""
    page = html.escape(html_page([Scene("", (Shown(motion),))]), quote=True)
    return (
        f'<iframe srcdoc="{page}" title="Motion player" sandbox="allow-scripts allow-downloads" allow="fullscreen" '
        f'loading="lazy" style="width:100%;height:{height}px;border:0;border-radius:12px"></iframe>'
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
        joints = tuple(str(name)[:64] for name in told["joints"][:MAX_JOINTS])
        parents = tuple(int(parent) for parent in told["parents"][:MAX_JOINTS])
        offsets = torch.tensor(told["offsets"][:MAX_JOINTS], dtype=torch.float32)
        skeleton = as_skeleton(str(told["name"])[:64], joints, parents, offsets)
    except (LookupError, TypeError, ValueError, RuntimeError, AttributeError, InputError) as error:
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


def page_head(title: str) -> str:
    """The page up to its data."""
    digest = base64.b64encode(hashlib.sha256(player_script().encode()).digest()).decode()
    policy = f"default-src 'none'; script-src 'sha256-{digest}'; img-src data: blob:; media-src blob:; base-uri 'none'"
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}; form-action \'none\'">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n<meta name="generator" content="moveset">\n'
        f"<title>{html.escape(title)}</title>\n</head>\n<body>\n"
        f"<noscript>This page plays motions with JavaScript and WebGL.</noscript>\n{_OPENS}"
    )


def page_tail() -> str:
    """The page after its data: the player, which finds them."""
    return f"{_CLOSES}\n<script>{player_script()}</script>\n</body>\n</html>\n"


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
    if not skeletons or any(
        skeleton.joints != skeletons[0].joints or not skeleton.offsets.equal(skeletons[0].offsets)
        for skeleton in skeletons
    ):
        raise InputError(f"the scene {scene.title!r} needs motions on one skeleton; retarget them, or make two scenes")
    return {
        "title": scene.title,
        "note": scene.note,
        "skeleton": skeleton_json(skeletons[0]),
        "takes": [
            {
                "title": shown.title,
                "prompts": [{"text": text, "firstFrame": frame} for text, frame in shown.prompts],
                "data": base64.b64encode(pack_packet(shown.motion)).decode(),
            }
            for shown in scene.takes
        ],
    }


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
