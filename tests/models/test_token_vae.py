import pytest
import torch

from moveset.errors import InputError
from moveset.models.token_vae import TokenVAEConfig

TINY = TokenVAEConfig(features=7, tokens=3, token_dim=4, width=16, layers=3, heads=2, feed_forward=32, positions=40)


def test_too_long_is_one_sentence():
    vae = TINY.build()
    with pytest.raises(InputError, match="41 tokens"):
        vae.decode(torch.zeros(1, 3, 4), torch.tensor([41]), 41)
    with pytest.raises(InputError, match="41 tokens"):
        vae.encode(torch.zeros(1, 35, 7), torch.tensor([35]))
