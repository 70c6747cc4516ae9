"""What every importer of motion capture returns: takes on ``hml22`` at 20 fps, or the reason why not."""

from dataclasses import dataclass
from pathlib import Path

from moveset.errors import MovesetError
from moveset.motion.clip import Motion


@dataclass(frozen=True)
class TakeRef:
    """A take that an importer found, not read yet.

    Args:
        name: unique name of the take, such as "dataset-2_walk_active_001" or "07_03".
        source: "bandai1", "bandai2", "cmu-amc" or "cmu-bvh".
        path: the file with the motion.
        content: what is done, in the words of the data set.
        style: how it is done, where the data set says so.
        description: the data set's own sentence or phrase about the take.
        sentences: whole sentences that people wrote about the take.
        subject: who performed; takes of one subject, or of two partners dancing together, share it.
        fps: frames per second of the file; 0 where the file itself says so.
        skeleton: path of the skeleton file, for formats that keep it apart.
        leave_out: why the take should not be trained on; empty for a usable take.
    """

    name: str
    source: str
    path: Path
    content: str
    style: str | None
    description: str | None
    sentences: tuple[str, ...]
    subject: str
    fps: int = 0
    skeleton: Path | None = None
    leave_out: str = ""


@dataclass(frozen=True, eq=False)
class ImportedTake:
    """A take on ``hml22`` at 20 fps: starting above the origin, facing +Z, floor at height 0. Fields as in ``TakeRef``.

    Args:
        motion: the motion.
        span: first and one-past-last frame kept, in frames at 20 fps of the readable part of the source.
    """

    name: str
    source: str
    content: str
    style: str | None
    description: str | None
    sentences: tuple[str, ...]
    subject: str
    motion: Motion
    span: tuple[int, int]


class RejectedTake(MovesetError):
    """A take that is readable and still no good for training; the message says why."""


def imported(ref: TakeRef, motion: Motion, span: tuple[int, int]) -> ImportedTake:
    """The take of a reference."""
    return ImportedTake(
        name=ref.name,
        source=ref.source,
        content=ref.content,
        style=ref.style,
        description=ref.description,
        sentences=ref.sentences,
        subject=ref.subject,
        motion=motion,
        span=span,
    )
