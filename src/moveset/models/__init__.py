"""Networks: plain ``nn.Module`` classes with their configurations. Importing the package registers every kind."""

from moveset.models import discriminator as discriminator
from moveset.models import latent_denoiser as latent_denoiser
from moveset.models import length as length
from moveset.models import timed_vae as timed_vae
from moveset.models import token_denoiser as token_denoiser
from moveset.models import token_vae as token_vae
