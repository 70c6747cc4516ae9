"""Files as other programs write them, made from ours."""

import json
import re
import struct
from dataclasses import replace

import numpy as np
import torch

from moveset.io.bvh import continuous_euler
from moveset.motion import rotations


def in_units(path, metres):
    """A BVH file of ours, which counts centimetres, in another unit of length."""

    def times(numbers):
        return " ".join(f"{0.01 / metres * float(x):.9g}" for x in numbers)

    head, frames = path.read_text().split("MOTION\n")
    head = re.sub("OFFSET (.+)", lambda found: f"OFFSET {times(found[1].split())}", head)
    count, rate, *rows = frames.splitlines()
    rows = [" ".join((times(row.split()[:3]), *row.split()[3:])) for row in rows]
    path.write_text("\n".join((f"{head}MOTION", count, rate, *rows, "")))
    return path


def reordered(bvh, order):
    """A BVH file of ours with its rotation channels in another order."""
    channels, columns, at = [], [], 0
    for names in bvh.channels:
        places = [name for name in names if name.endswith("position")]
        turned = at + len(places)
        matrices = rotations.to_matrix(
            rotations.from_euler(torch.from_numpy(bvh.values[:, turned : turned + 3]), "ZXY")
        )
        columns += [bvh.values[:, at:turned], continuous_euler(matrices.numpy()[:, None], order)[:, 0]]
        channels.append((*places, *(f"{axis}rotation" for axis in order)))
        at = turned + 3
    return replace(bvh, channels=tuple(channels), values=np.concatenate(columns, axis=1))


def unpack(data):
    """JSON tree and binary chunk of a GLB."""
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def pack(tree, binary):
    """A GLB of a JSON tree (or text) and a binary chunk."""
    text = (tree if isinstance(tree, str) else json.dumps(tree)).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(binary))
    return head + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary


def as_foreign(tree, binary, seed, spline):
    """The same motion on bones with any axes at rest, under a turned armature in centimetres, with a helper node."""
    generator = torch.Generator().manual_seed(seed)
    joints = tree["skins"][0]["joints"]
    parents = {child: k for k, node in enumerate(tree["nodes"]) for child in node.get("children", [])}
    axes = rotations.normalize(torch.randn(len(joints), 4, generator=generator, dtype=torch.float64))
    armature = rotations.normalize(torch.randn(4, generator=generator, dtype=torch.float64))
    unit = 0.01
    out = bytearray(binary)

    def view_of(accessor):
        return tree["bufferViews"][tree["accessors"][accessor]["bufferView"]]

    def values(accessor, width):
        view = view_of(accessor)
        return torch.from_numpy(
            np.frombuffer(binary, "<f4", view["byteLength"] // 4, view["byteOffset"]).reshape(-1, width).astype("f8")
        )

    def append(array):
        out.extend(b"\0" * (-len(out) % 4))
        raw = np.ascontiguousarray(array, "<f4").tobytes()
        tree["bufferViews"].append({"buffer": 0, "byteOffset": len(out), "byteLength": len(raw)})
        out.extend(raw)
        return len(tree["bufferViews"]) - 1

    # Joint j's own axes at rest are axes[j] of the world's: R(rest) = axes[j], so its world rotation is G · axes[j].
    animation = tree["animations"][0]
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        node, rotating = channel["target"]["node"], channel["target"]["path"] == "rotation"
        keys = values(sampler["output"], 4 if rotating else 3)
        if rotating:
            above = axes[parents[node]] if node in parents else armature
            keys = rotations.mul(rotations.mul(rotations.inv(above), keys), axes[node])
        else:
            keys = rotations.rotate(rotations.inv(armature), keys) / unit
        if spline:
            # Tangents that make the curve pass the keys; between them nothing is asked here.
            keys = torch.stack((torch.zeros_like(keys), keys, torch.zeros_like(keys)), dim=1).reshape(-1, keys.shape[1])
            sampler["interpolation"] = "CUBICSPLINE"
        tree["accessors"].append(
            {
                "bufferView": append(keys.numpy()),
                "componentType": 5126,
                "count": len(keys),
                "type": "VEC4" if rotating else "VEC3",
            }
        )
        sampler["output"] = len(tree["accessors"]) - 1

    bind = values(tree["skins"][0]["inverseBindMatrices"], 16).reshape(-1, 4, 4)
    turned = torch.zeros_like(bind)
    for j in joints:
        inverse = rotations.to_matrix(axes[j]).T / unit
        turned[j, :3, :3] = inverse.T  # stored by columns
        turned[j, 3, :3] = inverse @ bind[j, 3, :3]
        turned[j, 3, 3] = 1.0
        node = tree["nodes"][j]
        above = axes[parents[j]] if j in parents else armature
        shift = torch.tensor(node["translation"], dtype=torch.float64)
        node["translation"] = (rotations.rotate(rotations.inv(above), shift) / unit).tolist()
        node["rotation"] = rotations.mul(rotations.inv(above), axes[j]).tolist()
    tree["accessors"][tree["skins"][0]["inverseBindMatrices"]]["bufferView"] = append(turned.numpy())

    # A helper node between a knee and its hip that takes half of the way.
    names = [node["name"] for node in tree["nodes"]]
    hip, knee = names.index("left_hip"), names.index("left_knee")
    half = [0.5 * x for x in tree["nodes"][knee]["translation"]]
    tree["nodes"].append({"name": "helper", "translation": half, "children": [knee]})
    tree["nodes"][knee]["translation"] = half
    tree["nodes"][hip]["children"] = [
        len(tree["nodes"]) - 1 if c == knee else c for c in tree["nodes"][hip]["children"]
    ]
    tree["nodes"].append({"name": "Armature", "rotation": armature.tolist(), "scale": [unit] * 3, "children": [0]})
    tree["scenes"][0]["nodes"] = [len(tree["nodes"]) - 1, len(joints)]
    tree["skins"][0]["joints"] = joints[::-1]
    matrices = tree["accessors"][tree["skins"][0]["inverseBindMatrices"]]
    matrices["bufferView"] = append(turned[joints[::-1]].numpy())
    animation["channels"].append({"sampler": 0, "target": {"node": 0, "path": "weights"}})
    del tree["asset"]["extras"]
    tree["buffers"][0]["byteLength"] = len(out)
    return pack(tree, bytes(out))


def shaken(tree, binary, joint, by):
    """Tree and binary chunk where a joint travels within its parent by ``by`` of its units up and down, as in files
    whose exporter gives every bone a translation channel."""
    out = bytearray(binary)
    node = next(k for k, n in enumerate(tree["nodes"]) if n["name"] == joint)
    animation = tree["animations"][0]
    clock = animation["samplers"][0]["input"]
    frames = tree["accessors"][clock]["count"]
    keys = np.tile(np.array(tree["nodes"][node]["translation"]), (frames, 1))
    keys[:, 1] += by * np.sin(np.arange(frames) / 5)
    out += b"\0" * (-len(out) % 4)
    tree["bufferViews"].append({"buffer": 0, "byteOffset": len(out), "byteLength": 12 * frames})
    out += keys.astype("<f4").tobytes()
    tree["accessors"].append(
        {"bufferView": len(tree["bufferViews"]) - 1, "componentType": 5126, "count": frames, "type": "VEC3"}
    )
    target = {"node": node, "path": "translation"}
    animation["channels"].append({"sampler": len(animation["samplers"]), "target": target})
    animation["samplers"].append({"input": clock, "output": len(tree["accessors"]) - 1, "interpolation": "LINEAR"})
    tree["buffers"][0]["byteLength"] = len(out)
    return tree, bytes(out)
