"""``Timeline``: which prompt each segment of a stream has."""

from bisect import bisect_right
from dataclasses import dataclass, replace

from moveset.pipelines.request import check_prompt
from moveset.text.stages import split_stages

STAGE_SEGMENTS = 3  # of each stage of a prompt that has several and was given no duration


@dataclass(frozen=True)
class Timeline:
    """Which prompt a segment has.

    Args:
        prompts: in order of time, every stage of a sentence for itself.
        starts: number of the segment with which each begins; the first is 0.
        end: segments in all, the last not always whole; after them the last prompt is held.
        loop: begin again instead.
        origin: number of the segment with which the first prompt was taken up.
    """

    prompts: tuple[str, ...]
    starts: tuple[int, ...]
    end: float
    loop: bool = False
    origin: int = 0

    def at(self, segment: int) -> str:
        """The prompt of a segment.

        >>> line = Timeline(("walk", "bow"), (0, 3), 4)
        >>> [line.at(k) for k in (2, 3, 9)]
        ['walk', 'bow', 'bow']
        """
        return self.prompts[self._part(segment)]

    def behind(self, segment: int) -> int:
        """How many segments before this one belong to the same saying of its prompt.

        >>> line = Timeline(("walk", "bow"), (0, 3), 4)
        >>> [line.behind(k) for k in (0, 2, 3, 9)]
        [0, 2, 0, 6]
        """
        part, segment = self._part(segment), self._within(segment)
        return max(segment - (self.origin, *self.starts[1:])[part], 0)

    def _part(self, segment: int) -> int:
        return bisect_right(self.starts, self._within(segment)) - 1

    def _within(self, segment: int) -> int:
        return segment % int(self.end) if self.loop else segment

    def beginning(self, segment: int) -> "Timeline":
        """The same, taken up with another segment.

        >>> Timeline(("walk", "bow"), (0, 3), 6).beginning(10).starts
        (0, 13)
        """
        later = segment - self.origin
        starts = (0, *(start + later for start in self.starts[1:]))
        return replace(self, starts=starts, end=self.end + later, origin=segment)


def held(prompt: str, stages: bool = True) -> Timeline:
    """One prompt whose last stage is held for ever.

    Raises:
        InputError: an empty or absurd prompt.
    """
    check_prompt(prompt)
    said = split_stages(prompt) if stages else (prompt,)
    each = STAGE_SEGMENTS if len(said) > 1 else 1
    return Timeline(said, tuple(range(0, each * len(said), each)), each * len(said))


def share_evenly(begin: int, end: int, count: int) -> list[int]:
    """The ``count`` + 1 bounds of parts of [begin, end) that differ by one at most.

    >>> share_evenly(10, 17, 2)
    [10, 14, 17]
    """
    return [begin + -(-(end - begin) * k // count) for k in range(count + 1)]
