"""``moveset serve`` as a program: what it says, how it stops, and whom it makes wait."""

import asyncio
import http.client
import json
import signal
import socket
import sys
import threading
import time
import urllib.request
from contextlib import contextmanager, suppress
from dataclasses import replace
from queue import Queue
from types import SimpleNamespace

import pytest
import websockets

from moveset.cli.__main__ import main
from moveset.io.packets import pack_packet
from moveset.server.app import create_app
from moveset.server.limits import Limits
from moveset.server.run import listen, make_server
from moveset.server.service import Options
from tests import loops
from tests.motions import wander


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


def hangs_up(these):
    """Whether the server closes connections on which something is sent again and again."""
    with suppress(ConnectionError):
        for _ in range(100):
            time.sleep(0.1)
            for one in these:
                one.sendall(b"T")
        return False
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
                        program.process.send_signal(signal.SIGINT)
            except websockets.ConnectionClosed as end:
                return texts[-1], end.rcvd.code

    last, code = loops.run(asyncio.wait_for(play(), 60))
    assert last == {"type": "stopped", "frames": 56, "reason": "server stopping"}
    assert code in (1001, 1012)
    assert program.stop()[0] == 0


def test_a_refused_websocket_is_no_fault_of_the_server(models, capfd):
    with inside(models) as port:

        async def ask():
            async with websockets.connect(f"ws://127.0.0.1:{port}/v1/stream", origin="https://evil.example"):
                pass

        with pytest.raises(websockets.InvalidStatus, match="403"):
            loops.run(ask())
    assert capfd.readouterr() == ("", "")


def test_ctrl_c_again_and_again_is_no_failure_either(start):
    program = start()
    for _ in range(3):
        program.process.send_signal(signal.SIGINT)
        time.sleep(0.02)
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


def test_two_servers_do_not_share_a_port_on_windows(monkeypatch):
    # SO_REUSEADDR lets them there; an option that this system has stands for the one that forbids it.
    monkeypatch.setattr(socket, "SO_EXCLUSIVEADDRUSE", socket.SO_KEEPALIVE, raising=False)
    with listen("127.0.0.1", 0) as bound:
        reused, exclusive = (bound.getsockopt(socket.SOL_SOCKET, o) for o in (socket.SO_REUSEADDR, socket.SO_KEEPALIVE))
    assert (bool(reused), bool(exclusive)) == (False, True)


@pytest.mark.parametrize(
    ("host", "page"),
    [
        ("localhost", "http://localhost:80/"),
        ("0.0.0.0", "http://127.0.0.1:80/"),
        ("::", "http://[::1]:80/"),
        ("fe80::1", "http://[fe80::1]:80/"),
    ],
)
def test_a_browser_is_not_waited_for_and_gets_an_address_that_it_can_open(host, page, models, monkeypatch):
    seen, served = Queue(), threading.Event()
    monkeypatch.setattr("webbrowser.open", lambda url: seen.put((url, served.wait(10))))
    monkeypatch.setattr("moveset.server.run.listen", lambda *_: SimpleNamespace(getsockname=lambda: (host, 80, 0, 0)))
    monkeypatch.setattr("moveset.server.run.make_server", lambda _, opened: SimpleNamespace(run=lambda _: opened()))
    assert main(["serve", "--host", host, "--model", str(models[0])]) == 0
    served.set()
    assert seen.get(timeout=60) == (page, True)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--port", "70000"], "70000"),
        (["--streams", "0"], "streams"),
        (["--idle", "0"], "seconds"),
        (["--allow-origin", "example.org"], "example.org"),
        (["--allow-origin", "https://example.org/path"], "example.org"),
        *(
            (["--allow-origin", origin], "is no origin")
            for origin in ("*", "", "https://", "file:///a", "app://a?b", "x:", "https://*.example.org", "http://a:0")
        ),
        (["--allow-origin", "https://bücher.example"], "xn--"),
        (["--model", "nothing"], "nothing"),
        (["--device", "abacus"], "abacus"),
    ],
)
def test_options_that_do_not_go(options, word, capsys):
    assert main(["serve", "--no-open", *options]) == 2
    err = capsys.readouterr().err
    assert word in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "origin", ["null", "file://", "app://studio", "app://.", "capacitor://localhost", "http://192.168.0.2:5173"]
)
def test_origins_that_browsers_send_can_be_allowed(origin):
    from moveset.cli.serve import _options

    assert _options("127.0.0.1", (), "cpu", (origin,), 16, 120.0).origins == (origin,)


@pytest.mark.parametrize(
    ("given", "sent"),
    [
        ("https://a.example/", "https://a.example"),
        ("HTTPS://Game.Example", "https://game.example"),
        ("https://game.example:443", "https://game.example"),
        ("https://game.example:80", "https://game.example:80"),
        ("http://localhost:80", "http://localhost"),
        ("http://[FE80::1]:080/", "http://[fe80::1]"),
        ("https://xn--bcher-kva.example", "https://xn--bcher-kva.example"),
        ("App://Studio", "app://Studio"),  # no address: browsers keep what the program says
    ],
)
def test_origins_are_spelled_as_browsers_send_them(given, sent):
    from moveset.server.service import Options

    assert Options(origins=(given,)).origins == (sent,) == Options(origins=(sent,)).origins


def test_without_the_extra_it_says_how_to_get_it(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "fastapi", None)
    assert main(["serve"]) == 2
    err = capsys.readouterr().err
    assert ("pip install 'moveset[serve]'" in err, err.count("\n")) == (True, 1)


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


@pytest.mark.parametrize("drips", [False, True])
def test_who_begins_a_second_request_and_does_not_end_it_is_let_go(drips, models):
    with inside(models, patience=1.5, sockets=3) as port:
        held = [http.client.HTTPConnection("127.0.0.1", port, timeout=10) for _ in range(3)]
        for one in held:
            one.request("GET", "/healthz")
            assert one.getresponse().read()
            one.sock.sendall(b"GE")
        assert not drips or hangs_up([one.sock for one in held])
        assert all(let_go(one.sock) for one in held)
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/healthz") as answer:
            assert answer.status == 200


def test_requests_in_pieces_are_answered_for_as_long_as_they_come(models):
    with inside(models, patience=2.0) as port, socket.create_connection(("127.0.0.1", port)) as one:
        one.settimeout(10)
        for _ in range(10):
            one.sendall(b"GET /healthz HTTP/1.1\r\nHo")
            time.sleep(0.25)
            one.sendall(b"st: 127.0.0.1\r\n\r\n")
            answer = http.client.HTTPResponse(one)
            answer.begin()
            assert (answer.status, json.load(answer)["status"]) == (200, "ok")


def export(length):
    """What an export begins with."""
    lines = ("POST /v1/export?format=bvh HTTP/1.1", "Host: 127.0.0.1", "Content-Type: application/octet-stream")
    return "\r\n".join((*lines, f"Content-Length: {length}", "", "")).encode()


def test_who_drips_an_export_is_told_and_makes_room_for_others(models):
    with inside(models, patience=0.5, exports=1) as port, socket.create_connection(("127.0.0.1", port)) as one:
        one.sendall(export(100_000))
        one.settimeout(0.1)
        answer = b""
        for _ in range(100):
            one.sendall(b"x")
            with suppress(TimeoutError):
                answer = one.recv(100)
                break
        assert b"408" in answer
        data, headers = pack_packet(wander(9, seed=1)), {"Content-Type": "application/octet-stream"}
        asked = urllib.request.Request(f"http://127.0.0.1:{port}/v1/export?format=bvh", data, headers)
        with urllib.request.urlopen(asked) as answer:
            assert answer.read().startswith(b"HIERARCHY")


def test_an_export_may_take_longer_than_patience_where_it_keeps_coming(models):
    data = pack_packet(wander(90, seed=1))
    with inside(models, patience=1.0) as port, socket.create_connection(("127.0.0.1", port)) as one:
        one.settimeout(10)
        one.sendall(export(len(data)))
        for k in range(0, len(data), 2500):
            one.sendall(data[k : k + 2500])
            time.sleep(0.1)
        assert one.recv(100).startswith(b"HTTP/1.1 200")


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
