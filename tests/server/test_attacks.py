"""Attacks and accidents against a running server: it stays up, its memory bounded, and other streams go on in order."""

import asyncio
import json
import os
import random
import resource
import signal
import socket
import subprocess
import sys
from contextlib import suppress

import pytest
import websockets

from moveset.io.packets import unpack_packets
from tests import loops

pytestmark = pytest.mark.skipif(not os.path.exists("/proc/self/status"), reason="reads memory from /proc")

MEGABYTES = 60  # that memory may grow by: allocators keep what they had
WALK = "a person walks forward"


def run(attack, program):
    """An attack beside a stream that must not notice."""

    async def both():
        over = asyncio.Event()
        witness = asyncio.create_task(watch(program, over))
        await asyncio.sleep(0.2)
        before = program.memory
        try:
            await asyncio.wait_for(attack(), 120)
        finally:
            over.set()
            frames = await witness
        assert frames >= 10 * 28
        assert program.memory - before < MEGABYTES
        assert program.health()["status"] == "ok"

    loops.run(both())
    assert program.process.poll() is None


async def watch(program, over):
    """Plays a stream until it is told to stop, and at least ten segments; every frame once and in order."""
    frames = 0
    async with connected(program) as ws:
        await ws.recv()
        await ws.send(json.dumps({"type": "start", "prompt": WALK, "seed": 1, "buffer": 1.0}))
        while not over.is_set() or frames < 10 * 28:
            got = await asyncio.wait_for(ws.recv(), 60)
            if isinstance(got, bytes):
                take = unpack_packets(got)
                assert take.first_frame == frames
                frames += len(take.motion)
                await asyncio.sleep(0.01)
                await ws.send(json.dumps({"type": "played", "frame": frames}))
            else:
                assert json.loads(got)["type"] in ("started", "prompt", "segment"), got
    return frames


def connected(program, **options):
    return websockets.connect(f"ws://{program.address}/v1/stream", max_size=2**22, **options)


async def thrown_out(program, message):
    """The code with which the server closes a connection on which this is sent."""
    async with connected(program) as ws:
        try:
            await ws.send(message)
            while True:
                await ws.recv()
        except websockets.ConnectionClosed as end:
            return end.rcvd and end.rcvd.code


async def begun(program, **options):
    ws = await connected(program, **options)
    await ws.recv()
    await ws.send(json.dumps({"type": "start", "prompt": WALK, "seed": 2}))
    return ws


def test_oversized_and_malformed_messages(program):
    texts = ["x" * 9000, "x" * 60_000, "[" * 4000, "{" * 4000, '"\\ud800"', "\0" * 100, "9" * 4000, "ü" * 2000, ""]

    async def attack():
        for text in texts:
            async with connected(program) as ws:
                for _ in range(3):
                    try:
                        await ws.send(text)
                    except websockets.ConnectionClosed:
                        break
        for data in (b"", b"MVST" * 1000, os.urandom(3000)):
            assert await thrown_out(program, data) == 1008
        assert await thrown_out(program, "x" * 10**6) in (1009, None)  # more than is even read
        assert await thrown_out(program, ("x" * 1000 for _ in range(2000))) in (1009, None)  # in pieces without end

    run(attack, program)


def test_bytes_that_are_no_http(program):
    async def attack():
        hello = b"GET /v1/stream HTTP/1.1\r\nHost: %s\r\n" % program.address.encode()
        upgrade = b"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        key = b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
        for data in (
            os.urandom(5000), b"\x16\x03\x01\x02\x00\x01", b"GET " + b"a" * 200_000, hello + b"A: " + b"b" * 200_000,
            hello + b"\r\n", hello + upgrade + b"\r\n", hello + upgrade + key + b"\xff" * 100,
            hello + upgrade + key + b"\x81\xff" + b"\xff" * 8 + b"mask", hello + upgrade + key + b"\x89\xfe\xff\xff",
            b"POST /v1/generate HTTP/1.1\r\nHost: %s\r\nContent-Length: -5\r\n\r\n" % program.address.encode(),
            b"POST /v1/export?format=bvh HTTP/1.1\r\nHost: %s\r\nContent-Length: 99999999999999999999\r\n"
            b"Content-Type: application/octet-stream\r\n\r\n" % program.address.encode(),
        ):  # fmt: skip
            reader, writer = await asyncio.open_connection("127.0.0.1", program.port)
            answer = b""
            with suppress(OSError):  # it may have hung up before all was said
                writer.write(data)
                await writer.drain()
                writer.write_eof()
            with suppress(ConnectionError):
                answer = await asyncio.wait_for(reader.read(2000), 20)
            assert b"Traceback" not in answer
            assert not answer.startswith(b"HTTP/1.1 5"), answer
            writer.close()

    run(attack, program)


def test_a_thousand_connections(program):
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    count = min(1000, soft - 200)

    async def attack():
        refused = 0

        async def one():
            nonlocal refused
            try:
                ws = await connected(program, open_timeout=60, ping_interval=None)
            except (OSError, websockets.InvalidHandshake, EOFError):
                refused += 1
                return None
            return ws

        opened = [ws for ws in await asyncio.gather(*(one() for _ in range(count))) if ws]
        told = [json.loads(await asyncio.wait_for(ws.recv(), 60)) for ws in opened]
        good = sum(message["type"] == "hello" for message in told)
        assert 1 <= good <= 64
        assert all(message["type"] == "hello" or message["code"] == "busy" for message in told)
        assert good + refused + sum(message.get("code") == "busy" for message in told) == count
        for ws in opened:
            await ws.close()

    run(attack, program)


def test_connections_that_say_nothing(program):
    sockets = [socket.create_connection(("127.0.0.1", program.port)) for _ in range(250)]
    assert program.health()["status"] == "ok"
    for one in sockets:
        one.close()


def test_clients_that_never_read(program):
    async def attack():
        lazy = []
        for _ in range(2):
            _, writer = await asyncio.open_connection("127.0.0.1", program.port, limit=1024)
            request = (
                f"GET /v1/stream HTTP/1.1\r\nHost: {program.address}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
            )
            writer.write(request.encode())
            lazy.append(writer)
            writer.transport.pause_reading()

        def message(text):
            data = text.encode()
            head = bytes([0x81, 0x80 | len(data)]) if len(data) < 126 else b"\x81\xfe" + len(data).to_bytes(2, "big")
            return head + bytes(4) + data

        # One lies that it has played everything, and asks for ever more; the other floods with pings.
        lazy[0].write(message('{"type":"start","buffer":10}'))
        for k in range(3000):
            lazy[0].write(message(f'{{"type":"played","frame":{28 * k}}}') + message('{"type":"nonsense"}'))
            lazy[1].write((b"\x89\xfd" + bytes(4) + b"x" * 125) * 10)
            if k % 50 == 0:
                await asyncio.sleep(0.01)
        await asyncio.sleep(1.0)
        for writer in lazy:
            writer.transport.abort()

    run(attack, program)


CLIENT = """
import asyncio, json, sys, websockets
async def main():
    async with websockets.connect(sys.argv[1]) as ws:
        await ws.send(json.dumps({"type": "start", "buffer": 2.0}))
        frames = 0
        while True:
            got = await ws.recv()
            if isinstance(got, bytes):
                frames += 28
                print("frame", frames, flush=True)
                await ws.send(json.dumps({"type": "played", "frame": frames - 30}))
asyncio.run(main())
"""


def test_a_client_that_is_killed(program):
    async def attack():
        for _ in range(2):
            client = subprocess.Popen(
                [sys.executable, "-c", CLIENT, f"ws://{program.address}/v1/stream"], stdout=subprocess.PIPE
            )
            await asyncio.to_thread(client.stdout.readline)
            assert program.health()["streams"] >= 2
            client.send_signal(signal.SIGKILL)
            client.wait()
            client.stdout.close()
        for _ in range(200):
            if program.health()["streams"] == 1:
                return
            await asyncio.sleep(0.05)
        raise AssertionError(program.health())

    run(attack, program)


def wild(rng):
    """A message that is nearly right, or not at all."""
    kinds = ["start", "prompt", "played", "pause", "resume", "set", "stop", "", "x" * 50, None, 7]
    fields = ["prompt", "text", "seed", "steps", "guidance", "buffer", "commit", "frame", "model", "type", "__proto__"]
    values = [0, -1, 1, 2, 28, 10**6, 2**62, 2**70, 0.5, 1e308, -0.0, True, None, [], {}, [[]], {"a": {}}, float("nan")]
    values += ["", "walk", "a person bows", "<script>alert(1)</script>", "../../etc/passwd", "\u202e\u0000\x1b[2J"]
    values += ["😀" * 100, "tiny-stream", "nan"]
    message = {"type": rng.choice(kinds)}
    for _ in range(rng.choice([0, 1, 1, 2, 5])):
        message[rng.choice(fields)] = rng.choice(values)
    text = json.dumps(message)
    if rng.random() < 0.1:
        cut = rng.randrange(len(text))
        text = text[:cut] + rng.choice(["", "\0", "é", "}", '"', "\\u12"]) + text[cut + 1 :]
    return text


def test_ten_thousand_random_messages(program):
    """From five clients; each of them comes back when it is thrown out for too many bad ones."""

    async def client(seed):
        rng, sent = random.Random(seed), 0
        good = ['{"type":"prompt","text":"a person bows"}', '{"type":"played","frame":999999}', '{"type":"resume"}']
        while sent < 2000:
            ws = await begun(program)
            reading = asyncio.create_task(drain(ws))
            with suppress(websockets.ConnectionClosed):
                while sent < 2000:
                    await ws.send(wild(rng) if rng.random() < 0.7 else rng.choice(good))
                    sent += 1
            await ws.close()
            assert ws.close_code in (1000, 1008, 1009), ws.close_code
            reading.cancel()
        return sent

    async def drain(ws):
        with suppress(websockets.ConnectionClosed):
            async for got in ws:
                if isinstance(got, bytes):
                    unpack_packets(got)
                else:
                    assert json.loads(got).get("code") != "internal", got

    async def attack():
        assert sum(await asyncio.gather(*map(client, range(5)))) == 10_000

    run(attack, program)
