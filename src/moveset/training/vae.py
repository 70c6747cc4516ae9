"""Training the motion VAE: reconstruction after forward kinematics, a small KL, an averaged copy that ships."""

from dataclasses import dataclass, field, replace
from typing import Any, Literal, cast

import torch
from torch import Tensor

from moveset.data.crops import CropSampler
from moveset.data.dataset import choose_codec, open_for_training
from moveset.data.feature_store import Crop, FeatureStore
from moveset.errors import InputError
from moveset.models.timed_vae import TimedVAEConfig
from moveset.models.token_vae import TokenVAEConfig
from moveset.motion.features import FeatureCodec
from moveset.motion.measures import jerk, skating
from moveset.motion.native import NativeCodec
from moveset.training.ema import Ema, ema_warmup
from moveset.training.engine import Loop
from moveset.training.segment_losses import placed
from moveset.training.single_network import NetworkConfig, SingleNetworkTask
from moveset.training.tasks import Sources
from moveset.training.trained import load_trained
from moveset.training.vae_loss import (
    ReconstructionWeights,
    kl_divergence,
    position_errors,
    published_loss,
    reconstruction_loss,
)


@dataclass(frozen=True, kw_only=True)
class VAETrainingConfig(NetworkConfig):
    """What ``VAETask`` and ``DecoderTask`` train and how; the learning rate is a cosine over the run.

    Args:
        balance: contents are drawn by their count to the power of one minus this.
        loss: what a reconstruction is judged by: after forward kinematics ("kinematic", of native features only), or
            as published; "auto" is kinematic where it can be.
        beta2: of AdamW.
        codec: its features, a name for ``data.dataset.choose_codec``; how many there are the model is told.
        latent_noise: ``DecoderTask`` only: the most noise added to a latent, in standard deviations of the latents.
    """

    model: TimedVAEConfig | TokenVAEConfig = field(default_factory=TimedVAEConfig)
    weights: ReconstructionWeights = field(default_factory=ReconstructionWeights)
    kl: float = 1e-2
    batch: int = 64
    lr: float = 1e-3
    warmup: int = 100
    weight_decay: float = 0.0
    beta2: float = 0.99
    ema: float = 0.998
    composed_share: float = 0.3
    balance: float = 0.25
    latent_noise: float = 0.0
    codec: str = "auto"
    loss: Literal["auto", "kinematic", "published"] = "auto"


class VAETask(SingleNetworkTask):
    """Trains on crops of 32 to 196 frames of all training clips, composed and mirrored ones included.

    Raises:
        InputError: a loss that the features have no use for.
    """

    name = "vae"
    network = "vae"

    def __init__(self, config: VAETrainingConfig, sources: Sources, loop: Loop) -> None:
        dataset = open_for_training(sources.corpus)
        loop.learned_from["corpus"] = dataset.fingerprint
        self.codec = codec = choose_codec(dataset, config.codec)
        native = codec.name == "native"
        loss = ("kinematic" if native else "published") if config.loss == "auto" else config.loss
        # Not a check of the configuration: settings come one by one, in any order.
        if loss == "kinematic" and not native:
            raise InputError(f"loss=kinematic is for native features, not for {codec.name!r} ones; set loss=published")
        model = replace(config.model, features=codec.dim)
        self.config = config = replace(config, codec=codec.name, loss=loss, model=model)
        # Whoever comes first makes the cache; the other processes open it.
        with loop.fabric.rank_zero_first():
            workers = loop.config.workers
            self.store = FeatureStore.cached(dataset, config.codec, sources.cache, loop.rank == 0, workers)
        self.store.to(loop.device)
        self.vae = config.model.build().to(loop.device)
        self.ema = Ema(self.vae, config.ema)
        self.noise = loop.generator("noise", device=loop.device)
        self.optimizer = torch.optim.AdamW(
            self.vae.parameters(), config.lr, betas=(0.9, config.beta2), weight_decay=config.weight_decay
        )
        clips = dataset.split("train", untold=True)
        weights = dataset.weights(clips, power=config.balance, composed_share=config.composed_share)
        self.sampler = CropSampler(self.store, clips, weights, config.batch, loop.seed)
        val = dataset.split("val", composed=False, mirrored=False, untold=True)
        held_out = (self.store.whole(clip) for clip in val)
        self.held_out = sorted(held_out, key=lambda crop: crop.frames)

    def training_step(self, step: int, loop: Loop) -> dict[str, Tensor]:
        real, lengths = (x.to(loop.device) for x in self.store.batch(self.sampler.crops(step)))
        mean, log_variance = (x.float() for x in self.vae.encode(real, lengths))
        noise = torch.randn(mean.shape, generator=self.noise, device=loop.device)
        made = self.vae.decode(mean + self._spread(log_variance) * noise, lengths, real.shape[1])
        with torch.autocast(loop.device.type, enabled=False):
            loss, parts = self._loss(made.float(), real, lengths)
            kl = kl_divergence(mean, log_variance)
            norm = loop.minimise(loss + self.config.kl * kl, "vae")
        self.ema.update(self.vae, ema_warmup(step, self.config.ema))
        return {"loss": loss.detach(), "kl": kl.detach(), "gradient_norm": norm} | {
            k: v.detach() for k, v in parts.items()
        }

    def _loss(self, made: Tensor, real: Tensor, lengths: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        if self.config.loss == "published":
            return published_loss(made, real, lengths, self.codec, self.store.normalizer)
        codec = cast(NativeCodec, self.codec)
        return reconstruction_loss(made, real, lengths, codec, self.store.normalizer, self.config.weights)

    def _spread(self, log_variance: Tensor) -> Tensor:
        """Standard deviation of the latents that the decoder learns from."""
        return (0.5 * log_variance).exp()

    def validate(self, step: int, loop: Loop) -> dict[str, float]:
        return reconstruction_report(self.ema.module, self.store, self.held_out, self.codec, loop.device)


class DecoderTask(VAETask):
    """Goes on with the decoder of a trained VAE while its encoder, and so every latent made with it, stays as it is.

    The decoder meets two kinds of latents: those of the encoder, and those of a denoiser, which are a little off. Noise
    of a random size up to ``latent_noise`` prepares it for the second kind; undisturbed latents stay in the mix. Sizes
    and codec are those of the trained VAE, whatever the configuration says.

    Raises:
        InputError: a VAE of another kind than the timed one.
    """

    name = "decoder"

    def __init__(self, config: VAETrainingConfig, sources: Sources, loop: Loop) -> None:
        found = load_trained(sources.vae, "vae_ema", loop.device)
        loop.learned_from["vae"] = found.digest
        if not isinstance(found.module.config, TimedVAEConfig):
            raise InputError(f"{found.path} holds a {found.kind}; only the decoder of a timed_vae can be trained on")
        super().__init__(replace(config, model=found.module.config, codec=found.task["codec"]), sources, loop)
        self.vae.load_state_dict(found.module.state_dict())
        self.ema = Ema(self.vae, config.ema)
        parts = (self.vae.patch_in, self.vae.length_in, self.vae.encoder, self.vae.merge, self.vae.encoder_mixer)
        for part in (*parts, self.vae.norm_latent, self.vae.to_latent):
            part.requires_grad_(False)
        given = [name for name, parameter in self.vae.named_parameters() if not parameter.requires_grad]
        self._given = {name: found.module.state_dict()[name] for name in given}
        learning = [p for p in self.vae.parameters() if p.requires_grad]
        betas = (0.9, config.beta2)
        self.optimizer = torch.optim.AdamW(learning, config.lr, betas=betas, weight_decay=config.weight_decay)
        with torch.no_grad():
            crops = self.sampler.crops(0)
            mean, _ = self.vae.encode(*(x.to(loop.device) for x in self.store.batch(crops)))
        self.scale = mean.std(dim=0)

    def take_given(self) -> None:
        """The encoder is that of ``--vae``, whatever decoder it goes on from."""
        for module in (self.vae, self.ema.module):
            module.load_state_dict(self._given, strict=False)

    def _spread(self, log_variance: Tensor) -> Tensor:
        size = torch.rand((len(log_variance), 1, 1), generator=self.noise, device=self.noise.device)
        added = self.config.latent_noise * self.scale * (2 * size - 1).clamp_min(0.0).to(log_variance.device)
        return (log_variance.exp() + added.square()).sqrt()


@torch.no_grad()
def reconstruction_report(
    vae: Any, store: FeatureStore, crops: list[Crop], codec: FeatureCodec, device: torch.device, batch: int = 64
) -> dict[str, float]:
    """Means over clips: position errors (mm), jerk (m/s³) and skating of reconstructions and of the originals."""
    rows = []
    for start in range(0, len(crops), batch):
        real, lengths = (x.to(device) for x in store.batch(crops[start : start + batch]))
        made = vae.decode(vae.encode(real, lengths)[0], lengths, real.shape[1])
        made, real = (placed(features, codec, store.normalizer) for features in (made, real))
        aligned, unaligned = position_errors(made, real, lengths)
        columns = {"mpjpe_mm": aligned, "mpjpe_unaligned_mm": unaligned}
        for name, joints in (("", made), ("real_", real)):
            clips = [x[:frames] for x, frames in zip(joints, lengths.tolist(), strict=True)]
            columns[f"{name}jerk"] = torch.stack([jerk(clip, codec.fps) for clip in clips])
            columns[f"{name}skating"] = torch.stack([skating(clip, codec.fps, codec.skeleton) for clip in clips])
        rows.append(columns)
    return {name: float(torch.cat([row[name] for row in rows]).mean()) for name in rows[0]}
