"""Which finished jobs are remembered, and for how long; what is told of those that failed."""

from dataclasses import replace

import pytest

from moveset.errors import MovesetError
from moveset.io.packets import pack_packet
from moveset.server import files
from moveset.server.failures import RequestError
from moveset.server.jobs import Answer, Job, JobBook
from moveset.server.limits import Limits
from tests.motions import wander


def kept(book, made):
    found = []
    for job in made:
        try:
            found.append(book.find(job.id) is job)
        except RequestError:
            found.append(False)
    return found


@pytest.fixture
def book():
    def make(**limits):
        return JobBook(replace(Limits(), **limits), lambda job: 3)

    return make


def add(book, count, size=1):
    made = [Job(None) for _ in range(count)]
    for job in made:
        book.add(job)
        job.end("done", Answer(b"x" * size, "text/plain"))
    return made


def test_the_oldest_are_forgotten(book):
    one = book(kept_jobs=2)
    assert kept(one, add(one, 4)) == [False, False, True, True]


def test_large_results_push_out_others_but_not_themselves(book):
    one = book(kept_bytes=25)
    assert kept(one, add(one, 4, size=10)) == [False, False, True, True]
    assert kept(one, add(one, 2, size=100)) == [False, True]


def test_time_passes(book):
    one = book(kept_seconds=60.0)
    made = add(one, 1)
    assert kept(one, made) == [True]
    made[0].finished -= 61.0
    assert kept(one, made) == [False]


def test_unfinished_jobs_are_never_forgotten(book):
    one = book(kept_jobs=0, kept_seconds=0.0)
    waiting = Job(None)
    one.add(waiting)
    add(one, 3)
    assert one.find(waiting.id) is waiting
    assert one.unfinished() == [waiting]
    assert one.describe(waiting) == {
        "id": waiting.id, "state": "queued", "position": 3, "progress": 0.0, "error": None,
    }  # fmt: skip


def test_names_cannot_be_guessed():
    assert len({Job(None).id for _ in range(1000)}) == 1000
    assert len(Job(None).id) == 16


def test_a_disk_that_is_full_is_not_the_clients_mistake(serving, monkeypatch):
    def full(*_):
        raise MovesetError("cannot write motion.bvh: No space left on device; free some space")

    monkeypatch.setattr(files, "write_file", full)
    with serving() as client:
        body = {"prompts": [{"text": "a person bows", "seconds": 1.0}], "format": "bvh"}
        packet = {"content": pack_packet(wander(4, seed=5)), "headers": {"Content-Type": "application/octet-stream"}}
        for answer in (client.post("/v1/generate", json=body), client.post("/v1/export?format=bvh", **packet)):
            assert (answer.status_code, answer.json()["error"]["code"]) == (500, "internal")
