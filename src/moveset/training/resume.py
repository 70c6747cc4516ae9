"""What of a running training goes into a checkpoint, and back.

NAME.safetensors             parameters and buffers of each trained module and average
optimizer_NAME.safetensors   moments of each optimiser, named PARAMETER/KEY
rng.safetensors              generators and task tensors, named RANK/torch, …/cuda, …/generator/NAME, …/task/KEY
state.json                   step, world size, optimiser groups and scalars, task scalars by rank, versions
config.json                  {"task": NAME, "config": {…}, "engine": {…}, "learned_from": {WHAT: HASH}}
"""

import dataclasses
import json
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import safetensors.torch
import torch
from torch import Tensor

from moveset.errors import FormatError, InputError, MovesetError
from moveset.training import checkpoint
from moveset.training.optim import flatten_optimizer, unflatten_optimizer

if TYPE_CHECKING:
    from moveset.training.engine import Loop, Task

# Changing these does not change what is learned. The number of steps does: learning rates end with it.
_HARMLESS = {
    "save_every", "validate_every", "log_every", "keep_last", "keep_every", "tensorboard", "threads", "workers",
}  # fmt: skip


def save(task: "Task", loop: "Loop", folder: Path, step: int) -> Path:
    """Writes ``folder/step_N``; every process must call it.

    Raises:
        MovesetError: a parameter is not finite, or the disk refuses.
    """
    ranks = _gather(_rank_state(task, loop), loop)
    failure = ""
    if loop.rank == 0:
        try:
            _write(task, loop, folder, step, ranks)
        except MovesetError as error:
            if loop.world_size == 1:
                raise
            failure = str(error)
    if loop.world_size > 1:
        # All processes must fail together, or the others would wait for ever.
        failure = loop.fabric.broadcast(failure)
        if failure:
            raise MovesetError(failure)
    return folder / f"step_{step}"


def load(task: "Task", loop: "Loop", path: Path) -> int:
    """Loads a verified checkpoint into a freshly built task; returns its number of finished steps.

    Warns when the config, the number of processes or the kind of device has changed; in the latter cases random streams
    start anew.

    Raises:
        InputError: the checkpoint is of another task or of other sizes.
        FormatError: a file is damaged.
    """
    state, config = checkpoint.read_document(path, "state"), checkpoint.read_document(path, "config")
    if config["task"] != task.name:
        raise InputError(f"{path} is a checkpoint of {config['task']!r}, not of {task.name!r}; give another folder")
    _warn_of_changes(config, _config(task, loop), path)
    for name, module in {**task.modules(), **task.averages()}.items():
        checkpoint.load_module(module, path, name)
    for name, optimizer in task.optimizers().items():
        if name not in state["optimizers"]:
            raise InputError(f"{path} has no optimiser {name!r}; check the recipe")
        unflatten_optimizer(optimizer, checkpoint.read_tensors(path, f"optimizer_{name}"), state["optimizers"][name])

    tensors = checkpoint.read_tensors(path, "rng")
    same = state["world_size"] == loop.world_size
    if not same:
        warnings.warn(
            f"{path} was written by {state['world_size']} processes and is resumed by {loop.world_size}: data order "
            "and noise start anew, and the effective batch changes in proportion",
            stacklevel=3,
        )
    rank = loop.rank if same else 0
    prefix = f"{rank}/"
    mine = {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}
    scalars = state["ranks"][rank]
    task.load_state({**{k.removeprefix("task/"): v for k, v in mine.items() if k.startswith("task/")}, **scalars})
    known = _load_generators(loop, mine, path)
    if not known:
        warnings.warn(f"{path} was written on another kind of device: data order and noise start anew", stacklevel=3)
    if not same or not known:
        loop.reseed(state["step"])
    return int(state["step"])


def begin(task: "Task", paths: Sequence[Path]) -> None:
    """Loads the weights of verified checkpoints into a freshly built task, and nothing else of them.

    A module is taken from the first that has it: a student of one training may meet the discriminator of another.
    Warns of modules that none has: they start as they were built. So does what a task is given
    (``Task.take_given``): that of another training does not fit this one's data.

    Raises:
        InputError: one has none of the task's modules, or none that those before it lack, or one of other sizes.
        FormatError: a file is damaged.
    """
    modules = {**task.modules(), **task.averages()}
    missing = list(modules)
    for path in paths:
        if not (found := [name for name in missing if (path / f"{name}.safetensors").is_file()]):
            raise InputError(f"{path} has none of {', '.join(missing)}; give a checkpoint of {task.name!r} or the like")
        for name in found:
            checkpoint.load_module(modules[name], path, name)
            missing.remove(name)
        if not missing and path is not paths[-1]:
            raise InputError(f"{path} has all that {task.name!r} needs; leave out what follows it")
    if missing:
        warnings.warn(f"{paths[-1]} has no {', '.join(missing)}: that starts anew", stacklevel=4)
    task.take_given()


def shared_tensors(task: "Task") -> Iterator[Tensor]:
    """Parameters and buffers that all processes hold alike."""
    for module in {**task.modules(), **task.averages()}.values():
        yield from (tensor.data for tensor in module.parameters())
        yield from module.buffers()


def _write(task: "Task", loop: "Loop", folder: Path, step: int, ranks: list[dict[str, Tensor]]) -> None:
    import moveset

    tensors: dict[str, dict[str, Tensor]] = {}
    for name, module in {**task.modules(), **task.averages()}.items():
        tensors[name] = module.state_dict()
        for key, value in tensors[name].items():
            if value.is_floating_point() and not torch.isfinite(value).all():
                raise MovesetError(
                    f"{name}.{key} is not finite after step {step}, so it is not saved; resume from an older "
                    "checkpoint with a lower learning rate"
                )
    optimizers = {}
    for name, optimizer in task.optimizers().items():
        tensors[f"optimizer_{name}"], optimizers[name] = flatten_optimizer(optimizer)
    scalars = [json.loads(bytes(rank.pop("scalars").numpy())) for rank in ranks]
    tensors["rng"] = {f"{number}/{key}": value for number, rank in enumerate(ranks) for key, value in rank.items()}
    state = {
        "step": step,
        "world_size": loop.world_size,
        "optimizers": optimizers,
        "ranks": scalars,
        "versions": {"moveset": getattr(moveset, "__version__", "0"), "torch": torch.__version__},
    }
    checkpoint.write(folder, step, tensors, {"state": state, "config": _config(task, loop)})


def _config(task: "Task", loop: "Loop") -> dict[str, Any]:
    """As JSON, so that it compares equal to what is read back."""
    parts = {"config": dataclasses.asdict(task.config), "engine": dataclasses.asdict(loop.config)}
    config = {"task": task.name, **parts, "learned_from": loop.learned_from}
    return json.loads(json.dumps(config, default=str))


def _warn_of_changes(old: dict[str, Any], new: dict[str, Any], path: Path) -> None:
    changes = []
    for part in ("config", "engine"):
        for key in sorted(old[part].keys() | new[part].keys()):
            before, after = old[part].get(key), new[part].get(key)
            if before != after and not (part == "engine" and key in _HARMLESS):
                changes.append(f"{key} {before!r} -> {after!r}")
    if changes:
        warnings.warn(f"resuming {path} with other settings: {'; '.join(changes)}", stacklevel=4)
    known = old.get("learned_from", {})
    if others := [what for what, digest in new["learned_from"].items() if known.get(what, digest) != digest]:
        warnings.warn(f"resuming {path} with another {', another '.join(others)}", stacklevel=4)


def _rank_state(task: "Task", loop: "Loop") -> dict[str, Tensor]:
    state = task.state()
    scalars = {key: value for key, value in state.items() if not isinstance(value, Tensor)}
    tensors = {f"task/{key}": value for key, value in state.items() if isinstance(value, Tensor)}
    tensors |= {f"generator/{name}": generator.get_state() for name, generator in loop.generators.items()}
    tensors["torch"] = torch.get_rng_state()
    if loop.device.type == "cuda":
        tensors["cuda"] = torch.cuda.get_rng_state(loop.device)
    tensors["scalars"] = torch.frombuffer(bytearray(json.dumps(scalars).encode()), dtype=torch.uint8)
    return tensors


def _gather(tensors: dict[str, Tensor], loop: "Loop") -> list[dict[str, Tensor]]:
    """Every process's tensors, in the order of ranks. They travel as safetensors in one padded byte tensor."""
    if loop.world_size == 1:
        return [tensors]
    content = {key: value.detach().cpu().clone().contiguous() for key, value in tensors.items()}
    message = torch.frombuffer(bytearray(safetensors.torch.save(content)), dtype=torch.uint8).to(loop.device)
    sizes = [torch.zeros(1, dtype=torch.long, device=loop.device) for _ in range(loop.world_size)]
    torch.distributed.all_gather(sizes, torch.tensor([len(message)], device=loop.device))
    padded = torch.zeros(int(max(sizes)), dtype=torch.uint8, device=loop.device)
    padded[: len(message)] = message
    received = [torch.zeros_like(padded) for _ in range(loop.world_size)]
    torch.distributed.all_gather(received, padded)
    return [
        safetensors.torch.load(bytes(part[: int(size)].cpu().numpy()))
        for part, size in zip(received, sizes, strict=True)
    ]


def _load_generators(loop: "Loop", tensors: dict[str, Tensor], path: Path) -> bool:
    """Whether this is the kind of device whose states they are; those that it does not know are left out."""
    known = ("cuda" in tensors) == (loop.device.type == "cuda")
    for name, generator in loop.generators.items():
        if f"generator/{name}" not in tensors:
            raise FormatError(f"{path} has no state of the generator {name!r}; it was written by another version")
        stored = tensors[f"generator/{name}"]
        if stored.shape == generator.get_state().shape:
            generator.set_state(stored)
        else:
            known = False
    torch.set_rng_state(tensors["torch"])
    if loop.device.type == "cuda" and "cuda" in tensors:
        torch.cuda.set_rng_state(tensors["cuda"], loop.device)
    return known
