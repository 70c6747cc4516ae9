"""Readers of motion files against files that were changed at random: each is read or refused in a sentence, quickly.

python benchmarks/fuzz_readers.py --count 20000 --out results/fuzz.json

A mutant that takes more than two seconds of the processor, more than a gigabyte, or raises anything but ``InputError``
is a fault; it is kept in the folder given by --keep. Every mutant follows from the seed and its number.
"""

import io
import json
import random
import re
import signal
import struct
import sys
import tempfile
import time
import warnings
import zipfile
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import FrameType
from typing import NoReturn

import torch

from arguments import Parser, at_least, report_path, write_report
from moveset import load
from moveset.errors import InputError, exit_code_of
from moveset.io import save
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.retarget import retarget
from moveset.motion.skeleton import HML22, Skeleton

SECONDS, BYTES = 2.0, 2**30
READERS = ("a.bvh", "a.glb", "a.gltf", "a.vrma", "a.npz", "a.amass.npz", "a.npy", "a.html")
_NUMBER = re.compile(rb"-?\d+(\.\d+)?([eE][+-]?\d+)?")
_NUMBERS = (b"0", b"-1", b"1e308", b"-1e-308", b"4294967296", b"9" * 40, b"NaN", b"inf", b"0.5", b"65536", b"1,5")
_WORDS = (
    b"{",
    b"}",
    b"[",
    b"]",
    b'"',
    b"null",
    b"true",
    b"JOINT x",
    b"End Site",
    b"MOTION",
    b"\n",
    b"\0",
    b"\xff\xfe",
    b":",
)


@dataclass
class Tally:
    """What became of the mutants of one kind of file."""

    mutants: int = 0
    read: int = 0
    refused: int = 0
    faults: list[str] = field(default_factory=list)
    slowest_ms: float = 0.0


class _TooSlow(BaseException):
    pass


def originals(name: str, folder: Path) -> list[bytes]:
    """Whole files of a kind: a small body that moves, and a tree that is no body."""
    generator = torch.Generator().manual_seed(0)
    crane = Skeleton("crane", ("base", "arm", "hook"), (-1, 0, 1), torch.eye(3))
    found = []
    for skeleton in (HML22, crane):
        turned = rotations.identity(6, len(skeleton)) + 0.2 * torch.randn(6, len(skeleton), 4, generator=generator)
        motion = Motion(rotations.normalize(turned), torch.randn(6, 3, generator=generator), 20.0, skeleton)
        if skeleton is crane and name in ("a.vrma", "a.amass.npz", "a.npy"):
            continue
        motion = retarget(motion, "mixamo") if skeleton is HML22 and name in ("a.bvh", "a.glb") else motion
        found.append(save(motion, folder / name).read_bytes())
    return found


def mutant(data: bytes, random: random.Random) -> bytes:
    """A file after one to four changes: in its bytes, or in what they stand for (JSON, members of an archive)."""
    if data[:4] == b"glTF" and random.random() < 0.7:
        size = struct.unpack_from("<I", data, 12)[0]
        text = _changed(data[20 : 20 + size], random)
        text += b" " * (-len(text) % 4)
        rest = data[20 + size :]
        head = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON")
        return head + text + rest
    if data[:2] == b"PK" and random.random() < 0.7:
        out = io.BytesIO()
        with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as new:
            chosen = random.choice(old.namelist())
            for name in old.namelist():
                if name != chosen or random.random() < 0.9:
                    new.writestr(name, _changed(old.read(name), random) if name == chosen else old.read(name))
        return out.getvalue()
    return _changed(data, random)


def _changed(data: bytes, random: random.Random) -> bytes:
    for _ in range(random.randint(1, 4)):
        at = random.randrange(len(data) + 1)
        until = min(len(data), at + random.choice((1, 2, 4, 16, 200)))
        kind = random.randrange(7)
        if kind == 0:
            data = data[:at] + bytes([random.randrange(256)]) + data[at + 1 :]
        elif kind == 1:
            data = data[:at] + data[until:]
        elif kind == 2:
            data = data[:at] + data[at:until] * random.choice((2, 3, 100)) + data[until:]
        elif kind == 3:
            data = data[:at] + random.choice(_WORDS) + data[until:]
        elif kind == 4 and random.random() < 0.3:
            data = data[:at]
        elif kind == 5:
            other = random.randrange(len(data) + 1)
            data = data[:at] + data[other : other + until - at] + data[until:]
        elif (match := _NUMBER.search(data, at)) is not None:
            data = data[: match.start()] + random.choice(_NUMBERS) + data[match.end() :]
    return data


def fuzz(name: str, count: int, seed: int, keep: Callable[[int, bytes], None] = lambda number, data: None) -> Tally:
    """Read mutants of a kind of file.

    Args:
        name: whose extension says the kind.
        count: of mutants.
        seed: of their changes.
        keep: is given number and bytes of each that is a fault.
    """
    tally = Tally()

    def late(number: int, frame: FrameType | None) -> NoReturn:
        raise _TooSlow

    before = signal.signal(signal.SIGPROF, late)
    try:
        with tempfile.TemporaryDirectory() as scratch, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            path = Path(scratch) / name
            whole = originals(name, Path(scratch))
            for number in range(count):
                data = mutant(whole[number % len(whole)], random.Random(f"{seed} {name} {number}"))
                path.write_bytes(data)
                start = time.process_time()
                try:
                    signal.setitimer(signal.ITIMER_PROF, SECONDS)
                    motion = load(path)
                    assert torch.isfinite(motion.joints).all()
                    tally.read += 1
                except InputError as error:
                    tally.refused += 1
                    if "\n" in str(error):
                        tally.faults.append(f"{number}: a message of several lines")
                except (Exception, _TooSlow) as error:
                    tally.faults.append(f"{number}: {type(error).__name__}: {str(error)[:200]}")
                    keep(number, data)
                finally:
                    signal.setitimer(signal.ITIMER_PROF, 0.0)
                tally.slowest_ms = max(tally.slowest_ms, round(1e3 * (time.process_time() - start), 1))
                tally.mutants += 1
    finally:
        signal.signal(signal.SIGPROF, before)
    return tally


def main() -> None:
    """See the module."""
    import resource

    parser = Parser()
    parser.add_argument("--count", type=at_least(1), default=20_000)
    parser.add_argument("--readers", nargs="+", choices=[name.removeprefix("a") for name in READERS])
    parser.add_argument("--seed", type=at_least(0), default=0)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--out", type=report_path)
    given = parser.parse_args()
    torch.set_num_threads(1)
    if given.keep:
        given.keep.mkdir(parents=True, exist_ok=True)
    tallies = {}
    for name in [f"a{suffix}" for suffix in given.readers] if given.readers else READERS:
        fuzz(name, 20, given.seed)  # imports what the reader needs, which is not the mutants' doing
        own = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (own + BYTES, resource.RLIM_INFINITY))

        def keep(number: int, data: bytes, name: str = name) -> None:
            if given.keep:
                (given.keep / f"{number}-{name}").write_bytes(data)

        tallies[name.removeprefix("a")] = fuzz(name, given.count, given.seed, keep)
        resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        print(name, json.dumps(asdict(tallies[name.removeprefix("a")])), flush=True)
    if given.out:
        write_report(given.out, {name: asdict(tally) for name, tally in tallies.items()})


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
