"""Judges and models with known answers, for tests of the protocol."""

import hashlib

import torch

from moveset.evaluation.evaluator import EvaluatorCard
from moveset.evaluation.samples import text_of


class Oracle:
    """Knows which motion each sentence was written for: both are embedded as the item's own random point.

    Args:
        items: whose captions it knows.
    """

    sha256 = "0" * 64

    def __init__(self, items):
        self.card = EvaluatorCard(name="oracle")
        self._of_motion = {self._key(item.features()): item.name for item in items.items}
        self._of_text = {text_of(caption): item.label for item in items.items for caption in item.captions}
        self._label = {item.name: item.label for item in items.items}
        self.read, self.seen = [], 0

    @staticmethod
    def _key(features):
        return features.double().sum().item()

    @staticmethod
    def point(key):
        seed = int.from_bytes(hashlib.sha256(repr(key).encode()).digest()[:6], "big")
        return torch.randn(8, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)

    def embed_motions(self, features):
        self.seen += len(features)
        names = [self._of_motion.get(self._key(x)) for x in features]
        return torch.stack(
            [self.point(self._label.get(name, self._key(x))) for name, x in zip(names, features, strict=True)]
        )

    def embed_texts(self, captions):
        self.read += map(text_of, captions)
        return torch.stack([self.point(self._of_text.get(text_of(c), text_of(c))) for c in captions])


class Painter:
    """Makes motion from noise alone; remembers what it was asked for."""

    slug = model = "painter"
    network, steps, random, segment = "paint", 1, True, 0.0
    code = ("tests.evaluation.judges",)

    def __init__(self, spoil=None):
        self.asked, self._spoil = [], spoil

    def describe(self):
        return {"colour": "blue"}

    def weights(self):
        return {"paint.safetensors": "1" * 64}

    def generate(self, wanted, fps, tick=lambda count: None):
        self.asked += wanted
        made = []
        for one in wanted:
            noise = torch.randn(one.frames, 22, 3, generator=torch.Generator().manual_seed(one.seed))
            body = torch.randn(22, 3, generator=torch.Generator().manual_seed(3))
            made.append(body + 0.01 * noise)
        if self._spoil:
            self._spoil(made)
        return made
