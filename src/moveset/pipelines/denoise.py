"""From noise to latents: one network of a model folder, bound to a prompt, inside the sampler that it was trained for.

Shapes: B clips, N latent tokens, d numbers in each.
"""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from moveset.diffusion.phases import PhaseGrid
from moveset.diffusion.schedule import scaled_linear
from moveset.diffusion.steps import ddim_timesteps
from moveset.models.latent_denoiser import LatentDenoiser
from moveset.models.packed_denoiser import PackedDenoiser
from moveset.pcm.sampler import lcm_timesteps, sample_ddim_cfg, sample_lcm, sample_phased
from moveset.pipelines.bundle import Bundle
from moveset.pipelines.request import Method
from moveset.text.encoder import TextEmbedding, TextEncoder, stack

Bound = Callable[[Tensor, Tensor, Tensor | None], Tensor]


class Denoise:
    """Latents of prompts by one method; counts the network's evaluations.

    Args:
        bundle: the model.
        encoder: its text encoder, for the empty prompt of guidance.
        method: network, steps and guidance scale.
        device: where to compute.
        between: called before every evaluation; what it raises ends the work.
    """

    def __init__(
        self,
        bundle: Bundle,
        encoder: TextEncoder,
        method: Method,
        device: torch.device,
        between: Callable[[], None] | None = None,
    ) -> None:
        self._method, self._between = method, between
        self._device = device
        self._network = bundle.module(method.network, device)
        self._schedule = scaled_linear()
        self._grid = PhaseGrid(bundle.config.points, phases=method.steps if method.solver == "pcm" else 1)
        self._empty = encoder.encode([""]) if method.solver == "teacher" else None
        self.evaluations = 0

    def __call__(
        self, noise_BND: Tensor, text: TextEmbedding, frames: Sequence[int], later: Sequence[Tensor] = ()
    ) -> Tensor:
        """Normalised latents (B, N, d) of standard normal noise, on the device.

        Args:
            noise_BND: on any device.
            text: B prompts.
            frames: length of each clip.
            later: as much noise again for every step after the first; LCM alone needs it.
        """
        noise_BND = noise_BND.to(self._device)
        steps, guidance = self._method.steps, self._method.guidance
        if self._empty is not None:
            batch = len(noise_BND)
            both = self._bind(stack([text, *[self._empty] * batch]), [*frames, *frames])

            def teacher(z_BND: Tensor, t_B: Tensor) -> tuple[Tensor, Tensor]:
                conditional, unconditional = both(z_BND.repeat(2, 1, 1), t_B.repeat(2), None).chunk(2)
                return conditional, unconditional

            return sample_ddim_cfg(teacher, self._schedule, ddim_timesteps(steps), noise_BND, guidance)
        model = self._bind(text, frames)
        w_B = torch.full((len(noise_BND),), guidance, device=self._device)
        if self._method.solver == "lcm":
            times = lcm_timesteps(steps, self._grid.points)
            return sample_lcm(model, self._schedule, times, [noise_BND, *(z.to(self._device) for z in later)], w_B)
        return sample_phased(model, self._schedule, self._grid, noise_BND, w_B)

    def _bind(self, text: TextEmbedding, frames: Sequence[int]) -> Bound:
        """The network with prompts and lengths bound; it reads each prompt once where it can."""
        text = text.to(self._device)
        frames_B = torch.tensor(frames, device=self._device)
        call = _read_once(self._network, text, frames_B)

        def counted(z_BND: Tensor, t_B: Tensor, w_B: Tensor | None) -> Tensor:
            if self._between is not None:
                self._between()
            self.evaluations += len(z_BND)
            return call(z_BND, t_B, w_B)

        return counted


def _read_once(network: nn.Module, text: TextEmbedding, frames_B: Tensor) -> Bound:
    if isinstance(network, LatentDenoiser | PackedDenoiser):
        keys = network.read(text.tokens, text.mask)
        return lambda z_BND, t_B, w_B: network.denoise(z_BND, t_B, keys, w_B, None, frames_B)
    return lambda z_BND, t_B, w_B: network(z_BND, t_B, text.tokens, text.mask, w_B, None, frames_B)
