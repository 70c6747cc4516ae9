"""Whole-clip models and chunk by chunk rollouts as generators: what recurrent models are compared with.

B clips, n frames of a clip or chunk, P frames of a prefix, D features, L text tokens.
"""

from collections.abc import Callable, Sequence
from itertools import accumulate
from typing import Any

import torch
from torch import Tensor

from moveset.diffusion.guidance import cfg
from moveset.errors import InputError
from moveset.motion.clip import Motion
from moveset.motion.foot_lock import FootLock
from moveset.motion.hold_root import hold_root
from moveset.pipelines.baseline_bundle import DENOISER, IDLE, BaselineBundle
from moveset.pipelines.device import pick_device
from moveset.pipelines.request import Request
from moveset.rdm.prediction import clean_from_noise
from moveset.rdm.sequential import Solver, idle_prefix, rollout_chunks, sample_segment
from moveset.rdm.staircase import levels
from moveset.text.cache import CachedEncoder
from moveset.text.encoder import TextEmbedding, get_text_encoder, stack


class Baseline:
    """A baseline's model folder, sampled in batches of clips of like length.

    A clip of several parts is told all their prompts at once, a chunk that of the part that it begins in.

    Args:
        bundle: the folder.
        steps: K; None for the folder's own. Chunks take every step of their schedule.
        guidance: w; None for the folder's own, 0 for none.
        foot_lock: judge motion with planted feet held, as streams and clips are.
        device: where to compute.
        batch: clips evaluated at once.

    Raises:
        InputError: steps or guidance out of range.
        FormatError: a folder of another codec.
    """

    segment = 0

    def __init__(
        self,
        bundle: BaselineBundle,
        *,
        steps: int | None = None,
        guidance: float | None = None,
        foot_lock: bool = True,
        device: str = "auto",
        batch: int = 64,
    ) -> None:
        config = bundle.config
        own, limit = config.sampler_steps, config.timesteps
        self.steps = own if steps is None else steps
        if not 1 <= self.steps <= limit or (config.prefix and self.steps != limit):
            raise InputError(f"{config.name!r} cannot take {self.steps} steps; its own choice is {own}")
        chosen = config.guidance.get(DENOISER, 0.0)
        self._w = chosen if guidance is None else guidance
        if not 0.0 <= self._w < 100.0:
            raise InputError(f"guidance {self._w:g} is not in 0 to 100; {config.name!r} has {chosen:g}")
        self._bundle, self._batch, self._foot_lock = bundle, batch, foot_lock
        self._device, self._codec = pick_device(device), config.feature_codec()
        self._text = CachedEncoder(get_text_encoder(config.text_encoder, device=self._device), limit=8192)
        self._schedule = config.noise_schedule()
        self.model, self.network, self.fps = config.name, DENOISER, config.fps
        extras = [] if self.steps == own else [f"{self.steps}-steps"]
        extras += [] if self._w == chosen else [f"guidance{self._w:g}"]
        self.slug = "-".join([self.model, *extras, *(() if foot_lock else ("raw",))])

    def describe(self) -> dict[str, Any]:
        return {
            "guidance": self._w, "eta": self._bundle.config.eta, "foot_lock": self._foot_lock, "batch": self._batch,
            "device": self._device.type,
        }  # fmt: skip

    def weights(self) -> dict[str, str]:
        return self._bundle.sha256(DENOISER)

    @torch.inference_mode()
    def generate(
        self, requests: Sequence[Request], progress: Callable[[int], object] = lambda count: None
    ) -> list[Motion]:
        """A motion for each request, cut where it is longer than the network knows."""
        statistics, made = self._bundle.normalizer, dict[int, Motion]()
        sample = self._chunks if self._bundle.config.prefix else self._volumes
        order = sorted(range(len(requests)), key=lambda k: requests[k].total)
        for start in range(0, len(order), self._batch):
            rows = order[start : start + self._batch]
            features = (
                sample([requests[k] for k in rows]).cpu() * statistics["feature_std"] + statistics["feature_mean"]
            )
            made |= {k: self._motion(one[: requests[k].total]) for k, one in zip(rows, features, strict=True)}
            progress(len(rows))
        return [made[k] for k in range(len(requests))]

    def _volumes(self, clips: Sequence[Request]) -> Tensor:
        """(B, n, D) of whole clips; the network sees how long each is, up to its longest."""
        config, network = self._bundle.config, self._bundle.module(DENOISER, self._device)
        said = [" then ".join(clip.prompts) for clip in clips]
        text = self._read(said)
        size = (len(text.tokens), config.frames, self._codec.dim)
        valid_Bn = (
            torch.arange(config.frames) < torch.tensor([clip.total for clip in clips]).clamp(max=config.frames)[:, None]
        )
        valid_Bn = valid_Bn.to(self._device).repeat(size[0] // len(clips), 1)
        nothing, zero = torch.zeros(size, device=self._device), torch.zeros(size[:1], dtype=torch.long)
        zero = zero.to(self._device)

        def predicted(x_BnD: Tensor, t_B: Tensor) -> Tensor:
            made: Tensor = network(x_BnD, t_B, nothing, zero, zero, text.tokens, text.mask, None, valid_Bn)
            return made

        clean = clean_from_noise(self._schedule, predicted) if config.predict == "eps" else predicted
        solver = Solver(schedule=self._schedule, levels=levels(self.steps, config.timesteps), eta=config.eta)
        guided, seeds = self._guided(clean), [clip.seed for clip in clips]
        return sample_segment(lambda x, t, *_: guided(x, t), solver, seeds, [0] * len(seeds), nothing[: len(seeds)])

    def _chunks(self, clips: Sequence[Request]) -> Tensor:
        """(B, n, D) chunk by chunk, from a person who stands."""
        config, network = self._bundle.config, self._bundle.module(DENOISER, self._device)
        pose_D = self._bundle.normalizer[IDLE].to(self._device)
        prefix = idle_prefix(pose_D, len(clips), config.prefix)

        def denoise(x_BnD: Tensor, t_B: Tensor, prefix_BPD: Tensor, number: int) -> Tensor:
            text = self._read([_prompt_at(clip, number * config.frames) for clip in clips])

            def clean(x: Tensor, t: Tensor) -> Tensor:
                before = prefix_BPD.repeat(len(x) // len(prefix_BPD), 1, 1)
                made: Tensor = network(x, t, before, text.tokens, text.mask)
                return made

            return self._guided(clean)(x_BnD, t_B)

        seeds = [clip.seed for clip in clips]
        return rollout_chunks(
            denoise, self._schedule, prefix, max(clip.total for clip in clips), seeds, chunk=config.frames
        )

    def _guided(self, clean: Callable[[Tensor, Tensor], Tensor]) -> Callable[[Tensor, Tensor], Tensor]:
        """The same under classifier-free guidance, by one batch of both."""
        if not self._w:
            return clean
        return lambda x_BnD, t_B: cfg(*clean(x_BnD.repeat(2, 1, 1), t_B.repeat(2)).chunk(2), self._w)

    def _read(self, said: Sequence[str]) -> TextEmbedding:
        """Of these sentences, with the empty one below each if there is guidance."""
        found = [self._text.encode([sentence]) for sentence in said]
        empty = [self._text.encode([""])] * len(said) if self._w else []
        return stack(found + empty).to(self._device)

    def _motion(self, features: Tensor) -> Motion:
        if not self._foot_lock:
            return self._codec.decode(features)
        planted = self._codec.planted(features)
        motion = self._codec.decode(hold_root(features, planted, self._codec))
        return FootLock(self._codec.skeleton, self._codec.fps)(motion, planted[: len(motion)])


def _prompt_at(clip: Request, frame: int) -> str:
    """The prompt of the part that this frame belongs to; the last one beyond the end."""
    ends = accumulate(count or 0 for count in clip.frames)
    return next((prompt for prompt, end in zip(clip.prompts, ends, strict=True) if frame < end), clip.prompts[-1])
