"""What ``torchrun`` starts in test_momo.py: a regression over rows RANK, RANK + WORLD, … with a cap that binds."""

import json
import sys
from pathlib import Path

import torch
from torch import nn

from moveset.training.engine import EngineConfig, Task, run
from moveset.training.momo import MomoAdam
from moveset.training.optim import flatten_optimizer
from tests.training.tiny_task import TinyConfig


class Regression(Task):
    """Full-batch regression; equal shares make it the one-process problem."""

    name = "regression"

    def __init__(self) -> None:
        self.config, self.losses = TinyConfig(), []
        table = torch.Generator().manual_seed(3)
        self.x, self.y = torch.randn(12, 4, generator=table), torch.randn(12, 2, generator=table)
        self.net = nn.Sequential(nn.Linear(4, 8), nn.Tanh(), nn.Linear(8, 2))
        self.optimizer = MomoAdam(self.net.parameters(), lr=10.0)

    def modules(self):
        return {"net": self.net}

    def optimizers(self):
        return {"net": self.optimizer}

    def training_step(self, step, loop):
        mine = slice(loop.rank, None, loop.world_size)
        loss = (self.net(self.x[mine]) - self.y[mine]).square().mean()
        self.losses.append(loss.item())
        loop.minimise(loss, "net")
        return {}


def main(folder: Path) -> None:
    made, place = [], []

    def make(loop):
        place.append(loop.rank)
        made.append(Regression())
        return made[0]

    config = EngineConfig(steps=12, validate_every=0, device="cpu", threads=1, tensorboard=False)
    run(make, config, folder / f"run_{torch.distributed.is_torchelastic_launched()}")
    said = {
        "losses": made[0].losses,
        "parameters": nn.utils.parameters_to_vector(made[0].net.parameters()).tolist(),
        "state": {name: value.tolist() for name, value in flatten_optimizer(made[0].optimizer)[0].items()},
    }
    (folder / f"rank_{place[0]}.json").write_text(json.dumps(said))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
