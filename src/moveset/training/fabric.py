"""Where a training computes: device, precision, and the processes that share it."""

import atexit
import os
from importlib.util import find_spec
from typing import TYPE_CHECKING

import torch

from moveset.errors import InputError

if TYPE_CHECKING:
    from lightning_fabric import Fabric

    from moveset.training.engine import EngineConfig


def launch(config: "EngineConfig") -> "Fabric":
    """Lightning's Fabric for a training, launched: this process has its place among all of them.

    Raises:
        InputError: as ``chosen_device``; too many processes.
    """
    device = chosen_device(config.device)
    from lightning_fabric import Fabric

    precision = config.precision
    if precision == "auto":
        precision = "bf16-mixed" if _multiplies_bf16(device) else "32-true"
    devices, nodes = config.devices, 1
    if torch.distributed.is_torchelastic_launched():
        devices = int(os.environ["LOCAL_WORLD_SIZE"])
        nodes = int(os.environ["WORLD_SIZE"]) // devices
    else:
        # Hundreds of processes by a slip of the hand would bring the machine down before anything could be said.
        most = torch.cuda.device_count() if device == "cuda" else 4 * (os.cpu_count() or 1)
        if devices > most:
            raise InputError(f"{devices} devices are too many for {device}; use 1 to {most}")
    strategy = "ddp" if devices * nodes > 1 else "auto"
    fabric = Fabric(accelerator=device, devices=devices, num_nodes=nodes, strategy=strategy, precision=precision)
    fabric.launch()
    if torch.distributed.is_initialized() and torch.distributed.get_backend() == "gloo":
        atexit.register(_leave_group)
    return fabric


def chosen_device(device: str) -> str:
    """Where a training computes, "cpu" or "cuda", if it is asked to do so on this one or on any ("auto").

    Raises:
        InputError: no lightning-fabric, or a device that cannot be used here.
    """
    if find_spec("lightning_fabric") is None:
        raise InputError("training needs lightning-fabric; install it with pip install 'moveset[train]'")
    if device == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    if device == "mps":
        raise InputError("trainings add up in double precision, which 'mps' does not have; give --device cpu")
    if device != "cpu" and not (device == "cuda" and torch.cuda.is_available()):
        usable = "cpu, cuda" if torch.cuda.is_available() else "cpu"
        raise InputError(f"device {device!r} cannot be used here; this machine has {usable}")
    return device


def _multiplies_bf16(device: str) -> bool:
    """Whether a device has instructions for bfloat16: a processor without them takes longer than in full precision."""
    if device == "cpu":
        has = getattr(torch.cpu, "get_capabilities", dict)()  # of torch 2.6 there is none
        return bool(has.get("avx512_bf16") or has.get("amx_bf16"))
    return device == "cuda" and torch.cuda.is_bf16_supported()


def _leave_group() -> None:
    """Threads of gloo that still run when the interpreter is gone abort a process that has done its work
    (pytorch/pytorch#190489); Fabric sees to NCCL's alone."""
    if torch.distributed.is_initialized():
        torch.distributed.destroy_process_group()
