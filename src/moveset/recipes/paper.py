"""The published sizes and hyper-parameters, as far as the models go: HumanML3D or KIT-ML, sentence-T5, a GPU.

Source: MotionPCM (arXiv 2501.19083) on the VAE and denoiser of MotionLCM-V2 (arXiv 2404.19759).
"""

from moveset.models.discriminator import DiscriminatorConfig
from moveset.models.token_denoiser import TokenDenoiserConfig
from moveset.models.token_vae import TokenVAEConfig


def vae(features: int = 263) -> TokenVAEConfig:
    """18.06 M parameters at HumanML3D's 263 features; KIT-ML has 251."""
    return TokenVAEConfig(features=features)


def teacher(text_dim: int = 768) -> TokenDenoiserConfig:
    """8,237,856 parameters with sentence-T5's 768 numbers a sentence."""
    return TokenDenoiserConfig(text_dim=text_dim)


def student(text_dim: int = 768) -> TokenDenoiserConfig:
    """8,434,464 parameters: the teacher and a guidance embedding."""
    return TokenDenoiserConfig(text_dim=text_dim, guidance=True)


def discriminator() -> DiscriminatorConfig:
    """Heads on all nine blocks of the teacher: 1.2 M trained parameters."""
    return DiscriminatorConfig(width=256, taps=9)
