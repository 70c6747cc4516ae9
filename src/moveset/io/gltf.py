"""glTF 2.0: writing a skinned body with its animation, or a VRM animation; ``gltf_reader`` reads. F frames, J joints.

The tracks of the animation end the file, so that they can be streamed: F times, F rotations of every joint in turn,
F root positions, all float32. Everything before them follows from the skeleton and F alone: ``glb_head``.
"""

import base64
import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from moveset.io.body_mesh import Mesh, body_meshes
from moveset.io.glb import COMPONENTS, WIDTHS
from moveset.io.limits import atomic_write
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.retarget import retarget
from moveset.motion.skeleton import Skeleton

_VRMA = "VRMC_vrm_animation"

# glTF colours are linear: about the tones of the pictures.
_COLOURS = {
    "trunk": (0.68, 0.66, 0.61),
    "left": (0.78, 0.20, 0.09),
    "right": (0.05, 0.24, 0.50),
    "face": (0.04, 0.05, 0.07),
}
_FLOAT = 5126
_CODES = {np.dtype(kind): code for code, kind in COMPONENTS.items()}
_VERTICES, _INDICES = 34962, 34963


class _Builder:
    """Collects accessors, the bytes of those that are given, and the size of all."""

    def __init__(self) -> None:
        self.accessors: list[dict[str, Any]] = []
        self.views: list[dict[str, Any]] = []
        self.data = bytearray()
        self.size = 0

    def track(self, count: int, kind: str, **more: object) -> int:
        """Add one float32 accessor whose bytes follow all that are given, to be written by whoever has them."""
        begin = self.size + -self.size % 4
        self.size = begin + 4 * WIDTHS[kind] * count
        return self._add({"byteOffset": begin, "byteLength": self.size - begin}, _FLOAT, count, kind, more)

    def accessor(self, values: np.ndarray, kind: str, target: int | None = None, **more: object) -> int:
        """Add one accessor in a view of its own; ``values`` has the bytes' own type."""
        self.data += b"\0" * (-len(self.data) % 4)
        view = {"byteOffset": len(self.data), "byteLength": values.nbytes} | ({"target": target} if target else {})
        self.data += np.ascontiguousarray(values).tobytes()
        self.size = len(self.data)
        return self._add(view, _CODES[values.dtype], len(values), kind, more)

    def _add(self, view: dict[str, int], component: int, count: int, kind: str, more: Mapping[str, object]) -> int:
        self.views.append({"buffer": 0, **view})
        accessor = {"bufferView": len(self.views) - 1, "componentType": component, "count": count, "type": kind}
        self.accessors.append({**accessor, **more})
        return len(self.accessors) - 1


def write_glb(
    motion: Motion, path: str | Path, *, metadata: Mapping[str, object] | None = None, body: bool = True
) -> None:
    """Write a motion as a GLB file: joints by name, a body skinned to them, one animation in seconds.

    At rest the joints' axes are the world's and the body stands on the floor. Every joint has a linear rotation
    channel, the root one of translation. ``metadata``, the frame rate and the skeleton's name go into
    ``asset.extras.moveset``. Without a body it is a VRM animation.

    Raises:
        InputError: the path cannot be written to.
    """
    head = glb_head(motion.skeleton, motion.fps, len(motion), metadata or {}, body=body)
    with atomic_write(path) as file:
        file.write(head)
        file.write(_tracks(motion))


def write_gltf(motion: Motion, path: str | Path, *, metadata: Mapping[str, object] | None = None) -> None:
    """Write a motion as ``write_glb`` does, but as JSON with the binary data in it, in base64.

    Raises:
        InputError: the path cannot be written to.
    """
    document, given = _document(motion.skeleton, motion.fps, len(motion), metadata or {})
    data = base64.b64encode(given + _tracks(motion)).decode()
    document["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{data}"
    with atomic_write(path) as file:
        file.write(_json(document))


def write_vrma(motion: Motion, path: str | Path, *, metadata: Mapping[str, object] | None = None) -> None:
    """Write a motion as a VRM animation (VRMC_vrm_animation 1.0): the bones of a VRM humanoid, without a body.

    Raises:
        InputError: the path cannot be written to, or the skeleton cannot be retargeted to VRM's bones.
    """
    write_glb(retarget(motion, "vrm"), path, metadata=metadata, body=False)


def _tracks(motion: Motion) -> bytes:
    """Times, rotations joint by joint, root positions."""
    # Neighbouring keys in one hemisphere: not every player takes the short way by itself.
    turns = rotations.unroll(motion.rotations).numpy().astype(np.float32)
    root = motion.root.numpy().astype(np.float32)
    return key_times(0, len(motion), motion.fps).tobytes() + turns.transpose(1, 0, 2).tobytes() + root.tobytes()


def key_times(first: int, count: int, fps: float) -> np.ndarray:
    """Times of some frames in seconds, float32."""
    return (np.arange(first, first + count) / fps).astype(np.float32)


def glb_head(
    skeleton: Skeleton, fps: float, frames: int, metadata: Mapping[str, object], *, body: bool = True
) -> bytes:
    """The bytes of a GLB file up to its tracks, of which ``frames * (16 + 16 J)`` bytes must follow.

    Without a body it is a VRM animation.
    """
    document, given = _document(skeleton, fps, frames, metadata, body=body)
    tree = _json(document)
    tree += b" " * (-len(tree) % 4)
    size = document["buffers"][0]["byteLength"]
    return b"".join(
        (
            struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(tree) + 8 + size),
            struct.pack("<I4s", len(tree), b"JSON") + tree,
            struct.pack("<I4s", size, b"BIN\0") + given,
        )
    )


def _json(document: Mapping[str, object]) -> bytes:
    return json.dumps(document, separators=(",", ":")).encode()


def _document(
    skeleton: Skeleton, fps: float, frames: int, metadata: Mapping[str, object], *, body: bool = True
) -> tuple[dict[str, Any], bytes]:
    """The JSON tree, and the bytes of the buffer up to the tracks."""
    out = _Builder()
    rest = skeleton.rest_positions.numpy()
    stand = np.array((0.0, -float(rest[:, 1].min()), 0.0), dtype=np.float32)
    nodes: list[dict[str, Any]] = [
        {"name": name, "translation": (skeleton.offsets[j].tolist() if j else stand.tolist())}
        | ({"children": list(skeleton.children[j])} if skeleton.children[j] else {})
        for j, name in enumerate(skeleton.joints)
    ]
    more: dict[str, Any] = {}
    if body:
        nodes.append({"name": "Body", "mesh": 0, "skin": 0})
        more = _skinned(out, skeleton, rest, stand)
    else:
        bones = {name: {"node": j} for j, name in enumerate(skeleton.joints)}
        more["extensions"] = {_VRMA: {"specVersion": "1.0", "humanoid": {"humanBones": bones}}}
        more["extensionsUsed"] = [_VRMA]
    animation = _animation(out, len(skeleton), frames, fps, str(metadata.get("prompt", "motion"))[:60])
    extras = {**metadata, "fps": fps, "skeleton": skeleton.name}
    document = {
        "asset": {"version": "2.0", "generator": "moveset", "extras": {"moveset": extras}},
        "scene": 0,
        "scenes": [{"name": "Scene", "nodes": [0, len(skeleton)] if body else [0]}],
        "nodes": nodes,
        **more,
        "animations": [animation],
        "accessors": out.accessors,
        "bufferViews": out.views,
        "buffers": [{"byteLength": out.size}],
    }
    return document, bytes(out.data) + b"\0" * (-len(out.data) % 4)


def _skinned(out: _Builder, skeleton: Skeleton, rest: np.ndarray, stand: np.ndarray) -> dict[str, Any]:
    bind = np.tile(np.eye(4, dtype=np.float32), (len(skeleton), 1, 1))
    bind[:, 3, :3] = -(rest + stand)  # column-major, so the translation is the last row here
    skin = {
        "name": skeleton.name,
        "joints": list(range(len(skeleton))),
        "skeleton": 0,
        "inverseBindMatrices": out.accessor(bind, "MAT4"),
    }
    meshes = body_meshes(skeleton)
    materials = []
    for tone in meshes:
        paint = {"baseColorFactor": [*_COLOURS[tone], 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.75}
        materials.append({"name": tone, "pbrMetallicRoughness": paint})
    primitives = [_primitive(out, mesh, stand) | {"material": k} for k, mesh in enumerate(meshes.values())]
    return {"meshes": [{"name": "Body", "primitives": primitives}], "skins": [skin], "materials": materials}


def _primitive(out: _Builder, mesh: Mesh, stand: np.ndarray) -> dict[str, Any]:
    owner = np.zeros((len(mesh.joints), 4), dtype=np.uint16 if mesh.joints.max() > 255 else np.uint8)
    owner[:, 0] = mesh.joints
    weight = np.tile(np.array((255, 0, 0, 0), dtype=np.uint8), (len(mesh.joints), 1))
    index = np.uint32 if len(mesh.positions) > 65_535 else np.uint16
    places = mesh.positions + stand
    box = {"min": places.min(axis=0).tolist(), "max": places.max(axis=0).tolist()}
    return {
        "attributes": {
            "POSITION": out.accessor(places, "VEC3", _VERTICES, **box),
            "NORMAL": out.accessor(mesh.normals, "VEC3", _VERTICES),
            "JOINTS_0": out.accessor(owner, "VEC4", _VERTICES),
            "WEIGHTS_0": out.accessor(weight, "VEC4", _VERTICES, normalized=True),
        },
        "indices": out.accessor(mesh.triangles.ravel().astype(index), "SCALAR", _INDICES),
    }


def _animation(out: _Builder, joints: int, frames: int, fps: float, name: str) -> dict[str, Any]:
    ends = key_times(0, 1, fps).tolist(), key_times(frames - 1, 1, fps).tolist()
    clock = out.track(frames, "SCALAR", min=ends[0], max=ends[1])
    outputs = [(j, "rotation", out.track(frames, "VEC4")) for j in range(joints)]
    outputs.append((0, "translation", out.track(frames, "VEC3")))
    return {
        "name": name or "motion",
        "samplers": [{"input": clock, "output": o, "interpolation": "LINEAR"} for _, _, o in outputs],
        "channels": [
            {"sampler": k, "target": {"node": node, "path": path}} for k, (node, path, _) in enumerate(outputs)
        ],
    }
