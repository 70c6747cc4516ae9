"""``moveset serve`` as a program: what it says, how it stops, and whom it makes wait."""

import asyncio
import json
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from contextlib import contextmanager, suppress
from dataclasses import replace

import pytest
import websockets

from moveset.cli.__main__ import main
from moveset.server.app import create_app
from moveset.server.limits import Limits
from moveset.server.run import listen, make_server
from moveset.server.service import Options
from tests import loops


@contextmanager
def inside(models, **limits):
    """A listening server in a thread of this process; its port."""
    app = create_app(Options(models, "cpu", replace(Limits(), **limits)))
    bound, up = listen("127.0.0.1", 0), threading.Event()
    server = make_server(app, opened=up.set)
    thread = threading.Thread(target=server.run, args=([bound],))
    thread.start()
    assert up.wait(60)
    try:
        yield bound.getsockname()[1]
    finally:
        server.should_exit = True
        thread.join(60)
        assert not thread.is_alive()


def let_go(one):
    """Whether the server closes a connection on which nothing is sent."""
    one.settimeout(10)
    with suppress(ConnectionError), one:
        return one.recv(1) == b""
    return True


def test_being_stopped_tells_streams_and_is_no_failure(start):
    program = start()

    async def play():
        async with websockets.connect(f"ws://{program.address}/v1/stream") as ws:
            await ws.send('{"type":"start","buffer":2.0}')
            texts = []
            try:
                while True:
                    got = await ws.recv()
                    if isinstance(got, str):
                        texts.append(json.loads(got))
                    elif len([t for t in texts if t["type"] == "segment"]) == 2:
                        body = json.dumps(
                            {"prompts": [{"text": "a person bows", "seconds": 9.0}] * 4, "num": 8, "steps": 50}
                        )
                        request = urllib.request.Request(
                            f"{program.url}/v1/jobs", body.encode(), {"Content-Type": "application/json"}
                        )
                        urllib.request.urlopen(request).close()
                        program.process.terminate()
            except websockets.ConnectionClosed as end:
                return texts[-1], end.rcvd.code

    last, code = loops.run(asyncio.wait_for(play(), 60))
    assert last == {"type": "stopped", "frames": 56, "reason": "server stopping"}
    assert code in (1001, 1012)
    assert program.stop()[0] == 0


def test_a_refused_websocket_is_no_fault_of_the_server(start):
    program = start()

    async def ask():
        async with websockets.connect(f"ws://{program.address}/v1/stream", origin="https://evil.example"):
            pass

    with pytest.raises(websockets.InvalidStatus, match="403"):
        loops.run(ask())
    assert program.stop() == (0, "", "")


@pytest.mark.parametrize("times", [1, 2, 3])
def test_ctrl_c_is_no_failure_either(times, start):
    program = start()
    for pause in (0.02,) * times:
        program.process.send_signal(signal.SIGINT)
        time.sleep(pause)
    program.process.wait(60)
    code, _, err = program.stop()
    assert (code, err) == (0, "")


def test_a_port_that_is_taken(capsys, models):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert main(["serve", "--no-open", "--port", port, "--model", str(models[0])]) == 2
    err = capsys.readouterr().err
    assert f"port {port}" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--port", "70000"], "70000"),
        (["--streams", "0"], "streams"),
        (["--idle", "0"], "seconds"),
        (["--allow-origin", "example.org"], "example.org"),
        (["--allow-origin", "https://example.org/path"], "example.org"),
        (["--model", "nothing"], "nothing"),
        (["--device", "abacus"], "abacus"),
    ],
)
def test_options_that_do_not_go(options, word, capsys):
    assert main(["serve", "--no-open", *options]) == 2
    err = capsys.readouterr().err
    assert word in err
    assert err.count("\n") == 1


def test_without_the_extra_it_says_how_to_get_it():
    code = "import sys; sys.modules['fastapi'] = None; from moveset.cli.__main__ import main; sys.exit(main(['serve']))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2
    assert "pip install 'moveset[serve]'" in done.stderr
    assert done.stderr.count("\n") == 1


def test_who_says_nothing_is_let_go(models):
    with inside(models, patience=0.3, sockets=3) as port:
        silent = [socket.create_connection(("127.0.0.1", port)) for _ in range(3)]
        time.sleep(0.1)
        with socket.create_connection(("127.0.0.1", port)) as fourth:
            assert let_go(fourth)
        assert all(map(let_go, silent))
        for _ in range(2):
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/healthz") as answer:
                assert answer.status == 200


def test_who_sends_half_a_request_is_told(models):
    with inside(models, patience=0.3) as port, socket.create_connection(("127.0.0.1", port)) as one:
        one.settimeout(10)
        host = b"Host: 127.0.0.1\r\nContent-Type: application/json\r\n"
        one.sendall(b"POST /v1/generate HTTP/1.1\r\n" + host + b"Content-Length: 100\r\n\r\n{")
        assert b"408" in one.recv(100)


def test_a_websocket_may_wait_longer_than_that(models):
    with inside(models, patience=0.2) as port:

        async def wait():
            async with websockets.connect(f"ws://127.0.0.1:{port}/v1/stream") as ws:
                await ws.recv()
                await asyncio.sleep(0.8)
                await ws.send('{"type":"start"}')
                assert json.loads(await ws.recv())["type"] == "started"

        loops.run(wait())


def test_who_hangs_up_gives_the_clip_up(models):
    with inside(models) as port:
        body = json.dumps({"prompts": [{"text": "a person bows", "seconds": 9.0}] * 6, "num": 8, "steps": 50}).encode()
        one = socket.create_connection(("127.0.0.1", port))
        lines = ("POST /v1/generate HTTP/1.1", "Host: 127.0.0.1", "Content-Type: application/json")
        one.sendall("\r\n".join((*lines, f"Content-Length: {len(body)}", "", "")).encode() + body)

        def jobs():
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/healthz") as answer:
                return json.load(answer)["jobs"]

        while jobs() == 0:
            time.sleep(0.02)
        one.close()
        begun = time.monotonic()
        while jobs():
            assert time.monotonic() - begun < 30
            time.sleep(0.05)
