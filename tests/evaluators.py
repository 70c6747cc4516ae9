"""An evaluator with random weights, small enough to make in every test: all plumbing of a real one, no taste."""

from pathlib import Path

import torch

from moveset.evaluation.evaluator import Evaluator, EvaluatorCard
from moveset.models.evaluator import EvaluatorConfig
from moveset.motion.features import get_codec
from moveset.text.encoder import get_text_encoder
from moveset.text.words import TokenWords


def tiny_evaluator(path: Path, *, codec: str = "hml", fps: float = 20.0, seed: int = 0) -> Path:
    """Write the folder."""
    words = TokenWords(get_text_encoder("minilm"))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        module = EvaluatorConfig(
            features=get_codec(codec).dim, movement_width=16, movement_latent=16, word_width=words.width,
            speech_classes=0, text_hidden=8, motion_hidden=8, joint=8,
        ).build()  # fmt: skip
    card = EvaluatorCard(name=path.name, codec=codec, fps=fps, provenance={"data": "none: random weights for tests"})
    return Evaluator(card, module, words).save(path)
