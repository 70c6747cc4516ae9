"""What may be asked of a model, checked before anything is computed. One sentence a refusal: value, limit, remedy."""

import math
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, cast

from moveset.errors import InputError
from moveset.pipelines.model_config import SOLVERS, ClipConfig

MAX_PROMPT = 1000
MAX_PROMPTS = 64
MAX_NUM = 1000
MAX_GUIDANCE = 30.0
MAX_TEACHER_STEPS = 500
TEACHER_STEPS = 50
SEEDS = 2**63


@dataclass(frozen=True)
class Request:
    """One motion to make: its prompts in order, the frames of each (None: as long as the text asks for), its seed."""

    prompts: tuple[str, ...]
    frames: tuple[int | None, ...]
    seed: int

    @property
    def total(self) -> int:
        """Frames of all of them, those that the text decides left out."""
        return sum(count or 0 for count in self.frames)


@dataclass(frozen=True)
class Method:
    """How to sample: the network's name in the bundle, the number of steps, the guidance scale w."""

    solver: str
    network: str
    steps: int
    guidance: float


def check_request(
    config: ClipConfig,
    prompt: str | Sequence[str],
    seconds: float | Sequence[float] | None = None,
    seed: int = 0,
    num: int = 1,
) -> tuple[Request, ...]:
    """The requests of ``num`` variants; variant k has the seed ``seed + k``.

    Args:
        prompt: a sentence, or several that follow one another.
        seconds: of each clip: one number for all, one number a prompt, or None for automatic lengths.
        seed: of the first variant.
        num: variants.

    Raises:
        InputError: anything out of range.
    """
    prompts = check_prompts(prompt)
    num = check_whole("num", num)
    if not 1 <= num <= MAX_NUM:
        raise InputError(f"num {num} is not in 1 to {MAX_NUM}; run again with another seed for more")
    seed = check_whole("seed", seed)
    if not 0 <= seed <= SEEDS - num:
        raise InputError(f"seed {seed} is not in 0 to {SEEDS - num}; give a whole number in it such as 0")
    frames = tuple(None if s is None else _frames(s, config) for s in of_each(seconds, len(prompts)))
    return tuple(Request(prompts, frames, seed + k) for k in range(num))


def check_method(
    config: ClipConfig, solver: str = "pcm", steps: int | None = None, guidance: float | None = None
) -> Method:
    """Which network samples, in how many steps, at what guidance scale.

    Args:
        solver: "pcm" (MotionPCM students), "lcm" (the consistency baseline) or "teacher" (DDIM with guidance).
        steps: by default the fewest there is a student for, or 50 for the teacher.
        guidance: w in eps_c + w (eps_c - eps_0); by default the model's choice for this network.

    Raises:
        InputError: an unknown solver, steps without a student, or guidance out of range.
    """
    if solver not in SOLVERS:
        raise InputError(f"unknown solver {solver!r}; choose one of {', '.join(SOLVERS)}")
    if steps is not None:
        steps = check_whole("steps", steps)
    if solver == "teacher":
        network, steps = "teacher", TEACHER_STEPS if steps is None else steps
        if "teacher" not in config.models:
            raise InputError(f"model {config.name!r} comes without its teacher; use one of its students instead")
        if not 2 <= steps <= MAX_TEACHER_STEPS:
            raise InputError(
                f"{steps} steps are not in 2 to {MAX_TEACHER_STEPS}; {TEACHER_STEPS} is usual for the teacher"
            )
    else:
        known = config.steps(solver)
        if not known:
            raise InputError(f"model {config.name!r} has no {solver} students; choose another solver")
        steps = known[0] if steps is None else steps
        if steps not in known:
            choice = ", ".join(map(str, known))
            raise InputError(
                f"model {config.name!r} has no {solver} student for {steps} steps; choose {choice}, or solver 'teacher'"
            )
        network = f"{solver}-{steps}"
    if guidance is None:
        guidance = config.guidance[network]
    guidance = check_real("guidance", guidance)
    if not 0.0 <= guidance <= MAX_GUIDANCE:
        raise InputError(f"guidance {guidance:g} is not in 0 to {MAX_GUIDANCE:g}; this model's own choice is "
                         f"{config.guidance[network]:g}")  # fmt: skip
    return Method(solver, network, steps, guidance)


def check_prompts(prompt: str | Sequence[str]) -> tuple[str, ...]:
    """The prompts, of which a single one may be given by itself.

    Raises:
        InputError: none or too many, or one that ``check_prompt`` refuses.
    """
    # A number is no text, and is refused as such below.
    single = isinstance(prompt, str | bytes) or not isinstance(prompt, Iterable)
    prompts = cast(tuple[str, ...], (prompt,) if single else tuple(prompt))
    if not 1 <= len(prompts) <= MAX_PROMPTS:
        raise InputError(
            f"{len(prompts)} prompts were given; give 1 to {MAX_PROMPTS}, such as 'a person walks forward'"
        )
    for text in prompts:
        check_prompt(text)
    return prompts


def of_each(seconds: float | Sequence[float] | None, prompts: int) -> tuple[Any, ...]:
    """What was given as the duration of each prompt, unchecked: one number for all, or one a prompt.

    Raises:
        InputError: another number of durations.
    """
    # A tensor of one number says that it can be iterated over, and cannot.
    several = isinstance(seconds, Iterable) and not isinstance(seconds, str) and getattr(seconds, "ndim", 1) > 0
    given: tuple[Any, ...] = tuple(cast(Iterable[Any], seconds)) if several else (seconds,)
    if len(given) == 1:
        given *= prompts
    if len(given) != prompts:
        raise InputError(f"{len(given)} durations do not fit {prompts} prompts; give one for all or one for each")
    return given


def check_prompt(text: str) -> None:
    """Refuse a prompt that says nothing, says too much, or is no text.

    Raises:
        InputError: an empty or very long prompt, control characters, or halves of characters (lone surrogates).
    """
    if not isinstance(text, str):
        raise InputError(f"the prompt {text!r} is no text; describe a motion, such as 'a person walks forward'")
    if not text.strip():
        raise InputError("the prompt is empty; describe a motion, such as 'a person walks forward and waves'")
    if len(text) > MAX_PROMPT:
        raise InputError(
            f"a prompt has {len(text):,} characters, more than the limit of {MAX_PROMPT:,}; shorten it or give several"
        )
    if any(ord(c) < 32 and c not in "\t\n\r" for c in text):
        raise InputError("a prompt contains control characters; give plain text")
    if any("\ud800" <= c <= "\udfff" for c in text):
        raise InputError(f"the prompt {text!r} is not valid Unicode; give it as UTF-8")


def check_whole(name: str, value: object) -> int:
    """A whole number as one of Python's own, which JSON and large sums hold, where NumPy's may be given.

    Raises:
        InputError: it is none.
    """
    if not isinstance(value, Integral):
        raise InputError(f"{name} {value!r} is not a whole number; give one such as 1")
    return int(value)


def check_real(name: str, value: object) -> float:
    """A number as one of Python's own.

    Raises:
        InputError: it is none, or a whole number beyond all that floating point holds.
    """
    if not isinstance(value, Real):
        raise InputError(f"{name} {value!r} is not a number; give one such as 1.5")
    if isinstance(value, int) and abs(value) > sys.float_info.max:
        raise InputError(f"{name} is a whole number of {value.bit_length():,} bits; give a number such as 1.5")
    return float(value)


def _frames(seconds: float, config: ClipConfig) -> int:
    low, high = config.min_frames / config.fps, config.max_frames / config.fps
    if not isinstance(seconds, Real):
        raise InputError(f"duration {seconds!r} is not a number; give seconds from {low:g} to {high:g}")
    seconds = check_real("the duration", seconds)
    if not math.isfinite(seconds) or not low <= seconds <= high:
        remedy = "for a longer motion give several prompts" if seconds > high else f"give at least {low:g}"
        raise InputError(f"{seconds:g} seconds are not in {low:g} to {high:g} for a prompt; {remedy}")
    return round(seconds * config.fps)
