"""The description of the interface as one plain page: no scripts, nothing from elsewhere."""

import json
import re
from collections.abc import Iterator
from html import escape
from typing import Any

_STREAM = """<h2 id="stream">Streams</h2>
<p>WebSocket <code>/v1/stream</code>. The client sends JSON texts: <code>start</code>, <code>prompt</code>,
<code>played</code>, <code>pause</code>, <code>resume</code>, <code>set</code>, <code>stop</code>; the server answers
with JSON texts and binary packets of frames. <code>docs/server.md</code> of the source tells all of it.</p>"""


def reference_page(description: dict[str, Any]) -> str:
    title = escape(f"{description['info']['title']} {description['info']['version']}")
    parts = [
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>",
        f"<title>{title}</title><meta name='viewport' content='width=device-width'>",
        f"<link rel='stylesheet' href='/docs.css'></head><body><h1>{title}</h1>",
        f"<p>{escape(description['info'].get('description', ''))}",
        "Machines read <a href='/openapi.json'>openapi.json</a>.</p>",
        "<h2>Clips and files</h2>",
        *_routes(description["paths"]),
        _STREAM,
        "<h2>Bodies</h2>",
        *_bodies(description.get("components", {}).get("schemas", {})),
        "</body></html>",
    ]
    return "\n".join(parts)


def _routes(paths: dict[str, Any]) -> Iterator[str]:
    for path, methods in paths.items():
        for method, route in methods.items():
            yield f"<h3><code>{method.upper()} {escape(path)}</code> {escape(route.get('summary', ''))}</h3>"
            yield f"<p>{_words(route.get('description', ''))}</p>"
            rows = [
                f"<tr><td><code>{escape(given['name'])}</code></td><td>{given['in']}</td>"
                f"<td><code>{_type(given['schema'])}</code></td></tr>"
                for given in route.get("parameters", ())
            ]
            if rows:
                yield f"<table>{''.join(rows)}</table>"
            body = route.get("requestBody", {}).get("content", {})
            for kind, content in body.items():
                yield f"<p>Body: <code>{escape(kind)}</code> <code>{_type(content['schema'])}</code></p>"
            said = ", ".join(
                f"{status} {escape(answer['description'].rstrip('.'))}" for status, answer in route["responses"].items()
            )
            yield f"<p>Answers: {said}</p>"


def _bodies(schemas: dict[str, Any]) -> Iterator[str]:
    for name, schema in schemas.items():
        if "properties" not in schema:
            continue
        yield f"<h3><code>{escape(name)}</code></h3><p>{_words(schema.get('description', ''))}</p><table>"
        for field, kind in schema["properties"].items():
            default = escape(json.dumps(kind["default"])) if "default" in kind else "required"
            yield f"<tr><td><code>{escape(field)}</code></td><td><code>{_type(kind)}</code></td><td>{default}</td></tr>"
        yield "</table>"


def _words(text: str) -> str:
    """A docstring's text, with what it quotes as code."""
    return re.sub("``(.+?)``", r"<code>\1</code>", escape(text))


def _type(schema: dict[str, Any]) -> str:
    """What a schema allows, in a few words."""
    if "$ref" in schema:
        return escape(schema["$ref"].rpartition("/")[2])
    if "anyOf" in schema:
        return " or ".join(map(_type, schema["anyOf"]))
    bounds = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<", "maxLength": "length ≤"}
    said = " ".join(f"{sign} {schema[name]:g}" for name, sign in bounds.items() if name in schema)
    kind = str(schema.get("type", "value"))
    if kind == "array":
        kind = f"list of {_type(schema.get('items', {}))}"
    return f"{kind} {escape(said)}".strip()
