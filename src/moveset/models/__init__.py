"""Networks: plain ``nn.Module`` classes with their configurations. Importing the package registers every kind."""

from moveset.models import discriminator as discriminator
