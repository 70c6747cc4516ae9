"""Training the evaluator: a movement autoencoder, then a common space of sentences and motions by contrast.

T2M's recipe (Guo et al. 2022) without its slips: a "negative" is never the positive, nor another motion that shows just
what the sentence says; validation is in evaluation mode on the validation split; the statistics that features are
normalised by, root and contacts weighing ``feat_bias`` times more, are part of the weights.

Shapes: B batch, F frames, D features, E width of the common space.
"""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, TypeVar, cast

import torch
from torch import Tensor
from torch.nn import functional as fn

from moveset.data.crops import CropSampler
from moveset.data.dataset import Dataset, choose_codec, open_for_training
from moveset.data.feature_store import Crop, FeatureStore
from moveset.data.glove_files import read_glove
from moveset.errors import InputError
from moveset.models.evaluator import FRAMES_PER_TOKEN, EvaluatorConfig, MatchingEvaluator, MovementConfig
from moveset.models.registry import require_range
from moveset.motion.features import Normalizer, get_codec
from moveset.text.glove import GloveWords
from moveset.text.words import as_words
from moveset.training.ema import Ema, ema_warmup
from moveset.training.engine import Loop
from moveset.training.reading import embedded
from moveset.training.single_network import NetworkConfig, SingleNetworkTask
from moveset.training.tasks import Sources
from moveset.training.trained import load_trained

Option = TypeVar("Option")


@dataclass(frozen=True, kw_only=True)
class MovementTrainingConfig(NetworkConfig):
    """What ``MovementTask`` trains and how.

    Args:
        window: frames of a training window, a multiple of four.
        small, smooth: weights of the tokens' size and of their change from one to the next.
        feat_bias: how much more root and contacts weigh (T2M: 5 by intention, 25 in its checkpoints).
        codec: its features, a name for ``data.dataset.choose_codec``.
    """

    model: MovementConfig = field(default_factory=MovementConfig)
    window: int = 24
    batch: int = 128
    lr: float = 1e-4
    warmup: int = 0
    small: float = 1e-3
    smooth: float = 1e-3
    feat_bias: float = 5.0
    codec: str = "published"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_range("window modulo 4", self.window % FRAMES_PER_TOKEN, 0, 0)


@dataclass(frozen=True, kw_only=True)
class EvaluatorTrainingConfig(NetworkConfig):
    """What ``EvaluatorTask`` trains and how.

    Args:
        model: its sizes of the movement encoder follow from that.
        margin: distance beyond which a negative pair is left alone.
        negatives: "roll": one motion of the batch for each sentence, as published. "all": all that may serve.
        ema: decay of the averaged copy that ships; 0 for none.
        words: whose token states are a sentence's words: a text encoder; or "glove:PATH", a table of word vectors
            (``data.glove_files``) for captions with parts of speech.
        max_words: of a text encoder's tokens, the first ones.
        blurred: train behind the movement encoder's own dropout, as it was trained; T2M keeps it out, so that nothing
            hides what is to be told apart, which of few clips is learned by heart.
        noise: deviation of what is added to normalised features.
        feat_bias, codec: those of the movement encoder; filled in from it.
    """

    model: EvaluatorConfig = field(default_factory=EvaluatorConfig)
    margin: float = 10.0
    negatives: Literal["roll", "all"] = "roll"
    batch: int = 32
    lr: float = 1e-4
    warmup: int = 0
    ema: float = 0.999
    words: str = "minilm"
    max_words: int = 32
    blurred: bool = False
    noise: float = 0.0
    feat_bias: float = 5.0
    codec: str = "hml"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_range("batch", self.batch, 2, 65536)  # others are what a sentence is told apart from


class MovementTask(SingleNetworkTask):
    """The movement autoencoder: L1 on windows, tokens kept small and smooth."""

    name = "movement"
    network = "movement"

    def __init__(self, config: MovementTrainingConfig, sources: Sources, loop: Loop) -> None:
        dataset = open_for_training(sources.corpus)
        loop.learned_from["corpus"] = dataset.fingerprint
        codec = choose_codec(dataset, config.codec)
        self.config = config = replace(config, codec=codec.name, model=replace(config.model, features=codec.dim))
        self.store = _features(dataset, config.codec, sources.cache, loop)
        self.scale = _emphasis(self.store.normalizer, config.codec, config.feat_bias).to(loop.device)
        self.movement = config.model.build().to(loop.device)
        # Betas are Adam's own; T2M gives none.
        self.optimizer = torch.optim.Adam(self.movement.parameters(), config.lr)
        self.train_clips, self.val_clips = (
            [clip for clip in dataset.split(split) if self.store.clips[clip].frames >= config.window]
            for split in ("train", "val")
        )
        if not (self.train_clips and self.val_clips):
            raise InputError(f"no clip of one split has {config.window} frames; set window to fewer")

    def training_step(self, step: int, loop: Loop) -> dict[str, Tensor]:
        loss, parts = self._loss(self._windows(self.train_clips, loop.seed * 1_000_003 + step).to(loop.device))
        norm = loop.minimise(loss, "movement")
        return {"loss": loss.detach(), "gradient_norm": norm} | {k: v.detach() for k, v in parts.items()}

    def validate(self, step: int, loop: Loop) -> dict[str, float]:
        batches = [self._windows(self.val_clips, k).to(loop.device) for k in range(4)]
        return {"reconstruction": sum(float(self._loss(batch)[1]["reconstruction"]) for batch in batches) / 4}

    def _windows(self, clips: Sequence[int], seed: int) -> Tensor:
        generator, window = torch.Generator().manual_seed(seed), self.config.window
        # Every frame has the same chance, as if all windows of all clips were listed.
        places = torch.tensor([self.store.clips[clip].frames - window + 1 for clip in clips], dtype=torch.float64)
        drawn = torch.multinomial(places, self.config.batch, replacement=True, generator=generator)
        at = (torch.rand(len(drawn), generator=generator, dtype=torch.float64) * places[drawn]).long()
        crops = [Crop(clips[k], start, window) for k, start in zip(drawn.tolist(), at.tolist(), strict=True)]
        return self.store.batch(crops)[0]

    def _loss(self, x_BFD: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        x_BFD = x_BFD * self.scale
        made_BFD, tokens_BTC = (made.float() for made in self.movement(x_BFD))
        parts = {
            "reconstruction": fn.l1_loss(made_BFD, x_BFD),
            "size": tokens_BTC.abs().mean(),
            "change": fn.l1_loss(tokens_BTC[:, 1:], tokens_BTC[:, :-1]),
        }
        loss = parts["reconstruction"] + self.config.small * parts["size"] + self.config.smooth * parts["change"]
        return loss, parts


class EvaluatorTask(SingleNetworkTask):
    """Sentences and motions to one space; the movement encoder is given (``Sources.teacher``) and frozen."""

    name = "evaluator"
    network = "evaluator"

    def __init__(self, config: EvaluatorTrainingConfig, sources: Sources, loop: Loop) -> None:
        movement = load_trained(sources.teacher, "movement")
        codec, sizes = movement.task["codec"], movement.module.config
        model = replace(config.model, features=sizes.features, movement_width=sizes.width, movement_latent=sizes.latent)
        self.config = config = replace(config, codec=codec, feat_bias=movement.task["feat_bias"], model=model)
        self.dataset = open_for_training(sources.corpus)
        loop.learned_from |= {"corpus": self.dataset.fingerprint, "teacher": movement.digest}
        self.store = _features(self.dataset, config.codec, sources.cache, loop)
        self.scale = _emphasis(self.store.normalizer, config.codec, config.feat_bias).to(loop.device)
        self.evaluator: MatchingEvaluator = config.model.build().to(loop.device)
        self.evaluator.movement.requires_grad_(False)
        self.encoder = movement.module.encoder.state_dict()
        self.ema = Ema(self.evaluator, config.ema)
        self.take_given()
        trained = [parameter for parameter in self.evaluator.parameters() if parameter.requires_grad]
        self.optimizer = torch.optim.Adam(trained, config.lr)
        train, self.val = self.dataset.split("train"), self.dataset.split("val")
        weights = self.dataset.weights(train, power=0.25, composed_share=0.4)
        # Whole clips, or for those that may be divided most of them: a shorter window may miss what its sentence says.
        self.sampler = CropSampler(self.store, train, weights, config.batch, loop.seed, whole=0.5, shortest=(0.7, 24))
        with loop.fabric.rank_zero_first():
            self.read = reader(config, self.dataset, (*train, *self.val), sources.cache)
        words = self.read(train[:1], [0.0])[0].shape[-1]
        if words != config.model.word_width:
            raise InputError(f"words of {config.words!r} are {words} numbers; set model.word_width={words}")

    def take_given(self) -> None:
        """The movement encoder of ``Sources.teacher`` and the statistics of these features."""
        for network in (self.evaluator, cast(MatchingEvaluator, self.ema.module)):
            network.movement.load_state_dict(self.encoder)
            network.mean.copy_(self.store.normalizer.mean)
            network.std.copy_(self.store.normalizer.std / self.scale.cpu())

    def training_step(self, step: int, loop: Loop) -> dict[str, Tensor]:
        self.evaluator.movement.train(self.config.blurred)
        generator = torch.Generator().manual_seed(loop.seed * 1_000_003 + step)
        crops = [
            crop if self.dataset.clip(crop.clip).croppable else self.store.whole(crop.clip)
            for crop in self.sampler.crops(step)
        ]
        motion, text, labels = self._embed(self.evaluator, crops, generator, loop, self.config.noise)
        shift = int(torch.randint(1, len(crops), (), generator=generator)) if self.config.negatives == "roll" else None
        loss, right = contrast(text, motion, labels, self.config.margin, shift)
        norm = loop.minimise(loss, "evaluator")
        self.ema.update(self.evaluator, ema_warmup(step, self.config.ema))
        return {"loss": loss.detach(), "nearest": right.detach(), "gradient_norm": norm}

    def validate(self, step: int, loop: Loop) -> dict[str, float]:
        order = sorted(self.val, key=lambda clip: self.store.clips[clip].frames)
        losses, rights = [], []
        # Interleaved, so that a group holds short and long clips alike: length must not give the answer away.
        for k in range(groups := max(1, len(order) // 32)):
            crops, generator = [self.store.whole(c) for c in order[k::groups]], torch.Generator().manual_seed(k)
            motion, text, labels = self._embed(self.ema.module, crops, generator, loop)
            loss, right = contrast(text, motion, labels, self.config.margin, None)
            losses.append(float(loss))
            rights.append(float(right))
        return {"loss": sum(losses) / len(losses), "nearest": sum(rights) / len(rights)}

    def _embed(
        self,
        network: MatchingEvaluator,
        crops: Sequence[Crop],
        generator: torch.Generator,
        loop: Loop,
        noise: float = 0.0,
    ) -> tuple[Tensor, Tensor, list[Hashable]]:
        features, lengths = (x.to(loop.device) for x in self.store.batch(crops))
        if noise:
            added = torch.randn(features.shape, generator=generator).to(loop.device) * noise
            features = features + added * (features != 0).any(-1, keepdim=True)  # padding stays zero
        pick = torch.rand(len(crops), generator=generator).tolist()
        words, classes, counts = self.read([crop.clip for crop in crops], pick)
        words, classes = words.to(loop.device), None if classes is None else classes.to(loop.device)
        motion = network.embed_motion(features * self.scale, lengths).float()
        said = network.embed_text(words, classes, counts).float()
        return motion, said, [self.dataset.clip(crop.clip).group for crop in crops]


#: Words, classes of speech or None, and lengths of one sentence for each clip, which a share in [0, 1) picks.
Reader = Callable[[Sequence[int], Sequence[float]], tuple[Tensor, Tensor | None, Tensor]]


def reader(config: EvaluatorTrainingConfig, dataset: Dataset, clips: Sequence[int], cache: Path) -> Reader:
    """How sentences of these clips are read in training: token states from a cache, or words from a table.

    Raises:
        InputError: a table, and captions without parts of speech.
    """
    kind, _, path = config.words.partition(":")
    if kind == "glove":
        if not all(dataset.clip(clip).tagged for clip in clips):
            raise InputError(
                f"{config.words!r}: a corpus' captions have no parts of speech, which a table of words needs; train "
                "on a HumanML3D or KIT-ML folder, or with a text encoder's words"
            )
        table = GloveWords(*read_glove(Path(path)))

        def read_words(clips: Sequence[int], pick: Sequence[float]) -> tuple[Tensor, Tensor | None, Tensor]:
            return table.read(
                [_picked(dataset.clip(clip).tagged, share) for clip, share in zip(clips, pick, strict=True)]
            )

        return read_words

    said = sorted({text for clip in clips for text in dataset.clip(clip).captions})
    text = embedded(cache, config.words, said)

    def read_tokens(clips: Sequence[int], pick: Sequence[float]) -> tuple[Tensor, Tensor | None, Tensor]:
        captions = [_picked(dataset.clip(clip).captions, share) for clip, share in zip(clips, pick, strict=True)]
        return as_words(text.lookup(captions, config.max_words), config.max_words)

    return read_tokens


def _picked(options: Sequence[Option], share: float) -> Option:
    return options[int(share * len(options))]


def contrast(
    text_BE: Tensor, motion_BE: Tensor, labels: Sequence[Hashable], margin: float, shift: int | None
) -> tuple[Tensor, Tensor]:
    """(loss, share of sentences whose own motion is nearest): mean d² of pairs + mean max(0, margin - d)² of others.

    Args:
        text_BE, motion_BE: row k of one belongs to row k of the other.
        labels: what each pair shows; other pairs of the same label are no negatives.
        margin: distance at which a negative is far enough.
        shift: negatives are the motions rolled by this many rows; None takes all of the batch.

    Source: motionpcm.md 6.2; Hadsell et al. 2006, Eq. 4.
    """
    distance_BB = torch.cdist(text_BE, motion_BE, compute_mode="donot_use_mm_for_euclid_dist")
    names = {label: k for k, label in enumerate(dict.fromkeys(labels))}
    number = torch.tensor([names[label] for label in labels], device=text_BE.device)
    other_BB = number[:, None] != number
    used_BB = other_BB
    if shift is not None:
        used_BB = other_BB & torch.eye(len(labels), dtype=torch.bool, device=text_BE.device).roll(shift, 1)
    lacking = (margin - distance_BB).clamp_min(0).square()
    negative = lacking[used_BB].mean() if used_BB.any() else lacking.new_zeros(())
    own = distance_BB.diagonal()
    right = own < distance_BB.masked_fill(~other_BB, torch.inf).amin(1)
    return own.square().mean() + negative, right.float().mean()


def _features(dataset: Dataset, codec: str, cache: Path, loop: Loop) -> FeatureStore:
    # Whoever comes first makes the cache; the other processes open it.
    with loop.fabric.rank_zero_first():
        found = FeatureStore.cached(dataset, codec, cache, loop.rank == 0, loop.config.workers)
    return found.to(loop.device)


def _emphasis(normalizer: Normalizer, codec: str, feat_bias: float) -> Tensor:
    """(D,) by which features normalised without bias are to be multiplied."""
    return normalizer.std / normalizer.biased(get_codec(codec).groups, feat_bias).std
