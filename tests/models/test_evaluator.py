"""The evaluator's networks: published sizes, padding that does not count, and an oracle without packing."""

import pytest
import torch
from torch.nn import functional as fn

from moveset.errors import FormatError, InputError
from moveset.models.evaluator import EvaluatorConfig, MatchingEvaluator, MovementConfig
from moveset.models.registry import build_model, describe


def count(module):
    return sum(parameter.numel() for parameter in module.parameters())


@pytest.fixture(scope="module")
def small():
    torch.manual_seed(0)
    return EvaluatorConfig(
        features=20, movement_width=12, movement_latent=10, word_width=7, speech_classes=3, text_hidden=6,
        motion_hidden=9, joint=5,
    ).build().eval()  # fmt: skip


def test_published_sizes():
    with torch.device("meta"):
        module, kit = EvaluatorConfig().build(), EvaluatorConfig(features=251).build()
    assert (count(module.movement), count(module.motion), count(module.text)) == (1_842_688, 15_747_584, 4_100_288)
    assert count(kit) == count(module) - 12 * 512 * 4


def test_kind_and_sizes_come_back():
    config = EvaluatorConfig(features=20, movement_width=8, joint=4)
    assert build_model(*describe(config)).config == config
    with pytest.raises(FormatError, match="features"):
        build_model("t2m_evaluator", {"features": 3})


def test_padding_of_motions_does_not_count(small):
    x = torch.randn(3, 24, 20)
    lengths = torch.tensor([24, 13, 8])
    for row, length in zip(x, lengths, strict=True):
        row[length:] = 0
    together = small.embed_motion(x, lengths)
    # Alone, a clip ends with the zeros that its last token may see: three frames and those of an unfinished token.
    for k, length in enumerate(lengths.tolist()):
        alone = small.embed_motion(fn.pad(x[k : k + 1, :length], (0, 0, 0, 12)), lengths[k : k + 1])
        torch.testing.assert_close(together[k : k + 1], alone)


def test_contacts_are_not_judged_and_what_moves_is(small):
    x = torch.randn(1, 16, 20)
    changed, lengths = x.clone(), torch.tensor([16])
    changed[..., -4:] += 1
    assert torch.equal(small.embed_motion(x, lengths), small.embed_motion(changed, lengths))
    changed[:, 15, 0] += 1
    assert not torch.equal(small.embed_motion(x, lengths), small.embed_motion(changed, lengths))


def test_sequence_encoder_equals_cells_run_by_hand(small):
    """Both directions cell by cell over each sequence's own length: no packing, no batching."""
    words, speech, lengths = torch.randn(2, 5, 7), torch.rand(2, 5, 3), torch.tensor([5, 3])
    made = small.embed_text(words, speech, lengths)
    text = small.text
    for k, length in enumerate(lengths.tolist()):
        x, last = text.input(words[k] + text.speech(speech[k])), []
        for direction, suffix in enumerate(("", "_reverse")):
            cell = torch.nn.GRUCell(6, 6)
            cell.load_state_dict(
                {
                    name: getattr(text.gru, f"{name}_l0{suffix}")
                    for name in ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
                }
            )
            h = text.hidden[direction]
            for place in range(length) if not direction else reversed(range(length)):
                h = cell(x[place : place + 1], h)
            last.append(h)
        torch.testing.assert_close(made[k : k + 1], text.output(torch.cat(last, dim=-1)))


def test_words_and_classes_of_speech_belong_together(small):
    with pytest.raises(InputError, match="classes of speech"):
        small.embed_text(torch.randn(1, 4, 7), None, torch.tensor([4]))


def test_movement_autoencoder_has_a_token_for_four_frames():
    model = MovementConfig(features=20, width=8, latent=6).build().eval()
    made, tokens = model(torch.randn(2, 24, 20))
    assert made.shape == (2, 24, 20)
    assert tokens.shape == (2, 6, 6)
    # A token sees the three frames before and behind its own four, and no other.
    x = torch.randn(1, 40, 20, requires_grad=True)
    model(x)[1][0, 4].sum().backward()
    seen = x.grad.abs().sum((0, 2)).nonzero().flatten().tolist()
    assert seen == list(range(13, 23))


def test_gradients_reach_every_parameter(small):
    module: MatchingEvaluator = small
    motion = module.embed_motion(torch.randn(2, 16, 20), torch.tensor([16, 12]))
    text = module.embed_text(torch.randn(2, 4, 7), torch.rand(2, 4, 3), torch.tensor([4, 2]))
    grads = torch.autograd.grad((motion.square().sum() + text.square().sum()), list(module.parameters()))
    assert all(grad.abs().sum() > 0 for grad in grads)
