"""Steer a stream of a moveset server and keep what it made (``pip install websockets``):

python stream_client.py "a person walks forward" "a person waves" --seconds 10 -o take.bvh
"""

import argparse
import json
import struct
import urllib.error
import urllib.request
from pathlib import Path

from websockets.sync.client import connect

HEADER = struct.Struct("<4sHHIQffI")  # magic, version, joints, frames, first frame, fps, latency in ms, flags


def record(server: str, prompts: list[str], seconds: float, seed: int | None, packets: list[bytes]) -> None:
    """Fill a list with a stream's packets; it goes on to the next prompt whenever its share of the time is made."""
    waiting, made, share = prompts[1:], 0, seconds / len(prompts)
    with connect(f"{server.rstrip('/').replace('http', 'ws', 1)}/v1/stream", max_size=2**20) as socket:
        socket.send(json.dumps({"type": "start", "prompt": prompts[0], "seed": seed, "buffer": 2.0}))
        for message in socket:
            if isinstance(message, str):
                event = json.loads(message)
                if event["type"] == "error":
                    raise SystemExit(event["message"])
                if event["type"] == "started":
                    print(f"stream of {event['model']}, seed {event['seed']}, {event['fps']:g} frames a second")
                if event["type"] == "prompt":
                    print(f"{event['text']!r} from frame {event['takes_effect_at']} on", *event["warnings"], sep="; ")
                if event["type"] == "segment":
                    print(f"segment {event['segment']}: {event['prompt']!r}, made in {event['latency_ms']:.0f} ms")
                continue
            count, first, fps = HEADER.unpack_from(message)[3:6]
            # With "commit" set, a new prompt takes frames back that were sent but not played: they come once more.
            packets[:] = [packet for packet in packets if HEADER.unpack_from(packet)[4] < first] + [message]
            if (made := first + count) >= seconds * fps:
                return
            # A player acknowledges what it has shown; this one looks at nothing and wants the next segment at once.
            socket.send(json.dumps({"type": "played", "frame": made}))
            if waiting and made >= (len(prompts) - len(waiting)) * share * fps:
                socket.send(json.dumps({"type": "prompt", "text": waiting.pop(0)}))
    raise SystemExit(f"the server ended the stream after {made} frames")


def exported(server: str, name: str, packets: bytes) -> bytes:
    """What a file of this name holds: packets, or what the server makes of them."""
    if name.endswith(".mvst"):
        return packets
    kind = "amass.npz" if name.endswith(".amass.npz") else Path(name).suffix[1:]
    url = f"{server.rstrip('/')}/v1/export?format={kind}"
    request = urllib.request.Request(url, packets, {"Content-Type": "application/octet-stream"})
    with urllib.request.urlopen(request, timeout=120) as reply:
        return reply.read()


def main() -> None:
    """Read the command line, stream, save."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("prompts", nargs="+")
    parser.add_argument("--server", default="127.0.0.1:8765", type=lambda at: at if "//" in at else f"http://{at}")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--seed", type=int)
    parser.add_argument("-o", "--out", type=Path, help=".bvh .glb .npz .amass.npz …, or .mvst: the packets")
    given = parser.parse_args()
    if given.out and not given.out.parent.is_dir():
        raise SystemExit(f"there is no folder {given.out.parent}; make it first")
    packets: list[bytes] = []
    try:
        record(given.server, given.prompts, given.seconds, given.seed, packets=packets)
        if given.out:
            given.out.write_bytes(exported(given.server, given.out.name.lower(), b"".join(packets)))
    except (Exception, SystemExit, KeyboardInterrupt) as error:
        told = isinstance(error, urllib.error.HTTPError) and error.headers.get_content_type() == "application/json"
        why = json.load(error)["error"]["message"] if told else str(error) or type(error).__name__
        if not packets and isinstance(error, Exception):  # neither told by the server nor interrupted
            why = f"no server at {given.server} ({why}); start one with: moveset serve"
        if given.out and packets:  # whatever it was, a stream cannot be had a second time
            (kept := given.out.with_suffix(".mvst")).write_bytes(b"".join(packets))
            why += f"; the packets are in {kept}"
        raise SystemExit(why) from None


if __name__ == "__main__":
    main()
