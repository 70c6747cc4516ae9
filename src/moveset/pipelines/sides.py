"""What a model's networks are told of the sides that a prompt names."""

from typing import Any, cast

import torch

from moveset.models.sides import SidePredictor
from moveset.pipelines.model_config import SIDES
from moveset.pipelines.model_folder import ModelFolder
from moveset.text.encoder import TextEmbedding
from moveset.text.sides import with_sides


def read_sides(bundle: ModelFolder[Any], text: TextEmbedding, device: torch.device | str) -> TextEmbedding:
    """Prompts with the sides beside them that they name, for a model that was trained so; others as they are."""
    if SIDES not in bundle.config.models:
        return text
    predictor = cast(SidePredictor, bundle.module(SIDES, device))
    return with_sides(text, predictor.predict(text))
