"""A model folder with random weights, small enough to make in every test: all plumbing of the real one, no skill."""

from pathlib import Path

import torch

from moveset.models.length import LengthPredictorConfig
from moveset.models.token_denoiser import TokenDenoiserConfig
from moveset.models.token_vae import TokenVAEConfig
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.features import get_codec
from moveset.motion.skeleton import HML22
from moveset.pipelines.model_config import ClipConfig
from moveset.pipelines.model_folder import save_model
from moveset.text.encoder import get_text_encoder

CAPTIONS = ("a person walks forward", "someone waves with the left hand", "a man runs fast", "a person bows")


def tiny_bundle(path: Path, *, seed: int = 0) -> Path:
    """Write the folder: VAE, teacher, LCM 1 and PCM 1, 2, 4, over a standing person that wobbles a little."""
    features = standing_features()
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        sizes = {"width": 16, "layers": 1, "heads": 2, "feed_forward": 16, "positions": 260}
        denoiser = {**sizes, "text_dim": 384, "time_waves": 16, "guidance_waves": 16}
        students = {name: TokenDenoiserConfig(**denoiser, guided=True) for name in ("lcm-1", "pcm-1", "pcm-2", "pcm-4")}
        modules = {
            "vae": TokenVAEConfig(**sizes, features=len(features)).build(),
            "length": LengthPredictorConfig(width=8).build(),
            "teacher": TokenDenoiserConfig(**denoiser).build(),
            **{name: config.build() for name, config in students.items()},
        }
        for name in students:
            # Published students start blind to the guidance scale; these must not, or no test could see it arrive.
            torch.nn.init.normal_(modules[name].time.guidance.weight, std=0.5)
    config = ClipConfig(
        name=path.name,
        min_frames=8,
        guidance={"teacher": 2.0, **dict.fromkeys(students, 3.0)},
        far_prompt=0.4,
        provenance={"data": "none: random weights for tests"},
    )
    normalizer = {
        "feature_mean": features,
        "feature_std": torch.full_like(features, 0.02),
        "latent_mean": torch.zeros(16, 32),
        "latent_std": torch.ones(16, 32),
    }
    pooled = get_text_encoder("minilm").encode(list(CAPTIONS)).pooled
    return save_model(path, config, modules, normalizer, CAPTIONS, pooled)


def standing_features() -> torch.Tensor:
    """(269,) native features of a body that stands in the rest pose with its toes on the floor."""
    height = -float(HML22.rest_positions[:, 1].min())
    root = torch.tensor([[0.0, height, 0.0]]).repeat(2, 1)
    return get_codec("native").encode(Motion(rotations.identity(2, len(HML22)), root))[0]
