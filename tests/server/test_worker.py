"""The worker: streams go on while clips are made, jobs take turns, and what breaks one stream breaks no other."""

import threading
from dataclasses import replace

import pytest

from moveset.errors import InputError
from moveset.pipelines.postprocess import Postprocess
from moveset.pipelines.request import check_request
from moveset.pipelines.stream_batch import StreamBatch
from moveset.server.catalog import Catalog
from moveset.server.failures import RequestError
from moveset.server.jobs import Job, Order
from moveset.server.limits import Limits
from moveset.server.metrics import Metrics
from moveset.server.protocol import Start
from moveset.server.sessions import Session
from moveset.server.worker import Worker

WALK = "a person walks forward"


@pytest.fixture(scope="module")
def catalog(models):
    return Catalog(models, "cpu")


class Bench:
    """A worker, and clients that acknowledge everything at once."""

    def __init__(self, catalog, **limits):
        self.catalog, self.events, self.changed = catalog, [], threading.Condition()
        self.worker = Worker(catalog, replace(Limits(), **limits), Metrics(), self.finished)
        self.worker.start()

    def note(self, *event):
        with self.changed:
            self.events.append(event)
            self.changed.notify_all()

    def finished(self, job, error):
        self.note("job", job, error)

    def wait(self, condition):
        for _ in range(6000):
            with self.changed:
                if condition(self.events):
                    return
                self.changed.wait(0.01)
        raise AssertionError(self.events[-5:])

    def stream(self, name, prompt=WALK, steps=None, most=10**9, **options):
        def deliver(messages):
            for message in messages:
                if isinstance(message, dict):
                    self.note(name, message["type"], message)
                else:
                    self.worker.tell(received)

        def received():
            session.unsent -= 1
            if session.sent < most:
                session.acknowledge(session.sent)
            session.look()

        begin = Start(type="start", model="tiny-stream", prompt=prompt, seed=1, steps=steps)
        session = Session(len(self.events), deliver, options.get("buffer", 1.0), None, begin)
        self.worker.join_stream(session)
        return session

    def job(self, prompts=1, variants=1, steps=1):
        t2m = self.catalog.clip(None)
        requests = check_request(t2m.bundle.config, [WALK] * prompts, 1.0, 0, variants)
        job = Job(Order(t2m, requests, self.catalog.method(t2m, steps, None), "json", Postprocess()))
        self.worker.submit(job)
        return job

    def segments(self, name, events=None):
        return [e[2] for e in (events or self.events) if e[:2] == (name, "segment")]


@pytest.fixture
def bench(catalog):
    made = []

    def begin(**limits):
        made.append(Bench(catalog, **limits))
        return made[-1]

    yield begin
    for one in made:
        one.worker.stop()
        one.worker.join(0.1)


def test_nothing_comes_after_paused(bench, monkeypatch):
    begun, gate, step = threading.Event(), threading.Event(), StreamBatch.step

    def slow(batch, streams):
        if streams[0].number == 3:
            begun.set()
            gate.wait(20)
        return step(batch, streams)

    monkeypatch.setattr(StreamBatch, "step", slow)
    one = bench()
    session = one.stream("a")
    assert begun.wait(20)
    for change in (session.pause, session.resume, session.pause):
        one.worker.tell(change)
    before = len(one.events)
    gate.set()
    one.wait(lambda events: [e[1] for e in events].count("paused") == 2)
    assert [e[1] for e in one.events[before:]] == ["segment", "paused", "resumed", "paused"]
    sent = one.segments("a")[-1]["first_frame"] + 28
    assert [e[2]["frame"] for e in one.events[before + 1 :]] == [sent] * 3
    assert not session.due
    one.worker.tell(session.resume)
    one.wait(lambda events: len(events) > before + 5)
    assert one.events[before + 4][1:] == ("resumed", {"type": "resumed", "frame": sent})
    assert one.segments("a", one.events[before + 5 :])[0]["first_frame"] == sent


def test_streams_go_on_while_long_clips_are_made(bench):
    one = bench()
    job = one.job(prompts=8, variants=8, steps=50)
    one.wait(lambda _: job.state == "running")
    one.stream("a")
    one.stream("b")
    one.wait(lambda events: min(len(one.segments("a", events)), len(one.segments("b", events))) >= 10)
    assert job.finished is None
    assert not any(event[0] == "job" for event in one.events)
    assert [m["first_frame"] for m in one.segments("a")][:10] == [28 * k for k in range(10)]
    before = job.progress
    one.wait(lambda _: job.progress > before)  # and clips go on while streams take all they can get
    one.worker.cancel(job)
    one.wait(lambda events: any(e[0] == "job" for e in events))
    assert next(e[2] for e in one.events if e[0] == "job").code == "cancelled"


def test_jobs_take_turns(bench):
    one = bench()
    long = one.job(variants=8, prompts=8)
    short = one.job()
    one.wait(lambda events: sum(e[0] == "job" for e in events) == 2)
    assert [e[1] for e in one.events if e[0] == "job"] == [short, long]
    assert (len(short.made), len(long.made)) == (1, 8)
    assert [made.seed for made in long.made] == list(range(8))


def test_streams_of_one_setting_are_one_batch(bench, catalog, monkeypatch):
    one = bench()
    while not one.worker.ready:  # it asks for the same batch, and two threads would make two
        pass
    bundle = catalog.stream(None)
    group = catalog.batch(bundle, catalog.request(bundle, None, 0, None, None).settings)
    sizes, real, gate = [], group.step, threading.Event()

    def step(lanes):
        gate.wait(30)
        sizes.append(len(lanes))
        return real(lanes)

    monkeypatch.setattr(group, "step", step)
    for name in "abcd":
        one.stream(name, most=0)
    one.stream("other", steps=2, most=0)
    one.wait(lambda events: any(e[:2] == ("a", "started") for e in events))
    gate.set()
    one.wait(lambda events: all(one.segments(name, events) for name in ("a", "b", "c", "d", "other")))
    assert max(sizes) >= 3
    assert sum(sizes) == 4


def test_who_runs_out_first_comes_first(bench, monkeypatch):
    one = bench()
    while not one.worker.ready:
        pass
    gate, order = threading.Event(), []
    real = Worker._advance

    def advance(worker, batch):
        gate.wait(30)
        order.extend(session.number for session in batch)
        real(worker, batch)

    monkeypatch.setattr(Worker, "_advance", advance)
    full, empty = one.stream("full", most=0, buffer=9.0), one.stream("empty", most=0, buffer=9.0, steps=2)
    full.number, empty.number = 1, 2
    one.wait(lambda events: any(e[:2] == ("full", "started") for e in events))
    with one.worker.lock:
        full._clock = full._heard = full._clock + 1000.0
    gate.set()
    one.wait(lambda events: len(one.segments("full", events)) >= 2)
    # Of another setting, so in batches of their own: all of the one that runs out before the other goes on.
    assert order.index(2) <= 1
    last_empty = max(k for k, number in enumerate(order) if number == 2)
    assert order[:last_empty].count(1) <= 1


def test_what_breaks_one_stream_breaks_no_other(bench, catalog, monkeypatch):
    bundle = catalog.stream(None)
    group = catalog.batch(bundle, catalog.request(bundle, None, 0, None, None).settings)
    real = group.step

    def step(lanes):
        made = real(lanes)  # the others' lanes have moved on already
        if any(lane.condition.prompt == "break" and lane.number > 2 for lane in lanes):
            raise FloatingPointError("a fault of ours")
        return made

    monkeypatch.setattr(group, "step", step)
    one = bench()
    one.stream("good", most=28 * 12)
    one.stream("bad", prompt="break")
    one.wait(lambda events: any(e[:2] == ("bad", "stopped") for e in events))
    said = [e[2] for e in one.events if e[0] == "bad" and e[1] in ("error", "stopped")]
    assert [m.get("code") for m in said] == ["internal", None]
    assert said[1]["reason"] == "failed"
    one.wait(lambda events: len(one.segments("good", events)) >= 12)
    assert [m["first_frame"] for m in one.segments("good")] == [28 * k for k in range(len(one.segments("good")))]


def test_a_wish_that_is_refused_does_not_lose_the_prompt_that_came_with_it(bench):
    one = bench()
    session = one.stream("a", most=28)
    one.wait(lambda events: one.segments("a", events))

    def wish():
        session.wishes, session.asked = {"steps": 99}, "a person bows"

    one.worker.tell(wish)
    one.wait(lambda events: sum(e[:2] == ("a", "prompt") for e in events) == 2)
    said = [e[2] for e in one.events if e[0] == "a" and e[1] in ("error", "prompt")][1:]
    assert [(m["type"], m.get("code"), m.get("text")) for m in said] == [
        ("error", "invalid", None),
        ("prompt", None, "a person bows"),
    ]
    assert not session.over


def test_a_model_that_cannot_be_warmed_up_stops_no_other(bench, catalog, monkeypatch):
    def broken(self, bundle, settings):
        raise InputError("this model's segments cannot be made together; take another")

    monkeypatch.setattr(Catalog, "batch", broken)
    one = bench()
    one.stream("a")
    one.job()
    one.wait(
        lambda events: {("a", "stopped"), ("job", None)} <= {(e[0], None if e[0] == "job" else e[1]) for e in events}
    )
    assert one.worker.ready
    assert next(e[2]["message"] for e in one.events if e[:2] == ("a", "error")).startswith("this model's segments")
    assert next(e[2] for e in one.events if e[0] == "job") is None


def test_a_broken_job_is_said_and_the_next_is_made(bench, catalog, monkeypatch):
    one = bench()
    while not one.worker.ready:
        pass
    with monkeypatch.context() as patch:
        patch.setattr(type(catalog.clip(None)), "generate", lambda *a, **k: 1 / 0)
        one.job()
        one.wait(lambda events: len(events) == 1)
    error = one.events[0][2]
    assert (error.status, error.code) == (500, "internal")
    assert "division" not in error.message
    one.job()
    one.wait(lambda events: len(events) == 2)
    assert one.events[1][2] is None


def test_limits(bench):
    one = bench(streams=1, jobs=1)
    session = one.stream("a")
    with pytest.raises(RequestError, match="1 streams"):
        one.stream("b")
    one.worker.leave(session)
    one.stream("c")
    long = one.job(prompts=8, variants=8, steps=50)
    with pytest.raises(RequestError, match="1 clips"):
        one.job()
    one.worker.cancel(long)


def test_stopping_finishes_what_was_begun(bench):
    one = bench()
    begun = one.job(prompts=2, variants=2)
    one.wait(lambda _: begun.state == "running")
    waiting = one.job()
    assert one.worker.stop() == [waiting]
    one.worker.join(60)
    assert one.events == [("job", begun, None)]
    for late in (one.job, lambda: one.stream("late")):
        with pytest.raises(RequestError, match="stopping"):
            late()


def test_stopping_does_not_wait_for_ever(bench):
    one = bench()
    begun = one.job(prompts=8, variants=8, steps=50)
    one.wait(lambda _: begun.state == "running")
    one.worker.stop()
    one.worker.join(0.0)
    assert one.events[0][2].code == "cancelled"
