"""DiP, a baseline of the recurrent model: a decoder that continues the 20 frames before by 40, ten noise levels each.

Shapes: B rows, m clean frames, n frames to be denoised after them, D features.
Source: CLoSD (Tevet et al. 2024, arXiv 2410.03441), Section 4.1.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor, nn

from moveset.data.batch import Batch
from moveset.data.dataset import Dataset
from moveset.data.feature_store import FeatureStore
from moveset.data.segments import ClipSet, CuttingConfig
from moveset.data.splits import Split
from moveset.data.text_augmentation import TextAugmentation
from moveset.diffusion.schedule import cosine
from moveset.diffusion.steps import add_noise
from moveset.errors import InputError
from moveset.models.condition import Condition, PastSegment
from moveset.models.dip_decoder import DipDecoderConfig
from moveset.motion.features import FeatureCodec
from moveset.rdm.losses import masked_mse
from moveset.text.encoder import TextEmbedding
from moveset.training.condition_dropout import drop_captions
from moveset.training.ema import Ema, ema_warmup
from moveset.training.engine import Loop
from moveset.training.rdm import feature_weights
from moveset.training.segment_data import SegmentData
from moveset.training.single_network import NetworkConfig, SingleNetworkTask
from moveset.training.tasks import Sources


@dataclass(frozen=True, kw_only=True)
class DiPConfig(NetworkConfig):
    """What ``DiPTask`` trains and how.

    Args:
        model: its ``features`` and ``text_dim`` follow from codec and text encoder.
        codec: its features, a name for ``data.dataset.choose_codec``.
        levels: T, noise levels of the cosine schedule and steps of sampling.
        cutting: which clips are shown and what is said to them; where pieces are cut is not up to it.
        constant_lr: no cosine decay.
        condition_dropout: share of captions replaced by "", for guidance.
        standing: share of pieces that are a clip's first frames, after a person who stands: how sampling begins.
        root: weight of the four root features.
    """

    model: DipDecoderConfig = field(default_factory=DipDecoderConfig)
    levels: int = 10
    codec: str = "auto"
    cutting: CuttingConfig = field(default_factory=CuttingConfig)
    batch: int = 64
    lr: float = 1e-4
    warmup: int = 200
    constant_lr: bool = False
    condition_dropout: float = 0.1
    standing: float = 0.0
    ema: float = 0.9999
    root: float = 1.0
    text_encoder: str = "minilm"
    augmentation: TextAugmentation = field(default_factory=TextAugmentation)


@dataclass(frozen=True, eq=False)
class PieceBatch(Batch):
    """Clean frames (B, n, D), those before them (B, m, D), and what is said to them."""

    prefix: Tensor
    clean: Tensor
    captions: list[str]


class PieceSet(ClipSet):
    """Pieces of m + n frames from anywhere in the clips that are as long; other arguments as for ``ClipSet``.

    Args:
        standing: share of pieces whose m frames are the idle pose, and whose n frames are the first of their clip.

    Raises:
        InputError: no clip is as long.
    """

    def __init__(
        self,
        dataset: Dataset,
        split: Split,
        store: FeatureStore,
        codec: FeatureCodec,
        cutting: CuttingConfig,
        model: DipDecoderConfig,
        standing: float = 0.0,
    ) -> None:
        super().__init__(dataset, split, store, codec, cutting)
        self.prefix, self.frames, self.standing = model.prefix, model.frames, standing
        if standing:
            self.idle = idle_pose(dataset, store, codec).expand(self.prefix, -1)
        needed = self.prefix + self.frames
        self.weights = self.weights * torch.tensor([len(row) >= needed for row in self.rows])
        if not self.weights.any():
            raise InputError(f"no clip for {split!r} has {needed} frames; set model.prefix and model.frames to fewer")

    def batch(self, size: int, seed: int, step: int) -> PieceBatch:
        """The batch of a step: a pure function of (seed, step)."""
        pieces, captions = [], []
        for clip, chance in self.draw(size, seed, step):
            stands = chance[1] < self.standing
            room = len(clip) - self.prefix - self.frames
            # First of the n frames.
            start = 0 if stands else self.prefix + int(chance[0] * (room + 1))
            piece = torch.from_numpy(clip.cut(max(start - self.prefix, 0), start + self.frames)).float()
            pieces.append(torch.cat((self.idle, piece)) if stands else piece)
            captions.append(self.say(clip, start, self.frames, chance[3:])[0])
        prefix, clean = torch.stack(pieces).split((self.prefix, self.frames), dim=1)
        return PieceBatch(prefix, clean, captions)


class PieceData(SegmentData):
    """Pieces and embedded captions of both splits."""

    def cut(self, config: DiPConfig, dataset: Dataset, split: Split, store: FeatureStore) -> PieceSet:
        return PieceSet(dataset, split, store, self.codec, config.cutting, config.model, config.standing)


def idle_pose(dataset: Dataset, store: FeatureStore, codec: FeatureCodec) -> Tensor:
    """Normalised features (D,) of standing still: the first frame nearest to the mean of all, at rest.

    Of captures of the training split, no mirror images.
    """
    starts = [store.clips[clip].start for clip in dataset.split("train", composed=False, mirrored=False)]
    first_ND = torch.from_numpy(np.array(store.features[starts], np.float32))
    nearest = first_ND[(first_ND - first_ND.mean(dim=0)).square().sum(dim=1).argmin()]
    pose = store.normalizer.denormalize(nearest)
    for steps in ("root_yaw", "root_velocity", "velocities"):
        pose[codec.groups[steps]] = 0.0
    pose[codec.groups["contacts"]] = 1.0
    return store.normalizer.normalize(pose)


class DiPTask(SingleNetworkTask):
    """One network, which says the clean frames."""

    name = "dip"
    network = "denoiser"

    def __init__(self, config: DiPConfig, sources: Sources, loop: Loop) -> None:
        self.data = PieceData(sources, config, loop)
        sizes = {"features": self.data.codec.dim, "text_dim": self.data.text.widths[0]}
        self.config = config = replace(config, codec=self.data.codec.name, model=replace(config.model, **sizes))
        self.schedule = cosine(config.levels)
        self.denoiser = config.model.build().to(loop.device)
        self.ema = Ema(self.denoiser, config.ema)
        self.draws = loop.generator("draws")
        self.scale = feature_weights(self.data.codec, config.root).sqrt().to(loop.device)
        self.optimizer = torch.optim.AdamW(self.denoiser.parameters(), config.lr, weight_decay=0.0)

    def learning_rates(self, step: int, steps: int) -> dict[str, float]:
        return {"denoiser": self.config.lr} if self.config.constant_lr else super().learning_rates(step, steps)

    def training_step(self, step: int, loop: Loop) -> dict[str, Tensor]:
        config = self.config
        batch = self.data.training_batch(config.batch, step)
        said = drop_captions(batch.captions, config.condition_dropout, self.draws)
        text = self.data.read(said, self.draws)
        loss, error = self._loss(self.denoiser, batch, text, self.draws)
        report = {"loss": loss.detach(), "error": error, "gradient_norm": loop.minimise(loss, "denoiser")}
        self.ema.update(self.denoiser, ema_warmup(step, config.ema))
        return report

    def validate(self, step: int, loop: Loop) -> dict[str, float]:
        """Error of the averaged network on 256 pieces of val."""
        generator, errors = torch.Generator().manual_seed(0), []
        for k in range(2):
            batch = self.data.val.batch(128, 0, k).to(loop.device)
            errors.append(self._loss(self.ema.module, batch, self.data.read(batch.captions), generator)[1])
        return {"error": float(torch.stack(errors).mean())}

    def _loss(
        self, denoiser: nn.Module, batch: PieceBatch, text: TextEmbedding, generator: torch.Generator
    ) -> tuple[Tensor, Tensor]:
        """The weighted error of the clean frames, and the plain one."""
        t_B = torch.randint(1, len(self.schedule), (len(batch.clean),), generator=generator)
        noise = torch.randn(batch.clean.shape, generator=generator).to(batch.clean)
        t_B = t_B.to(batch.clean.device)
        noisy = add_noise(self.schedule, batch.clean, noise, t_B)
        made = denoiser(noisy, t_B, Condition(text, past=PastSegment.clean(batch.prefix))).float()
        valid = torch.ones(batch.clean.shape[:2], device=batch.clean.device)
        loss = masked_mse(made * self.scale, batch.clean * self.scale, valid)
        return loss, masked_mse(made.detach(), batch.clean, valid)
