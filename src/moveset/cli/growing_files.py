"""The files that a stream writes while it runs; one that is as long as can be read back is followed by the next."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Self

from moveset.cli.output import plan_outputs
from moveset.errors import InputError

if TYPE_CHECKING:
    from moveset.io.take_writer import Take
    from moveset.motion.clip import Motion
    from moveset.motion.skeleton import Skeleton


def plan_takes(outputs: Sequence[Path]) -> None:
    """Check the files of a stream before anything is computed.

    Raises:
        InputError: an extension that cannot grow, a file named twice, or a folder that cannot be written to.
    """
    from moveset.io import check_name
    from moveset.io.growing import part_of
    from moveset.io.take_writer import SUFFIXES

    for path in outputs:
        if path.suffix.lower() not in SUFFIXES:
            raise InputError(f"cannot stream to {str(path)!r}: its extension is none of {' '.join(SUFFIXES)}; use one")
        check_name(part_of(path))
    plan_outputs(outputs, [""])


def said_from(notes: Mapping[str, str | int | float], second: float) -> dict[str, str | int | float]:
    """Metadata of the motion from a second on: the prompt that is followed there, and those that come after it.

    >>> said_from({"prompt": "walk | wave | bow", "starts": "0 | 4.2 | 8.4", "seed": 1}, 5.0)
    {'prompt': 'wave | bow', 'starts': '0 | 3.4', 'seed': 1}
    """
    prompts, starts = (str(notes.get(name, "")).split(" | ") for name in ("prompt", "starts"))
    if "starts" not in notes or len(starts) != len(prompts):  # somebody says " | "
        return {**notes}
    left = [(text, float(start) - second) for text, start in zip(prompts, starts, strict=True)]
    followed = max(k for k, (_, start) in enumerate(left) if start <= 0)
    texts, seconds = zip(*left[followed:], strict=True)
    said = {"prompt": " | ".join(texts), "starts": " | ".join(f"{max(start, 0.0):g}" for start in seconds)}
    return {**notes, **said}


class GrowingFiles:
    """Takes of one motion in several files; leaving the ``with`` block ends them, whatever happened.

    Args:
        outputs: their paths; ``walk.bvh`` is followed by ``walk-2.bvh`` when it is full.
        skeleton, fps, metadata: as for ``open_take``.
    """

    def __init__(
        self, outputs: Sequence[Path], skeleton: "Skeleton", fps: float, metadata: Mapping[str, str | int | float]
    ) -> None:
        self.frames = 0
        self.paths: list[Path] = []
        self._outputs, self._skeleton, self._fps, self._metadata = tuple(outputs), skeleton, fps, metadata
        self._takes: list[Take] = []
        self._numbers = [1] * len(outputs)

    def __enter__(self) -> Self:
        try:
            for path in self._outputs:
                self._takes.append(self._open(path))
        except BaseException:
            self._close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def append(self, motion: "Motion") -> None:
        """Write the next frames to all files.

        Raises:
            MovesetError: a full disk.
        """
        for k, path in enumerate(self._outputs):
            if self._takes[k].room < len(motion):
                self._end(self._takes[k])
                self._numbers[k] += 1
                self._takes[k] = self._open(path.with_stem(f"{path.stem}-{self._numbers[k]}"))
            self._takes[k].append(motion)
        self.frames += len(motion)

    def _open(self, path: Path) -> "Take":
        from moveset.io.take_writer import open_take

        notes = said_from(self._metadata, self.frames / self._fps)
        return open_take(path, self._skeleton, self._fps, metadata=notes)

    def _end(self, take: "Take") -> None:
        if (path := take.close()) is not None and path not in self.paths:
            self.paths.append(path)

    def _close(self) -> None:
        with ExitStack() as stack:  # if one fails, the other files must be ended all the same
            for take in reversed(self._takes):
                stack.callback(self._end, take)
