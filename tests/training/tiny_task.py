"""A task with all that makes resuming hard: dropout, two optimisers, an average, noise, a shuffled data order."""

import signal
import time
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import nn

from moveset.training.ema import Ema
from moveset.training.engine import EngineConfig, Loop, Task, run
from moveset.training.optim import cosine_lr


@dataclass(frozen=True, kw_only=True)
class TinyConfig:
    width: int = 16
    batch: int = 4
    lr: float = 1e-2
    seconds_per_step: float = 0.0


class TinyTask(Task):
    """A two-step GAN whose generator also regresses: 5 -> 3 numbers."""

    name = "tiny"
    stop_at = 0  # the step in which this process gets a SIGTERM

    def __init__(self, config: TinyConfig, loop: Loop) -> None:
        self.config = config
        self.generator = nn.Sequential(
            nn.Linear(5, config.width), nn.ReLU(), nn.Dropout(0.3), nn.Linear(config.width, 3)
        )
        self.discriminator = nn.Sequential(nn.Linear(3, 8), nn.LeakyReLU(), nn.Linear(8, 1))
        self.generator.to(loop.device), self.discriminator.to(loop.device)
        self.ema = Ema(self.generator, 0.9)
        self.noise = loop.generator("noise")
        self.order = loop.generator("order")
        table = torch.Generator().manual_seed(0)
        self.inputs = torch.randn(30, 5, generator=table)
        self.targets = self.inputs @ torch.randn(5, 3, generator=table)
        self.queue, self.position = torch.empty(0, dtype=torch.long), 0
        self._optimizers = {
            "generator": torch.optim.AdamW(self.generator.parameters(), lr=config.lr),
            "discriminator": torch.optim.AdamW(self.discriminator.parameters(), lr=1e-3, betas=(0.0, 0.999)),
        }

    def modules(self):
        return {"generator": self.generator, "discriminator": self.discriminator}

    def averages(self):
        return {"generator_ema": self.ema.module}

    def optimizers(self):
        return self._optimizers

    def learning_rates(self, step, steps):
        return {"generator": cosine_lr(step, self.config.lr, 3, steps)}

    def batch(self, device):
        if self.position + self.config.batch > len(self.queue):
            self.queue, self.position = torch.randperm(len(self.inputs), generator=self.order), 0
        rows = self.queue[self.position : self.position + self.config.batch]
        self.position += self.config.batch
        inputs = self.inputs[rows] + 0.1 * torch.randn(len(rows), 5, generator=self.noise)
        return inputs.to(device), self.targets[rows].to(device)

    def training_step(self, step, loop):
        time.sleep(self.config.seconds_per_step)
        if step == self.stop_at:
            signal.raise_signal(signal.SIGTERM)
        inputs, real = self.batch(loop.device)
        fake = self.generator(inputs)
        d_loss = (1 - self.discriminator(real)).relu().mean() + (1 + self.discriminator(fake.detach())).relu().mean()
        loop.minimise(d_loss, "discriminator")
        g_loss = (fake - real).square().mean() - 0.1 * self.discriminator(fake).mean()
        norm = loop.minimise(g_loss, "generator")
        self.ema.update(self.generator)
        return {"g_loss": g_loss, "d_loss": d_loss, "grad_norm": norm}

    def validate(self, step, loop):
        torch.rand(7, generator=self.noise), torch.rand(7)  # must not change the training
        assert not self.generator.training
        return {
            "mse": (self.generator(self.inputs.to(loop.device)) - self.targets.to(loop.device)).square().mean().item()
        }

    def state(self):
        return {"queue": self.queue, "position": self.position}

    def load_state(self, state):
        self.queue, self.position = state["queue"], int(state["position"])


def train(folder, *, steps=20, resume=False, task=None, stop_at=0, **engine):
    settings = {"save_every": 5, "log_every": 2, "validate_every": 4, "tensorboard": False, "device": "cpu", **engine}

    def make(loop):
        made = TinyTask(task or TinyConfig(), loop)
        made.stop_at = stop_at
        return made

    return run(make, EngineConfig(steps=steps, **settings), Path(folder), resume)
