"""``TextToMotion``: sentences in, motions out, in one to four evaluations of a small network.

Shapes: B rows (one clip each), N latent tokens, d numbers in each, F frames, D features.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from typing import cast

import torch
from torch import Tensor, nn

from moveset import __version__
from moveset.errors import InputError
from moveset.models.length import LengthPredictor
from moveset.motion.clip import Motion
from moveset.motion.features import get_codec
from moveset.pcm.sampler import item_noise
from moveset.pipelines.denoise import Denoise
from moveset.pipelines.device import Stopwatch, one_thread, pick_device
from moveset.pipelines.model_config import DEFAULT_MODEL, ClipConfig
from moveset.pipelines.model_folder import ModelFolder
from moveset.pipelines.postprocess import assembled
from moveset.pipelines.request import Method, Request, check_method, check_request, check_whole
from moveset.pipelines.warnings import too_long, unfamiliar
from moveset.text.encoder import TextEmbedding, TextEncoder, get_text_encoder, stack


@dataclass(frozen=True, eq=False)
class Generation:
    """What was made, and how.

    Args:
        motions: one a variant.
        raw: the same before foot locking.
        prompts: in order of time.
        seed: of the first variant; variant k has ``seed + k``.
        seconds: duration of the first motion.
        network_evaluations: of the denoiser, for one variant; guidance by two evaluations counts both.
        timings_ms: "text", "sample", "decode" and "finish" (joining and foot locking), for all variants together.
        warnings: what the user should know about the prompts.
        starts: frame of the first motion with which each prompt begins.
    """

    motions: tuple[Motion, ...]
    raw: tuple[Motion, ...]
    prompts: tuple[str, ...]
    model: str
    seed: int
    steps: int
    guidance: float
    seconds: float
    network_evaluations: int
    timings_ms: Mapping[str, float]
    warnings: tuple[str, ...] = ()
    starts: tuple[int, ...] = ()

    @property
    def motion(self) -> Motion:
        """The first variant."""
        return self.motions[0]

    @property
    def metadata(self) -> dict[str, str | int | float]:
        """What a file should tell about how it was made; for ``moveset.save(…, metadata=…)``."""
        notes = {
            "generator": f"moveset {__version__}",
            "model": self.model,
            "prompt": " | ".join(self.prompts),
            "seed": self.seed,
            "steps": self.steps,
            "guidance": self.guidance,
        }
        if len(self.prompts) > 1:
            # In seconds, which stay true at any frame rate.
            notes["starts"] = " | ".join(f"{start / self.motion.fps:g}" for start in self.starts)
        return notes


class TextToMotion:
    """A text-to-motion model, ready to call.

    >>> from moveset import TextToMotion
    >>> t2m = TextToMotion.from_pretrained()  # doctest: +SKIP
    >>> t2m("a person waves with the left hand", seconds=4.0, seed=7).motion.save("wave.glb")  # doctest: +SKIP
    """

    def __init__(self, bundle: ModelFolder[ClipConfig], device: torch.device | str = "auto") -> None:
        self.bundle = bundle
        self.device = pick_device(str(device))

    @classmethod
    def from_pretrained(
        cls, name_or_path: str | Path = DEFAULT_MODEL, *, device: torch.device | str = "auto"
    ) -> "TextToMotion":
        """A shipped model by name, or a model folder. Weights are read when they are first needed.

        Raises:
            InputError: no such model, or no such device.
            FormatError: a damaged model folder.
        """
        return cls(ModelFolder.open(name_or_path, ClipConfig), device)

    def __call__(
        self,
        prompt: str | Sequence[str],
        *,
        seconds: float | Sequence[float] | None = None,
        steps: int | None = None,
        guidance: float | None = None,
        seed: int = 0,
        num: int = 1,
        solver: str = "pcm",
        foot_lock: bool = True,
        batch: int = 1,
    ) -> Generation:
        """Make ``num`` variants of a motion.

        Args:
            prompt: a sentence, or several: the clips follow one another without a pop.
            seconds: of each clip, one for all or one a prompt; None predicts them from the text.
            steps: sampling steps; None takes the fewest the model has a student for (50 for the teacher).
            guidance: scale w; None takes the model's choice.
            seed: of variant 0. Variant k has ``seed + k``, so it equals variant 0 of that seed.
            num: variants.
            solver: "pcm", "lcm" or "teacher".
            foot_lock: hold planted feet in place.
            batch: clips a network evaluates at once. With 1 a clip never depends on its neighbours, not even in the
                last bit; more is faster on a GPU.

        Raises:
            InputError: anything out of range; nothing has been computed then.
        """
        requests = check_request(self.bundle.config, prompt, seconds, seed, num)
        method = check_method(self.bundle.config, solver, steps, guidance)
        variants = self.generate(requests, method, foot_lock=foot_lock, batch=batch)
        return replace(
            variants[0],
            motions=tuple(variant.motion for variant in variants),
            raw=tuple(variant.raw[0] for variant in variants),
        )

    @torch.inference_mode()
    def generate(
        self,
        requests: Sequence[Request],
        method: Method,
        *,
        foot_lock: bool = True,
        batch: int = 1,
        between: Callable[[float], None] | None = None,
    ) -> tuple[Generation, ...]:
        """One ``Generation`` for every request, whatever their prompts and lengths; their timings are those of all.

        One clip at a time is computed with one thread (``device.one_thread``), batches with as many as torch has.
        ``between`` is called before every evaluation of a network, with the share of the work that is done; what it
        raises ends the work.
        """
        batch = check_whole("batch", batch)
        if batch < 1:
            raise InputError(f"batch {batch} is not at least 1; give 1 unless there is a GPU")
        if not requests:
            return ()
        with one_thread() if batch == 1 else nullcontext():
            return self._generate(requests, method, foot_lock, batch, between)

    def _generate(
        self,
        requests: Sequence[Request],
        method: Method,
        foot_lock: bool,
        batch: int,
        between: Callable[[float], None] | None,
    ) -> tuple[Generation, ...]:
        rows = [slice(k, k + batch) for k in range(0, sum(len(r.prompts) for r in requests), batch)]
        done = 0

        def pause() -> None:
            if between is not None:
                between(done / (2 * len(rows)))

        denoise = Denoise(self.bundle, self.encoder, method, self.device, pause)
        vae = self.bundle.module("vae", self.device)
        if any(frames is None for request in requests for frames in request.frames):
            self.bundle.module("length", self.device)
        self.bundle.captions  # noqa: B018  (read here, so that no file is read on the clock)
        clock = Stopwatch(self.device)

        prompts = [prompt for request in requests for prompt in request.prompts]
        known = {prompt: self.encoder.encode([prompt]) for prompt in dict.fromkeys(prompts)}
        frames = [n for request in requests for n in self._frames(request, known)]
        warnings = {request.prompts: self._warnings(request.prompts, known) for request in requests}
        clock.lap("text")

        # The clips of a timeline take one after the other from their motion's seed; after them LCM's later steps do.
        steps = method.steps if method.solver == "lcm" else 1
        drawn = [item_noise([r.seed], (steps * len(r.prompts), *self.bundle.config.latent))[0] for r in requests]
        noise, *later = (torch.cat(step) for step in zip(*(x.chunk(steps) for x in drawn), strict=True))
        latents = []
        for part in rows:
            text = stack([known[p] for p in prompts[part]])
            latents.append(denoise(noise[part], text, frames[part], [z[part] for z in later]))
            done += 1
        clock.lap("sample")

        decoded = []
        for z, part in zip(latents, rows, strict=True):
            pause()
            decoded.append(self._decode(vae, z, frames[part]))
            done += 1
        clips = iter([clip for batch_of_clips in decoded for clip in batch_of_clips])
        clock.lap("decode")

        takes = [[next(clips) for _ in request.prompts] for request in requests]
        made = [assembled(take, foot_lock) for take in takes]
        clock.lap("finish")
        return tuple(
            Generation(
                motions=(motion,),
                raw=(raw,),
                prompts=request.prompts,
                model=self.bundle.config.name,
                seed=request.seed,
                steps=method.steps,
                guidance=method.guidance,
                seconds=motion.seconds,
                network_evaluations=denoise.evaluations // len(prompts) * len(request.prompts),
                timings_ms=clock.laps,
                warnings=warnings[request.prompts],
                starts=tuple(accumulate((len(motion) for motion, _ in takes[k][:-1]), initial=0)),
            )
            for k, (request, (raw, motion)) in enumerate(zip(requests, made, strict=True))
        )

    @cached_property
    def encoder(self) -> TextEncoder:
        """The text encoder that the model was trained with."""
        return get_text_encoder(self.bundle.config.text_encoder, device=self.device)

    def _frames(self, request: Request, known: Mapping[str, TextEmbedding]) -> list[int]:
        """Frames of each clip: as asked for, or as predicted from the text."""
        config = self.bundle.config
        frames = []
        for prompt, wanted in zip(request.prompts, request.frames, strict=True):
            if wanted is None:
                predictor = cast(LengthPredictor, self.bundle.module("length", self.device))
                likely = int(predictor.predict(known[prompt].pooled.to(self.device)))
                wanted = min(max(likely, config.min_frames), config.max_frames)
            frames.append(wanted)
        return frames

    def _warnings(self, prompts: tuple[str, ...], known: Mapping[str, TextEmbedding]) -> tuple[str, ...]:
        pooled = torch.cat([known[prompt].pooled for prompt in prompts])
        return (*too_long(self.encoder, prompts), *unfamiliar(self.bundle, prompts, pooled))

    def _decode(self, vae: nn.Module, z_BND: Tensor, frames: Sequence[int]) -> list[tuple[Motion, Tensor]]:
        """Motions of ``frames[k]`` frames of normalised latents (B, N, d), and their planted feet (F, 4)."""
        n = {name: value.to(self.device) for name, value in self.bundle.normalizer.items()}
        lengths = torch.tensor(frames, device=self.device)
        x_BFD = vae.decode(torch.addcmul(n["latent_mean"], z_BND, n["latent_std"]), lengths, max(frames))
        x_BFD = torch.addcmul(n["feature_mean"], x_BFD, n["feature_std"]).cpu()
        codec = get_codec(self.bundle.config.codec)
        clips = [x[:length] for x, length in zip(x_BFD, frames, strict=True)]
        return [(codec.decode(x), codec.planted(x)) for x in clips]
