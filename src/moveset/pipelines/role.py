"""What the networks of a model folder are for. A folder says so by their names, and nothing else reads those."""

from dataclasses import dataclass
from enum import Enum


class Role(Enum):
    """What a network does.

    ``DENOISER``: samples in many steps, and is told a segment that is still noisy, where there is one before.
    ``AUTOREGRESSIVE``: the same, told the finished segment before as it is, and trained without the flow.
    ``STUDENT``: samples in a few steps, between the edges of its phases.
    """

    VAE = "vae"
    LENGTH = "length"
    SIDES = "sides"
    FLOW = "flow"
    DENOISER = "denoiser"
    AUTOREGRESSIVE = "autoregressive"
    STUDENT = "student"


@dataclass(frozen=True)
class Named:
    """What a name says: the role, and of a student its solver ("pcm" or "lcm") and steps."""

    role: Role
    solver: str | None = None
    steps: int | None = None


_NAMES = {
    "vae": Role.VAE,
    "length": Role.LENGTH,
    "sides": Role.SIDES,
    "flow": Role.FLOW,
    "teacher": Role.DENOISER,
    "rdm": Role.DENOISER,
    "denoiser": Role.DENOISER,
    "md": Role.AUTOREGRESSIVE,
}


def named(network: str) -> Named:
    """What the network of this name is.

    >>> named("pcm-2").steps, named("md").role
    (2, <Role.AUTOREGRESSIVE: 'autoregressive'>)

    Raises:
        ValueError: no name for a network.
    """
    if is_student(network):
        solver, _, steps = network.partition("-")
        return Named(Role.STUDENT, solver, int(steps))
    if network not in _NAMES:
        raise ValueError(f"{network!r} is no name of a network; there are {', '.join(_NAMES)}, pcm-1 and the like")
    return Named(_NAMES[network])


def is_student(network: str) -> bool:
    """Whether a network of this name samples in the few steps that its name has."""
    solver, _, steps = network.partition("-")
    return solver in ("pcm", "lcm") and steps.isdecimal()
