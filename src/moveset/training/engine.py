"""The training loop: a ``Task`` says what a step is; ``run`` repeats it, logs, validates, saves and resumes.

Resuming is exact: 10 steps, a kill, and 10 more steps give on a CPU the bytes that 20 steps give. All that a step
depends on is therefore in the checkpoint: parameters, averages, optimisers, the generators made by ``Loop.generator``,
torch's global generator (dropout), and what ``Task.state`` adds; learning rates are functions of the step.

Several processes (``torchrun``, or ``devices > 1``) are data parallel: each draws its own batch, and gradients are
averaged in one flat all-reduce just before an optimiser steps. Unlike a wrapper around each module this leaves a GAN
free to call its modules in any order and by any method, and costs nothing noticeable at these sizes (72 MB of gradients
for the largest model).
"""

import hashlib
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import torch
from torch import Tensor, nn

from moveset.errors import InputError
from moveset.io.limits import system_errors
from moveset.io.process import locked, noted_signals
from moveset.training import checkpoint, resume
from moveset.training.fabric import launch
from moveset.training.log import TrainingLog

if TYPE_CHECKING:
    from lightning_fabric import Fabric

Precision = Literal["32-true", "bf16-mixed", "auto"]


@dataclass(frozen=True, kw_only=True)
class EngineConfig:
    """How a training runs; what it trains is the task's config.

    Args:
        save_every: steps between checkpoints; the last step is always saved.
        validate_every: steps between validations, 0 for none; the last step is always validated otherwise.
        log_every: steps between lines in ``metrics.jsonl``.
        keep_every: besides those, checkpoints at multiples of this stay for good; 0 for none.
        grad_clip: largest norm of an optimiser's whole gradient; 0 for no clipping.
        precision: "32-true", "bf16-mixed", or "auto": bf16 on a CUDA device or processor that has instructions for it.
        device: "auto", "cpu" or "cuda".
        devices: processes on this machine; under ``torchrun`` its own number counts.
        threads: CPU threads of torch, 0 to leave them alone.
        workers: processes that make batches ahead, for tasks of segments on a fast device (``data.loader``); 0 makes
            each where it is used.
        tensorboard: write TensorBoard events too, where it is installed.
    """

    steps: int
    save_every: int = 500
    validate_every: int = 500
    log_every: int = 20
    keep_last: int = 2
    keep_every: int = 0
    grad_clip: float = 1.0
    precision: Precision = "auto"
    device: str = "auto"
    devices: int = 1
    threads: int = 0
    workers: int = 0
    seed: int = 0
    tensorboard: bool = True

    def __post_init__(self) -> None:
        for name in ("steps", "save_every", "log_every", "keep_last", "devices"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} is {getattr(self, name)} but must be at least 1; give a positive number")
        for name in ("validate_every", "keep_every", "grad_clip", "threads", "workers"):
            if getattr(self, name) < 0:
                raise InputError(f"{name} is {getattr(self, name)} but must not be negative; give 0 to switch it off")
        if not 0 <= self.seed < 2**31:
            raise InputError(f"seed {self.seed} is not in 0 to {2**31 - 1}")


class Task:
    """One trainable thing. Subclasses set ``name`` and ``config``, a frozen dataclass of JSON values.

    ``unused`` are fields of the configuration that this task, which shares it with another, does not read.
    """

    name: str
    config: Any
    unused: tuple[str, ...] = ()

    def modules(self) -> dict[str, nn.Module]:
        """Trained modules; each is saved as NAME.safetensors. The engine puts them in train mode before every step."""
        raise NotImplementedError

    def averages(self) -> dict[str, nn.Module]:
        """Modules that follow trained ones (``Ema.module``), saved as NAME.safetensors too."""
        return {}

    def optimizers(self) -> dict[str, torch.optim.Optimizer]:
        """Optimisers by name: two of them make a GAN."""
        raise NotImplementedError

    def learning_rates(self, step: int, steps: int) -> dict[str, float]:
        """Learning rates to set before step ``step`` of so many, by optimiser; those not named keep theirs."""
        return {}

    def training_step(self, step: int, loop: "Loop") -> Mapping[str, float | Tensor]:
        """Step ``step`` (1, 2, …): computes losses, calls ``loop.minimise``, returns scalars to log.

        Runs under autocast in the configured precision. Tensors are not waited for; don't call ``.item()``.
        """
        raise NotImplementedError

    def validate(self, step: int, loop: "Loop") -> Mapping[str, float]:
        """Metrics on held-out data: on rank 0, without gradient, modules in eval mode; leaves no generator changed."""
        return {}

    def state(self) -> dict[str, Tensor | int | float | str]:
        """What else the next step depends on in this process, such as the position in the data."""
        return {}

    def load_state(self, state: Mapping[str, Tensor | int | float | str]) -> None:
        """Takes back what ``state`` gave."""

    def take_given(self) -> None:
        """Puts into the modules, whatever weights were loaded, what is not learned here but follows from the data or
        from another network."""


@dataclass(frozen=True)
class TrainResult:
    """How a run ended: ``stopped_by`` is the name of a signal, or None when all steps are done."""

    step: int
    checkpoint: Path | None
    stopped_by: str | None
    validation: dict[str, float]


class Loop:
    """What a task may ask of the engine: where to compute, randomness, and to follow a gradient."""

    def __init__(self, fabric: "Fabric", config: EngineConfig) -> None:
        self.fabric = fabric
        self.config = config
        self.device: torch.device = fabric.device
        self.rank: int = fabric.global_rank
        self.world_size: int = fabric.world_size
        #: Of this process's batches: each is a function of it and of the step.
        self.seed = config.seed * 64 + self.rank
        self.generators: dict[str, torch.Generator] = {}
        #: Hashes of what the task learns from, noted by it: "corpus", "vae", "teacher", "flow" ("" for none).
        self.learned_from: dict[str, str] = {}
        self._optimizers: dict[str, torch.optim.Optimizer] = {}

    def generator(self, name: str, *, device: torch.device | str = "cpu") -> torch.Generator:
        """A new generator of this process, saved with every checkpoint; streams of different names are independent."""
        if name in self.generators:
            raise ValueError(f"there is a generator {name!r} already")
        made = torch.Generator(device).manual_seed(stream_seed(self.config.seed, name, self.rank))
        self.generators[name] = made
        return made

    def reseed(self, step: int) -> None:
        """Starts this process's streams, torch's global one included, anew at a step."""
        for name, generator in self.generators.items():
            generator.manual_seed(stream_seed(self.config.seed, f"{name}@{step}", self.rank))
        torch.manual_seed(stream_seed(self.config.seed, f"dropout@{step}", self.rank))

    def minimise(self, loss: Tensor, *optimizers: str) -> Tensor:
        """One update of these optimisers' parameters, and of no others: no gradient leaks into the other half of a GAN.

        Gradients are averaged over processes and clipped; an optimiser with a true attribute ``wants_loss`` is given
        the loss. Returns the norm of the first one's gradient before clipping.
        """
        moved = {name: [p for p in _parameters(self._optimizers[name]) if p.requires_grad] for name in optimizers}
        with torch.autocast(self.device.type, enabled=False):
            loss.backward(inputs=[parameter for parameters in moved.values() for parameter in parameters])
        norms = []
        for name, parameters in moved.items():
            optimizer = self._optimizers[name]
            if self.world_size > 1:
                self._average(parameters)
            norms.append(nn.utils.clip_grad_norm_(parameters, self.config.grad_clip or float("inf")))
            arguments: list[Any] = [loss.detach()] if getattr(optimizer, "wants_loss", False) else []
            optimizer.step(*arguments)
            optimizer.zero_grad(set_to_none=True)
        return norms[0]

    def _average(self, parameters: list[nn.Parameter]) -> None:
        """A parameter unused in this process counts as zero: other processes may have used it."""
        gradients = [torch.zeros_like(p) if p.grad is None else p.grad for p in parameters]
        flat = cast(Tensor, self.fabric.all_reduce(nn.utils.parameters_to_vector(gradients), reduce_op="mean"))
        parts = flat.split([parameter.numel() for parameter in parameters])
        for parameter, part in zip(parameters, parts, strict=True):
            parameter.grad = part.view_as(parameter)


def run(
    make_task: Callable[[Loop], Task],
    config: EngineConfig,
    folder: Path,
    resume_from_latest: bool = False,
    init: Path | Sequence[Path] = (),
) -> TrainResult:
    """Trains a task until ``config.steps`` or a signal.

    Args:
        make_task: builds the task; torch's global generator is seeded for it, so fresh modules are reproducible.
        folder: gets ``step_N/`` and ``metrics.jsonl``.
        resume_from_latest: continue from the latest valid checkpoint in ``folder``, or start if there is none.
        init: run folder or checkpoint whose weights a training starts with, at step 0 and with fresh optimisers; of
            several, each module is taken from the first that has it.

    Raises:
        InputError: the folder holds another run, is in use, or its checkpoint or ``init`` does not fit the task.
        MovesetError: a metric or parameter is no longer finite, or a checkpoint could not be written.
    """
    if config.threads:
        torch.set_num_threads(config.threads)
    fabric = launch(config)
    cuda = [fabric.device] if fabric.device.type == "cuda" else []
    with ExitStack() as stack:
        if fabric.is_global_zero:
            busy = f"another training is running in {folder}; stop it or give another folder"
            with system_errors(f"train in {folder}", "give another folder", InputError):
                stack.enter_context(locked(folder, busy))
                checkpoint.clean(folder)
        # The caller's global generator is left as it was.
        stack.enter_context(torch.random.fork_rng(devices=cuda))

        loop = Loop(fabric, config)
        torch.manual_seed(stream_seed(config.seed, "initialisation", None))
        task = make_task(loop)
        loop._optimizers = task.optimizers()
        torch.manual_seed(stream_seed(config.seed, "dropout", loop.rank))  # the ranks were alike so far
        start = _start(task, loop, folder, resume_from_latest, [init] if isinstance(init, Path) else init)
        if loop.world_size > 1:
            for tensor in resume.shared_tensors(task):
                torch.distributed.broadcast(tensor, src=0)
        # Not before: a task may take minutes to prepare its data, and a signal should end that at once.
        signals = stack.enter_context(noted_signals())
        return _train(task, loop, folder, start, signals, stack)


def _train(task: Task, loop: Loop, folder: Path, start: int, signals: list[int], stack: ExitStack) -> TrainResult:
    config, first = loop.config, loop.fabric.is_global_zero
    modules, optimizers = task.modules(), loop._optimizers
    log = (
        stack.enter_context(TrainingLog(folder, task.name, start, config.steps, config.tensorboard)) if first else None
    )
    saved = folder / f"step_{start}" if start else None
    validation: dict[str, float] = {}
    step, stopped = start, _agree(loop, signals)
    while step < config.steps and not stopped:
        step += 1
        for module in modules.values():
            module.train()
        rates = task.learning_rates(step, config.steps)
        for name, rate in rates.items():
            for group in optimizers[name].param_groups:
                group["lr"] = rate
        with _autocast(loop):
            metrics = task.training_step(step, loop)

        stopped, last = _agree(loop, signals), step == config.steps
        saving = last or bool(stopped) or step % config.save_every == 0
        validating = bool(config.validate_every) and (last or step % config.validate_every == 0)
        if log:
            log.add(metrics)
            if saving or step % config.log_every == 0:
                log.flush(step, **{f"lr_{name}": rate for name, rate in rates.items()})
        # Saved first: a validation that fails must not cost the steps before it.
        if saving:
            saved = resume.save(task, loop, folder, step)
            if first:
                checkpoint.prune(folder, config.keep_last, config.keep_every)
        if validating:
            if log:
                validation = _validate(task, loop, step)
                log.write("val", step, validation)
            loop.fabric.barrier()
        if log and (saving or validating):
            log.restart_clock()
    return TrainResult(step, saved, signal.Signals(stopped).name if stopped else None, validation)


def _start(task: Task, loop: Loop, folder: Path, resume_from_latest: bool, init: Sequence[Path]) -> int:
    """Loads the latest checkpoint if asked; returns the number of finished steps."""
    found = None
    if resume_from_latest:
        # One process looks, so that all agree on what they find.
        found = loop.fabric.broadcast(checkpoint.latest(folder) if loop.rank == 0 else None)
    elif existing := checkpoint.steps(folder):
        raise InputError(
            f"{folder} already holds a training up to step {existing[-1]}; continue it with --resume or give another "
            "folder"
        )
    start = resume.load(task, loop, found) if found else 0
    if init and not found:
        resume.begin(task, [checkpoint.resolve(path) for path in init])
    if resume_from_latest and loop.rank == 0:
        checkpoint.set_aside(folder, after=start)
        checkpoint.prune(folder, loop.config.keep_last, loop.config.keep_every)
    return start


def _validate(task: Task, loop: Loop, step: int) -> dict[str, float]:
    """Validation must not change the training: eval mode, no gradient, every generator as it was."""
    before = {name: generator.get_state() for name, generator in loop.generators.items()}
    cuda = [loop.device] if loop.device.type == "cuda" else []
    for module in task.modules().values():
        module.eval()
    with torch.random.fork_rng(devices=cuda), torch.no_grad(), _autocast(loop):
        metrics = dict(task.validate(step, loop))
    for name, generator in loop.generators.items():
        if name in before:
            generator.set_state(before[name])
    return metrics


def stream_seed(seed: int, name: str, rank: int | None) -> int:
    """Seed of a named random stream: a hash, so that streams are independent whatever the seed."""
    digest = hashlib.sha256(f"{seed}/{name}/{'shared' if rank is None else rank}".encode()).digest()
    return int.from_bytes(digest[:8], "little") >> 1


def _parameters(optimizer: torch.optim.Optimizer) -> list[nn.Parameter]:
    return [parameter for group in optimizer.param_groups for parameter in group["params"]]


def _agree(loop: Loop, signals: list[int]) -> int:
    """The signal that any process has received (0: none), so that all stop after the same step."""
    mine = signals[0] if signals else 0
    if loop.world_size == 1:
        return mine
    agreed = torch.tensor(mine, device=loop.device)
    torch.distributed.all_reduce(agreed, op=torch.distributed.ReduceOp.MAX)
    return int(agreed)


@contextmanager
def _autocast(loop: Loop) -> Iterator[None]:
    """The configured precision. Autocast's cache of converted weights is off: it would outlive an optimiser's step
    within ours, and hand weights converted under ``no_grad`` to a forward pass that needs their gradient."""
    cached = torch.is_autocast_cache_enabled()
    with loop.fabric.autocast():
        torch.set_autocast_cache_enabled(False)
        try:
            yield
        finally:
            torch.set_autocast_cache_enabled(cached)
