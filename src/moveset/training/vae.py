"""Training the motion VAE: reconstruction after forward kinematics, a small KL, an averaged copy that ships."""

from dataclasses import dataclass, field
from typing import Protocol, cast

import torch
from torch import Tensor, nn

from moveset.data.corpus import Corpus
from moveset.evaluation.physical import jerk, skating
from moveset.models.registry import describe
from moveset.models.timed_vae import TimedVAEConfig
from moveset.models.token_vae import TokenVAEConfig
from moveset.motion.native import NativeCodec
from moveset.training.clips import Crop, CropSampler, FeatureStore, clip_weights
from moveset.training.ema import Ema, ema_warmup
from moveset.training.engine import Loop, Task
from moveset.training.optim import cosine_lr
from moveset.training.tasks import Sources
from moveset.training.vae_loss import ReconstructionWeights, kl_divergence, position_errors, reconstruction_loss


class MotionVAE(Protocol):
    """What a motion VAE offers, whatever its architecture."""

    def encode(self, x_BFD: Tensor, lengths_B: Tensor) -> tuple[Tensor, Tensor]:
        """Posterior mean and log-variance (B, N, d)."""

    def decode(self, z_BND: Tensor, lengths_B: Tensor, frames: int) -> Tensor:
        """Features (B, frames, D)."""


@dataclass(frozen=True, kw_only=True)
class VAETrainingConfig:
    """What ``VAETask`` trains and how; the learning rate is a cosine over the run."""

    model: TimedVAEConfig | TokenVAEConfig = field(default_factory=TimedVAEConfig)
    weights: ReconstructionWeights = field(default_factory=ReconstructionWeights)
    kl: float = 1e-2
    batch: int = 64
    lr: float = 1e-3
    warmup: int = 100
    weight_decay: float = 0.0
    ema: float = 0.998
    composed_share: float = 0.3
    kind: str = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", describe(self.model)[0])


class VAETask(Task):
    """Trains on crops of 32 to 196 frames of all training clips, composed and mirrored ones included."""

    name = "vae"

    def __init__(self, config: VAETrainingConfig, sources: Sources, loop: Loop) -> None:
        self.config, self.steps = config, loop.config.steps
        corpus = Corpus.open(sources.corpus)
        self.codec = NativeCodec(corpus.skeleton)
        self.store = FeatureStore.of(corpus, self.codec, sources.cache / "features", progress=loop.rank == 0)
        self.vae = config.model.build().to(loop.device)
        self.ema = Ema(self.vae, config.ema)
        self.noise = loop.generator("noise", device=loop.device)
        self.optimizer = torch.optim.AdamW(
            self.vae.parameters(), config.lr, betas=(0.9, 0.99), weight_decay=config.weight_decay
        )
        records = corpus.indices("train")
        weights = clip_weights(corpus, records, power=0.25, composed_share=config.composed_share)
        clips = [2 * record + mirrored for record in records for mirrored in (0, 1)]
        seed = loop.config.seed * 64 + loop.rank
        self.sampler = CropSampler(self.store, clips, weights.repeat_interleave(2), config.batch, seed)
        held_out = [2 * record for record in corpus.indices("val", composed=False)]
        self.held_out = sorted((Crop(c, 0, self.store.clips[c].frames) for c in held_out), key=lambda c: c.frames)

    def modules(self) -> dict[str, nn.Module]:
        return {"vae": self.vae}

    def averages(self) -> dict[str, nn.Module]:
        return {"vae_ema": self.ema.module}

    def optimizers(self) -> dict[str, torch.optim.Optimizer]:
        return {"vae": self.optimizer}

    def learning_rates(self, step: int) -> dict[str, float]:
        return {"vae": cosine_lr(step, self.config.lr, self.config.warmup, self.steps)}

    def training_step(self, step: int, loop: Loop) -> dict[str, Tensor]:
        real, lengths = (x.to(loop.device) for x in self.store.batch(self.sampler.crops(step)))
        mean, log_variance = (x.float() for x in self.vae.encode(real, lengths))
        noise = torch.randn(mean.shape, generator=self.noise, device=loop.device)
        made = self.vae.decode(mean + (0.5 * log_variance).exp() * noise, lengths, real.shape[1])
        with torch.autocast(loop.device.type, enabled=False):
            loss, parts = reconstruction_loss(
                made.float(), real, lengths, self.codec, self.store.normalizer, self.config.weights
            )
            kl = kl_divergence(mean, log_variance)
            norm = loop.minimise(loss + self.config.kl * kl, "vae")
        self.ema.update(self.vae, ema_warmup(step, self.config.ema))
        return {"loss": loss.detach(), "kl": kl.detach(), "gradient_norm": norm} | {
            k: v.detach() for k, v in parts.items()
        }

    def validate(self, step: int, loop: Loop) -> dict[str, float]:
        return reconstruction_report(
            cast(MotionVAE, self.ema.module), self.store, self.held_out, self.codec, loop.device
        )


@torch.no_grad()
def reconstruction_report(
    vae: MotionVAE, store: FeatureStore, crops: list[Crop], codec: NativeCodec, device: torch.device, batch: int = 64
) -> dict[str, float]:
    """Means over clips: position errors in millimetres, jerk (m/s³) and skating of reconstructions and of the originals."""
    rows = []
    for start in range(0, len(crops), batch):
        real, lengths = (x.to(device) for x in store.batch(crops[start : start + batch]))
        made = vae.decode(vae.encode(real, lengths)[0], lengths, real.shape[1])
        aligned, unaligned = position_errors(made, real, lengths, codec, store.normalizer)
        columns = {"mpjpe_mm": aligned, "mpjpe_unaligned_mm": unaligned}
        for name, features in (("", made), ("real_", real)):
            joints = codec.joints(store.normalizer.denormalize(features))
            columns[f"{name}jerk"] = jerk(joints, codec.fps, lengths)
            columns[f"{name}skating"] = skating(joints, codec.fps, lengths)
        rows.append(columns)
    return {name: float(torch.cat([row[name] for row in rows]).mean()) for name in rows[0]}
