"""glTF as other programs write it: sparse keys, no skin, several animations, packed data, JSON, VRM animations."""

import base64
import json
import math
import warnings

import numpy as np
import pytest
import torch

from moveset.cli.__main__ import main
from moveset.errors import FormatError, InputError
from moveset.io import load, save
from moveset.io.gltf import write_glb
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.retarget import retarget
from moveset.motion.rigs import RIGS
from moveset.motion.skeleton import HML22, Skeleton
from tests.io.foreign import pack, unpack
from tests.motions import wander

ARM = Skeleton("arm", ("shoulder", "elbow", "wrist"), (-1, 0, 1), torch.tensor([[0, 0, 0], [0.3, 0, 0], [0.2, 0, 0]]))


@pytest.fixture(scope="module")
def motion():
    return wander(25, seed=1, turn=0.8)


@pytest.fixture
def changed(tmp_path):
    """A motion's file after a function has changed its tree and binary chunk."""

    def write(motion, change, name="a.glb"):
        write_glb(motion, tmp_path / name)
        tree, binary = unpack((tmp_path / name).read_bytes())
        del tree["asset"]["extras"]
        tree, binary = change(tree, binary) or (tree, binary)
        (tmp_path / name).write_bytes(pack(tree, binary))
        return tmp_path / name

    return write


def swing(times):
    """The arm with its elbow at 40 degrees times the sine of time."""
    turned = rotations.identity(len(times), 3)
    turned[:, 1] = rotations.about("z", torch.tensor([40.0 * math.sin(t) for t in times]))
    return Motion(turned, torch.zeros(len(times), 3), 20.0, ARM)


def keyed(times, interpolation="LINEAR"):
    """Puts the keys of an animation at some times."""

    def change(tree, binary):
        clock = tree["accessors"][tree["animations"][0]["samplers"][0]["input"]]
        start = tree["bufferViews"][clock["bufferView"]]["byteOffset"]
        raw = np.array(times, "<f4").tobytes()
        for sampler in tree["animations"][0]["samplers"]:
            sampler["interpolation"] = interpolation
        return tree, binary[:start] + raw + binary[start + len(raw) :]

    return change


WAVE = [0, 1, 2, 3, 3.1, 3.2, 4, 5, 6]
RATES = {
    "frames of films": ([k / 24 for k in range(30)], 24, 30),
    "frames from 1 on": ([(k + 1) / 30 for k in range(30)], 30, 30),
    "on twos": ([k / 12 for k in range(30)], 12, 30),
    "frames at 120": ([k / 120 for k in range(30)], 120, 30),
    "an odd rate": ([k / 12.5 for k in range(30)], 12.5, 30),
    "a frame left out here and there": ([k / 60 for k in range(60) if k % 7 or k < 20], 60, 60),
    "long after the start": ([100 + k / 30 for k in range(30)], 30, 30),
    "a wave": (WAVE, 30, 181),
    "one a second": (range(5), 30, 121),
    "four a second": ([k / 4 for k in range(9)], 32, 65),
    "two keys": ([0, 2.01], 30, 61),
    "no grid": ([0, 0.37, 0.5, 1.7, math.pi], 30, 95),
}


@pytest.mark.parametrize("kind", RATES)
def test_sparse_keys_are_sampled_and_frames_are_kept(changed, kind):
    times, fps, count = RATES[kind]
    found = load(changed(swing(times), keyed(times)))
    assert found.fps == pytest.approx(fps, abs=0.6)
    assert abs(len(found) - count) <= 1
    # From the first key to the last, and through all between.
    assert len(found) - 1 == pytest.approx((times[-1] - times[0]) * found.fps, abs=1.0)
    bend = rotations.angle(found.rotations[:, 1])
    grid = np.arange(len(found)) / found.fps + times[0]
    expected = np.abs(np.interp(grid, times, [40.0 * math.sin(t) for t in times]))
    assert np.abs(np.degrees(bend.numpy()) - expected).max() < 0.5


def test_frames_that_are_said_to_have_another_rate_are_those_of_the_file(tmp_path):
    save(wander(24, seed=1, fps=24.0), tmp_path / "a.glb")
    for fps in (None, 30.0):
        found = load(tmp_path / "a.glb", fps=fps, source_fps=60.0)
        assert (found.fps, len(found)) == (60.0, 24)
    for fps in (0.0, -5.0, math.nan):
        with pytest.raises(InputError, match=r"a motion of .* frames a second is not in 0.01 to 1000"):
            load(tmp_path / "a.glb", fps=fps)


@pytest.mark.parametrize("fps", [24.0, 25.0, 29.97, 30.0, 60.0])
@pytest.mark.parametrize("frames", [2, 40, 41, 60])
@pytest.mark.parametrize("name", ["a.glb", "a.gltf", "a.vrma"])
def test_our_frames_at_another_rate_are_as_many_as_those_of_the_motion(name, frames, fps, tmp_path):
    """The oracle is the motion itself: what is behind its last frame nobody knows."""
    made = wander(frames, seed=1)
    save(made, tmp_path / name)
    found, wanted = load(tmp_path / name, fps=fps), load(tmp_path / name).resampled(fps)
    assert (len(found), found.fps) == (len(wanted), fps) == (len(made.resampled(fps)), fps)
    assert (found.joints - wanted.joints).norm(dim=-1).max() < 1e-4


def test_the_rate_of_sparse_keys_can_be_chosen(changed, tmp_path):
    path = changed(swing(WAVE), keyed(WAVE))
    assert main(["convert", str(path), str(tmp_path / "b.npz"), "--fps", "50"]) == 0
    found = load(tmp_path / "b.npz")
    assert (found.fps, len(found)) == (50, 301)
    # What happens between two keys of a tenth of a second is there.
    assert rotations.angle(found.rotations[155, 1] - 0) == pytest.approx(math.radians(40 * math.sin(3.1)), abs=1e-3)


@pytest.mark.parametrize("rig", ["hml22", "mixamo"])
@pytest.mark.parametrize("moves", [True, False])
def test_animated_nodes_without_a_skin_are_the_joints(motion, changed, rig, moves):
    """An armature, and a mesh at a hand; ``moves`` is whether the root's own channel is there."""
    made = retarget(motion, rig)

    def change(tree, binary):
        count = len(made.skeleton)
        del tree["skins"], tree["nodes"][count]["skin"]
        tree["nodes"].append({"name": "Armature", "children": [0, count], "rotation": [0, 0, 0, 1]})
        tree["nodes"].append({"name": "World", "children": [count + 1]})
        tree["nodes"].append({"name": "sword", "mesh": 0})
        tree["nodes"][count - 1]["children"] = [count + 3]
        tree["scenes"][0]["nodes"] = [count + 2]
        if not moves:
            tree["animations"][0]["channels"] = [
                c for c in tree["animations"][0]["channels"] if c["target"]["node"] in range(3, count)
            ]

    found = load(changed(made, change))
    assert found.skeleton.joints == made.skeleton.joints
    if moves:
        assert (found.joints - made.joints).abs().max() < 1e-4


def sized(where, *sizes, as_matrix):
    """Gives a node a size along each of its axes: one above the skeleton, one beside it, or one of its joints."""

    def change(tree, binary):
        elbow = next(node for node in tree["nodes"] if node.get("name") == "elbow")
        node = elbow if where == "joint" else {"name": where}
        if as_matrix:
            turn = rotations.to_matrix(torch.tensor(node.pop("rotation", [0.0, 0.0, 0.0, 1.0])).double())
            columns = (turn * torch.tensor(sizes).double()).T.tolist()
            place = node.pop("translation", [0.0, 0.0, 0.0])
            node["matrix"] = [*columns[0], 0, *columns[1], 0, *columns[2], 0, *place, 1]
        else:
            node["scale"] = list(sizes)
        if where == "above":
            node["children"] = tree["scenes"][0]["nodes"]
            tree["scenes"][0]["nodes"] = [len(tree["nodes"])]
        if where != "joint":
            tree["nodes"].append(node)

    return change


@pytest.mark.parametrize("as_matrix", [False, True])
def test_a_size_means_the_same_as_a_scale_and_in_a_matrix(changed, as_matrix):
    motion, read = swing([0.0, 0.5, 1.0]), {"as_stored": True}
    bones = ARM.offsets[1:].norm(dim=-1)
    for where, sizes, factor in (
        ("above", (2.0, 2.0, 2.0), 2.0), ("beside", (-1.0, 1.0, 3.0), 1.0), ("joint", (1.0, 1.3, 0.7), 1.0),
    ):  # fmt: skip
        found = load(changed(motion, sized(where, *sizes, as_matrix=as_matrix)), **read)
        assert torch.allclose(found.skeleton.offsets[1:].norm(dim=-1), factor * bones, atol=1e-5)
    for where, sizes in (("above", (1.0, 1.0, 2.0)), ("above", (-1.0, 1.0, 1.0)), ("joint", (1.0, 1.0, -1.0))):
        with pytest.raises(FormatError, match="mirrors, shears or stretches unevenly"):
            load(changed(motion, sized(where, *sizes, as_matrix=as_matrix)), **read)


def test_a_skin_that_nothing_moves_is_passed_over(motion, changed):
    """A second body, larger than the one that is animated."""

    def change(tree, binary):
        first = len(tree["nodes"])
        tree["nodes"] += [{"name": f"statue_{k}"} for k in range(40)]
        tree["skins"].append({"joints": list(range(first, first + 40))})

    assert load(changed(motion, change)).skeleton.joints == HML22.joints


def with_animations(*clips):
    """Adds animations before the file's own: (name, whether it turns the joints)."""

    def change(tree, binary):
        own = tree["animations"][0]
        still = {
            "samplers": [{"input": len(tree["accessors"]), "output": len(tree["accessors"]) + 1}],
            "channels": [{"sampler": 0, "target": {"node": 0, "path": "rotation"}}],
        }
        tree["accessors"] += [
            {"bufferView": len(tree["bufferViews"]), "componentType": 5126, "count": 2, "type": "SCALAR"},
            {"bufferView": len(tree["bufferViews"]) + 1, "componentType": 5126, "count": 2, "type": "VEC4"},
        ]
        for values in ([0.0, 1.0], [0, 0, 0, 1, 0, 0, 0, 1]):
            raw = np.array(values, "<f4").tobytes()
            tree["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(raw)})
            binary += raw
        tree["buffers"][0]["byteLength"] = len(binary)
        tree["animations"] = [{**(own if moves else still), "name": name} for name, moves in clips]
        return tree, binary

    return change


def test_the_animation_that_moves_is_taken_and_others_by_name_or_number(motion, changed, tmp_path, capsys):
    path = changed(motion, with_animations(("T-Pose", False), ("Walk", True), ("Run", True)))
    with pytest.warns(UserWarning, match=r"3 animations \(T-Pose, Walk, Run\) 'Walk' is read; --animation NAME"):
        found = load(path)
    assert (found.joints - motion.joints).abs().max() < 1e-4
    for name in ("Run", "run", "3"):
        assert main(["convert", str(path), str(tmp_path / "b.npz"), "--animation", name]) == 0
        assert (load(tmp_path / "b.npz").joints - motion.joints).abs().max() < 1e-4
    assert capsys.readouterr().err == ""
    assert rotations.angle(load(path, animation="T-Pose").rotations).max() < 1e-3
    with pytest.raises(FormatError, match=r"no animation 'Jump'; choose one of T-Pose, Walk, Run"):
        load(path, animation="Jump")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(load(changed(motion, with_animations(("T-Pose", False)))))


def retargeted_channels(path):
    def change(tree, binary):
        for channel in tree["animations"][0]["channels"]:
            channel["target"] = path

    return change


def packed(tree, binary):
    for view in tree["bufferViews"]:
        view["extensions"] = {"EXT_meshopt_compression": {"buffer": 0, "mode": "ATTRIBUTES"}}
    tree["extensionsRequired"] = tree["extensionsUsed"] = ["EXT_meshopt_compression"]


def sparse(count, places, values):
    def change(tree, binary):
        accessor = tree["accessors"][tree["animations"][0]["samplers"][1]["output"]]
        view = len(tree["bufferViews"])
        raw = [np.array(places, "<u2").tobytes(), np.array(values, "<f4").tobytes()]
        for part in raw:
            binary += bytes(-len(binary) % 4)
            tree["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(part)})
            binary += part
        accessor["sparse"] = {
            "count": count,
            "indices": {"bufferView": view, "componentType": 5123},
            "values": {"bufferView": view + 1},
        }
        return tree, binary

    return change


REFUSED = {
    "morph targets alone": (retargeted_channels({"node": 0, "path": "weights"}), "shapes alone .morph targets"),
    "pointers": (retargeted_channels({"path": "pointer"}), "turns no joint"),
    "meshopt": (packed, "packed by EXT_meshopt_compression.*without compression"),
    "too many sparse places": (sparse(9, [1], [[0, 0, 0, 1]]), "outside its buffer|sparse"),
    "sparse places beyond": (sparse(1, [99], [[0, 0, 0, 1]]), "sparse accessor has places beyond"),
}


@pytest.mark.parametrize("wrong", REFUSED)
def test_what_cannot_be_read_is_named(changed, wrong):
    change, words = REFUSED[wrong]
    with pytest.raises(FormatError, match=words) as caught:
        load(changed(swing(range(5)), change))
    assert "\n" not in str(caught.value)


def test_sparse_accessors_are_filled_in(changed):
    turned = rotations.about("x", 30.0)
    found = load(changed(swing([k / 20 for k in range(5)]), sparse(2, [1, 3], [turned.tolist()] * 2)))
    plain = swing([k / 20 for k in range(5)])
    assert torch.allclose(found.rotations[1, 1], turned, atol=1e-6)
    assert torch.allclose(found.rotations[2], plain.rotations[2], atol=1e-6)


@pytest.mark.parametrize("rig", RIGS)
def test_json_gltf_is_the_glb_in_text(motion, rig, tmp_path):
    made = retarget(motion, rig)
    for name in ("a.gltf", "a.glb"):
        save(made, tmp_path / name, metadata={"prompt": "größe"})
    found, binary = load(tmp_path / "a.gltf"), load(tmp_path / "a.glb")
    assert torch.equal(found.rotations, binary.rotations)
    assert torch.equal(found.root, binary.root)
    assert found.skeleton is made.skeleton
    tree = json.loads((tmp_path / "a.gltf").read_text("utf-8"))
    assert tree["asset"]["extras"]["moveset"]["prompt"] == "größe"


def test_gltf_with_its_data_beside_it(motion, tmp_path):
    save(motion, tmp_path / "a.gltf")
    tree = json.loads((tmp_path / "a.gltf").read_text())
    data = base64.b64decode(tree["buffers"][0]["uri"].partition(",")[2])
    (tmp_path / "the walk.bin").write_bytes(data)
    (tmp_path / "link.bin").symlink_to("the walk.bin")
    (tmp_path / "deep").mkdir()

    def of(uri):
        tree["buffers"][0]["uri"] = uri
        (tmp_path / "deep" / "b.gltf").write_text(json.dumps(tree))
        (tmp_path / "b.gltf").write_text(json.dumps(tree))
        return tmp_path / "b.gltf"

    assert (load(of("the%20walk.bin")).joints - motion.joints).abs().max() < 1e-5
    for uri in ("http://example.org/a.bin", "/etc/passwd", "../the walk.bin", "..%2Fthe walk.bin", "link.bin", "", "."):
        with pytest.raises(InputError, match="outside the file and its folder"):
            load(of(uri))
    with pytest.raises(InputError, match=r"'none\.bin' beside it, with its data, is not there"):
        load(of("none.bin"))
    with pytest.raises(FormatError, match="not base64"):
        load(of("data:application/octet-stream;base64,%%%"))
    (tmp_path / "c.glb").write_bytes(pack(tree | {"buffers": [{"uri": "the walk.bin", "byteLength": 4}]}, b""))
    with pytest.raises(FormatError, match="self-contained"):
        load(tmp_path / "c.glb")


@pytest.mark.parametrize("rig", RIGS)
def test_vrm_animations_come_back(motion, rig, tmp_path):
    made = retarget(motion, rig)
    save(made, tmp_path / "a.vrma", metadata={"seed": 3})
    found, wanted = load(tmp_path / "a.vrma"), retarget(made, "vrm")
    assert found.skeleton is RIGS["vrm"]
    assert torch.equal(found.root, wanted.root)
    assert (found.joints - wanted.joints).abs().max() < 1e-5
    tree, _ = unpack((tmp_path / "a.vrma").read_bytes())
    bones = tree["extensions"]["VRMC_vrm_animation"]["humanoid"]["humanBones"]
    assert {name: tree["nodes"][bone["node"]]["name"] for name, bone in bones.items()} == {n: n for n in bones}
    assert tree["extensions"]["VRMC_vrm_animation"]["specVersion"] == "1.0"
    assert "meshes" not in tree


def test_bones_of_a_vrm_animation_may_be_called_anything(motion, tmp_path):
    """Names of the nodes are free, nodes that are no bones stand between, and fingers are there."""
    save(retarget(motion, "vrm"), tmp_path / "a.vrma")
    tree, binary = unpack((tmp_path / "a.vrma").read_bytes())
    for k, node in enumerate(tree["nodes"]):
        node["name"] = f"ボーン {k}"
    spine = tree["extensions"]["VRMC_vrm_animation"]["humanoid"]["humanBones"]["spine"]["node"]
    tree["nodes"].append({"name": "between", "children": [spine], "translation": tree["nodes"][spine]["translation"]})
    tree["nodes"][spine]["translation"] = [0, 0, 0]
    children = tree["nodes"][0]["children"]
    children[children.index(spine)] = len(tree["nodes"]) - 1
    tree["nodes"].append({"name": "Root", "children": [0]})
    tree["scenes"][0]["nodes"] = [len(tree["nodes"]) - 1]
    del tree["asset"]["extras"]
    (tmp_path / "b.vrma").write_bytes(pack(tree, binary))
    found = load(tmp_path / "b.vrma")
    assert set(found.skeleton.joints) == set(RIGS["vrm"].joints)
    assert (retarget(found, "hml22").joints - retarget(load(tmp_path / "a.vrma"), "hml22").joints).abs().max() < 2e-4


@pytest.mark.parametrize("rig", ["vrm", "mixamo"])
def test_pixivs_loader_reads_vrm_animations(motion, rig, node, tmp_path):
    save(retarget(motion, rig), tmp_path / "a.vrma")
    wanted = retarget(motion, "vrm")
    found = node("vrma.mjs", tmp_path / "a.vrma")
    assert set(found["rotations"]) == set(wanted.skeleton.joints)
    for bone, values in found["rotations"].items():
        turned = rotations.mul(
            rotations.inv(wanted.rotations[:, wanted.skeleton.index(bone)]), torch.tensor(values).reshape(-1, 4)
        )
        assert rotations.angle(turned).max() < 2e-3
    assert torch.allclose(torch.tensor(found["hips"]).reshape(-1, 3), wanted.root, atol=1e-5)
    assert found["times"] == pytest.approx([k / 20 for k in range(25)], abs=1e-6)
    assert found["rest"][1] == pytest.approx(-float(wanted.skeleton.rest_positions[:, 1].min()), abs=1e-5)
