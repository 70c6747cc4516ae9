"""Networks: plain ``nn.Module`` classes with their configurations. Importing the package registers every kind."""

from moveset.models import dip_decoder as dip_decoder
from moveset.models import discriminator as discriminator
from moveset.models import evaluator as evaluator
from moveset.models import flow as flow
from moveset.models import latent_denoiser as latent_denoiser
from moveset.models import length as length
from moveset.models import light_t2m as light_t2m
from moveset.models import segment_denoiser as segment_denoiser
from moveset.models import segment_transformer as segment_transformer
from moveset.models import sides as sides
from moveset.models import timed_vae as timed_vae
from moveset.models import token_denoiser as token_denoiser
from moveset.models import token_vae as token_vae
