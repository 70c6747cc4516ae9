"""What networks of segments are told of a prompt."""

import torch

from moveset.data.captions import mirror_text
from moveset.pipelines.conditioning import Conditioning
from moveset.pipelines.timeline import held
from moveset.text.cache import CachedEncoder
from moveset.text.sides import with_sides


def test_sides_that_a_prompt_names_are_said_beside_it_and_beside_what_it_says_of_the_mirror_image(bundle, encoder):
    cpu, said = torch.device("cpu"), "a person waves with the left hand"
    binding = Conditioning(bundle, bundle.module("pcm-1"), CachedEncoder(encoder, 4), cpu)
    found = binding.of(held(said, False), 0, 2.0)
    for told, sentence in ((found.text, said), (found.mirrored, mirror_text(said))):
        plain = encoder.encode([sentence])
        sides_B3 = bundle.module("sides").predict(plain)
        assert sides_B3.abs().sum() == 3
        assert torch.equal(told.tokens, with_sides(plain, sides_B3).tokens)
        assert torch.equal(told.pooled, plain.pooled)
        assert not torch.equal(told.tokens, plain.tokens)
