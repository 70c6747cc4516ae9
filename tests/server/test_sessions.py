"""When a stream is due, when it runs out, and where a prompt takes it back to; with a clock of our own."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from moveset.motion.features import get_codec
from moveset.motion.stream_decoder import StreamDecoder
from moveset.pipelines.conditioning import SegmentCondition
from moveset.pipelines.stream_batch import Stream
from moveset.pipelines.timeline import held
from moveset.server import sessions
from moveset.server.sessions import Session
from moveset.text.encoder import TextEmbedding


@pytest.fixture
def clock(monkeypatch):
    now = SimpleNamespace(now=100.0)
    monkeypatch.setattr(sessions, "time", SimpleNamespace(monotonic=lambda: now.now))
    return now


def begin(buffer=2.0, commit=None):
    session = Session(1, lambda messages: None, buffer, commit, None)
    config = SimpleNamespace(fps=20.0, segment=28)
    codec = get_codec("native")
    text = TextEmbedding(torch.zeros(1, 1, 4), torch.ones(1, 1, dtype=torch.bool), torch.zeros(1, 4))
    condition = SegmentCondition("walk", text, None, 0, 1.0)
    stream = Stream(0, 1.0, held("walk"), StreamDecoder(codec), condition)
    session.started(SimpleNamespace(bundle=SimpleNamespace(config=config)), stream)
    return session


def make(session):
    """What the worker does with it."""
    session.keep()
    session.stream = session.stream.copy()
    session.stream.number += 1
    session.sent = session.stream.number * 28
    session.due_since = None
    session.look()


def test_at_most_the_buffer_and_a_segment_are_ahead(clock):
    session = begin(buffer=2.0)
    while session.due:
        make(session)
    assert session.sent == 56  # 28 are less than two seconds, 56 are not
    session.acknowledge(16)
    assert not session.due
    session.acknowledge(17)
    assert session.due


def test_what_is_on_its_way_holds_it_back(clock):
    session = begin()
    session.unsent = 1
    assert not session.due
    session.unsent = 0
    assert session.due


def test_pausing_holds_it_and_its_clock(clock):
    session = begin()
    make(session)
    before = session.deadline - clock.now
    session.pause()
    session.pause()
    assert not session.due
    clock.now += 50.0
    session.resume()
    session.resume()
    assert session.due
    assert session.deadline - clock.now == pytest.approx(before)


def test_acknowledgements_only_grow_and_never_pass_what_was_sent(clock):
    session = begin()
    make(session)
    for frame, want in ((10, 10), (5, 10), (10**15, 28)):
        session.acknowledge(frame)
        assert session.played == want


def test_who_acknowledges_faster_than_real_time_does_not_come_first(clock):
    hasty, calm = begin(), begin()
    for _ in range(10):
        make(hasty)
        hasty.acknowledge(hasty.sent)
    make(calm)
    clock.now += 1.0
    calm.acknowledge(20)
    assert calm.deadline < hasty.deadline


def test_a_slow_player_is_not_in_a_hurry(clock):
    slow, quick = begin(), begin()
    for session in (slow, quick):
        make(session)
        make(session)
    clock.now += 10.0
    slow.acknowledge(1)
    quick.acknowledge(50)
    assert quick.deadline < slow.deadline


def test_a_prompt_goes_back_to_the_first_segment_that_is_not_committed(clock):
    session = begin(buffer=10.0, commit=10)
    for _ in range(5):
        make(session)
    session.acknowledge(30)
    session.stream.line, session.stream.guidance = held("bow").beginning(5), 3.0
    session.stream.condition = condition = replace(session.stream.condition, prompt="bow")
    session.go_back()
    assert (session.stream.number, session.sent) == (2, 56)  # frame 40 is in segment 1
    assert (session.stream.line, session.stream.guidance) == (held("bow").beginning(2), 3.0)
    assert session.stream.condition is condition
    make(session)
    assert min(session.kept) >= 1
    session.acknowledge(84)
    session.go_back()
    assert session.stream.number == 3


@pytest.mark.parametrize("commit", [0, 1, 27, 28, 29, 84, 85, 200, 10_000])
def test_a_prompt_is_never_put_off_beyond_what_was_sent(clock, commit):
    session = begin(buffer=10.0, commit=commit)
    for _ in range(3):
        make(session)
    session.go_back()
    boundaries = [0, 28, 56, 84]
    assert session.sent == next((frame for frame in boundaries if frame >= commit), 84)
    assert session.stream.number == session.sent // 28


def test_what_is_remembered_is_bounded(clock):
    session = begin(buffer=10.0, commit=0)
    for _ in range(200):
        while session.due:
            make(session)
        session.acknowledge(session.sent - 100)
        session.acknowledge(session.played + 40)
    assert len(session.kept) <= 10
    assert session.sent > 1000


def test_since_when_it_is_due(clock):
    session = begin()
    assert session.due_since == 100.0
    clock.now = 107.0
    session.look()
    assert session.due_since == 100.0
    make(session)
    make(session)
    assert session.due_since is None
    session.acknowledge(28)
    assert session.due_since == 107.0
