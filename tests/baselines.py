"""Model folders of baselines with random weights, small enough to make in every test."""

from pathlib import Path

import torch

from moveset.models.dip_decoder import DipDecoderConfig
from moveset.models.light_t2m import LightT2MConfig
from moveset.models.segment_denoiser import SegmentDenoiserConfig
from moveset.pipelines.model_config import DENOISER, IDLE, BaselineConfig
from moveset.pipelines.model_folder import save_model
from moveset.text.encoder import get_text_encoder
from tests.bundles import CAPTIONS, standing_features

SETTINGS = {
    "light": {"frames": 60, "sampler_steps": 3},
    "noise": {"frames": 60, "sampler_steps": 3, "predict": "eps"},
    "chunks": {"frames": 12, "prefix": 5, "schedule": "cosine", "timesteps": 4, "sampler_steps": 4, "eta": 1.0},
}


def tiny_baseline(path: Path, kind: str, **changed: object) -> Path:
    """Write the folder of a "light", "noise" or "chunks" model over a standing person that wobbles a little."""
    features = standing_features()
    settings = SETTINGS[kind] | changed
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        common = {"features": len(features), "text_dim": 384}
        model = {
            "light": LightT2MConfig(**common, frames=60, width=32, stages=1, groups=4, rank=4, pool="mean"),
            "noise": SegmentDenoiserConfig(
                **common, frames=60, width=32, layers=1, heads=2, feed_forward=32, conditioning=32, text_width=32,
                text_layers=1, text_feed_forward=32,
            ),
            "chunks": DipDecoderConfig(**common, frames=12, prefix=5, width=32, layers=1, heads=2, feed_forward=32),
        }[kind].build()  # fmt: skip
    statistics = {"feature_mean": features, "feature_std": torch.full_like(features, 0.02)}
    if kind == "chunks":
        statistics[IDLE] = torch.zeros_like(features)
    config = BaselineConfig(name=path.name, guidance={DENOISER: 1.5}, far_prompt=0.4, **settings)
    pooled = get_text_encoder("minilm").encode(list(CAPTIONS)).pooled
    return save_model(path, config, {DENOISER: model}, statistics, CAPTIONS, pooled)
