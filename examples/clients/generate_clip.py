"""A clip from a moveset server with nothing but the standard library: ``python generate_clip.py PROMPT -o walk.glb``.

Whole files (.bvh .glb .npz .amass.npz .mp4 .gif .png) come straight from the server; without -o the numbers themselves
are fetched and read, which is what an engine does.
"""

import argparse
import base64
import http.client
import json
import struct
import sys
import urllib.error
import urllib.request
from pathlib import Path

HEADER = struct.Struct("<4sHHIQffI")


def ask(server: str, body: dict) -> bytes:
    """The answer to a request for motion."""
    request = urllib.request.Request(
        f"{server.rstrip('/')}/v1/generate", json.dumps(body).encode(), {"Content-Type": "application/json"}
    )
    try:
        with urllib.request.urlopen(request, timeout=120) as reply:
            return reply.read()
    except urllib.error.HTTPError as error:
        told = error.headers.get_content_type() == "application/json"
        sys.exit(json.load(error)["error"]["message"] if told else f"no moveset server at {server} ({error})")
    except (OSError, http.client.HTTPException) as error:
        sys.exit(f"no server at {server} ({getattr(error, 'reason', error)}); start one with: moveset serve")


def frames(packets: bytes) -> list[tuple[float, ...]]:
    """Rows of root position and local quaternions, 3 + 4J numbers each, of packets back to back."""
    rows, place = [], 0
    while place < len(packets):
        magic, version, joints, count, _first, _fps, _latency, flags = HEADER.unpack_from(packets, place)
        if magic != b"MVST" or version != 1:
            sys.exit("the server sent something else than packets of version 1")
        place += HEADER.size
        row = struct.Struct(f"<{3 + 4 * joints}f")
        rows += [row.unpack_from(packets, place + k * row.size) for k in range(count)]
        place += count * (row.size + 4 * (flags & 1))
    return rows


def main() -> None:
    """Read the command line, ask, save or print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("prompts", nargs="+", help="sentences that follow each other")
    parser.add_argument("--server", default="127.0.0.1:8765", type=lambda at: at if "//" in at else f"http://{at}")
    parser.add_argument("--seconds", type=float, help="of each sentence; without it the text decides")
    parser.add_argument("--seed", type=int)
    parser.add_argument("-o", "--out", type=Path, help="file to write; its extension is the format")
    given = parser.parse_args()
    body = {"prompts": [{"text": text, "seconds": given.seconds} for text in given.prompts], "seed": given.seed}
    if given.out:
        if not given.out.parent.is_dir():
            sys.exit(f"there is no folder {given.out.parent}; make it first")
        name = given.out.name.lower()
        format = "amass.npz" if name.endswith(".amass.npz") else given.out.suffix.lower().removeprefix(".")
        given.out.write_bytes(ask(given.server, body | {"format": format}))
        return
    answer = json.loads(ask(given.server, body))
    for warning in answer["warnings"]:
        print(f"warning: {warning}", file=sys.stderr)
    take = answer["takes"][0]
    rows = frames(base64.b64decode(take["data"]))
    print(f"{len(rows)} frames at {take['fps']:g} a second, seed {take['seed']}")
    print("the pelvis ends at", *(f"{x:.2f}" for x in rows[-1][:3]), "m (x left, y up, z ahead)")


if __name__ == "__main__":
    main()
