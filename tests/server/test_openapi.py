"""The server against its own description: whatever fits it, or nearly fits it, is answered without a fault of ours."""

import pytest
import schemathesis
from hypothesis import HealthCheck, settings
from schemathesis.checks import not_a_server_error

from moveset.server.wire import pack_packet
from tests.motions import wander


@pytest.fixture(scope="module")
def described(client):
    return schemathesis.openapi.from_asgi("/openapi.json", client.app, base_url="http://127.0.0.1", headers=HEADERS)


HEADERS = {"Host": "127.0.0.1"}
schema = schemathesis.pytest.from_fixture("described")


@schema.parametrize()
@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
def test_no_request_is_too_strange(case, client):
    # Short ones only: what is tested is the form.
    if isinstance(case.body, dict):
        case.body = {**case.body, **({"steps": 1} if isinstance(case.body.get("steps"), int) else {})}
    answer = case.call(session=client, base_url="http://127.0.0.1")
    case.validate_response(answer, checks=[not_a_server_error])
    assert answer.status_code != 503 or answer.headers["retry-after"]
    if answer.status_code >= 400:
        assert set(answer.json()["error"]) == {"code", "message"}


def test_the_description_is_complete(client):
    found = client.get("/openapi.json").json()
    assert set(found["paths"]) == {
        "/v1/models", "/v1/prompts", "/v1/generate", "/v1/jobs", "/v1/jobs/{number}", "/v1/jobs/{number}/result",
        "/v1/export",
    }  # fmt: skip
    body = found["components"]["schemas"]["GenerateBody"]
    assert body["additionalProperties"] is False
    assert client.post(
        "/v1/export?format=npz",
        content=pack_packet(wander(2, seed=1)),
        headers={"Content-Type": "application/octet-stream"},
    ).is_success
