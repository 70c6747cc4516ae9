"""Streams by WebSocket: what arrives is what a stream gives alone, as far ahead as was agreed, and never more."""

import asyncio
import itertools
import json
import time
from contextlib import contextmanager

import pytest
from starlette.websockets import WebSocketDisconnect

from moveset.io.packets import skeleton_json, unpack_packets
from moveset.pipelines.motion_stream import MotionStream
from moveset.server.socket import stream

WALK, BOW = "a person walks forward", "a person bows"
URL = "ws://127.0.0.1/v1/stream"


class Talk:
    """A client that reads what it is told to."""

    def __init__(self, socket):
        self.socket = socket
        self.hello = socket.receive_json()
        self.packets = {}

    def say(self, **message):
        self.socket.send_text(json.dumps(message))

    def hear(self):
        """The next message; packets are kept by their first frame."""
        got = self.socket.receive()
        if got["type"] == "websocket.close":
            raise WebSocketDisconnect(got["code"], got.get("reason"))
        if got.get("bytes") is not None:
            take = unpack_packets(got["bytes"])
            self.packets[take.first_frame] = take
            return {"type": "packet", "first_frame": take.first_frame, "bytes": got["bytes"]}
        return json.loads(got["text"])

    def until(self, kind, **wanted):
        """Everything up to a message of this kind."""
        heard = []
        while not heard or heard[-1]["type"] != kind or any(heard[-1].get(k) != v for k, v in wanted.items()):
            heard.append(self.hear())
            assert heard[-1]["type"] in (kind, "packet", "segment", "prompt", "started", "set", "error"), heard[-1]
        return heard

    def begin(self, **options):
        self.say(type="start", **options)
        return self.until("started")[-1]

    def quiet(self):
        """Whether nothing more comes: a question is answered at once, and nothing was sent before the answer."""
        time.sleep(0.3)
        self.say(type="nonsense")
        return self.until("error")[:-1] == []


@pytest.fixture
def talk(client):
    @contextmanager
    def connect(url=URL):
        with client.websocket_connect(url) as socket:
            yield Talk(socket)

    return connect


def alone(models, count, prompt=WALK, **options):
    return list(itertools.islice(MotionStream.from_pretrained(models[1], prompt, device="cpu", **options), count))


def differ(take, segment):
    return float((take.motion.joints - segment.motion.joints).norm(dim=-1).max())


def test_hello(talk):
    with talk() as one:
        assert (one.hello["type"], one.hello["version"]) == ("hello", 1)
        assert one.hello["limits"]["buffer"] == [0.5, 10.0]
        assert [model["name"] for model in one.hello["models"]] == ["tiny", "tiny-stream"]


def test_frames_are_those_of_the_stream_alone(talk, models):
    with talk() as one:
        begun = one.begin(prompt=WALK, seed=5, buffer=5.0, steps=2, guidance=2.0)
        want = {"model": "tiny-stream", "seed": 5, "steps": 2, "guidance": 2.0, "buffer": 5.0, "commit": None}
        want |= {"fps": 20.0, "segment_frames": 28}
        assert {name: begun[name] for name in want} == want
        assert begun["skeleton"] == skeleton_json()
        heard = one.until("packet", first_frame=84)
    told = [message for message in heard if message["type"] == "segment"]
    packets = [message for message in heard if message["type"] == "packet"]
    assert [(m["segment"], m["first_frame"], m["frames"], m["prompt"]) for m in told] == [
        (k, 28 * k, 28, WALK) for k in range(4)
    ]
    assert all(m["network_evaluations"] == 2 and m["latency_ms"] > 0 and m["queue_ms"] >= 0 for m in told)
    assert [m["first_frame"] for m in packets] == [0, 28, 56, 84]
    for k, segment in enumerate(alone(models, 4, seed=5, steps=2, guidance=2.0)):
        take = one.packets[28 * k]
        assert differ(take, segment) < 1e-3
        assert take.planted.shape == (28, 4)


def test_a_prompt_takes_effect_at_the_frame_that_is_told(talk, models):
    with talk() as one:
        one.begin(prompt=WALK, seed=5, buffer=3.0)
        one.until("packet", first_frame=56)
        one.say(type="prompt", text=BOW)
        changed = one.until("prompt", text=BOW)[-1]
        assert (changed["takes_effect_at"], changed["warnings"]) == (84, [])
        one.say(type="played", frame=80)
        heard = one.until("packet", first_frame=112)
        assert [m["prompt"] for m in heard if m["type"] == "segment"] == [BOW, BOW]
    lone = MotionStream.from_pretrained(models[1], WALK, seed=5, device="cpu")
    want = [next(lone) for _ in range(3)]
    lone.prompt(BOW)
    want += [next(lone) for _ in range(2)]
    assert max(differ(one.packets[28 * k], want[k]) for k in range(5)) < 1e-3


def test_what_comes_after_what_is_told_with_its_frames(talk):
    with talk() as one:
        one.begin(prompt="a person walks, then bows", seed=5, buffer=8.0)
        begun = one.until("prompt")[-1]
        assert begun["text"] == "a person walks, then bows"
        assert begun["stages"] == [
            {"text": "a person walks", "takes_effect_at": 0},
            {"text": "a person bows", "takes_effect_at": 84},
        ]
        heard = one.until("packet", first_frame=112)
        told = [m["prompt"] for m in heard if m["type"] == "segment"]
        assert told == ["a person walks"] * 3 + ["a person bows"] * 2


def test_stages_begin_anew_where_a_prompt_goes_back_to(talk):
    with talk() as one:
        one.begin(prompt=WALK, seed=5, buffer=8.0, commit=0)
        one.until("packet", first_frame=112)
        one.say(type="played", frame=28)
        one.say(type="prompt", text="a person bows, then runs")
        changed = one.until("prompt", text="a person bows, then runs")[-1]
        begins = changed["takes_effect_at"]
        assert begins < 112
        assert [stage["takes_effect_at"] for stage in changed["stages"]] == [begins, begins + 84]
        heard = one.until("packet", first_frame=begins + 84)
        told = {m["first_frame"]: m["prompt"] for m in heard if m["type"] == "segment"}
        assert [told[begins + 28 * k] for k in range(4)] == ["a person bows"] * 3 + ["a person runs"]


def test_an_unfamiliar_prompt_is_warned_of(talk):
    with talk() as one:
        one.begin(prompt="quarterly earnings of a bank", seed=5)
        assert "unlike anything" in one.until("prompt")[-1]["warnings"][0]


def test_the_longest_prompt_fits_however_it_is_escaped(talk):
    with talk() as one:
        one.begin(prompt="🤸" * 512)
        assert one.until("prompt")[-1]["text"] == "🤸" * 512


def test_who_never_acknowledges_gets_the_buffer_and_no_more(talk):
    with talk() as one:
        one.begin(buffer=2.0)
        one.until("packet", first_frame=28)
        assert one.quiet()
        one.say(type="played", frame=17)
        one.until("packet", first_frame=56)
        assert one.quiet()
        one.say(type="set", buffer=4.0)
        one.until("packet", first_frame=84)
        assert one.quiet()


def test_pause_and_resume(talk):
    with talk() as one:
        one.begin(buffer=2.0)
        one.until("packet", first_frame=28)
        one.say(type="pause")
        assert one.hear() == {"type": "paused", "frame": 56}
        one.say(type="played", frame=56)
        assert one.quiet()
        one.say(type="resume")
        assert one.hear() == {"type": "resumed", "frame": 56}
        one.until("packet", first_frame=84)


def test_steps_change_from_the_next_segment_on(talk):
    with talk() as one:
        assert one.begin(buffer=2.0)["steps"] == 1
        one.until("packet", first_frame=28)
        one.say(type="set", steps=2, guidance=4.0)
        assert one.until("set")[-1] == {"type": "set", "buffer": 2.0, "steps": 2, "guidance": 4.0}
        one.say(type="played", frame=40)
        assert one.until("segment")[-1]["network_evaluations"] == 2
        one.until("packet")
        one.say(type="set", steps=3)
        assert "has no 3 steps; choose 1, 2" in one.until("error")[-1]["message"]
        one.say(type="played", frame=70)
        assert one.until("segment")[-1]["network_evaluations"] == 2


def test_a_prompt_may_take_back_what_was_not_committed(talk, models):
    with talk() as one:
        one.begin(prompt=WALK, seed=5, buffer=6.0, commit=5)
        one.until("packet", first_frame=112)
        assert one.quiet()
        one.say(type="played", frame=21)
        one.until("packet", first_frame=140)
        one.say(type="prompt", text=BOW)
        assert one.until("prompt", text=BOW)[-1]["takes_effect_at"] == 28
        heard = one.until("packet", first_frame=140)
        assert [m["first_frame"] for m in heard if m["type"] == "packet"] == [28, 56, 84, 112, 140]
    lone = MotionStream.from_pretrained(models[1], WALK, seed=5, device="cpu")
    want = [next(lone)]
    lone.prompt(BOW)
    want += [next(lone) for _ in range(3)]
    assert max(differ(one.packets[28 * k], want[k]) for k in range(4)) < 1e-3


def test_one_stream_after_the_other(talk):
    with talk() as one:
        one.say(type="played", frame=3)
        assert one.hear()["code"] == "not_started"
        first = one.begin(seed=1)
        one.say(type="start")
        assert one.until("error")[-1]["code"] == "already_started"
        one.say(type="stop")
        while (message := one.hear())["type"] != "stopped":
            pass
        assert message["reason"] == "asked"
        second = one.begin(seed=1)
        assert second["stream"] > first["stream"]
        assert one.until("packet")[-1]["first_frame"] == 0


@pytest.mark.parametrize(
    ("options", "code"),
    [({"model": "tiny"}, "unknown_model"), ({"model": "../x"}, "unknown_model"), ({"steps": 3}, "invalid")],
)
def test_a_stream_that_cannot_begin_leaves_the_connection(talk, options, code):
    with talk() as one:
        one.say(type="start", **options)
        assert one.hear()["code"] == code
        if code == "invalid":
            assert one.hear() == {"type": "stopped", "frames": 0, "reason": "refused"}
        assert one.begin()["model"] == "tiny-stream"


def test_the_model_may_stand_in_the_address(talk):
    with talk(f"{URL}?model=tiny-stream") as one:
        assert one.begin()["model"] == "tiny-stream"
    with talk(f"{URL}?model=nothing") as one:
        one.say(type="start")
        assert one.hear()["code"] == "unknown_model"


def test_a_seed_is_chosen_and_told(talk):
    with talk() as one, talk() as two:
        assert one.begin()["seed"] != two.begin()["seed"]


def closed(one):
    """The last message and the code with which the connection was closed."""
    last = None
    while True:
        try:
            last = one.hear()
        except WebSocketDisconnect as end:
            return last, end.code


@pytest.mark.parametrize(
    ("send", "word", "code"),
    [
        (lambda socket: socket.send_text("x" * 8193), "too_large", 1009),
        (lambda socket: socket.send_text("ü" * 4097), "too_large", 1009),
        (lambda socket: socket.send_bytes(b"MVST"), "binary", 1008),
    ],
)
def test_what_ends_a_connection(talk, send, word, code):
    with talk() as one:
        one.begin()
        send(one.socket)
        last, found = closed(one)
        assert (last["type"], last["code"], found) == ("error", word, code)


def test_too_many_malformed_messages_end_a_connection(serving):
    with serving(bad_messages=5) as client, client.websocket_connect(URL) as socket:
        one = Talk(socket)
        for _ in range(6):
            socket.send_text("{")
        heard, code = closed(one)
        assert (heard["code"], code) == ("invalid", 1008)


def test_idle_connections_are_closed(serving):
    with serving(idle=0.3) as client, client.websocket_connect(URL) as socket:
        heard, code = closed(Talk(socket))
        assert (heard["code"], code) == ("idle", 1008)


def test_connections_and_streams_are_limited(serving):
    with serving(connections=2, streams=1) as client, client.websocket_connect(URL) as a:
        with client.websocket_connect(URL) as b:
            one, two = Talk(a), Talk(b)
            with client.websocket_connect(URL) as c:
                assert c.receive_json()["code"] == "busy"
                with pytest.raises(WebSocketDisconnect) as end:
                    c.receive_json()
                assert end.value.code == 1013
            one.begin()
            two.say(type="start")
            assert two.hear()["code"] == "busy"
            one.say(type="stop")
            while one.hear()["type"] != "stopped":
                pass
            two.begin()
        with client.websocket_connect(URL) as d:  # there is room again
            assert Talk(d).hello


def test_of_connections_that_come_at_once_as_many_stay_as_there_is_room_for(serving):
    class Socket:
        """As far as the server sees one: told what is sent, and silent until it is hung up."""

        def __init__(self, app, hung_up):
            self.app, self.told, self._hung_up = app, [], hung_up

        async def accept(self):
            pass

        async def receive(self):
            await self._hung_up.wait()
            return {"type": "websocket.disconnect"}

        async def send_text(self, text):
            self.told.append(json.loads(text))

        async def close(self, code, reason):
            self.told.append(code)

    async def burst(app):
        hung_up = asyncio.Event()
        sockets = [Socket(app, hung_up) for _ in range(9)]
        tasks = [asyncio.create_task(stream(socket)) for socket in sockets]
        while not all(socket.told for socket in sockets):
            await asyncio.sleep(0.01)
        hung_up.set()
        await asyncio.gather(*tasks)
        return [socket.told for socket in sockets]

    with serving(connections=4) as client:
        told = client.portal.call(burst, client.app)
        assert [one[0]["type"] for one in told] == ["hello"] * 4 + ["error"] * 5
        assert all(one[0]["code"] == "busy" and one[-1] == 1013 for one in told[4:])
        metrics = client.get("/metrics").text
        assert 'moveset_refused_total{code="busy"} 5.0' in metrics
        assert "moveset_connections 0.0" in metrics


def test_stopping_tells_streams(serving):
    with serving() as client:
        with client.websocket_connect(URL) as socket:
            one = Talk(socket)
            one.begin(buffer=2.0)
            one.until("packet", first_frame=28)
            job = client.post("/v1/jobs", json={"prompts": [{"text": WALK, "seconds": 1.0}]}).json()["id"]
            the = client.app.state.service
            client.portal.call(the.stop)
            heard, code = closed(one)
            assert heard == {"type": "stopped", "frames": 56, "reason": "server stopping"}
            assert code == 1001
        assert client.get(f"/v1/jobs/{job}").json()["state"] in ("done", "cancelled")
        assert client.get("/healthz").status_code == 503
        answer = client.post("/v1/generate", json={"prompts": [{"text": WALK}]})
        assert (answer.status_code, answer.json()["error"]["code"]) == (503, "stopping")
        with client.websocket_connect(URL) as socket, pytest.raises(WebSocketDisconnect) as end:
            socket.receive_json()
        assert end.value.code == 1013
