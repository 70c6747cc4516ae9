"""The clients of examples/clients against a server that runs: what they save is what the server made."""

import importlib
import json
import os
import re
import shutil
import socket
import subprocess
import sys
import threading
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from moveset import MotionStream
from moveset.io import load
from moveset.io.packets import pack_packet, unpack_packets
from tests.motions import wander
from tests.servers import answering

CLIENTS = Path(__file__).resolve().parents[2] / "examples" / "clients"
PROMPTS = ("a person walks forward", "someone waves with the left hand")


@pytest.fixture(scope="module")
def node():
    """A Node with a WebSocket client, as a command."""
    found = shutil.which("node")
    if found is None:
        pytest.skip("no node here: install Node 20 or newer")
    for command in ([found], [found, "--experimental-websocket"]):
        asked = [*command, "-e", "process.exit(typeof WebSocket === 'function' ? 0 : 1)"]
        if subprocess.run(asked, capture_output=True, check=False, timeout=60).returncode == 0:
            return command
    pytest.skip("this node has no WebSocket: install Node 20.10 or newer")


def run(*command, **more):
    return subprocess.run(
        [str(part) for part in command], capture_output=True, text=True, timeout=120, check=False, **more
    )


def expected(model, seed, change):
    """What the stream's own model makes of one prompt, and of the other from segment ``change`` on."""
    stream = MotionStream.from_pretrained(model, prompt=PROMPTS[0], seed=seed)
    for segment in stream:
        if segment.number + 1 == change:
            stream.prompt(PROMPTS[1])
        yield segment.motion


def assert_is_the_stream(out, path, model, seed, exactly):
    """The take is that of the model with the second prompt where the server said that it takes effect."""
    effect = int(re.search(rf"{PROMPTS[1]}.? from frame (\d+) on", out)[1])
    got = load(path) if path.suffix != ".mvst" else unpack_packets(path.read_bytes()).motion
    assert effect % 28 == 0
    assert 28 <= effect < len(got)
    for k, wanted in zip(range(len(got) // 28), expected(model, seed, effect // 28), strict=False):
        there = got[28 * k : 28 * (k + 1)]
        assert float((there.joints - wanted.joints).abs().max()) < exactly


def test_the_python_client_keeps_the_stream(served, tiny_streams, tmp_path):
    for name, exactly in (("take.mvst", 1e-5), ("take.bvh", 1e-3)):
        done = run(sys.executable, CLIENTS / "stream_client.py", *PROMPTS, "--seconds", 8, "--seed", 3,
                   "--server", served, "-o", tmp_path / name)  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert "stream of tiny-stream, seed 3, 20 frames a second" in done.stdout
        assert len(re.findall(r"^segment \d+: ", done.stdout, re.MULTILINE)) == 6
        assert_is_the_stream(done.stdout, tmp_path / name, tiny_streams, 3, exactly)


def test_the_javascript_client_keeps_the_stream(node, served, tiny_streams, tmp_path):
    done = run(*node, CLIENTS / "stream_client.mjs", *PROMPTS, tmp_path / "take.npz",
               env={"MOVESET_SERVER": served, "PATH": ""})  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert_is_the_stream(done.stdout, tmp_path / "take.npz", tiny_streams, 7, 1e-5)


def test_javascript_reads_packets_as_python_writes_them(node, tmp_path):
    motion = wander(9, seed=1)
    planted = (motion.rotations[:, :4, 0] > 0).contiguous()
    (tmp_path / "p.mvst").write_bytes(pack_packet(motion, first_frame=2**33 + 5, latency_ms=4.5, planted=planted))
    script = f"""
        import {{ parsePacket }} from {json.dumps((CLIENTS / "stream_client.mjs").as_uri())};
        import {{ readFileSync }} from "node:fs";
        const bytes = readFileSync({json.dumps(str(tmp_path / "p.mvst"))});
        const whole = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length);
        const p = parsePacket(whole);
        let refused = 0;
        for (const cut of [0, 31, 32, whole.byteLength - 1])
            try {{ parsePacket(whole.slice(0, cut)) }} catch {{ refused++ }}
        console.log(JSON.stringify({{...p, rows: [...p.rows], contacts: [...p.contacts], refused}}));
    """
    done = run(*node, "--input-type=module", "-e", script)
    assert done.returncode == 0, done.stderr
    got = json.loads(done.stdout)
    assert (got["joints"], got["frames"], got["firstFrame"], got["fps"], got["latencyMs"], got["refused"]) == (
        22, 9, 2**33 + 5, 20, 4.5, 4
    )  # fmt: skip
    rows = [*motion.root[2].tolist(), *motion.rotations[2].flatten().tolist()]
    assert got["rows"][2 * 91 : 3 * 91] == rows
    assert got["contacts"] == planted.int().flatten().tolist()


def test_a_page_can_import_the_javascript_client(node):
    client = (CLIENTS / "stream_client.mjs").as_uri()
    script = f"""
        globalThis.process = undefined;
        const found = await import({json.dumps(client)});
        console.log(Object.keys(found).join());
    """
    done = run(*node, "--input-type=module", "-e", script)
    assert done.stdout.strip() == "parsePacket,record", done.stderr
    # Whatever is imported before anything runs has to be there in a page.
    assert not re.search(r"^import\b", (CLIENTS / "stream_client.mjs").read_text(), re.M)


def test_a_clip_needs_the_standard_library_alone(served, tmp_path):
    client = (sys.executable, "-I", "-S", CLIENTS / "generate_clip.py", "--server", f"{served}/", "--seed", 4)
    done = run(*client, *PROMPTS, "--seconds", 2)
    assert done.returncode == 0, done.stderr
    assert "80 frames at 20 a second, seed 4" in done.stdout
    saved = run(*client, *PROMPTS, "--seconds", 2, "-o", tmp_path / "clip.npz")
    assert saved.returncode == 0, saved.stderr
    end = load(tmp_path / "clip.npz").root[-1]
    assert " ".join(f"{x:.2f}" for x in end.tolist()) in done.stdout


@pytest.mark.parametrize("script", ["stream_client.py", "stream_client.mjs"])
def test_a_stream_that_no_file_can_be_made_of_is_kept(node, served, tmp_path, script):
    take = tmp_path / "take.fbx"
    if script.endswith(".py"):
        done = run(sys.executable, CLIENTS / script, "--server", served, "--seconds", 1, "a", "-o", take)
        assert len(done.stderr.strip().splitlines()) == 1
    else:
        done = run(*node, CLIENTS / script, "a", take, env={"MOVESET_SERVER": served})
    assert (done.returncode, "unknown format 'fbx'" in done.stderr) == (1, True)
    assert done.stderr.strip().endswith(f"the packets are in {tmp_path / 'take.mvst'}")
    assert len(unpack_packets((tmp_path / "take.mvst").read_bytes()).motion) >= 28


@pytest.mark.parametrize(
    ("reply", "word"),
    [
        (None, "refused"),
        (b"", "closed"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\nHIERARCHY", "9 bytes"),
        (b"HTTP/1.1 502 Bad Gateway\r\nContent-Length: 6\r\n\r\n<html>", "502"),
    ],
    ids=["gone", "hangs up", "breaks off", "of a proxy"],
)
def test_a_stream_is_kept_whatever_the_server_does_before_there_is_a_file(reply, word, tmp_path, monkeypatch):
    packet = pack_packet(wander(9, seed=1))
    with nullcontext("127.0.0.1:9") if reply is None else answering(reply, end=packet) as address:
        monkeypatch.syspath_prepend(CLIENTS)
        client = importlib.import_module("stream_client")
        monkeypatch.setattr(client, "record", lambda *_, packets: packets.append(packet))
        monkeypatch.setattr(sys, "argv", ["", "a", "--server", address, "-o", str(tmp_path / "take.bvh")])
        with pytest.raises(SystemExit, match=rf"{word}.*; the packets are in .*take\.mvst"):
            client.main()
    assert (tmp_path / "take.mvst").read_bytes() == packet
    assert not (tmp_path / "take.bvh").exists()


def test_an_interruption_is_not_taken_for_a_missing_server(monkeypatch):
    def interrupted(*_, packets):
        raise KeyboardInterrupt

    monkeypatch.syspath_prepend(CLIENTS)
    client = importlib.import_module("stream_client")
    monkeypatch.setattr(client, "record", interrupted)
    monkeypatch.setattr(sys, "argv", ["", "a"])
    with pytest.raises(SystemExit, match=r"^KeyboardInterrupt$"):
        client.main()


@pytest.fixture
def breaking():
    """Address of a server whose streams break off behind their first packet, and that packet."""
    from websockets.sync.server import serve

    packet = pack_packet(wander(28, seed=1))

    def stream(connection):
        started = {"type": "started", "model": "m", "seed": 1, "fps": 20}
        segment = {"type": "segment", "segment": 0, "prompt": "a", "latency_ms": 1}
        connection.recv()
        for message in (json.dumps(started), json.dumps(segment), packet):
            connection.send(message)
        connection.recv()
        connection.socket.shutdown(socket.SHUT_RDWR)

    with serve(stream, "127.0.0.1", 0) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield "http://127.0.0.1:{1}".format(*server.socket.getsockname()), packet
        server.shutdown()


@pytest.mark.parametrize("script", ["stream_client.py", "stream_client.mjs"])
def test_what_came_of_a_stream_that_broke_off_is_kept(node, breaking, tmp_path, script):
    url, packet = breaking
    if script.endswith(".py"):
        done = run(sys.executable, CLIENTS / script, "a", "--server", url, "-o", tmp_path / "take.bvh")
    else:
        done = run(*node, CLIENTS / script, "a", tmp_path / "take.bvh", env={"MOVESET_SERVER": url})
    assert done.returncode == 1
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert done.stderr.strip().endswith(f"the packets are in {tmp_path / 'take.mvst'}")
    assert (tmp_path / "take.mvst").read_bytes() == packet


def test_a_stream_is_closed_with_what_the_server_refused(node):
    client = (CLIENTS / "stream_client.mjs").as_uri()
    script = f"""
        let closed = 0;
        globalThis.WebSocket = class {{
            constructor() {{ setTimeout(() => this.onmessage({{ data: '{{"type": "error", "message": "no"}}' }})) }}
            send() {{}}
            close() {{ closed++ }}
        }};
        const {{ record }} = await import({json.dumps(client)});
        await record("http://x", ["a"], 1).catch(({{ message }}) => console.log(message, closed));
    """
    assert run(*node, "--input-type=module", "-e", script).stdout == "no 1\n"


def test_the_javascript_client_runs_by_whatever_path(node, tmp_path):
    (tmp_path / "elsewhere").symlink_to(CLIENTS)
    script = tmp_path / "elsewhere" / "stream_client.mjs"
    done = run(*node, script, "a", env={"MOVESET_SERVER": "http://127.0.0.1:9"})
    assert (done.returncode, "no server at" in done.stderr) == (1, True)


@pytest.mark.parametrize(
    "reply",
    [
        b"",
        b"HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\nHIERARCHY",
        b"HTTP/1.1 502 Bad Gateway\r\nContent-Length: 6\r\n\r\n<html>",
    ],
    ids=["hangs up", "breaks off", "of a proxy"],
)
@pytest.mark.parametrize("script", ["generate_clip.py", "stream_client.py"])
def test_a_server_that_is_none_is_told_in_one_sentence(reply, script, tmp_path):
    with answering(reply) as address:
        done = run(sys.executable, CLIENTS / script, "a", "--server", address, "-o", tmp_path / "a.bvh")
    assert done.returncode == 1
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert not list(tmp_path.iterdir())


def test_amass_is_asked_for_by_name(node, served, tmp_path):
    host = served.removeprefix("http://")
    clients = {
        "clip": (sys.executable, CLIENTS / "generate_clip.py", "a", "--seconds", 2, "--server", host, "-o"),
        "stream": (sys.executable, CLIENTS / "stream_client.py", "a", "--seconds", 1, "--server", host, "-o"),
        "script": (*node, CLIENTS / "stream_client.mjs", "a"),
    }
    for name, command in clients.items():
        path = tmp_path / f"{name}.AMASS.npz"
        done = run(*command, path, env={**os.environ, "MOVESET_SERVER": f"{served}/"})
        assert done.returncode == 0, done.stderr
        with np.load(path) as found:
            assert found["poses"].shape[1] == 156


def test_a_folder_that_is_missing_is_said_before_anything_is_made(served, tmp_path):
    for client in ("generate_clip.py", "stream_client.py"):
        done = run(sys.executable, CLIENTS / client, "a", "--server", served, "-o", tmp_path / "no" / "take.bvh")
        assert done.returncode == 1
        assert done.stderr == f"there is no folder {tmp_path / 'no'}; make it first\n"
        assert done.stdout == ""


def test_clients_say_what_is_wrong_in_one_sentence(node, served):
    nowhere = "http://127.0.0.1:9"
    cases = [
        run(sys.executable, CLIENTS / "generate_clip.py", "a", "--server", nowhere),
        run(sys.executable, CLIENTS / "stream_client.py", "a", "--server", nowhere),
        run(sys.executable, CLIENTS / "generate_clip.py", "", "--server", served),
        run(sys.executable, CLIENTS / "stream_client.py", "x" * 600, "--server", served),
    ]
    for done in cases:
        assert done.returncode == 1
        assert "Traceback" not in done.stderr
        assert len(done.stderr.strip().splitlines()) == 1
    done = run(*node, CLIENTS / "stream_client.mjs", "a", env={"MOVESET_SERVER": nowhere, "PATH": ""})
    assert done.returncode == 1
    assert done.stderr == f"no server at {nowhere}; start one with: moveset serve\n"


def test_the_stream_client_fits_on_a_screen():
    assert (CLIENTS / "stream_client.py").read_text().count("\n") < 90
