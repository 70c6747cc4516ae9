"""Streams in the studio: what is said takes effect at the frame that the server reports, and what is lost is told."""

import json

import numpy as np
import pytest

import moveset
from moveset.io.packets import unpack_packets
from moveset.motion.kinematics import fk


class Spy:
    """Listens to the WebSockets of a page."""

    def __init__(self, page):
        self.messages, self.packets, self.sent = [], [], []
        page.on("websocket", self._listen)

    def _listen(self, socket):
        socket.on("framereceived", lambda data: self._got(data))
        socket.on("framesent", lambda data: self.sent.append(json.loads(data)))

    def _got(self, data):
        if isinstance(data, bytes):
            self.packets.append(data)
        else:
            self.messages.append(json.loads(data))

    def said(self, kind):
        """Messages of the server of one type."""
        return [message for message in self.messages if message["type"] == kind]


def route_next(studio, route):
    """Let a function stand between the page and the server for the next stream alone."""
    waiting = [route]
    studio.page.route_web_socket(
        "**/v1/stream", lambda socket: waiting.pop()(socket) if waiting else socket.connect_to_server()
    )


def start(studio, text):
    """Begin a stream and wait for its first frames."""
    studio.click("#mode-live")
    studio.say(text)
    studio.wait("document.body.dataset.live === 'running' && __moveset.live.shown")
    # Where pictures are slow, as in software, the clock of the player is as well.
    studio.run("__moveset.player.speed = 2")


def test_a_new_sentence_takes_effect_at_the_reported_frame(studio):
    spy = Spy(studio.page)
    start(studio, "a person walks forward")
    studio.wait("__moveset.player.frame > 2")
    studio.say("a person waves with both hands")
    studio.wait("__moveset.live.shown.takes[0].prompts.length === 2")
    told = spy.said("prompt")[-1]
    assert told["text"] == "a person waves with both hands"
    at = told["takes_effect_at"]
    marks = studio.run("__moveset.live.shown.takes[0].prompts")
    assert marks[1] == {"text": told["text"], "firstFrame": at}
    assert at > 0
    # It is marked on the strip, counted down to, and current as soon as that frame is played.
    assert studio.wait(f"document.querySelector('.strip [data-frame=\"{at}\"]')")
    studio.wait(f"__moveset.player.frame >= {at}")
    studio.wait(f"document.querySelector('.strip .now').dataset.frame === '{at}'")
    assert studio.run("document.querySelector('#live-strip').getAttribute('aria-label')") == f"Now: {told['text']}"
    assert studio.words("#figure-latency").endswith("ms")
    # What plays is what was sent last for each frame.
    studio.click("#live-pause")
    studio.wait("document.body.dataset.live === 'paused'")
    studio.wait("!__moveset.player.playing")
    frames = studio.run("__moveset.live.shown.takes[0].take.frames")
    expected = np.full((frames, 22, 3), np.nan)
    for packet in spy.packets:
        take = unpack_packets(packet)
        places = fk(take.motion.rotations, take.motion.root, take.motion.skeleton)[1].numpy()
        expected[take.first_frame : take.first_frame + len(places)] = places[: frames - take.first_frame]
    said = {segment["first_frame"]: segment["prompt"] for segment in spy.said("segment")}
    assert said[at] == told["text"]
    seen = np.array(
        studio.run(f"Array.from({{ length: {frames} }}, (_, k) => Array.from(__moveset.player.jointPositions(k, 0)))")
    ).reshape(-1, 22, 3)
    assert np.abs(seen - expected).max() < 1e-3
    # Playing was acknowledged in order, and never more than was shown.
    played = [message["frame"] for message in spy.sent if message["type"] == "played"]
    assert played == sorted(set(played))
    assert played[-1] <= studio.run("__moveset.player.frame")


def test_what_was_made_ahead_of_a_new_sentence_is_not_played_as_that(studio):
    start(studio, "a person walks forward")
    studio.wait("__moveset.live.shown.takes[0].take.frames > 40")
    # What the server had on its way does not follow on a sentence that it never heard of: nothing more is heard of it.
    at = studio.run("(__moveset.live.stream.socket.onmessage = null, __moveset.live.shown.takes[0].take.frames)") - 10
    stages = json.dumps([{"text": "a person waves", "takes_effect_at": at}])
    studio.run(f"__moveset.live.hear({{ type: 'prompt', stages: {stages}, warnings: [] }})")
    assert studio.run("__moveset.live.shown.takes[0].take.frames") == at


def test_what_comes_after_what_is_marked_and_counted_down_to(studio):
    start(studio, "a person walks forward, then waves with both hands")
    marks = [
        {"text": "a person walks forward", "firstFrame": 0},
        {"text": "a person waves with both hands", "firstFrame": 84},
    ]
    studio.wait("__moveset.live.shown.takes[0].prompts.length === 2")
    assert studio.run("__moveset.live.shown.takes[0].prompts") == marks
    studio.wait("document.querySelector('#figure-prompt').textContent.startsWith('4.2 s, in')")


def test_the_timeline_of_clips_is_not_there(studio):
    entries = [{"text": text, "seconds": 2, "made": None} for text in ("a person walks", "a person bows")]
    studio.run("entries => __moveset.clip.restore(entries)", entries)
    hidden = "document.querySelector('#timeline').hidden"
    drawn = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
    studio.run(drawn)
    assert not studio.run(hidden)
    studio.click("#mode-live")
    studio.run(drawn)
    assert studio.run(hidden)
    studio.click("#mode-clip")
    assert not studio.run(hidden)


def test_a_stream_pauses_goes_on_stops_and_is_kept(studio, tmp_path):
    kept = studio.run("__moveset.recent.added")
    start(studio, "a person walks forward")
    # Space on the page stops the motion and the making of it.
    studio.run("document.activeElement.blur()")
    studio.page.keyboard.press("Space")
    studio.wait("document.body.dataset.live === 'paused'")
    frame = studio.run("__moveset.player.frame")
    studio.page.keyboard.press("Space")
    studio.wait(f"document.body.dataset.live === 'running' && __moveset.player.frame > {frame}")
    studio.page.keyboard.press("h")
    assert studio.run("__moveset.recent.added") == kept + 1
    studio.page.keyboard.press("x")
    studio.wait("document.body.dataset.live === 'idle'")
    assert studio.run("__moveset.recent.added") == kept + 2
    assert studio.words("#made").startswith("Stream of")
    studio.run("__moveset.player.pause()")
    studio.run("__moveset.player.seek(5)")
    assert studio.run("__moveset.player.frame") == 5
    with studio.page.expect_download() as download:
        studio.click("#open-downloads")
        studio.click("[data-format=npz]")
    download.value.save_as(tmp_path / "stream.npz")
    assert len(moveset.load(tmp_path / "stream.npz").root) > 20
    # What was said of the last stream does not stand beside the next one.
    start(studio, "a person bows")
    assert studio.words("#made") == ""


def test_a_recording_of_a_stream_ends_when_it_is_asked_to_and_is_one_file(studio):
    saved = []
    studio.page.on("download", lambda download: saved.append(download.suggested_filename))
    start(studio, "a person walks forward")
    studio.click("#open-downloads")
    studio.click("[data-format=webm]")
    studio.wait("__moveset.player.recording !== null")
    assert "red button" in studio.words(".toast p")
    studio.page.wait_for_timeout(300)
    studio.click(".mv-record")
    studio.wait("__moveset.player.recording === null && document.body.dataset.live === 'running'")
    studio.page.wait_for_timeout(500)
    assert saved == ["a-person-walks-forward.webm"]


def test_a_stream_that_was_stopped_is_kept_where_the_next_one_begins_before_it_has_ended(studio):
    def route(socket):
        # A server with much to do says that a stream has stopped only after somebody has asked for another one.
        upstream = socket.connect_to_server()
        upstream.on_message(lambda message: None if '"stopped"' in str(message) else socket.send(message))

    studio.page.route_web_socket("**/v1/stream", route)
    kept = studio.run("__moveset.recent.added")
    start(studio, "a person walks forward")
    studio.click("#live-stop")
    assert studio.run("document.body.dataset.live") == "stopping"
    start(studio, "a person bows")
    assert studio.run("__moveset.recent.added") == kept + 1
    studio.click("#open-recent")
    assert studio.words("#shelf .kept strong") == "a person walks forward"


def test_a_lost_stream_is_told_and_found_again(studio):
    lose = {"next": True}

    def route(socket):
        if not lose.pop("next", False):
            socket.connect_to_server()
            return
        upstream = socket.connect_to_server()

        def heard(message):
            socket.send(message)
            if isinstance(message, bytes):
                socket.close(code=1011, reason="gone")

        upstream.on_message(heard)

    studio.page.route_web_socket("**/v1/stream", route)
    studio.click("#mode-live")
    studio.say("a person walks forward")
    studio.wait("document.body.dataset.live === 'lost' && !document.querySelector('#gone').hidden")
    assert "lost" in studio.words("#gone-text")
    studio.click("#reconnect")
    studio.wait("document.body.dataset.live === 'running' && document.querySelector('#gone').hidden")
    assert studio.run("__moveset.live.prompt") == "a person walks forward"


def test_a_stream_that_is_left_before_it_begins_does_not_come_after_one(studio):
    studio.make("a person bows")
    held = []

    def route(socket):
        upstream = socket.connect_to_server()
        upstream.on_message(
            lambda message: held.append((socket, message)) if isinstance(message, bytes) else socket.send(message)
        )

    route_next(studio, route)
    studio.click("#mode-live")
    studio.say("a person walks forward")
    while not held:
        studio.page.wait_for_timeout(20)
    studio.click("#mode-clip")
    for socket, message in held:
        socket.send(message)
    studio.page.wait_for_timeout(300)
    assert studio.run("__moveset.stage.shown.kind") == "clip"
    # And what stands there is not greeted again.
    assert studio.run("document.querySelector('.hero').getClientRects().length") == 0


def test_a_stream_that_was_refused_does_not_clear_the_stage(studio):
    studio.make("a person bows")

    def route(socket):
        refusal = {"type": "error", "code": "no", "message": "Not today."}
        stopped = {"type": "stopped", "frames": 0, "reason": "refused"}
        socket.on_message(lambda _: [socket.send(json.dumps(said)) for said in (refusal, stopped)])

    route_next(studio, route)
    studio.run("__moveset.clip.lastSeed = null")
    studio.click("#mode-live")
    studio.say("a person walks forward")
    studio.wait("document.body.dataset.live === 'idle' && document.querySelector('.toast.fault')")
    assert studio.run("document.body.dataset.phase") == "shown"


def test_a_start_that_is_refused_can_be_mended(studio):
    studio.click("#mode-live")
    studio.run("document.querySelector('#live-seed').value = '1.5'")
    with studio.page.expect_websocket() as begun:
        studio.say("a person walks forward")
    studio.wait("document.querySelector('.toast.fault') && document.body.dataset.live === 'idle'")
    assert begun.value.is_closed() or begun.value.wait_for_event("close")
    assert not studio.run("document.querySelector('#live-seed').disabled")
    studio.run("document.querySelector('#live-seed').value = '7'")
    start(studio, "a person walks forward")
    assert studio.run("__moveset.live.started.seed") == 7


def test_a_take_that_is_chosen_during_a_stream_stands_alone(studio):
    studio.make("a person bows")
    start(studio, "a person walks forward")
    studio.click("#open-recent")
    studio.click(".shelf li:nth-child(1) button")
    studio.wait("document.body.dataset.live === 'idle'")
    start(studio, "a person walks forward")
    kept = studio.run("__moveset.recent.added")
    studio.click("#live-keep")
    studio.click("#open-recent")
    studio.click(".shelf li:nth-child(1) button")
    studio.wait(f"document.body.dataset.live === 'idle' && __moveset.recent.added === {kept + 2}")
    assert studio.run("document.querySelector('#live-strip').hidden")
    assert studio.words("#made") == ""


def test_a_stream_is_stopped_before_it_has_begun(studio):
    held = []
    route_next(studio, lambda socket: socket.on_message(lambda _: held.append(socket)))
    studio.click("#mode-live")
    studio.say("a person walks forward")
    while not held:
        studio.page.wait_for_timeout(20)
    (socket,) = held
    studio.click("#live-stop")
    skeleton = studio.run("__moveset.player.cast.entries[0].take.skeleton.data")
    started = {"type": "started", "model": "m", "seed": 1, "steps": 1, "fps": 20, "segment_frames": 28, "buffer": 2,
               "commit": None, "skeleton": skeleton}  # fmt: skip
    socket.send(json.dumps(started))
    socket.send(json.dumps({"type": "stopped", "frames": 0, "reason": "asked"}))
    studio.wait("document.body.dataset.live === 'idle'")
    assert studio.run("document.querySelectorAll('.toast').length") == 0


def test_the_servers_refusal_is_shown_and_the_stream_goes_on(studio):
    start(studio, "a person walks forward")
    studio.run("__moveset.live.stream.send({ type: 'prompt', text: '' })")
    studio.wait("document.querySelector('.toast.fault')")
    assert studio.words(".toast.fault p")
    assert studio.run("document.body.dataset.live") == "running"


@pytest.mark.parametrize("mode", ["clip", "live"])
def test_hostile_prompts_are_text(studio, mode):
    attack = "<img src=x onerror=window.pwned=1><script>window.pwned=1</script> \"'&{{7*7}}"
    if mode == "clip":
        studio.say(attack, "Control+Enter")
        studio.make(attack)
        studio.click("#open-recent")
        assert attack in studio.words("#shelf")
        assert attack in studio.words("#timeline")
    else:
        start(studio, attack)
        studio.wait("document.querySelector('.strip .words')")
        assert attack in studio.words("#live-strip")
    studio.wait(f"document.querySelector('.mv-caption').textContent === {json.dumps(attack)}")
    assert attack[:30] in studio.words("#notice")
    assert studio.run("window.pwned === undefined && document.querySelectorAll('img, body script').length") == 0
