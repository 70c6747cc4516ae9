"""GLB: exact round trips, what validators and players say, files of others, and files that are wrong."""

import json
import struct
import tempfile
import tracemalloc

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from moveset.errors import FormatError, InputError
from moveset.io import save
from moveset.io.gltf import write_glb
from moveset.io.gltf_clip import Channel, Clip
from moveset.io.gltf_reader import glb_metadata, read_glb
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.retarget import retarget
from moveset.motion.rigs import RIGS
from moveset.motion.skeleton import HML22, Skeleton
from tests.io.foreign import as_foreign, pack, unpack
from tests.motions import wander


@pytest.fixture(scope="module")
def motion():
    return wander(25, seed=1, turn=0.8)


@pytest.fixture(scope="module")
def data(motion, tmp_path_factory):
    path = tmp_path_factory.mktemp("glb") / "motion.glb"
    write_glb(motion, path)
    return path.read_bytes()


@pytest.mark.parametrize("rig", RIGS)
def test_own_files_come_back_exactly(motion, rig, tmp_path):
    written = retarget(motion, rig)
    write_glb(written, tmp_path / "a.glb", metadata={"prompt": "a person walks", "seed": 7})
    found = read_glb(tmp_path / "a.glb")
    assert torch.equal(found.root, written.root)
    assert found.fps == written.fps
    assert found.skeleton is written.skeleton
    assert torch.equal(found.rotations, rotations.unroll(written.rotations))
    assert (found.joints - written.joints).abs().max() < 1e-5
    kept = glb_metadata(tmp_path / "a.glb")
    assert kept == {"prompt": "a person walks", "seed": 7, "fps": 20.0, "skeleton": rig}


def test_long_clips_keep_every_frame(tmp_path):
    turns = rotations.about("y", torch.arange(20_000) * 7.0)[:, None]
    long = Motion(turns, torch.zeros(20_000, 3), 30.0, Skeleton("top", ("top",), (-1,), torch.zeros(1, 3)))
    write_glb(long, tmp_path / "a.glb")
    found = read_glb(tmp_path / "a.glb")
    assert torch.equal(found.rotations, rotations.unroll(turns))


@pytest.mark.parametrize("fps", [20.0, 24.0, 25.0, 24_000 / 1001, 29.97, 59.94])
@pytest.mark.parametrize("frames", [600, 50_000])
def test_frames_of_other_programs_are_kept_at_any_rate_and_for_long(fps, frames, tmp_path):
    """Times are float32: after half an hour those of two frames lie 0.3 % nearer or farther than they are."""
    made = wander(frames, seed=2, fps=fps, skeleton=Skeleton("pole", ("base", "top"), (-1, 0), torch.eye(3)[:2]))
    write_glb(made, tmp_path / "a.glb")
    tree, binary = unpack((tmp_path / "a.glb").read_bytes())
    del tree["asset"]["extras"]
    (tmp_path / "a.glb").write_bytes(pack(tree, binary))
    found = read_glb(tmp_path / "a.glb")
    assert found.fps == pytest.approx(fps, rel=2e-6)
    assert len(found) == frames
    assert (found.rotations * made.rotations).sum(-1).abs().min() > 1.0 - 1e-5


def test_bytes_are_a_correct_glb(data):
    """The container by hand, without our reader: header, chunks, padding, time axis."""
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert (kind, size % 4) == (b"JSON", 0)
    tree = json.loads(data[20 : 20 + size])
    assert [tree["nodes"][j]["name"] for j in tree["skins"][0]["joints"]] == list(HML22.joints)
    clock = tree["accessors"][tree["animations"][0]["samplers"][0]["input"]]
    start = 20 + size + 8 + tree["bufferViews"][clock["bufferView"]]["byteOffset"]
    times = np.frombuffer(data, "<f4", clock["count"], start)
    np.testing.assert_allclose(times, np.arange(25) / 20, atol=1e-6)


def test_khronos_validator_finds_nothing(motion, node, tmp_path):
    crane = Skeleton("crane", ("base", "arm", "hook"), (-1, 0, 1), torch.tensor([[0, 0, 0], [0, 2.0, 0], [1.0, 0, 0]]))
    motions = [retarget(motion, rig) for rig in RIGS] + [
        motion[:1],
        Motion(rotations.identity(3, 3), torch.zeros(3, 3), 20.0, crane),
    ]
    notes = {"prompt": 'a "quoted" größe', "seed": 7, "guidance": 2.5}
    paths = [save(made, tmp_path / f"{k}.glb", metadata=notes) for k, made in enumerate(motions)]
    paths += [save(motion, tmp_path / f"a{suffix}", metadata=notes) for suffix in (".gltf", ".vrma")]
    for path, report in zip(paths, node("validate.cjs", *paths), strict=True):
        issues = report["issues"]
        assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]
        assert report["info"]["animationCount"] == 1
        if path.suffix == ".glb":
            assert issues["numInfos"] == 0, issues["messages"]
            assert report["info"]["hasSkins"]


@pytest.mark.parametrize("rig", ["hml22", "ue5"])
def test_three_js_plays_every_format_alike(motion, rig, node, tmp_path):
    made = retarget(motion, rig)
    for name, unit in (("a.glb", 1.0), ("a.gltf", 1.0), ("a.bvh", 0.01)):
        save(made, tmp_path / name, metadata={"seed": 7})
        played = node("joints.mjs", tmp_path / name, unit, made.fps, len(made), *made.skeleton.joints)
        positions = torch.tensor(played["positions"]).reshape(made.joints.shape)
        assert (positions - made.joints).abs().max() < 1e-4, name
        if name == "a.glb":
            assert played["extras"]["moveset"]["seed"] == 7


@pytest.mark.parametrize("spline", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_foreign_rigs_are_read_in_place(motion, data, seed, spline):
    """Bones turned anyhow at rest, an armature that is turned and counts centimetres, helper nodes, extra channels."""
    found = _read(as_foreign(*unpack(data), seed, spline))
    assert found.fps == 20.0
    order = [found.skeleton.joints.index(name) for name in HML22.joints]
    assert (found.joints[:, order] - motion.joints).abs().max() < 1e-4
    # Axes are the world's at rest, so the motion can go to any other rig.
    back = retarget(found, "hml22")
    assert (back.joints - motion.joints).abs().max() < 2e-4
    assert rotations.angle(rotations.mul(rotations.inv(back.rotations), motion.rotations)).max() < 2e-3


@pytest.mark.parametrize("kind", ["STEP", "CUBICSPLINE"])
def test_interpolation_between_keys_agrees_with_scipy(kind):
    interpolate = pytest.importorskip("scipy.interpolate")
    generator = torch.Generator().manual_seed(5)
    keys = torch.cumsum(0.1 + torch.rand(6, generator=generator, dtype=torch.float64), dim=0)
    times = torch.linspace(float(keys[0]), float(keys[-1]), 101, dtype=torch.float64)
    values = torch.randn(18 if kind == "CUBICSPLINE" else 6, 3, generator=generator, dtype=torch.float64)
    found = Clip({}, {0: Channel(keys, values, kind)}, False).translation(0, times, torch.zeros(3))
    keys, times, values = keys.numpy(), times.numpy(), values.numpy()
    if kind == "STEP":
        expected = interpolate.interp1d(keys, values, kind="previous", axis=0)(times)
    else:
        # Between two keys the first leaves with its out-tangent, the second is met with its in-tangent.
        at = np.clip(np.searchsorted(keys, times, side="right") - 1, 0, 4)
        rows = [
            interpolate.CubicHermiteSpline(
                keys[k : k + 2], values[[3 * k + 1, 3 * k + 4]], values[[3 * k + 2, 3 * k + 3]]
            )(t)
            for k, t in zip(at, times, strict=True)
        ]
        expected = np.stack(rows)
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-9)


def _read(data):
    with tempfile.NamedTemporaryFile(suffix=".glb") as file:
        file.write(data)
        file.flush()
        return read_glb(file.name)


def drop(key):
    return lambda tree: tree.pop(key)


def put(where, value):
    """Set a value at a path of keys and indices."""

    def change(tree):
        for key in where[:-1]:
            tree = tree[key]
        tree[where[-1]] = value

    return change


def last_sampler(tree):
    return tree["animations"][0]["samplers"][-1]["output"]


WRONG = {
    "no animation": (drop("animations"), "no animation"),
    "no channels": (put(("animations", 0, "channels"), []), "turns no joint"),
    "outside file": (put(("buffers", 0, "uri"), "http://example.org/secret.bin"), "outside the file"),
    "local file": (put(("buffers", 0, "uri"), "../../etc/passwd"), "outside the file"),
    "cycle": (put(("nodes", 21, "children"), [0]), "cycle"),
    "two parents": (put(("nodes", 20, "children"), [5]), "two parents"),
    "child outside": (put(("nodes", 20, "children"), [999]), "no index"),
    "child no number": (put(("nodes", 20, "children"), ["5"]), "no index"),
    "joint outside": (put(("skins", 0, "joints", 3), -1), "no index"),
    "joint twice": (put(("skins", 0, "joints", 3), 4), "twice"),
    "huge count": (put(("accessors", 0, "count"), 10**9), "exceeds the limit"),
    "negative count": (put(("accessors", 0, "count"), -5), "no index"),
    "view past the end": (put(("bufferViews", 0, "byteOffset"), 2**31), "outside its buffer"),
    "accessor past the end": (put(("accessors", 0, "byteOffset"), 64), "outside its buffer"),
    "sparse": (put(("accessors", 0, "sparse"), {"count": 1}), "sparse"),
    "component type": (put(("accessors", 0, "componentType"), 7), "componentType"),
    "stride": (put(("bufferViews", 0, "byteStride"), 4), "outside its buffer"),
    "wrong type": (put(("accessors", 0, "type"), "VEC2"), "plain MAT4"),
    "rotation of text": (put(("nodes", 1, "rotation"), "0001"), "4 moderate numbers"),
    "rotation not unit": (put(("nodes", 1, "rotation"), [0, 0, 0, 0]), "unit quaternion"),
    "flat matrix": (put(("nodes", 1, "matrix"), [0] * 16), "mirrors, shears"),
    "interpolation": (put(("animations", 0, "samplers", 0, "interpolation"), "MAGIC"), "interpolation"),
    "sampler outside": (put(("animations", 0, "channels", 0, "sampler"), 99), "no index"),
    "nodes no list": (put(("nodes",), {}), "not a list"),
    "node no object": (put(("nodes", 0), 3), "not an object"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_wrong_trees_are_refused(data, wrong):
    change, words = WRONG[wrong]
    tree, binary = unpack(data)
    change(tree)
    with pytest.raises(FormatError, match=words):
        _read(pack(tree, binary))


def many_channels(joints, keys, shared):
    """A file with a chain of joints that all turn alike, by one accessor or by one each to the same bytes."""
    times, turns = (np.arange(keys) / 30).astype("<f4").tobytes(), np.tile((0, 0, 0, 1), (keys, 1)).astype("<f4")
    part = {"componentType": 5126, "count": keys}
    outputs = [0] * joints if shared else list(range(joints))
    tree = {
        "asset": {"version": "2.0"},
        "nodes": [{"name": f"n{k}", "children": [k + 1]} for k in range(joints - 1)] + [{"name": "last"}],
        "buffers": [{"byteLength": 20 * keys}],
        "bufferViews": [
            {"buffer": 0, "byteLength": 4 * keys},
            {"buffer": 0, "byteOffset": 4 * keys, "byteLength": 16 * keys},
        ],
        "accessors": [{"bufferView": 0, **part, "type": "SCALAR"}]
        + [{"bufferView": 1, **part, "type": "VEC4"} for _ in range(max(outputs) + 1)],
        "animations": [{
            "samplers": [{"input": 0, "output": 1 + k} for k in range(max(outputs) + 1)],
            "channels": [{"sampler": outputs[k], "target": {"node": k, "path": "rotation"}} for k in range(joints)],
        }],
    }  # fmt: skip
    return pack(tree, times + turns.tobytes())


def test_a_small_file_does_not_fill_the_memory(monkeypatch):
    tracemalloc.start()
    with pytest.raises(FormatError, match="600 animated nodes"):
        _read(many_channels(600, 10_000, shared=True))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20e6, "600 times 10,000 quaternions are 192 MB"
    monkeypatch.setattr("moveset.io.gltf_clip._MAX_NUMBERS", 100_000)
    with pytest.raises(FormatError, match="more than 100000 numbers; split"):
        _read(many_channels(600, 10_000, shared=False))


def test_what_is_too_much_is_not_called_damaged(motion, data, monkeypatch):
    tree, binary = unpack(data)
    # A face with more joints than are read, beside the body that moves.
    tree["nodes"] += [{"name": f"face {k}"} for k in range(600)]
    tree["skins"].insert(0, {"joints": [len(tree["nodes"]) - 1 - k for k in range(600)]})
    assert len(_read(pack(tree, binary)).skeleton) == 22
    tree["skins"][1]["joints"] += tree["skins"][0]["joints"]
    with pytest.raises(FormatError, match="622 joints of its skin exceed the limit of 512; simplify"):
        _read(pack(tree, binary))
    monkeypatch.setattr("moveset.io.gltf_clip.MAX_FRAMES", 20)
    with pytest.raises(FormatError, match="keys exceed the limit of 20; split"):
        _read(data)
    tree["nodes"] += [{}] * 20_000
    with pytest.raises(FormatError, match="nodes exceed the limit of 20000; reduce"):
        _read(pack(tree, binary))


def test_wrong_numbers_are_refused(data):
    tree, binary = unpack(data)
    for index, value, words in (
        (last_sampler(tree), np.nan, "NaN"),
        (last_sampler(tree), np.inf, "NaN"),
        (tree["animations"][0]["samplers"][0]["input"], -1.0, "key times"),
        (tree["animations"][0]["samplers"][0]["output"], 0.0, "unit quaternion"),
        (tree["skins"][0]["inverseBindMatrices"], 0.0, "matrix"),
    ):
        spoilt = bytearray(binary)
        view = tree["bufferViews"][tree["accessors"][index]["bufferView"]]
        spoilt[view["byteOffset"] : view["byteOffset"] + 16] = np.full(4, value, "<f4").tobytes()
        with pytest.raises(FormatError, match=words):
            _read(pack(tree, bytes(spoilt)))


def test_absurd_times_do_not_become_absurd_arrays(data):
    tree, binary = unpack(data)
    clock = tree["animations"][0]["samplers"][0]["input"]
    view = tree["bufferViews"][tree["accessors"][clock]["bufferView"]]
    spoilt = bytearray(binary)
    spoilt[view["byteOffset"] + 96 : view["byteOffset"] + 100] = np.float32(1e8).tobytes()
    with pytest.raises(FormatError, match="exceed the limit"):
        _read(pack(tree, bytes(spoilt)))


def test_deep_json_and_constants_are_refused(data):
    _, binary = unpack(data)
    for text in ("[" * 100_000, '{"nodes": ' + "[" * 5000, '{"asset": NaN}', "{", "[]", "9" * 5000):
        with pytest.raises(FormatError):
            _read(pack(text, binary))


def test_truncation_anywhere_is_refused(data):
    for size in [*range(0, 40), *range(40, len(data), len(data) // 60)]:
        with pytest.raises(FormatError):
            _read(data[:size])


@settings(max_examples=120, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), min_size=1, max_size=8))
def test_flipped_bytes_never_crash(small_glb, flips):
    spoilt = bytearray(small_glb)
    for at, value in flips:
        spoilt[at % len(spoilt)] = value
    try:
        found = _read(bytes(spoilt))
    except InputError:
        return
    assert torch.isfinite(found.joints).all()


@pytest.fixture(scope="module")
def small_glb(tmp_path_factory):
    """Mostly JSON, so that flips hit it."""
    path = tmp_path_factory.mktemp("glb") / "small.glb"
    tree = Skeleton("crane", ("base", "arm", "hook"), (-1, 0, 1), torch.tensor([[0, 0, 0], [0, 2.0, 0], [1.0, 0, 0]]))
    write_glb(Motion(rotations.identity(4, 3), torch.zeros(4, 3), 20.0, tree), path)
    json_tree, binary = unpack(path.read_bytes())
    return pack({k: v for k, v in json_tree.items() if k not in ("materials", "meshes")}, binary)
