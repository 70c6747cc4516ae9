"""``Segment``: what a stream gives out, piece by piece."""

from dataclasses import dataclass

from moveset.motion.clip import Motion


@dataclass(frozen=True, eq=False)
class Segment:
    """A piece of the motion.

    Args:
        number: from 0.
        first_frame: number of its first frame in the stream.
        frames: n.
        prompt: what it was told.
        motion: world rotations and path, going on from the segment before; float64, so that long walks stay smooth.
        latency_ms: what making it took, with the encoding of new prompts since the segment before.
        network_evaluations: since the segment before; guidance by two evaluations counts both, as
            does a network that is evaluated with its mirror image.
    """

    number: int
    first_frame: int
    frames: int
    prompt: str
    motion: Motion
    latency_ms: float
    network_evaluations: int
