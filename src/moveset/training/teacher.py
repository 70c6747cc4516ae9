"""Training the teacher: noise prediction in the VAE's latent space, text dropped now and then for guidance."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor, nn

from moveset.data.dataset import open_for_training
from moveset.data.feature_store import FeatureStore
from moveset.data.latents import LatentBatch, LatentSet
from moveset.data.text_augmentation import TextAugmentation
from moveset.diffusion.schedule import scaled_linear
from moveset.diffusion.steps import add_noise
from moveset.models.condition import Condition
from moveset.models.latent_denoiser import LatentDenoiserConfig
from moveset.models.token_denoiser import TokenDenoiserConfig
from moveset.motion.features import get_codec
from moveset.text.encoder import TextEmbedding
from moveset.text.sides import with_sides
from moveset.training.condition_dropout import drop_captions
from moveset.training.ema import Ema, ema_warmup
from moveset.training.engine import Loop
from moveset.training.reading import embedded, read_captions, told_sides
from moveset.training.segment_losses import placed
from moveset.training.single_network import NetworkConfig, SingleNetworkTask
from moveset.training.tasks import Sources
from moveset.training.trained import TrainedNetwork, load_trained, require_learned_from, warn_of_another_corpus

Weight = Literal["eps", "v"]


@dataclass(frozen=True, kw_only=True)
class TeacherConfig(NetworkConfig):
    """What ``TeacherTask`` trains and how; the learning rate is a cosine over the run.

    Args:
        model: its sizes of latents and of text follow from autoencoder and text encoder.
        beta2: of AdamW.
        normalised_latents: latents of mean 0 and deviation 1; False takes them as the encoder gives them, as published.
        sides: share of samples that are told, beside their sentence, which sides the motion favours (``text.sides``).
        weight: of the error in the noise: "eps" (1, as published), or "v" (1 / alpha_t^2: the error in v, arXiv
            2202.00512). What is done, and with which hand, is decided where there is little but noise, and there the
            error in the noise is a hundredth of what it is elsewhere.
    """

    model: LatentDenoiserConfig | TokenDenoiserConfig = field(default_factory=LatentDenoiserConfig)
    batch: int = 128
    lr: float = 8e-4
    warmup: int = 200
    weight_decay: float = 0.0
    beta2: float = 0.99
    normalised_latents: bool = True
    weight: Weight = "eps"
    sides: float = 0.0
    condition_dropout: float = 0.1
    ema: float = 0.999
    text_encoder: str = "minilm"
    augmentation: TextAugmentation = field(default_factory=TextAugmentation)


def normalised_latents(teacher: TrainedNetwork) -> bool:
    """Whether a teacher knows latents of mean 0 and deviation 1; one from before that was a choice does."""
    return bool(teacher.task.get("normalised_latents", True))


class LatentData:
    """Latents and embedded captions of both splits, each made once and kept in the cache folder."""

    def __init__(
        self,
        sources: Sources,
        text_encoder: str,
        augmentation: TextAugmentation,
        loop: Loop,
        normalised: bool,
        teacher: TrainedNetwork | None = None,
    ) -> None:
        self.augmentation = augmentation
        self.seed, self.device = loop.seed, loop.device
        self.vae = vae = load_trained(sources.vae, "vae_ema", loop.device)
        if teacher is not None:
            hint = f"give the --vae that it was trained with, not {vae.path}"
            require_learned_from(teacher, "vae", vae.digest, hint)
        # Whoever comes first makes the caches; the other processes open them.
        with loop.fabric.rank_zero_first():
            self._open(sources, text_encoder, loop)
        if not normalised:
            self.train, self.val = self.train.as_encoded(), self.val.as_encoded()

    def _open(self, sources: Sources, text_encoder: str, loop: Loop) -> None:
        dataset, vae, there = open_for_training(sources.corpus), self.vae, loop.device
        loop.learned_from |= {"corpus": dataset.fingerprint, "vae": vae.digest}
        warn_of_another_corpus([vae], dataset)
        store = FeatureStore.cached(dataset, vae.task["codec"], sources.cache, loop.rank == 0, loop.config.workers)
        self.codec, self.normalizer = get_codec(vae.task["codec"]), store.normalizer
        latents = f"{sources.cache}/latents-{vae.digest[:12]}-{{}}.safetensors"
        self.train = LatentSet.of(dataset, "train", store, vae.module, Path(latents.format("train")), device=there)
        path = Path(latents.format("val"))
        self.val = LatentSet.of(dataset, "val", store, vae.module, path, windows=0, device=there)
        # As the network meets them: latents are normalised by the statistics of training.
        self.val.center, self.val.scale = self.train.center, self.train.scale
        captions = [*self.train.all_captions(), *self.val.all_captions()]
        self.text = embedded(sources.cache, text_encoder, captions, self.device)

    def joints(self, z_BND: Tensor, frames_B: Tensor) -> Tensor:
        """(B, F, J, 3) joints of latents as the networks know them, metres."""
        z_BND = z_BND * self.train.scale.to(z_BND) + self.train.center.to(z_BND)
        features_BFD = self.vae.module.decode(z_BND, frames_B, int(frames_B.max()))
        return placed(features_BFD, self.codec, self.normalizer)

    def batch(self, size: int, step: int) -> LatentBatch:
        """Training latents of a step, on the device."""
        return self.train.batch(size, self.seed, step).to(self.device)

    def read(self, captions: list[str], augmented_by: torch.Generator | None = None) -> TextEmbedding:
        """Token states of captions; "" is the unconditional input. Roughened if given a generator."""
        return read_captions(self.text, captions, self.augmentation, augmented_by)

    def told(self, batch: LatentBatch, captions: list[str], share: float, generator: torch.Generator) -> TextEmbedding:
        """Roughened captions of a batch, and beside ``share`` of them the sides that its motions favour."""
        text = self.read(captions, generator)
        return with_sides(text, told_sides(captions, batch.sides, share, generator)) if share else text


class TeacherTask(SingleNetworkTask):
    """Epsilon prediction on 1000 scaled-linear steps (MotionPCM, Section 4.1; MLD)."""

    name = "teacher"
    network = "teacher"

    def __init__(self, config: TeacherConfig, sources: Sources, loop: Loop) -> None:
        normalised = config.normalised_latents
        self.data = LatentData(sources, config.text_encoder, config.augmentation, loop, normalised)
        _, tokens, token_dim = self.data.train.mean.shape
        model = replace(config.model, token_dim=token_dim, text_dim=self.data.text.widths[0])
        if isinstance(model, LatentDenoiserConfig):
            model = replace(model, tokens=tokens)
        self.config = config = replace(config, model=model)
        self.schedule = scaled_linear()
        self.teacher = config.model.build().to(loop.device)
        self.ema = Ema(self.teacher, config.ema)
        self.noise = loop.generator("noise")
        self.optimizer = torch.optim.AdamW(
            self.teacher.parameters(), config.lr, betas=(0.9, config.beta2), weight_decay=config.weight_decay
        )

    def training_step(self, step: int, loop: Loop) -> dict[str, Tensor]:
        batch = self.data.batch(self.config.batch, step)
        captions = drop_captions(batch.captions, self.config.condition_dropout, self.noise)
        t = torch.randint(1000, (len(captions),), generator=self.noise).to(loop.device)
        text = self.data.told(batch, captions, self.config.sides, self.noise)
        loss = self._loss(self.teacher, batch, text, t, self.noise)
        norm = loop.minimise(loss, "teacher")
        self.ema.update(self.teacher, ema_warmup(step, self.config.ema))
        return {"loss": loss.detach(), "gradient_norm": norm}

    def validate(self, step: int, loop: Loop) -> dict[str, float]:
        generator = torch.Generator().manual_seed(0)
        losses = []
        for k in range(4):
            batch = self.data.val.batch(128, 0, k).to(loop.device)
            t = (torch.arange(128, device=loop.device) * 1000) // 128
            losses.append(self._loss(self.ema.module, batch, self.data.read(batch.captions), t, generator))
        return {"loss": float(torch.stack(losses).mean())}

    def _loss(
        self,
        model: nn.Module,
        batch: LatentBatch,
        text: TextEmbedding,
        t: Tensor,
        generator: torch.Generator,
    ) -> Tensor:
        noise = torch.randn(batch.z0.shape, generator=generator).to(batch.z0)
        noisy = add_noise(self.schedule, batch.z0, noise, t)
        made = model(noisy, t, Condition(text, length=batch.frames))
        error_B = (made.float() - noise).square().mean(dim=(1, 2))
        return (error_B if self.config.weight == "eps" else error_B / self.schedule.alpha(t).square()).mean()
