"""A moveset server as this add-on needs it: ask for motion, get takes. Standard library only."""

import base64
import binascii
import ipaddress
import json
import urllib.error
import urllib.parse
import urllib.request
from dataclasses import dataclass
from http.client import HTTPException
from typing import Any

import numpy as np

from .packets import read_packets
from .take import MotionError, Skeleton, Take

MAX_ANSWER = 64 * 2**20


@dataclass(frozen=True)
class Answer:
    """What a request for motion brought.

    Args:
        takes: one for each variant asked for.
        seeds: the seed of each.
        warnings: sentences the server wants somebody to read.
    """

    takes: tuple[Take, ...]
    seeds: tuple[int, ...]
    warnings: tuple[str, ...]


def is_this_machine(url: str) -> bool:
    """Whether a server's address is on this machine, so that asking it is no use of the network.

    Raises:
        MotionError: this is no address of a server.
    """
    host = _checked(url).hostname or ""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def generate(
    url: str,
    prompts: list[tuple[str, float | None]],
    *,
    steps: int | None = None,
    seed: int | None = None,
    num: int = 1,
    timeout: float = 120.0,
) -> Answer:
    """Ask for motion.

    Args:
        url: of the server, "http://127.0.0.1:8765".
        prompts: sentences with seconds, None for as long as the sentence needs; several follow each other in one take.
        steps: network evaluations, None for the model's choice.
        seed: None for any.
        num: how many variants.
        timeout: seconds without a word from the server.

    Raises:
        MotionError: no server there, or what the server says is wrong.
    """
    body = {
        "prompts": [{"text": text, "seconds": seconds} for text, seconds in prompts],
        "steps": steps,
        "seed": seed,
        "num": num,
        "format": "json",
    }
    answer = _ask(url, "/v1/generate", json.dumps(body).encode(), timeout)
    try:
        told = answer["skeleton"]
        skeleton = Skeleton(
            str(told["name"]),
            tuple(map(str, told["joints"])),
            tuple(map(int, told["parents"])),
            np.array(told["offsets"], dtype=np.float64),
        )
        title = ", then ".join(text for text, _ in prompts)
        takes = [
            read_packets(base64.b64decode(take["data"], validate=True), skeleton, title) for take in answer["takes"]
        ]
        seeds = tuple(int(take["seed"]) for take in answer["takes"])
        return Answer(tuple(takes), seeds, tuple(map(str, answer.get("warnings", ()))))
    except (KeyError, TypeError, ValueError, OverflowError, binascii.Error) as error:
        if isinstance(error, MotionError):
            raise
        raise MotionError(f"the server at {url} answered something else than motion; is it moveset's?") from error


def _checked(url: str) -> urllib.parse.SplitResult:
    try:
        parts = urllib.parse.urlsplit(url.strip())
        if parts.scheme in ("http", "https") and parts.hostname and parts.port != 0:
            return parts
    except ValueError:
        pass  # a bracket that is not closed, or a port that is no number of one
    raise MotionError(f"{url!r} is no address of a server; give one such as http://127.0.0.1:8765")


def _ask(url: str, path: str, body: bytes, timeout: float) -> dict[str, Any]:
    _checked(url)
    request = urllib.request.Request(
        url.strip().rstrip("/") + path, data=body, headers={"Content-Type": "application/json"}, method="POST"
    )
    # A proxy set for the web must not be asked for a server on this machine.
    proxies = [urllib.request.ProxyHandler({})] if is_this_machine(url) else []
    try:
        with urllib.request.build_opener(*proxies).open(request, timeout=timeout) as reply:
            data = reply.read(MAX_ANSWER + 1)
    except urllib.error.HTTPError as error:
        raise MotionError(_said(error)) from error
    except (OSError, HTTPException, ValueError) as error:
        # Of the last kind are addresses with characters that cannot be sent.
        reason = str(getattr(error, "reason", error)).strip()
        raise MotionError(f"no moveset server answers at {url} ({reason}); start one with: moveset serve") from error
    if len(data) > MAX_ANSWER:
        raise MotionError(f"the server's answer is larger than {MAX_ANSWER >> 20} MiB; ask for less at once")
    try:
        answer = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise MotionError(f"the server at {url} answered no JSON; is it moveset's?") from error
    if not isinstance(answer, dict):
        raise MotionError(f"the server at {url} answered something else than motion; is it moveset's?")
    return answer


def _said(error: urllib.error.HTTPError) -> str:
    """The server's own sentence, or its status where it has none."""
    try:
        return str(json.loads(error.read(65536))["error"]["message"])
    except (ValueError, RecursionError, KeyError, TypeError, OSError, HTTPException):
        return f"the server answered {error.code} {error.reason}"
