"""glTF 2.0 files, read strictly: GLB and .gltf with what lies in it or beside it; the JSON tree and its accessors."""

import base64
import json
import re
import struct
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import unquote

import numpy as np

from moveset.errors import FormatError, InputError
from moveset.io.limits import MAX_FRAMES, MAX_POSES, read_limited

MAX_JSON = 16 * 2**20
MAX_NODES = 20_000
_MAX_TEXT = 128 * 2**20  # of a .gltf with its buffers in it
COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_DATA = re.compile(rb'"data:[^"\\]*"')
_EMBEDDED = re.compile(r"data:[\w.+/-]*;base64,")
_PLAIN_NAME = re.compile(r"[^\\/:\0]+")


class Glb:
    """A glTF file in memory; every access checks type, range and bounds.

    Raises:
        InputError: the file cannot be read.
        FormatError: it is not glTF 2.0, is truncated, or is not what the specification allows.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = path
        self._binary = b""
        self._fetched: dict[str, bytes] = {}
        data = read_limited(path)
        self._text = data[:64].removeprefix(b"\xef\xbb\xbf").lstrip()[:1] == b"{"
        text = self._plain_text(data) if self._text else self._first_chunk(data)
        try:
            self.tree = json.loads(text.decode("utf-8-sig"), parse_constant=self._no_constant)
        except (ValueError, RecursionError) as error:
            raise FormatError(f"{path}: its JSON cannot be parsed; it is damaged") from error
        if not isinstance(self.tree, dict):
            self.fail("its JSON is not an object; it is damaged")

    def _plain_text(self, data: bytes) -> bytes:
        if len(data) > _MAX_TEXT:
            self.fail(f"it is larger than the limit of {_MAX_TEXT // 2**20} MB; export it as binary glTF (.glb)")
        if len(_DATA.sub(b"", data)) > MAX_JSON:
            self.fail(f"its JSON is larger than the limit of {MAX_JSON // 2**20} MB; reduce it")
        return data

    def _first_chunk(self, data: bytes) -> bytes:
        if len(data) < 20 or data[:4] != b"glTF":
            self.fail("it does not begin as a GLB file, nor as JSON; export it as binary glTF (.glb)")
        version, length = struct.unpack_from("<II", data, 4)
        if version != 2 or length != len(data):
            self.fail(f"it declares glTF {version} and {length} bytes but has {len(data)}; it is damaged or truncated")
        chunks = self._chunks(data)
        if not chunks or chunks[0][0] != b"JSON" or len(chunks[0][1]) > MAX_JSON:
            self.fail(f"its first chunk is not JSON of at most {MAX_JSON // 2**20} MB; it is damaged")
        if len(chunks) > 1 and chunks[1][0] == b"BIN\0":
            self._binary = chunks[1][1]
        return chunks[0][1]

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
        if not isinstance(found, list):
            self.fail(f"{key!r} is not a list; it is damaged")
        if len(found) > limit:
            self.fail(f"{len(found)} {key} exceed the limit of {limit}; reduce the file")
        return found

    def entry(self, key: str, index: object) -> dict[str, Any]:
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
        if accessor.get("type") != kind:
            self.fail(f"an accessor is not a plain {kind}; export the file again")
        dtype, width = self._component(accessor), WIDTHS[kind]
        count = self.index(accessor.get("count"), 2**32, "entries allowed")
        if count > 3 * MAX_FRAMES:
            self.fail(f"an accessor of {count} entries exceeds the limit of {3 * MAX_FRAMES}; split the file")
        if count * width > 4 * MAX_POSES:
            self.fail(f"an accessor of {count * width} numbers exceeds the limit of {4 * MAX_POSES}; split the file")
        if "bufferView" in accessor or "sparse" not in accessor:
            values = self._values(accessor, count, width, dtype).astype(np.float64)
        else:
            values = np.zeros((count, width))
        if "sparse" in accessor:
            self._replace(values, accessor["sparse"], dtype)
        if accessor.get("normalized") is True and dtype.kind in "iu":
            values = np.maximum(values / np.iinfo(dtype).max, -1.0)
        if not np.isfinite(values).all() or (np.abs(values) > 1e9).any():
            self.fail("an accessor holds NaN, infinite or absurd numbers; export the file again")
        return values

    def _component(self, owner: dict[str, Any]) -> np.dtype:
        code = owner.get("componentType")
        if type(code) is not int or code not in COMPONENTS:
            self.fail(f"componentType {str(code)[:32]} does not exist; it is damaged")
        return np.dtype(COMPONENTS[code])

    def _values(self, owner: dict[str, Any], count: int, width: int, dtype: np.dtype) -> np.ndarray:
        """(count, width) numbers of a view of a buffer, from the owner's offset on."""
        view = self.entry("bufferViews", owner.get("bufferView"))
        packed = view.get("extensions")
        if isinstance(packed, dict) and packed:
            self.fail(
                f"its data are packed by {str(next(iter(packed)))[:64]}, which is not read; export it without "
                "compression (gltfpack without -c, glTF-Transform without meshopt)"
            )
        data = self._buffer(view.get("buffer"))
        offsets = [self.index(o.get("byteOffset", 0), 2**32, "bytes") for o in (view, owner)]
        size = self.index(view.get("byteLength"), 2**32, "bytes")
        stride = self.index(view.get("byteStride", width * dtype.itemsize), 253, "bytes of stride")
        need = stride * (count - 1) + width * dtype.itemsize if count else 0
        if stride < width * dtype.itemsize or offsets[1] + need > size or offsets[0] + size > len(data):
            self.fail("an accessor reaches outside its buffer; it is damaged or truncated")
        return np.ndarray((count, width), dtype, data, sum(offsets), (stride, dtype.itemsize))

    def _replace(self, values: np.ndarray, sparse: object, dtype: np.dtype) -> None:
        """Put the values of a sparse accessor in their places."""
        parts = [sparse.get(key) for key in ("indices", "values")] if isinstance(sparse, dict) else []
        if not isinstance(sparse, dict) or not all(isinstance(part, dict) for part in parts):
            self.fail("a sparse accessor lacks its indices or values; it is damaged")
        where, what = sparse["indices"], sparse["values"]
        count = self.index(sparse.get("count"), len(values) + 1, "places of a sparse accessor")
        kind = self._component(where)
        places = self._values(where, count, 1, kind)[:, 0]
        if kind.kind != "u" or (places >= len(values)).any():
            self.fail("a sparse accessor has places beyond its end; it is damaged")
        values[places] = self._values(what, count, values.shape[1], dtype)

    def _buffer(self, index: object) -> bytes:
        """The bytes of a buffer: in the file, in its JSON, or, for .gltf, in a file beside it."""
        entry = self.entry("buffers", index)
        uri = entry.get("uri")
        if uri is None:
            return self._binary if index == 0 else b""
        if not isinstance(uri, str) or (not self._text and not uri.startswith("data:")):
            self.fail("it keeps data outside the file; export it as one self-contained .glb")
        if uri not in self._fetched:
            self._fetched[uri] = self._embedded(uri) if uri.startswith("data:") else self._beside(uri)
        return self._fetched[uri]

    def _embedded(self, uri: str) -> bytes:
        match = _EMBEDDED.match(uri)
        try:
            if match is None:
                raise ValueError("no base64")
            return base64.b64decode(uri[match.end() :], validate=True)
        except ValueError as error:
            raise FormatError(f"{self.path}: a buffer in it is not base64; it is damaged") from error

    def _beside(self, uri: str) -> bytes:
        name = unquote(uri)
        folder = Path(self.path).parent
        # Only files of the same folder, and not what a link there leads to.
        if not _PLAIN_NAME.fullmatch(name) or name in (".", "..") or (folder / name).is_symlink():
            self.fail("it keeps data outside the file and its folder; export it as one self-contained .glb")
        try:
            return read_limited(folder / name)
        except FormatError:
            raise
        except InputError as error:
            raise InputError(f"{self.path}: {name!r} beside it, with its data, is not there; copy both") from error
