"""Training the side predictor: cross-entropy on the sides that motions favour, by the token states of sentences."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor
from torch.nn.functional import cross_entropy

from moveset.data.captions import mirror_text
from moveset.data.dataset import Dataset, choose_codec, open_for_training
from moveset.data.feature_store import FeatureStore
from moveset.data.splits import Split
from moveset.models.sides import SidePredictorConfig
from moveset.training.engine import Loop
from moveset.training.reading import draw_told, embedded
from moveset.training.single_network import NetworkConfig, SingleNetworkTask
from moveset.training.tasks import Sources


@dataclass(frozen=True, kw_only=True)
class SidesConfig(NetworkConfig):
    """What ``SidesTask`` trains and how; the learning rate is a cosine over the run.

    Args:
        model: its ``text_dim`` follows from the text encoder.
        noise: mean standard deviation of the noise on token states.
    """

    model: SidePredictorConfig = field(default_factory=SidePredictorConfig)
    batch: int = 128
    lr: float = 1e-3
    warmup: int = 0
    noise: float = 0.05
    text_encoder: str = "minilm"


class SidesTask(SingleNetworkTask):
    """A small classifier of token states."""

    name = "sides"
    network = "sides"

    def __init__(self, config: SidesConfig, sources: Sources, loop: Loop) -> None:
        dataset = open_for_training(sources.corpus)
        loop.learned_from["corpus"] = dataset.fingerprint
        codec = choose_codec(dataset, "auto").name
        with loop.fabric.rank_zero_first():
            store = FeatureStore.cached(dataset, codec, sources.cache, loop.rank == 0, loop.config.workers)
            self.train, self.val = _pairs(dataset, "train", store), _pairs(dataset, "val", store)
            captions = [text for texts, _ in self.train + self.val for text in texts]
            self.text = embedded(sources.cache, config.text_encoder, captions, loop.device)
        self.config = config = replace(config, model=replace(config.model, text_dim=self.text.widths[0]))
        self.sides = config.model.build().to(loop.device)
        self.noise = loop.generator("noise", device=loop.device)
        self.optimizer = torch.optim.AdamW(self.sides.parameters(), config.lr, weight_decay=0.01)

    def training_step(self, step: int, loop: Loop) -> dict[str, Tensor]:
        captions, sides = draw_told(self.train, self.config.batch, loop.seed, step)
        text = self.text.lookup(captions)
        noise = torch.randn(text.tokens.shape, generator=self.noise, device=loop.device)
        text = replace(text, tokens=text.tokens + self.config.noise * noise)
        true_B3 = torch.stack(sides).to(loop.device)
        loss = cross_entropy(self.sides(text).flatten(0, 1), _classes(true_B3).flatten())
        norm = loop.minimise(loss, "sides")
        return {"loss": loss.detach(), "gradient_norm": norm}

    def validate(self, step: int, loop: Loop) -> dict[str, float]:
        """Share of captions of which it says a side, and how often the motion favours that one and not the other."""
        captions = [text for texts, _ in self.val for text in texts]
        true_B3 = torch.stack([sides for texts, sides in self.val for _ in texts])
        made_B3 = self.sides.predict(self.text.lookup(captions)).cpu()
        said = ~made_B3.isnan()
        judged = said & (true_B3 != 0)
        right = (made_B3 == true_B3)[judged]
        return {"said": float(said.any(dim=1).float().mean()), "right": float(right.float().mean())}


def _classes(sides: Tensor) -> Tensor:
    """0 left, 1 neither, 2 right."""
    return (1 - sides).long()


def _pairs(dataset: Dataset, split: Split, store: FeatureStore) -> list[tuple[tuple[str, ...], Tensor]]:
    """Sentences of clips with the sides that these favour; in training also sentences to which that is added.

    People who say a leg err as often as not (55 % of 114 takes of CMU's, where of arms it is 15 % of 377).
    """
    found = [(dataset.clip(item).captions, store.sides[item]) for item in dataset.split(split)]
    if split == "train":
        found = [(captions + tuple(_named(captions, sides)), sides) for captions, sides in found]
    return found


def _named(captions: Sequence[str], sides: Tensor) -> Iterator[str]:
    """Short sentences of a clip that name no side, with the arm or the leg that its motion favours."""
    short = [said.rstrip(". ") for said in captions if len(said.split()) <= _SHORT and mirror_text(said) == said]
    for number, (side, nouns) in enumerate(zip(sides.tolist(), _NOUNS, strict=False)):
        if side and short:
            said = short[number % len(short)]
            for noun in nouns:
                yield f"{said} with the {'left' if side > 0 else 'right'} {noun}"


_NOUNS = (("hand", "arm"), ("leg", "foot"))
_SHORT = 12  # words
