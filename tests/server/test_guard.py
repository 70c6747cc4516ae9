"""Who may ask: hosts, origins, headers, and a page that loads nothing from elsewhere."""

import re

import pytest
from starlette.websockets import WebSocketDisconnect

PROMPTS = {"prompts": [{"text": "a person bows", "seconds": 1.0}]}


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    (folder / "assets").mkdir()
    (folder / "index.html").write_text("<!doctype html><title>studio</title>")
    (folder / "assets" / "app.js").write_text("1")
    (folder / "secret.txt").write_text("secret")
    (folder.parent / "secret.txt").write_text("secret")
    return folder


@pytest.fixture(scope="module")
def paged(serving, page):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("moveset.server.page.STUDIO", page)
        with serving(origins=("https://friend.example",)) as client:
            yield client


@pytest.mark.parametrize(
    ("origin", "status"),
    [
        (None, 200),
        ("http://127.0.0.1", 200),
        ("https://friend.example", 200),
        ("https://evil.example", 403),
        ("http://127.0.0.1:81", 403),
        ("http://127.0.0.1.evil.example", 403),
        ("null", 403),
        ("", 403),
        ("http://[", 403),
    ],
)
def test_pages_of_other_sites_change_nothing(paged, origin, status):
    headers = {} if origin is None else {"Origin": origin}
    assert paged.post("/v1/generate", json=PROMPTS, headers=headers).status_code == status
    assert paged.delete("/v1/jobs/1", headers=headers).status_code == (404 if status == 200 else 403)
    assert paged.get("/v1/models", headers=headers).status_code == 200  # a browser keeps the answer from the other page
    if status == 200:
        with paged.websocket_connect("ws://127.0.0.1/v1/stream", headers=headers) as socket:
            assert socket.receive_json()["type"] == "hello"
    else:
        with pytest.raises(WebSocketDisconnect), paged.websocket_connect("ws://127.0.0.1/v1/stream", headers=headers):
            pass


def test_pages_that_may_use_the_server_may_also_read_its_answers(paged):
    friend = {"Origin": "https://friend.example"}
    asked = {**friend, "Access-Control-Request-Method": "POST", "Access-Control-Request-Headers": "content-type"}
    told = paged.options("/v1/generate", headers=asked)
    assert told.status_code == 204
    assert told.headers["access-control-allow-origin"] == "https://friend.example"
    assert "POST" in told.headers["access-control-allow-methods"]
    assert "Content-Type" in told.headers["access-control-allow-headers"]
    for answer in (
        paged.get("/v1/models", headers=friend),
        paged.post("/v1/generate", json=PROMPTS, headers=friend),
        paged.get("/v1/jobs/1", headers=friend),
    ):
        assert answer.headers["access-control-allow-origin"] == "https://friend.example"
        readable = answer.headers["access-control-expose-headers"].split(", ")
        assert {"Content-Disposition", "X-Moveset-Seed", "X-Moveset-Warnings"} <= set(readable)
        assert "Origin" in answer.headers["vary"]


@pytest.mark.parametrize("origin", ["null", "file://", "app://studio", "capacitor://localhost"])
def test_pages_of_programs_may_where_they_are_named(serving, origin):
    with serving(origins=(origin,)) as client:
        answer = client.post("/v1/generate", json=PROMPTS, headers={"Origin": origin})
        assert (answer.status_code, answer.headers["access-control-allow-origin"]) == (200, origin)
        assert client.post("/v1/generate", json=PROMPTS, headers={"Origin": "app://other"}).status_code == 403


@pytest.mark.parametrize("origin", ["https://evil.example", "null", "", "http://127.0.0.1"])
def test_other_pages_read_nothing(paged, origin):
    asked = {"Origin": origin, "Access-Control-Request-Method": "POST"}
    for answer in (paged.options("/v1/generate", headers=asked), paged.get("/v1/models", headers=asked)):
        assert not any(name.startswith("access-control") for name in answer.headers)
    assert paged.options("/v1/generate", headers=asked).status_code == 405


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", "", "a b", "127.0.0.1:x"]
)
def test_other_names_are_not_answered(paged, host):
    answer = paged.get("/v1/models", headers={"Host": host})
    assert (answer.status_code, answer.json()["error"]["code"]) == (403, "foreign_host")


def test_any_name_where_it_is_meant_to_be_reached(serving):
    with serving(hosts=None) as client:
        for host in ("studio.lan:8765", "moveset_server", "moveset_server:8765", "_x"):  # as in docker compose
            assert client.get("/healthz", headers={"Host": host}).status_code == 200
        assert client.get("/healthz", headers={"Host": "a;b"}).status_code == 403


@pytest.mark.parametrize(
    "path", ["/", "/docs", "/v1/models", "/assets/app.js", "/nothing", "/healthz", "/openapi.json"]
)
def test_every_answer_tells_browsers_to_stay_here(paged, path):
    headers = paged.get(path).headers
    policy = headers["content-security-policy"]
    assert "default-src 'self'" in policy
    assert "frame-ancestors 'none'" in policy
    assert "connect-src 'self' ws://127.0.0.1 wss://127.0.0.1;" in policy
    assert "unsafe" not in policy
    assert "*" not in policy
    assert headers["x-content-type-options"] == "nosniff"
    assert not any(name.startswith("access-control") for name in headers)


def test_types_of_the_pages_files_are_those_that_browsers_run_on_any_machine(paged, monkeypatch):
    # As where Windows' registry calls everything text.
    monkeypatch.setattr("starlette.responses.guess_type", lambda _: ("text/plain", None))
    assert paged.get("/assets/app.js").headers["content-type"].startswith("text/javascript")
    assert paged.get("/").headers["content-type"].startswith("text/html")


def test_a_host_cannot_write_policy(serving):
    with serving(hosts=None) as client:
        policy = client.get("/", headers={"Host": "x; script-src *"}).headers["content-security-policy"]
        assert "script-src *" not in policy


@pytest.mark.parametrize("path", ["/", "/docs"])
def test_pages_load_nothing_from_elsewhere(client, path):
    text = client.get(path).text
    assert not re.findall(r"(?:src|href)=['\"](?:[a-z]+:)?//", text)
    assert "<script>" not in text
    assert "style=" not in text
    for link in re.findall(r"href=['\"]([^'\"#]+)", text):
        assert client.get(link).status_code == 200


def test_the_description_of_everything(client):
    text = client.get("/docs").text
    assert "``" not in text
    for route in client.get("/openapi.json").json()["paths"]:
        assert route in text
    assert "GenerateBody" in text


@pytest.mark.parametrize(
    "path",
    [
        "/assets/../secret.txt",
        "/assets/..%2fsecret.txt",
        "/assets/%2e%2e/secret.txt",
        "/assets/..%5csecret.txt",
        "/assets//etc/passwd",
        "/assets/....//secret.txt",
        "/assets/%00",
        "/secret.txt",
        "/assets/",
        "/assets",
    ],
)
def test_nothing_but_the_page_is_served(paged, path):
    answer = paged.get(path)
    assert answer.status_code in (404, 405)
    assert "secret" not in answer.text


def test_the_page(paged):
    assert "studio" in paged.get("/").text
    assert paged.get("/assets/app.js").text == "1"
    assert paged.get("/favicon.ico").status_code == 204
