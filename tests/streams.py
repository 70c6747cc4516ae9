"""A stream's model folder with random weights, small enough to make in every test: all plumbing, no skill."""

import itertools
from pathlib import Path

import torch

from moveset.models.flow import FlowConfig
from moveset.models.segment_transformer import SegmentTransformerConfig
from moveset.models.sides import SidePredictorConfig
from moveset.motion.native import NativeCodec
from moveset.pipelines.model_config import StreamConfig
from moveset.pipelines.model_folder import save_model
from moveset.text.encoder import get_text_encoder
from tests.bundles import CAPTIONS, standing_features

FRAMES = 28


def tiny_stream(path: Path, *, seed: int = 0) -> Path:
    """Write the folder: rdm, md, pcm-1, pcm-2, flow and sides, over a standing person that wobbles a little."""
    features = standing_features()
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        sizes = {"features": len(features), "frames": FRAMES, "width": 32, "heads": 2, "hidden": 32, "blocks": 1}
        # Two networks are told how far the way has turned.
        modules = {
            name: SegmentTransformerConfig(
                **sizes, guided=name.startswith("pcm"), heading_change=name in ("rdm", "pcm-1")
            ).build()
            for name in ("rdm", "md", "pcm-1", "pcm-2")
        }
        modules["flow"] = FlowConfig(
            features=len(features), blocks=2, hidden=8, text_context=4, index_context=4
        ).build()
        modules["sides"] = SidePredictorConfig(width=8, least=0.0).build()
        for name, module in modules.items():
            if name not in ("flow", "sides"):
                module.spectrum.copy_(torch.linspace(1.4, 0.4, FRAMES)[:, None])
            # Fresh networks say nothing of text, guidance or predecessor, and a fresh flow is the identity.
            for key, weight in module.named_parameters():
                if (key.endswith("weight") and not weight.any()) or key.startswith("text"):
                    torch.nn.init.normal_(weight, std=0.1 if name == "flow" else 0.3)
    config = StreamConfig(
        name=path.name,
        network="pcm-1",
        sampler_steps=6,
        start=3,
        lag=1,
        guidance={"rdm": 0.0, "md": 0.0, "pcm-1": 1.5, "pcm-2": 1.5},
        far_prompt=0.4,
        symmetric=("pcm-1",),
        provenance={"data": "none: random weights for tests"},
    )
    order, signs = NativeCodec().mirror()
    features = 0.5 * (features + features[order] * signs)
    normalizer = {"feature_mean": features, "feature_std": torch.full_like(features, 0.02)}
    pooled = get_text_encoder("minilm").encode(list(CAPTIONS)).pooled
    return save_model(path, config, modules, normalizer, CAPTIONS, pooled)


def take(stream, count):
    """The next segments of a stream."""
    return list(itertools.islice(stream, count))


def same(one, two):
    """Whether two segments are so to the last bit."""
    return torch.equal(one.motion.rotations, two.motion.rotations) and torch.equal(one.motion.root, two.motion.root)
