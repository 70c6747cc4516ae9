"""Whole-clip models and chunk by chunk rollouts as generators: what recurrent models are compared with.

B clips, n frames of a clip or chunk, P frames of a prefix, D features, L text tokens.
"""

from collections.abc import Callable, Sequence
from itertools import accumulate
from typing import Any, cast

import torch
from torch import Tensor

from moveset.diffusion.steps import predict_z0
from moveset.errors import InputError
from moveset.models.condition import Condition, Denoiser, PastSegment, Prediction, guided
from moveset.motion.clip import Motion
from moveset.motion.foot_lock import FootLock
from moveset.motion.hold_root import hold_root
from moveset.pipelines.device import pick_device
from moveset.pipelines.model_config import DENOISER, IDLE, SCHEDULES, BaselineConfig
from moveset.pipelines.model_folder import ModelFolder
from moveset.pipelines.request import Request
from moveset.rdm.sequential import Solver, rollout_chunks, sample_segment
from moveset.rdm.staircase import levels
from moveset.text.cache import CachedEncoder
from moveset.text.encoder import get_text_encoder


class Baseline:
    """A baseline's model folder, sampled in batches of clips of like length.

    A clip of several parts is told all their prompts at once, a chunk that of the part that it begins in.

    Args:
        steps: K; None for the folder's own. Chunks take every step of their schedule.
        guidance: w; None for the folder's own, 0 for none.
        foot_lock: judge motion with planted feet held, as streams and clips are.

    Raises:
        InputError: steps or guidance out of range.
        FormatError: a folder of another codec.
    """

    segment = 0

    def __init__(
        self,
        bundle: ModelFolder[BaselineConfig],
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
        self._schedule = SCHEDULES[config.schedule](config.timesteps)
        self.model, self.network, self.fps = config.name, DENOISER, config.fps
        self.skeleton = self._codec.skeleton.name
        extras = [] if self.steps == own else [f"{self.steps}-steps"]
        extras += [] if self._w == chosen else [f"guidance{self._w:g}"]
        self.slug = "-".join([self.model, *extras, *(() if foot_lock else ("raw",))])

    def describe(self) -> dict[str, Any]:
        config = self._bundle.config
        found = {
            "guidance": self._w, "eta": config.eta, "foot_lock": self._foot_lock, "batch": self._batch,
            "device": self._device.type,
        }  # fmt: skip
        return found if config.variance == "posterior" else {**found, "variance": config.variance}

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
        config = self._bundle.config
        text = self._text.encode([" then ".join(clip.prompts) for clip in clips])
        seeds, size = [clip.seed for clip in clips], (len(clips), config.frames, self._codec.dim)
        totals_B = torch.tensor([clip.total for clip in clips]).clamp(max=config.frames)
        valid_Bn = (torch.arange(config.frames) < totals_B[:, None]).to(self._device)
        nothing = torch.zeros(size, device=self._device)
        zero = torch.zeros(len(clips), dtype=torch.long, device=self._device)
        predict = self._guided(Condition(text, past=PastSegment(nothing, zero, zero), valid=valid_Bn))

        def clean(x_BnD: Tensor, t_B: Tensor, *_: Tensor) -> Tensor:
            said = predict(x_BnD, t_B)
            if config.predict != "eps":
                return said
            # Without a flow the noise is that of x. In float32: alpha is 0.006 at the noisiest level.
            return predict_z0(self._schedule, x_BnD.float(), said.float(), t_B)

        solver = Solver(schedule=self._schedule, levels=levels(self.steps, config.timesteps), eta=config.eta,
                        variance=config.variance)  # fmt: skip
        return sample_segment(clean, solver, seeds, [0] * len(seeds), nothing)

    def _chunks(self, clips: Sequence[Request]) -> Tensor:
        """(B, n, D) chunk by chunk, from a person who stands."""
        config = self._bundle.config
        pose_D = self._bundle.normalizer[IDLE].to(self._device)
        prefix = pose_D.expand(len(clips), config.prefix, -1)

        def denoise(x_BnD: Tensor, t_B: Tensor, prefix_BPD: Tensor, number: int) -> Tensor:
            text = self._text.encode([_prompt_at(clip, number * config.frames) for clip in clips])
            return self._guided(Condition(text, past=PastSegment.clean(prefix_BPD)))(x_BnD, t_B)

        seeds = [clip.seed for clip in clips]
        return rollout_chunks(
            denoise, self._schedule, prefix, max(clip.total for clip in clips), seeds, chunk=config.frames
        )

    def _guided(self, condition: Condition) -> Prediction:
        network = cast(Denoiser, self._bundle.module(DENOISER, self._device))
        return guided(network, condition, self._w or None, self._text.encode([""]))

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
