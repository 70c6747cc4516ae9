"""What test_processes.py starts: the same things in each of two processes, each saying what it found."""

import hashlib
import json
import os
import signal
import socket
import sys
import warnings
from contextlib import suppress
from pathlib import Path

import torch
from torch import nn

from moveset.training.engine import EngineConfig, Task, run
from moveset.training.momo import MomoAdam
from moveset.training.optim import flatten_optimizer
from tests.training.tiny_task import TinyConfig, TinyTask


def digest(module: nn.Module) -> str:
    return hashlib.sha256(b"".join(p.detach().numpy().tobytes() for p in module.parameters())).hexdigest()


class Regression(Task):
    """Full-batch regression over rows RANK, RANK + WORLD, …; equal shares make it the one-process problem exactly."""

    name = "regression"

    def __init__(self, loop, momo: bool = False) -> None:
        self.config, self.losses = TinyConfig(), []
        table = torch.Generator().manual_seed(3)
        self.x, self.y = torch.randn(12, 4, generator=table), torch.randn(12, 2, generator=table)
        self.net = nn.Sequential(nn.Linear(4, 8), nn.Tanh(), nn.Linear(8, 2))
        self.unused = nn.Linear(4, 4)  # a parameter that no process uses must not stop the average
        parameters = [*self.net.parameters(), *self.unused.parameters()]
        # A step of ten is one whose cap binds.
        self.optimizer = MomoAdam(parameters, lr=10.0) if momo else torch.optim.AdamW(parameters, lr=1e-2)

    def modules(self):
        return {"net": self.net, "unused": self.unused}

    def optimizers(self):
        return {"net": self.optimizer}

    def training_step(self, step, loop):
        mine = slice(loop.rank, None, loop.world_size)
        loss = (self.net(self.x[mine]) - self.y[mine]).square().mean()
        self.losses.append(loss.item())
        return {"norm": loop.minimise(loss, "net"), "loss": loss}

    @classmethod
    def trained(cls, folder: Path, steps: int, momo: bool = False) -> "Regression":
        made = []

        def make(loop):
            made.append(cls(loop, momo))
            return made[0]

        run(make, config(steps), folder)
        return made[0]


def tiny(folder: Path, stop_at: int = 0, resume: bool = False) -> TinyTask:
    made = []

    def make(loop):
        made.append(TinyTask(TinyConfig(), loop))
        if loop.rank == 1:  # the other process must hear of it and stop after the same step
            made[0].stop_at = stop_at
        return made[0]

    result = run(make, config(12), folder, resume)
    assert (result.step, result.stopped_by) == ((stop_at, "SIGTERM") if stop_at else (12, None))
    return made[0]


def config(steps: int) -> EngineConfig:
    exact = {"device": "cpu", "precision": "32-true", "threads": 1}
    return EngineConfig(steps=steps, save_every=5, validate_every=4, tensorboard=False, **exact)


def main(folder: Path) -> None:
    said = {"rank": int(os.environ["RANK"]), "world": int(os.environ["WORLD_SIZE"])}
    regression = Regression.trained(folder / "regression", 20)
    said["regression"] = [p.detach().flatten().tolist() for p in regression.net.parameters()]
    momo = Regression.trained(folder / "momo", 12, momo=True)
    said["losses"] = momo.losses
    said["momo"] = nn.utils.parameters_to_vector(momo.net.parameters()).tolist()
    said["state"] = {name: value.tolist() for name, value in flatten_optimizer(momo.optimizer)[0].items()}

    straight = tiny(folder / "straight")
    tiny(folder / "halves", stop_at=7)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        resumed = tiny(folder / "halves", resume=True)
    said["generator"] = [digest(task.generator) for task in (straight, resumed)]
    said["average"] = [digest(task.ema.module) for task in (straight, resumed)]
    said["noise"] = [torch.rand(1, generator=task.noise).item() for task in (straight, resumed)]
    (folder / f"rank_{said['rank']}.json").write_text(json.dumps(said))


def launch(folder: str) -> int:
    """Fork the processes with the environment that ``torchrun`` gives.

    Returns:
        The first exit code that is not 0, whereupon the other process is ended; else 0.
    """
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = str(free.getsockname()[1])
    said = {"TORCHELASTIC_RUN_ID": "test", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "GROUP_RANK": "0"}
    os.environ |= {**said, "WORLD_SIZE": "2", "LOCAL_WORLD_SIZE": "2"}
    running = set()
    for rank in ("0", "1"):
        if (process := os.fork()) == 0:
            os.environ |= {"RANK": rank, "LOCAL_RANK": rank}
            main(Path(folder))
            sys.exit()
        running.add(process)
    while running:
        process, status = os.wait()
        running.discard(process)
        if code := os.waitstatus_to_exitcode(status):
            for other in running:
                with suppress(ProcessLookupError):
                    os.kill(other, signal.SIGKILL)
            return code
    return 0
