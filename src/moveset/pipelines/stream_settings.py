"""What may be asked of a stream, checked before anything is computed. One sentence a refusal: value, limit, remedy."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, pairwise

from torch import nn

from moveset.diffusion.phases import PhaseGrid
from moveset.diffusion.steps import Variance, require_variance
from moveset.errors import InputError
from moveset.pipelines.model_config import EPS_SCALES, FLOW, SCHEDULES, StreamConfig
from moveset.pipelines.request import MAX_GUIDANCE, SEEDS, check_prompts, check_real, check_whole, of_each
from moveset.pipelines.role import Role, is_student, named
from moveset.pipelines.timeline import STAGE_SEGMENTS, Timeline, share_evenly
from moveset.rdm.sequential import Solver
from moveset.rdm.staircase import Staircase, levels
from moveset.text.stages import split_stages

SEGMENTS = 4  # of a prompt that is followed by another and was given no duration
MAX_SECONDS = 86_400.0
MAX_BUFFER = 64
BLEND_SECONDS = 0.3


@dataclass(frozen=True)
class StreamSettings:
    """How segments are made.

    Fields as for ``check_stream``, decided: K steps of which later segments take R, ``past_lag`` None for a finished
    past that is told clean.
    """

    network: str
    steps: int
    start: int
    lag: int
    eta: float
    guidance: float
    buffer: int = 0
    foot_lock: bool = True
    blend_seconds: float = BLEND_SECONDS
    stages: bool = True
    past_lag: int | None = None
    variance: Variance = "posterior"
    eps_scale: float = 1.0
    time_shift: float = 0.0

    @property
    def one_by_one(self) -> bool:
        """Whether every segment waits for its finished predecessor."""
        return self.lag == self.steps

    @property
    def sequential(self) -> bool:
        """Whether every segment waits for its finished predecessor, and begins with noise of its own."""
        return self.one_by_one and self.start == self.steps

    @property
    def clean_left(self) -> bool:
        """Whether every segment is told its finished predecessor as it is, at every step."""
        return self.one_by_one and self.past_lag is None

    def staircase(self) -> Staircase:
        return Staircase(self.steps, None, self.start, lag=self.lag)

    def solver(self, config: StreamConfig, network: nn.Module) -> Solver:
        """How this network samples; one that was trained on other than white noise says so itself."""
        if is_student(self.network):  # its levels are the edges of its phases
            falling = PhaseGrid(config.points, self.steps, config.timesteps).edges[::-1]
        else:
            falling = levels(self.steps, config.timesteps)
        return Solver(
            schedule=SCHEDULES[config.schedule](config.timesteps), levels=falling, eta=self.eta,
            variance=self.variance, eps_scale=self.eps_scale, time_shift=self.time_shift, past_lag=self.past_lag,
            colour=getattr(network, "colour", None),
        )  # fmt: skip


@dataclass(frozen=True)
class StreamRequest:
    """A checked request: what happens when, from which noise, and how it is made.

    ``durations`` are the seconds of each prompt as they were asked for, ``counts`` the segments they were rounded to.
    """

    timeline: Timeline
    seed: int
    settings: StreamSettings
    durations: tuple[float, ...]
    counts: tuple[int, ...]

    @property
    def seconds(self) -> float:
        return sum(self.durations)


def check_stream(
    config: StreamConfig,
    prompt: str | Sequence[str] | None = None,
    seconds: float | Sequence[float] | None = None,
    *,
    loop: bool = False,
    seed: int = 0,
    network: str | None = None,
    steps: int | None = None,
    start: int | None = None,
    lag: int | None = None,
    past_lag: int | None = None,
    eta: float | None = None,
    variance: Variance | None = None,
    eps_scale: float | None = None,
    time_shift: float | None = None,
    guidance: float | None = None,
    buffer: int = 0,
    foot_lock: bool = True,
    blend_seconds: float = BLEND_SECONDS,
    stages: bool = True,
) -> StreamRequest:
    """A request of a stream.

    Args:
        prompt: a sentence, or several that follow one another; None is the model's idle prompt.
        seconds: of each prompt: one number for all or one a prompt. Prompts change between two segments, so durations
            are rounded to whole segments, together rather than each, and every prompt gets at least one. The stages of
            a prompt share its segments evenly, and get at least one each.
        loop: begin again after the last prompt, which is held otherwise.
        network: a denoiser of the folder; by default the model's choice.
        steps: K, for networks that are no students; without ``network`` it may also name a student by its steps.
        start: R, for networks that see a noisy predecessor and are no students.
        lag: likewise, and for students of several evaluations.
        past_lag: where ``start`` may be chosen and lag is all of the steps: how many steps the finished segment before
            is told to be ahead, noised again to that level; all of the steps tell it clean.
        eta: 0 to 1, for networks that are no students.
        variance: of the noise that is put back, "posterior" or "beta" (the larger one), where ``eta`` is above 0.
        eps_scale: factor of the predicted noise in every step, for networks that are no students: more than 1 makes
            motion more various, and livelier.
        time_shift: 0 to 1, for the same: share by which they are told more noise than there is; sentences show sooner.
        guidance: w; by default the model's choice for this network.
        buffer: segments made ahead of the reader, in a thread of their own; 0 makes them when they are asked for.
        blend_seconds: seam smoothing.
        stages: "walks, then waves" is two things to do, one after the other; False says all of it to every segment.

    Raises:
        InputError: anything out of range, or of another type.
    """
    seed, buffer = check_whole("seed", seed), check_whole("buffer", buffer)
    blend_seconds = check_real("blend_seconds", blend_seconds)
    steps, start, lag, past_lag = (
        None if value is None else check_whole(name, value)
        for name, value in (("steps", steps), ("start", start), ("lag", lag), ("past_lag", past_lag))
    )
    eta, eps_scale, time_shift, guidance = (
        None if value is None else check_real(name, value)
        for name, value in (("eta", eta), ("eps_scale", eps_scale), ("time_shift", time_shift), ("guidance", guidance))
    )
    if stages not in (True, False):  # any text is true
        raise InputError(f"stages {stages!r} is neither true nor false; leave it out for true")
    timeline, durations, counts = _timeline(config, prompt, seconds, loop, stages)
    if not 0 <= seed < SEEDS:
        raise InputError(f"seed {seed} is not in 0 to {SEEDS - 1}; give a whole number that is")
    if not 0 <= buffer <= MAX_BUFFER:
        raise InputError(f"a buffer of {buffer} segments is not in 0 to {MAX_BUFFER}; 1 or 2 is plenty")
    if not 0.0 <= blend_seconds < math.inf:
        raise InputError(f"cannot blend over {blend_seconds} s; give a duration such as {BLEND_SECONDS}, or 0 for none")
    network = _network(config, network, steps)
    plan = _plan(config, network, steps, start, lag, eta)
    told = _past_lag(config, network, plan, past_lag)
    if variance is not None:
        require_variance(variance)
        if not plan[3]:
            raise InputError(f"variance {variance!r} is of fresh noise, and eta is 0; set eta=1, or leave it out")
    w = config.guidance.get(network, 0.0) if guidance is None else guidance
    if not 0.0 <= w <= MAX_GUIDANCE:
        raise InputError(f"guidance {w:g} is not in 0 to {MAX_GUIDANCE:g}; this model's own choice is "
                         f"{config.guidance.get(network, 0.0):g}")  # fmt: skip
    settings = StreamSettings(network, *plan, float(w), buffer, foot_lock, blend_seconds, stages, told,
                              config.variance if variance is None else variance,
                              *_corrections(config, network, plan[0], eps_scale, time_shift))  # fmt: skip
    return StreamRequest(timeline, seed, settings, durations, counts)


def offered_steps(config: StreamConfig) -> tuple[int, ...]:
    """Steps a segment to choose from: of the students, or of the sampler: its own, and fewer for slower machines."""
    if is_student(config.network):
        return config.steps("pcm")
    own = check_stream(config).settings
    fewer = (2, own.steps // 2) if own.sequential else ()
    return tuple(sorted({own.steps, *(steps for steps in fewer if 0 < steps < own.steps)}))


def _timeline(
    config: StreamConfig, prompt: str | Sequence[str] | None, seconds: float | Sequence[float] | None, loop: bool,
    stages: bool,
) -> tuple[Timeline, tuple[float, ...], tuple[int, ...]]:  # fmt: skip
    """The timeline, and of each prompt the duration asked for and its segments."""
    prompts = check_prompts(config.idle if prompt is None else prompt)
    said = [split_stages(text) if stages else (text,) for text in prompts]
    each = config.segment / config.fps
    if seconds is None:
        given = tuple(each * (STAGE_SEGMENTS * len(parts) if len(parts) > 1 else SEGMENTS) for parts in said)
    else:
        given = tuple(check_real("the duration", s) for s in of_each(seconds, len(prompts)))
    for s in given:
        if not 0.0 < s <= MAX_SECONDS:
            raise InputError(f"{s:g} seconds are not in 0 to {MAX_SECONDS:g} for a prompt; give a duration such as 3")
    bounds, starts, spent = [0], [], 0.0
    for s, parts in zip(given, said, strict=True):
        spent += s
        begin, end = bounds[-1], max(bounds[-1] + len(parts), round(spent / each))
        starts += share_evenly(begin, end, len(parts))[:-1]
        bounds.append(end)
    counts = tuple(end - begin for begin, end in pairwise(bounds))
    timeline = Timeline(tuple(chain.from_iterable(said)), tuple(starts), bounds[-1], loop)
    return timeline, given, counts


def _network(config: StreamConfig, network: str | None, steps: int | None) -> str:
    if network is None and steps is not None and is_student(config.network):
        network = f"pcm-{steps}"
        if network not in config.denoisers:
            others = [name for name in config.denoisers if not is_student(name)]
            choice = ", ".join(map(str, config.steps("pcm")))
            also = f", or network {' or '.join(map(repr, others))}" if others else ""
            raise InputError(f"model {config.name!r} has no student for {steps} steps; choose {choice}{also}")
    network = config.network if network is None else network
    if network not in config.denoisers:
        raise InputError(f"unknown network {network!r}; model {config.name!r} has {', '.join(config.denoisers)}")
    return network


def _plan(
    config: StreamConfig, network: str, steps: int | None, start: int | None, lag: int | None, eta: float | None
) -> tuple[int, int, int, float]:
    """K, R, lag and eta of a network."""
    of = named(network)
    if of.steps is not None:
        count = of.steps
        if steps not in (None, count) or eta:
            said = f"eta {eta}" if eta else f"{steps} steps"
            raise InputError(f"{said} does not go with network {network!r}, which takes {count} steps without noise; "
                             "leave it out or choose another network")  # fmt: skip
        steps, default_eta = count, 0.0
    else:
        steps, default_eta = config.sampler_steps if steps is None else steps, config.eta
    if not 1 <= steps <= config.timesteps:
        raise InputError(
            f"{steps} steps are not in 1 to {config.timesteps}; {config.sampler_steps} is this model's own"
        )
    if of.role is Role.DENOISER:
        # The model's own staircase, at another number of steps the one of the same shape.
        scale = steps / config.sampler_steps
        start = min(steps, math.ceil(config.start * scale)) if start is None else start
        lag = min(steps, math.ceil(config.lag * scale)) if lag is None else lag
        least = 0 if FLOW in config.models else 1  # without a flow, segments that are never denoised repeat the first
        if not least <= start <= steps or not 1 <= lag <= steps:
            raise InputError(f"start {start} is not in {least} to {steps} steps, or lag {lag} not in 1 to {steps}; "
                             "leave them out for the model's own")  # fmt: skip
    else:
        lag = steps if lag is None else lag
        least = 1 if of.role is Role.STUDENT else steps
        if start not in (None, steps) or not least <= lag <= steps:
            raise InputError(f"network {network!r} begins every segment from noise: its start is {steps}, and its lag "
                             f"in {least} to {steps}; leave them out or choose network 'rdm'")  # fmt: skip
        start = steps
    eta = default_eta if eta is None else eta
    if not 0.0 <= eta <= 1.0:
        raise InputError(
            f"eta {eta:g} is not in 0 (no fresh noise) to 1; leave it out for the model's own {config.eta:g}"
        )
    return steps, start, lag, eta


def _past_lag(
    config: StreamConfig, network: str, plan: tuple[int, int, int, float], past_lag: int | None
) -> int | None:
    """How many steps ahead a network of this plan is told a finished segment to be; None for all the way."""
    steps, _, lag, _ = plan
    if named(network).role is not Role.DENOISER or lag != steps:
        if past_lag not in (None, steps):
            raise InputError(f"past_lag {past_lag} is for network 'rdm' with a lag of all of its steps, which waits "
                             "for the finished segment before; leave it out")  # fmt: skip
        return None
    if past_lag is None:
        if config.past_lag is None:
            return None
        past_lag = math.ceil(config.past_lag * steps / config.sampler_steps)
    if not 1 <= past_lag <= steps:
        raise InputError(f"past_lag {past_lag} is not in 1 to {steps} steps; leave it out for the model's own")
    return None if past_lag == steps else past_lag


def _corrections(
    config: StreamConfig, network: str, steps: int, eps_scale: float | None, time_shift: float | None
) -> tuple[float, float]:
    """The factor of the noise of each of these steps, and by how much the network is told more than there is."""
    if is_student(network):
        for name, value, usual in (("eps_scale", eps_scale, 1.0), ("time_shift", time_shift, 0.0)):
            if value not in (None, usual):
                raise InputError(f"{name} {value:g} does not go with the student {network!r}; leave it out")
        return 1.0, 0.0
    for name, value, (low, high) in (("eps_scale", eps_scale, EPS_SCALES), ("time_shift", time_shift, (0.0, 1.0))):
        if value is not None and not low <= value <= high:
            raise InputError(f"{name} {value:g} is not in {low:g} to {high:g}; leave it out for the model's own")
    own = config.eps_scale ** (config.sampler_steps / steps)
    return own if eps_scale is None else eps_scale, config.time_shift if time_shift is None else time_shift
