"""The GLB container (glTF 2.0, binary), read strictly: chunks, the JSON tree, accessors. Nothing outside the file."""

import json
import struct
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from moveset.errors import FormatError
from moveset.io.limits import MAX_FRAMES, MAX_POSES, read_limited

MAX_JSON = 16 * 2**20
MAX_NODES = 20_000
_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Glb:
    """A GLB file in memory; every access checks type, range and bounds.

    Raises:
        InputError: the file cannot be read.
        FormatError: it is not GLB 2.0, is truncated, or is not what the glTF specification allows.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = path
        data = read_limited(path)
        if len(data) < 20 or data[:4] != b"glTF":
            self.fail("it does not begin as a GLB file; export it as binary glTF (.glb)")
        version, length = struct.unpack_from("<II", data, 4)
        if version != 2 or length != len(data):
            self.fail(f"it declares glTF {version} and {length} bytes but has {len(data)}; it is damaged or truncated")
        chunks = self._chunks(data)
        if not chunks or chunks[0][0] != b"JSON" or len(chunks[0][1]) > MAX_JSON:
            self.fail(f"its first chunk is not JSON of at most {MAX_JSON // 2**20} MB; it is damaged")
        self.binary = chunks[1][1] if len(chunks) > 1 and chunks[1][0] == b"BIN\0" else b""
        try:
            self.tree = json.loads(chunks[0][1].decode("utf-8"), parse_constant=self._no_constant)
        except (ValueError, RecursionError) as error:
            raise FormatError(f"{path}: its JSON cannot be parsed; it is damaged") from error
        if not isinstance(self.tree, dict):
            self.fail("its JSON is not an object; it is damaged")

    def fail(self, message: str) -> NoReturn:
        raise FormatError(f"{self.path}: {message}")

    def _no_constant(self, name: str) -> NoReturn:
        self.fail(f"its JSON contains {name}; it is damaged")

    def _chunks(self, data: bytes) -> list[tuple[bytes, bytes]]:
        chunks, at = [], 12
        while at < len(data):
            if at + 8 > len(data):
                self.fail("a chunk header is cut off; it is truncated")
            size, kind = struct.unpack_from("<I4s", data, at)
            if at + 8 + size > len(data):
                self.fail(f"a chunk of {size} bytes reaches past the end; it is truncated")
            chunks.append((kind, data[at + 8 : at + 8 + size]))
            at += 8 + size
        return chunks

    def items(self, owner: dict[str, Any], key: str, limit: int = MAX_NODES) -> list[Any]:
        """A list of objects or indices under a key; empty where the key is absent."""
        found = owner.get(key, [])
        if not isinstance(found, list) or len(found) > limit:
            self.fail(f"{key!r} is not a list of at most {limit} entries; it is damaged")
        return found

    def entry(self, key: str, index: object) -> dict[str, Any]:
        """The object at an index of a top-level list."""
        found = self.items(self.tree, key, 1_000_000)
        at = self.index(index, len(found), key)
        if not isinstance(found[at], dict):
            self.fail(f"{key}[{at}] is not an object; it is damaged")
        return found[at]

    def index(self, value: object, size: int, what: str) -> int:
        """An integer in [0, size)."""
        if type(value) is not int or not 0 <= value < size:
            self.fail(f"{str(value)[:32]} is no index into its {size} {what}; it is damaged")
        return value

    def vector(self, owner: dict[str, Any], key: str, default: tuple[float, ...]) -> np.ndarray:
        """Finite numbers, as many as the default has."""
        found = owner.get(key, default)
        good = isinstance(found, list | tuple) and len(found) == len(default)
        if not good or not all(type(x) in (int, float) and abs(x) < 1e9 for x in found):
            self.fail(f"{key!r} is not a list of {len(default)} moderate numbers; it is damaged")
        return np.array(found, dtype=np.float64)

    def accessor(self, index: object, kind: str) -> np.ndarray:
        """The (count, width) float64 values of an accessor of a type ("SCALAR", "VEC3", "VEC4", "MAT4")."""
        accessor = self.entry("accessors", index)
        if accessor.get("type") != kind or "sparse" in accessor:
            self.fail(f"an accessor is not a plain {kind}; export the file without sparse or compressed data")
        code = accessor.get("componentType")
        if type(code) is not int or code not in _COMPONENTS:
            self.fail(f"componentType {str(code)[:32]} does not exist; it is damaged")
        dtype, width = np.dtype(_COMPONENTS[code]), _WIDTHS[kind]
        count = self.index(accessor.get("count"), 3 * MAX_FRAMES + 1, "frames allowed")
        view = self.entry("bufferViews", accessor.get("bufferView"))
        if view.get("buffer") != 0 or "uri" in self.entry("buffers", 0):
            self.fail("it keeps data outside the file; export it as one self-contained .glb")
        offsets = [self.index(o.get("byteOffset", 0), 2**32, "bytes") for o in (view, accessor)]
        size = self.index(view.get("byteLength"), 2**32, "bytes")
        stride = self.index(view.get("byteStride", width * dtype.itemsize), 253, "bytes of stride")
        need = stride * (count - 1) + width * dtype.itemsize if count else 0
        if stride < width * dtype.itemsize or offsets[1] + need > size or offsets[0] + size > len(self.binary):
            self.fail("an accessor reaches outside its buffer; it is damaged or truncated")
        if count * width > 4 * MAX_POSES:
            self.fail(f"an accessor of {count * width} numbers exceeds the limit of {4 * MAX_POSES}; split the file")
        raw = np.ndarray((count, width), dtype, self.binary, sum(offsets), (stride, dtype.itemsize))
        values = raw.astype(np.float64)
        if accessor.get("normalized") is True and dtype.kind in "iu":
            values = np.maximum(values / np.iinfo(dtype).max, -1.0)
        if not np.isfinite(values).all() or (np.abs(values) > 1e9).any():
            self.fail("an accessor holds NaN, infinite or absurd numbers; export the file again")
        return values
