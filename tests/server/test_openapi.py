"""The server against its own description: whatever fits it, or nearly fits it, is answered without a fault of ours."""

import pytest
import schemathesis
from hypothesis import HealthCheck, given, settings

from moveset.io.packets import pack_packet
from tests.motions import wander

ROUTES = {
    "/v1/models": ["get"],
    "/v1/prompts": ["get"],
    "/v1/generate": ["post"],
    "/v1/jobs": ["post"],
    "/v1/jobs/{number}": ["get", "delete"],
    "/v1/jobs/{number}/result": ["get"],
    "/v1/export": ["post"],
}


@pytest.mark.parametrize("mode", [schemathesis.GenerationMode.POSITIVE, schemathesis.GenerationMode.NEGATIVE])
@pytest.mark.parametrize(("path", "method"), [(path, method) for path, methods in ROUTES.items() for method in methods])
def test_no_request_is_too_strange(client, path, method, mode):
    schema = schemathesis.openapi.from_dict(client.get("/openapi.json").json())
    operation = schema[path][method]
    if mode is schemathesis.GenerationMode.NEGATIVE and path == "/v1/models":
        pytest.skip("nothing can be wrong with a request that says nothing")

    @given(case=operation.as_strategy(generation_mode=mode))
    @settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True, database=None)
    def ask(case):
        sent = case.as_transport_kwargs(base_url="http://127.0.0.1")
        sent = {name: sent[name] for name in ("method", "url", "params", "headers", "json", "data") if sent.get(name)}
        sent["headers"] = {**sent["headers"], "Host": "127.0.0.1"}
        if isinstance(sent.get("data"), bytes | str):
            sent["content"] = sent.pop("data")
        answer = client.request(**sent)
        assert answer.status_code < 500 or answer.headers["retry-after"]
        if answer.status_code >= 400:
            assert set(answer.json()["error"]) == {"code", "message"}

    ask()


def test_the_description_is_complete(client):
    found = client.get("/openapi.json").json()
    assert {path: list(methods) for path, methods in found["paths"].items()} == ROUTES
    for path, method in (("/v1/generate", "post"), ("/v1/jobs/{number}/result", "get")):
        assert set(found["paths"][path][method]["responses"]["200"]["headers"]) == {
            "X-Moveset-Seed", "X-Moveset-Warnings"
        }  # fmt: skip
    for methods in found["paths"].values():
        for method, route in methods.items():
            told = {"400", "403", "500"} | ({"408", "413"} if method != "get" else set())
            assert told <= set(route["responses"])
    exported = found["paths"]["/v1/export"]["post"]["responses"]["200"]["content"]
    assert "application/json" not in exported
    assert {"video/mp4", "model/gltf-binary", "application/octet-stream"} <= set(exported)
    assert "application/json" in found["paths"]["/v1/generate"]["post"]["responses"]["200"]["content"]
    body = found["components"]["schemas"]["GenerateBody"]
    assert body["additionalProperties"] is False
    assert client.post(
        "/v1/export?format=npz",
        content=pack_packet(wander(2, seed=1)),
        headers={"Content-Type": "application/octet-stream"},
    ).is_success
