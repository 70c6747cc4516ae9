"""Takes as the Blender add-on reads them: packets, files, and what a server answers."""

import contextlib
import http.server
import importlib
import json
import struct
import threading
import zipfile

import numpy as np
import pytest
import torch

from moveset.io.packets import pack_packet
from moveset.motion.retarget import retarget
from tests.motions import wander
from tests.servers import answering


@pytest.fixture(scope="module")
def load(addon):
    return lambda name: importlib.import_module(f"moveset_blender.{name}")


@pytest.fixture(scope="module")
def motion():
    return wander(50, seed=2, turn=1.0)


@pytest.fixture(scope="module")
def packets(motion):
    planted = torch.arange(200).reshape(50, 4) % 3 == 0
    return [
        pack_packet(motion[a:b], first_frame=7 + a, latency_ms=3.5, planted=planted[a:b] if feet else None)
        for a, b, feet in ((0, 28, True), (28, 29, False), (29, 50, True))
    ]


def test_packets_are_the_motion(load, motion, packets):
    take = load("packets").read_packets(b"".join(packets), load("hml22").HML22, "walk")
    assert (take.title, take.fps, len(take.root)) == ("walk", 20.0, 50)
    assert np.array_equal(take.root, motion.root.double().numpy())
    assert np.abs(take.rotations - motion.rotations.numpy()).max() < 1e-6
    assert np.abs(take.world()[1] - motion.joints.numpy()).max() < 1e-5


def test_a_packet_written_by_hand(load):
    """The layout itself, byte by byte, so that both sides cannot be wrong alike."""
    rows = np.zeros((2, 91), "<f4")
    rows[:, 6::4] = 1.0
    rows[:, :3] = ((1.0, 0.9, 2.0), (1.5, 0.8, 2.5))
    header = b"MVST" + struct.pack("<HH", 1, 22) + struct.pack("<I", 2) + struct.pack("<Q", 2**40)
    header += struct.pack("<ffI", 25.0, 1.0, 1)
    assert len(header) == 32
    take = load("packets").read_packets(header + rows.tobytes() + bytes(8), load("hml22").HML22)
    assert take.fps == 25.0
    assert np.allclose(take.root, rows[:, :3])
    assert np.array_equal(take.rotations, np.tile((0.0, 0.0, 0.0, 1.0), (2, 22, 1)))


def test_damaged_packets_are_refused(load, packets):
    read, error = load("packets").read_packets, load("take").MotionError
    skeleton, whole = load("hml22").HML22, b"".join(packets)
    for cut in (0, 1, 31, 32, 500, len(packets[0]) - 1, len(whole) - 1):
        with pytest.raises(error):
            read(whole[:cut], skeleton)
    for place, byte in ((0, 88), (4, 2), (6, 23), (28, 3), (31, 1)):
        with pytest.raises(error):
            read(whole[:place] + bytes([byte]) + whole[place + 1 :], skeleton)
    with pytest.raises(error, match="does not follow"):
        read(packets[0] + packets[2], skeleton)
    with pytest.raises(error, match="does not follow"):
        read(packets[1] + packets[0], skeleton)
    for value, what in ((np.nan, "NaN"), (1e30, "absurd")):
        bad = bytearray(packets[0])
        bad[32:36] = np.float32(value).tobytes()
        with pytest.raises(error, match=what):
            read(bytes(bad), skeleton)
    with pytest.raises(error, match="unit"):
        read(packets[0][:44] + bytes(16) + packets[0][60:], skeleton)
    with pytest.raises(error, match="cut off"):
        read(packets[0][:8] + b"\xff\xff\x0f\x00" + packets[0][12:], skeleton)


def test_files_are_the_motion(load, motion, packets, tmp_path):
    (tmp_path / "walk.mvst").write_bytes(b"".join(packets))
    other = retarget(motion, "mixamo")
    motion.save(tmp_path / "walk.npz")
    other.save(tmp_path / "other.npz")
    for name, wanted in (("walk.mvst", motion), ("walk.npz", motion), ("other.npz", other)):
        take = load("files").read_take(tmp_path / name)
        assert (take.title, take.fps, take.skeleton.joints) == (name.split(".")[0], 20.0, wanted.skeleton.joints)
        assert np.abs(take.world()[1] - wanted.joints.numpy()).max() < 1e-5


def test_strange_files_are_refused(load, tmp_path, motion):
    read, error = load("files").read_take, load("take").MotionError
    with pytest.raises(error, match=r"gone\.npz cannot be read"):
        read(tmp_path / "gone.npz")
    (tmp_path / "a.bvh").write_text("HIERARCHY")
    with pytest.raises(error, match="neither"):
        read(tmp_path / "a.bvh")
    (tmp_path / "a.npz").write_bytes(b"PK\x03\x04 and then nothing")
    with pytest.raises(error, match="damaged"):
        read(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", poses=np.zeros((3, 156)))
    with pytest.raises(error, match="lacks rotations"):
        read(tmp_path / "b.npz")
    motion.save(tmp_path / "c.npz")
    with np.load(tmp_path / "c.npz") as npz:
        arrays = dict(npz)
    np.savez(tmp_path / "c.npz", **(arrays | {"joints": np.array([print], dtype=object)}))
    with pytest.raises(error, match="damaged"):
        read(tmp_path / "c.npz")
    np.savez(tmp_path / "c.npz", **(arrays | {"parents": arrays["parents"][::-1]}))
    with pytest.raises(error, match="no tree"):
        read(tmp_path / "c.npz")
    motion.save(tmp_path / "whole.npz")
    whole = (tmp_path / "whole.npz").read_bytes()
    # One byte in a thousand places: whatever it breaks, of the archive, of what is packed in it or of an array's head.
    for place in range(0, len(whole), max(1, len(whole) // 1000)):
        (tmp_path / "d.npz").write_bytes(whole[:place] + bytes([whole[place] ^ 0x55]) + whole[place + 1 :])
        with contextlib.suppress(error):
            read(tmp_path / "d.npz")
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as bomb, bomb.open("a.npy", "w") as member:
        for _ in range(600):
            member.write(bytes(2**20))
    with pytest.raises(error, match="512 MiB"):
        read(tmp_path / "bomb.npz")


def test_a_server_gives_takes(load, served):
    generate = load("server").generate
    prompts = [("a person walks forward", 2.0), ("a person bows", None)]
    answer = generate(served, prompts, steps=1, seed=5, num=2)
    assert answer.seeds == (5, 6)
    assert [take.title for take in answer.takes] == ["a person walks forward, then a person bows"] * 2
    assert all(take.skeleton.joints == load("hml22").HML22.joints for take in answer.takes)
    assert all(len(take.root) > 40 for take in answer.takes)
    again = generate(served + "/", prompts, steps=1, seed=6)
    assert np.array_equal(again.takes[0].rotations, answer.takes[1].rotations)


def test_a_server_says_what_is_wrong_in_its_own_words(load, served):
    server, error = load("server"), load("take").MotionError
    with pytest.raises(error, match="prompt"):
        server.generate(served, [("", None)])
    with pytest.raises(error, match="steps"):
        server.generate(served, [("a person walks", None)], steps=3)


def test_what_is_no_moveset_server_is_told_from_one(load):
    server, error = load("server"), load("take").MotionError

    class Other(http.server.BaseHTTPRequestHandler):
        answer = b""

        def do_POST(self):
            # Read to its end: a connection closed over unread bytes is reset, and the answer lost with it.
            self.rfile.read(int(self.headers["Content-Length"]))
            self.send_response(200)
            self.end_headers()
            self.wfile.write(self.answer)

        def log_message(self, *_):
            pass

    other = http.server.HTTPServer(("127.0.0.1", 0), Other)
    thread = threading.Thread(target=other.serve_forever, daemon=True)
    thread.start()
    url = f"http://127.0.0.1:{other.server_port}"
    empty = {
        "skeleton": {"name": "x", "joints": ["a"], "parents": [-1], "offsets": [[0, 0, 0]]},
        "takes": [{"seed": 1}],
    }
    absurd = empty | {"skeleton": empty["skeleton"] | {"parents": [float("inf")]}}
    strange = [json.dumps(empty).encode(), json.dumps(absurd).encode(), b"[" * 100_000]
    try:
        for answer in (b"<html>", b"[]", b"{}", b'{"skeleton": 3, "takes": []}', *strange):
            Other.answer = answer
            with pytest.raises(error, match="is it moveset's"):
                server.generate(url, [("a person walks", None)])
    finally:
        other.shutdown()
        other.server_close()
    with pytest.raises(error, match=r"no moveset server answers .* moveset serve"):
        server.generate(url, [("a person walks", None)], timeout=5)
    for wrong in (
        "file:///etc/passwd", "127.0.0.1:8765", "", "ftp://127.0.0.1/", "http://[::1", "http://127.0.0.1:87x5",
        "http://127.0.0.1:8765 x", "http://127.0.0.1:99999",
    ):  # fmt: skip
        with pytest.raises(error, match="no address of a server"):
            server.generate(wrong, [("a person walks", None)])
        with pytest.raises(error, match="no address of a server"):
            server.is_this_machine(wrong)
    for wrong in ("http://127.0.0.1:9/a b", "http://127.0.0.1:9/ü", f"http://{'a' * 70}.example"):
        with pytest.raises(error, match="no moveset server answers"):
            server.generate(wrong, [("a person walks", None)], timeout=5)


@pytest.mark.parametrize(
    ("reply", "word"),
    [
        (b"", "moveset serve"),
        (b"SSH-2.0-x\r\n", "SSH.*moveset serve"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 99\r\n\r\n{}", "moveset"),
        (b"HTTP/1.1 500 Oops\r\nTransfer-Encoding: chunked\r\n\r\n9\r\n", "500 Oops"),
    ],
    ids=["silent", "ssh", "breaks off", "breaks off an error"],
)
def test_other_services_on_the_port_are_told_from_a_moveset_server(load, reply, word):
    with answering(reply) as address, pytest.raises(load("take").MotionError, match=word):
        load("server").generate(f"http://{address}", [("a person walks", None)], timeout=30)


def test_which_servers_are_on_this_machine(load):
    here = load("server").is_this_machine
    assert all(map(here, ("http://127.0.0.1:8765", "http://localhost:1", "http://[::1]:8765/", "https://127.9.9.9")))
    assert not any(map(here, ("http://192.168.0.4:8765", "http://example.org", "http://localhost.example.org")))
