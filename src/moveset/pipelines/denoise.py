"""From noise to latents: one network of a model folder, bound to a prompt, inside the sampler that it was trained for.

Shapes: B clips, N latent tokens, d numbers in each.
"""

from collections.abc import Callable, Sequence
from typing import cast

import torch
from torch import Tensor

from moveset.diffusion.phases import PhaseGrid
from moveset.diffusion.schedule import scaled_linear
from moveset.diffusion.steps import ddim_timesteps
from moveset.models.condition import Condition, Denoiser, guided
from moveset.pcm.sampler import lcm_timesteps, sample_ddim, sample_lcm, sample_phased
from moveset.pipelines.model_config import ClipConfig
from moveset.pipelines.model_folder import ModelFolder
from moveset.pipelines.request import Method
from moveset.pipelines.sides import read_sides
from moveset.text.encoder import TextEmbedding, TextEncoder


class Denoise:
    """Latents of prompts by one method; counts the network's evaluations.

    Args:
        encoder: its text encoder, for the empty prompt of guidance.
        between: called before every evaluation; what it raises ends the work.
    """

    def __init__(
        self,
        bundle: ModelFolder[ClipConfig],
        encoder: TextEncoder,
        method: Method,
        device: torch.device,
        between: Callable[[], None] | None = None,
    ) -> None:
        self._bundle, self._method, self._between = bundle, method, between
        self._device = device
        self._network = cast(Denoiser, bundle.module(method.network, device))
        self._schedule = scaled_linear()
        self._grid = PhaseGrid(bundle.config.points, phases=method.steps if method.solver == "pcm" else 1)
        self._empty = None if self._network.takes_scale else encoder.encode([""]).to(device)
        self.evaluations = 0

    def __call__(
        self, noise_BND: Tensor, text: TextEmbedding, frames: Sequence[int], later: Sequence[Tensor] = ()
    ) -> Tensor:
        """Normalised latents (B, N, d) of standard normal noise, on the device.

        Args:
            text: B prompts.
            frames: length of each clip.
            later: as much noise again for every step after the first; LCM alone needs it.
        """
        noise_BND = noise_BND.to(self._device)
        steps = self._method.steps
        text = read_sides(self._bundle, text.to(self._device), self._device)
        condition = Condition(text, length=torch.tensor(frames, device=self._device))
        predict = guided(self._network, condition, self._method.guidance, self._empty)

        def model(z_BND: Tensor, t_B: Tensor) -> Tensor:
            if self._between is not None:
                self._between()
            self.evaluations += len(z_BND) * (1 if self._network.takes_scale else 2)
            return predict(z_BND, t_B)

        if self._method.solver == "teacher":
            return sample_ddim(model, self._schedule, ddim_timesteps(steps), noise_BND)
        if self._method.solver == "lcm":
            times = lcm_timesteps(steps, self._grid.points)
            return sample_lcm(model, self._schedule, times, [noise_BND, *(z.to(self._device) for z in later)])
        return sample_phased(model, self._schedule, self._grid, noise_BND)
