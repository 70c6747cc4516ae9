"""Training the length predictor: cross-entropy on classes of lengths (T2M), by the embeddings of sentences."""

from dataclasses import dataclass, field, replace

import torch
from torch import Tensor
from torch.nn.functional import cross_entropy

from moveset.data.dataset import Dataset, open_for_training
from moveset.data.splits import Split
from moveset.models.length import LengthPredictorConfig
from moveset.training.engine import Loop
from moveset.training.reading import draw_told, embedded
from moveset.training.single_network import NetworkConfig, SingleNetworkTask
from moveset.training.tasks import Sources


@dataclass(frozen=True, kw_only=True)
class LengthConfig(NetworkConfig):
    """What ``LengthTask`` trains and how; the learning rate is a cosine over the run.

    Args:
        model: its ``text_dim`` follows from the text encoder.
    """

    model: LengthPredictorConfig = field(default_factory=LengthPredictorConfig)
    batch: int = 64
    lr: float = 1e-3
    warmup: int = 0
    smoothing: float = 0.05
    text_encoder: str = "minilm"


class LengthTask(SingleNetworkTask):
    """A small classifier of pooled sentence embeddings."""

    name = "length"
    network = "length"

    def __init__(self, config: LengthConfig, sources: Sources, loop: Loop) -> None:
        dataset = open_for_training(sources.corpus)
        loop.learned_from["corpus"] = dataset.fingerprint
        self.train, self.val = _pairs(dataset, "train"), _pairs(dataset, "val")
        captions = [text for texts, _ in self.train + self.val for text in texts]
        with loop.fabric.rank_zero_first():
            self.text = embedded(sources.cache, config.text_encoder, captions, loop.device)
        self.config = config = replace(config, model=replace(config.model, text_dim=self.text.widths[1]))
        self.length = config.model.build().to(loop.device)
        self.optimizer = torch.optim.AdamW(self.length.parameters(), config.lr, weight_decay=0.01)

    def training_step(self, step: int, loop: Loop) -> dict[str, Tensor]:
        captions, frames = draw_told(self.train, self.config.batch, loop.seed, step)
        classes = self.length.classes_of(torch.tensor(frames)).to(loop.device)
        logits = self.length(self.text.pooled_of(captions).float())
        loss = cross_entropy(logits, classes, label_smoothing=self.config.smoothing)
        norm = loop.minimise(loss, "length")
        return {"loss": loss.detach(), "gradient_norm": norm}

    def validate(self, step: int, loop: Loop) -> dict[str, float]:
        """Median error in frames, over captions as they are written, and that of always saying the same."""
        pairs = [(text, frames) for texts, frames in self.val for text in texts]
        made = self.length.predict(self.text.pooled_of([text for text, _ in pairs]).float()).cpu()
        true = torch.tensor([float(frames) for _, frames in pairs])
        constant = torch.tensor([float(frames) for _, frames in self.train]).median()
        return {
            "median_error": float((made - true).abs().median()),
            "constant_error": float((constant - true).abs().median()),
        }


def _pairs(dataset: Dataset, split: Split) -> list[tuple[tuple[str, ...], int]]:
    """Sentences of clips with how many frames these last."""
    clips = [dataset.clip(item) for item in dataset.split(split)]
    return [(clip.captions, clip.frames) for clip in clips]
