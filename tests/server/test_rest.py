"""Clips and files by HTTP: what comes back is what the pipelines make, and what goes wrong is said in JSON."""

import base64
import io
import json
import threading
import time

import numpy as np
import pytest
import torch

from moveset.io import load
from moveset.io.packets import pack_packet, unpack_packets
from moveset.motion.retarget import retarget
from moveset.pipelines.text_to_motion import TextToMotion
from moveset.server import files
from tests.motions import wander

BYTES = {"Content-Type": "application/octet-stream"}
WALK = {"text": "a person walks forward", "seconds": 1.5}
BOW = {"text": "a person bows", "seconds": 1.0}


def said(answer, status, code):
    assert answer.status_code == status, answer.text
    assert set(answer.json()) == {"error"}
    assert answer.json()["error"]["code"] == code
    return answer.json()["error"]["message"]


def opened(answer, suffix, tmp_path):
    path = tmp_path / f"made.{suffix}"
    path.write_bytes(answer.content)
    return load(path)


def differ(one, two):
    """Metres between the joints of the same name."""
    places = [two.joints[:, two.skeleton.index(name)] for name in one.skeleton.joints]
    return float((one.joints - torch.stack(places, dim=1)).norm(dim=-1).max())


def test_what_there_is(client):
    found = client.get("/v1/models").json()
    clip, stream = found["models"]
    assert (clip["name"], clip["task"], clip["steps"]) == ("tiny", "clip", [1, 2, 4, 50])
    assert (stream["name"], stream["task"], stream["segment_frames"]) == ("tiny-stream", "stream", 28)
    assert found["default"] == {"clip": "tiny", "stream": "tiny-stream"}
    assert found["limits"]["prompt"] == 512
    # What the studio cuts long takes by.
    assert {"export", "picture_seconds", "frames"} <= set(found["limits"])
    assert len(found["skeleton"]["joints"]) == 22
    assert {"json", "bvh", "glb", "npz", "mp4", "gif", "png"} <= set(found["formats"])


def test_suggestions(client):
    known = client.get("/v1/prompts").json()["prompts"]
    assert "a person walks forward" in known
    assert client.get("/v1/prompts?model=tiny-stream").json()["prompts"] == known
    said(client.get("/v1/prompts?model=../../etc/passwd"), 404, "unknown_model")


def test_a_clip_is_what_the_pipeline_makes(client, models):
    body = {"prompts": [WALK, BOW], "seed": 7, "num": 2, "steps": 2, "guidance": 1.5}
    answer = client.post("/v1/generate", json=body).json()
    made = TextToMotion.from_pretrained(models[0])(
        [WALK["text"], BOW["text"]], seconds=[1.5, 1.0], seed=7, num=2, steps=2, guidance=1.5
    )
    assert (answer["model"], answer["seed"], answer["steps"], answer["guidance"]) == ("tiny", 7, 2, 1.5)
    assert answer["network_evaluations"] == made.network_evaluations == 4
    assert answer["warnings"] == list(made.warnings)
    assert set(answer["timings_ms"]) == set(made.timings_ms)
    assert len(answer["takes"]) == 2
    for k, take in enumerate(answer["takes"]):
        motion = unpack_packets(base64.b64decode(take["data"])).motion
        assert torch.allclose(motion.rotations, made.motions[k].rotations, atol=1e-5)
        assert torch.allclose(motion.root, made.motions[k].root, atol=1e-5)
        assert (take["seed"], take["frames"], take["fps"], take["seconds"]) == (7 + k, 50, 20.0, 2.5)
        assert take["prompts"] == [
            {"text": WALK["text"], "first_frame": 0},
            {"text": BOW["text"], "first_frame": 30},
        ]


def test_a_seed_is_chosen_and_told(client):
    answers = [client.post("/v1/generate", json={"prompts": [BOW]}).json() for _ in range(2)]
    assert answers[0]["seed"] != answers[1]["seed"]
    again = client.post("/v1/generate", json={"prompts": [BOW], "seed": answers[0]["seed"]}).json()
    assert again["takes"] == answers[0]["takes"]


def test_touches_of_json(client):
    answer = client.post("/v1/generate", json={"prompts": [WALK, BOW], "seed": 1, "fps": 60, "in_place": True}).json()
    take = answer["takes"][0]
    assert take["fps"] == 60.0
    assert take["prompts"][1]["first_frame"] == 90
    root = unpack_packets(base64.b64decode(take["data"])).motion.root
    assert float(root[:, [0, 2]].std(dim=0).max()) < 1e-6


def test_a_result_of_one_frame_is_a_whole_packet(client):
    take = client.post("/v1/generate", json={"prompts": [BOW], "seed": 1, "fps": 1}).json()["takes"][0]
    assert (take["frames"], take["seconds"]) == (1, 1.0)
    found = unpack_packets(base64.b64decode(take["data"]))
    assert len(found.motion) == 1
    assert found.planted is None


@pytest.mark.parametrize("suffix", ["bvh", "glb", "npz"])
def test_files_of_clips_can_be_read_again(client, suffix, tmp_path):
    body = {"prompts": [WALK], "seed": 3, "format": suffix, "skeleton": "mixamo", "fps": 30}
    answer = client.post("/v1/generate", json=body)
    assert answer.headers["content-disposition"] == f'attachment; filename="a-person-walks-forward.{suffix}"'
    motion = opened(answer, suffix, tmp_path)
    assert motion.fps == pytest.approx(30.0, rel=1e-4)
    assert any("Hips" in joint for joint in motion.skeleton.joints)


def test_a_file_tells_its_seed_and_warnings_in_headers(client, tmp_path):
    unknown = "a person rides a unicycle 🚲\r\nX-Evil: 1"
    body = {"prompts": [{"text": unknown, "seconds": 1.0}], "format": "npz"}
    answer = client.post("/v1/generate", json=body)
    seed = int(answer.headers["x-moveset-seed"])
    same = client.post("/v1/generate", json={**body, "seed": seed, "format": "json"}).json()
    assert json.loads(answer.headers["x-moveset-warnings"]) == same["warnings"] != []
    assert "x-evil" not in answer.headers
    again = client.post("/v1/generate", json={**body, "seed": seed})
    assert again.content == answer.content
    number = client.post("/v1/jobs", json={**body, "seed": seed}).json()["id"]
    while client.get(f"/v1/jobs/{number}").json()["state"] in ("queued", "running"):
        time.sleep(0.01)
    later = client.get(f"/v1/jobs/{number}/result")
    assert (later.headers["x-moveset-seed"], later.headers["x-moveset-warnings"]) == (
        str(seed), answer.headers["x-moveset-warnings"]
    )  # fmt: skip


def test_headers_of_many_warnings_stay_short(client):
    prompts = [{"text": f"{'unheard ' * 60}of {k}", "seconds": 1.0} for k in range(8)]
    answer = client.post("/v1/generate", json={"prompts": prompts, "format": "npz", "seed": 1})
    told = answer.headers["x-moveset-warnings"]
    assert len(told) <= 4096
    full = client.post("/v1/generate", json={"prompts": prompts, "seed": 1}).json()["warnings"]
    assert json.loads(told) == full[: len(json.loads(told))]


@pytest.mark.parametrize("suffix", ["bvh", "glb", "npz"])
def test_frames_become_files(client, suffix, tmp_path):
    take = wander(40, seed=5)
    packets = pack_packet(take[:15], first_frame=100) + pack_packet(take[15:], first_frame=115)
    answer = client.post(f"/v1/export?format={suffix}&title=<b>Über</b>", content=packets, headers=BYTES)
    assert answer.headers["content-disposition"] == f'attachment; filename="b-ber-b.{suffix}"'
    assert differ(opened(answer, suffix, tmp_path), take) < 1e-3
    answer = client.post(f"/v1/export?format={suffix}&skeleton=smpl", content=packets, headers=BYTES)
    assert differ(opened(answer, suffix, tmp_path), retarget(take, "smpl")) < 1e-3


def test_amass_is_a_format_of_its_own(client, tmp_path):
    assert "amass.npz" in client.get("/v1/models").json()["formats"]
    take = wander(20, seed=5)
    answer = client.post("/v1/export?format=amass.npz&title=a+walk", content=pack_packet(take), headers=BYTES)
    assert answer.headers["content-disposition"] == 'attachment; filename="a-walk.amass.npz"'
    with np.load(io.BytesIO(answer.content)) as found:
        assert found["poses"].shape == (20, 156)
    assert differ(opened(answer, "amass.npz", tmp_path), take) < 1e-3


@pytest.mark.parametrize(("suffix", "magic"), [("png", b"\x89PNG"), ("gif", b"GIF8"), ("mp4", b"\0\0\0")])
def test_frames_become_pictures(client, suffix, magic):
    answer = client.post(f"/v1/export?format={suffix}", content=pack_packet(wander(4, seed=5)), headers=BYTES)
    assert answer.status_code == 200
    assert answer.content.startswith(magic)


def test_a_job_from_beginning_to_end(client):
    begun = client.post("/v1/jobs", json={"prompts": [WALK], "seed": 3, "num": 3})
    assert begun.status_code == 202
    number = begun.json()["id"]
    states = []
    while not states or states[-1]["state"] in ("queued", "running"):
        states.append(client.get(f"/v1/jobs/{number}").json())
        time.sleep(0.01)
    assert states[-1]["state"] == "done"
    shares = [state["progress"] for state in states]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    made = client.get(f"/v1/jobs/{number}/result").json()
    assert made["takes"] == client.post("/v1/generate", json={"prompts": [WALK], "seed": 3, "num": 3}).json()["takes"]
    assert client.delete(f"/v1/jobs/{number}").json()["state"] == "done"
    for path in ("", "/result"):
        said(client.get(f"/v1/jobs/0000{path}"), 404, "unknown_job")
    said(client.delete("/v1/jobs/0000"), 404, "unknown_job")


def test_the_line_is_bounded_and_jobs_can_be_given_up(serving):
    long = {"prompts": [WALK] * 8, "num": 8, "steps": 50}
    with serving(jobs=2, kept_jobs=1) as client:
        one, two = (client.post("/v1/jobs", json=long).json()["id"] for _ in range(2))
        full = client.post("/v1/generate", json={"prompts": [BOW]})
        assert "2 clips" in said(full, 503, "busy")
        assert int(full.headers["retry-after"]) >= 1
        said(client.get(f"/v1/jobs/{two}/result"), 409, "not_done")
        for number in (two, one):
            client.delete(f"/v1/jobs/{number}")
            while (state := client.get(f"/v1/jobs/{number}").json())["state"] in ("queued", "running"):
                time.sleep(0.01)
            assert state["state"] == "cancelled"
            assert state["progress"] < 1.0
            said(client.get(f"/v1/jobs/{number}/result"), 409, "cancelled")
        assert client.post("/v1/generate", json={"prompts": [BOW]}).status_code == 200
        said(client.get(f"/v1/jobs/{two}"), 404, "unknown_job")


def test_answers_that_wait_to_be_written_count(serving):
    with serving(jobs=2) as client:
        the, gate = client.app.state.service, threading.Event()
        the.writer.thread.submit(gate.wait)
        try:
            begun = [client.post("/v1/jobs", json={"prompts": [BOW]}).json()["id"] for _ in range(2)]
            while the.worker.load["jobs"]:
                time.sleep(0.01)
            assert "2 clips" in said(client.post("/v1/jobs", json={"prompts": [BOW]}), 503, "busy")
        finally:
            gate.set()
        while any(client.get(f"/v1/jobs/{number}").json()["state"] != "done" for number in begun):
            time.sleep(0.01)
        assert client.post("/v1/generate", json={"prompts": [BOW]}).status_code == 200


@pytest.fixture
def drawing(monkeypatch):
    """Films that are not finished before a gate is opened; what was begun to be drawn, and the gate."""
    begun, gate, write = [], threading.Event(), files.write_file

    def slow(motion, format, *rest):
        if format == "mp4":
            begun.append(len(motion))
            gate.wait(20)
        return write(motion, format if format != "mp4" else "png", *rest)

    monkeypatch.setattr(files, "write_file", slow)
    yield begun, gate
    gate.set()


def film(client, begun):
    number = client.post("/v1/jobs", json={"prompts": [BOW], "format": "mp4"}).json()["id"]
    while client.app.state.service.worker.load["jobs"] or not begun:
        time.sleep(0.01)
    return number


def test_nobody_waits_for_anothers_film(client, drawing):
    begun, gate = drawing
    number = film(client, begun)
    packet = pack_packet(wander(4, seed=5))
    for suffix in ("json", "bvh", "npz"):
        assert client.post("/v1/generate", json={"prompts": [BOW], "format": suffix}).status_code == 200
    assert client.post("/v1/export?format=glb", content=packet, headers=BYTES).status_code == 200
    assert not gate.is_set()
    assert client.get(f"/v1/jobs/{number}").json()["state"] == "running"


def test_films_can_be_given_up(client, drawing):
    begun, gate = drawing
    numbers = [film(client, begun) for _ in range(3)]
    for number in numbers[:2]:
        client.delete(f"/v1/jobs/{number}")
    gate.set()
    states = {}
    for number in numbers:
        while (state := client.get(f"/v1/jobs/{number}").json()["state"]) == "running":
            time.sleep(0.01)
        states[number] = state
    assert list(states.values()) == ["cancelled", "cancelled", "done"]
    assert len(begun) == 2  # the one that was in work, and the one that was wanted
    for number in numbers[:2]:
        said(client.get(f"/v1/jobs/{number}/result"), 409, "cancelled")


@pytest.mark.parametrize(
    ("body", "status", "word"),
    [
        ({"prompts": [WALK], "model": "huge"}, 404, "huge"),
        ({"prompts": [WALK], "model": "tiny-stream"}, 404, "tiny-stream"),
        ({"prompts": [WALK], "steps": 3}, 400, "has no 3 steps; choose 1, 2, 4, 50"),
        ({"prompts": [WALK], "format": "fbx"}, 400, "fbx"),
        ({"prompts": [WALK], "format": "../x"}, 400, "x"),
        ({"prompts": [WALK], "format": "bvh", "num": 2}, 400, "2 variants"),
        ({"prompts": [WALK], "skeleton": "mixamo"}, 400, "skeleton"),
        ({"prompts": [WALK], "format": "bvh", "skeleton": "alien"}, 400, "alien"),
        ({"prompts": [{"text": "walk", "seconds": 30.0}]}, 400, "30 seconds"),
        ({"prompts": [{"text": "walk", "seconds": 9.0}] * 8}, 400, "60 s"),
        ({"prompts": [WALK], "seed": 2**63 - 1, "num": 8}, 400, "seed"),
        ({"prompts": [{"text": "x" * 513}]}, 422, "512"),
        ({"prompts": [{"text": "a\x07b"}]}, 422, "control characters"),
        ({"prompts": [{"text": ""}]}, 422, "text"),
        ({"prompts": [WALK], "guidance": 31}, 422, "30"),
        ({"prompts": [WALK], "path": "/etc/passwd"}, 422, "path"),
        ({"prompts": [WALK], "\ud800": 1}, 422, "unicode"),
        ({"prompts": float("nan")}, 422, "NaN should be a valid list"),
        ([], 422, "object"),
    ],
    ids=str,
)
def test_what_does_not_go(client, body, status, word):
    for path in ("/v1/generate", "/v1/jobs"):
        content = json.dumps(body).encode()
        answer = client.post(path, content=content, headers={"Content-Type": "application/json"})
        assert word in said(answer, status, {404: "unknown_model"}.get(status, "invalid"))


@pytest.mark.parametrize("content", [b"", b"{", b"[" * 60_000, b"nul", b"\xff\xfe", b"1" * 9000])
def test_bodies_that_are_no_json(client, content):
    answer = client.post("/v1/generate", content=content, headers={"Content-Type": "application/json"})
    message = said(answer, 422, "invalid")
    assert "/docs" in message


def test_exports_that_do_not_go(client):
    packet = pack_packet(wander(3, seed=1))

    def export(query, content=packet, headers=BYTES):
        return client.post(f"/v1/export?{query}", content=content, headers=headers)

    said(export("format=bvh", b"MVST"), 400, "invalid")
    said(export("format=bvh", b""), 400, "invalid")
    said(export("format=exe"), 400, "invalid")
    said(export(""), 422, "invalid")
    said(export("format=bvh&fps=NaN"), 422, "invalid")
    said(export("format=bvh&fps=1000"), 422, "invalid")
    said(export("format=bvh&skeleton=../../x"), 400, "invalid")
    said(export("format=bvh&title=%00"), 400, "invalid")
    said(export("format=bvh", headers={"Content-Type": "text/plain"}), 415, "wrong_type")
    long = pack_packet(wander(2500, seed=1))
    assert "120 s" in said(export("format=mp4", long), 400, "invalid")


def test_sizes_are_limited_by_what_is_said_and_by_what_is_sent(serving):
    json_type = {"Content-Type": "application/json"}
    with serving(body=2000, export=3000) as client:
        assert "2,000 bytes" in said(
            client.post("/v1/generate", content=b" " * 2001, headers=json_type), 413, "too_large"
        )

        def drip():
            for _ in range(100):
                yield b" " * 100

        said(client.post("/v1/generate", content=drip(), headers=json_type), 413, "too_large")
        said(client.post("/v1/export?format=bvh", content=drip(), headers=BYTES), 413, "too_large")
        packet = pack_packet(wander(8, seed=1))
        assert len(packet) < 3000
        assert client.post("/v1/export?format=bvh", content=packet, headers=BYTES).status_code == 200


def test_other_paths_and_methods(client):
    said(client.get("/v1/nothing"), 404, "not_found")
    said(client.post("/healthz"), 405, "wrong_method")
    refused = client.get("/v1/generate")
    assert said(refused, 405, "wrong_method") == "'/v1/generate' does not take GET; use POST"
    assert refused.headers["allow"] == "POST"
    assert client.put("/v1/jobs/1").headers["allow"] == "GET, DELETE, HEAD"


@pytest.mark.parametrize("path", ["/", "/healthz", "/metrics", "/v1/models", "/docs", "/openapi.json"])
def test_who_asks_for_the_head_is_told_what_get_would_be(client, path):
    head, got = client.head(path), client.get(path)
    assert (head.status_code, head.content) == (200, b"")
    assert head.headers["content-type"] == got.headers["content-type"]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_worker_that_is_gone_is_told(serving, monkeypatch):
    with serving() as client:
        worker = client.app.state.service.worker

        def die():
            raise SystemExit

        monkeypatch.setattr(worker, "_serve", die)
        client.post("/v1/jobs", json={"prompts": [BOW]})
        worker._thread.join(60)
        answer = client.get("/healthz")
        assert (answer.status_code, answer.json()["status"]) == (503, "failed")


def test_health_and_numbers(client):
    assert client.get("/healthz").json()["status"] == "ok"
    client.post("/v1/generate", json={"prompts": [BOW]})
    text = client.get("/metrics").text
    numbers = dict(line.rsplit(" ", 1) for line in text.splitlines() if not line.startswith("#"))
    assert float(numbers["moveset_clips_total"]) >= 1
    assert float(numbers["moveset_frames_total"]) >= 20
    assert 'moveset_requests_total{status="200"}' in numbers
    assert io.StringIO(text).readline().startswith("# HELP")
