"""What every importer of motion capture returns: runs of takes on ``hml22`` at 20 fps, or the reason why not."""

from dataclasses import dataclass
from pathlib import Path

from torch import Tensor

from moveset.errors import MovesetError


@dataclass(frozen=True)
class TakeRef:
    """A take that an importer found, not read yet.

    Args:
        name: unique name of the take, such as "dataset-2_walk_active_001" or "07_03".
        source: "cmu-amc", "cmu-bvh", "cmu-more", "bandai1", "bandai2", or the name of a set of more-mocap.
        subject: who performed, and so who has the same markers, floor and posture.
        group: takes of one group show the same seconds of one performance.
        content: what is done, in the words of the data set; empty where ``sentence`` says it.
        style: how it is done, where the data set says so.
        description: the data set's own phrase about the take.
        sentence: the data set's own sentence about the take.
        fps: frames per second of the file; 0 where the file itself says so.
        capture_hz: frames per second of the capture that a conversion was made from.
        drop: frames of the file before its first usable one.
        unit: metres a unit of length.
        skeleton: path of the skeleton file, for formats that keep it apart.
        leave_out: why the take should not be trained on; empty for a usable take.
        levelled: whether it leans as its subject's markers do, and is to be made upright.
    """

    name: str
    source: str
    path: Path
    subject: str
    group: str
    content: str = ""
    style: str | None = None
    description: str | None = None
    sentence: str | None = None
    fps: float = 0.0
    capture_hz: float = 0.0
    drop: int = 0
    unit: float = 1.0
    skeleton: Path | None = None
    leave_out: str = ""
    levelled: bool = False


@dataclass(frozen=True, eq=False)
class ImportedRun:
    """Consecutive clean frames of a take on ``hml22`` at 20 fps, in the place and height that the capture has.

    Args:
        first_frame: frames from the beginning of the capture.
        rotations: (F, 22, 4) local rotations whose signs are continuous in time.
        root: (F, 3) metres.
    """

    first_frame: int
    rotations: Tensor
    root: Tensor

    def __len__(self) -> int:
        return len(self.root)


@dataclass(frozen=True, eq=False)
class ImportedTake:
    """What came of importing a take.

    Args:
        runs: in the order of time; none where the take was rejected.
        reason: why it was rejected, or what was cut out; empty where neither happened.
    """

    runs: tuple[ImportedRun, ...]
    reason: str = ""


class RejectedTake(MovesetError):
    """A take that is readable and still no good for training; the message says why."""
