import pytest
import torch
from torch import nn

from moveset.errors import InputError
from moveset.models.condition import Denoiser
from moveset.models.discriminator import DiscriminatorConfig
from tests.conditions import condition_of


class Backbone(Denoiser):
    """The smallest thing with a denoiser's call: two tapped layers and dropout."""

    def __init__(self, channels: int = 4, width: int = 64) -> None:
        super().__init__()
        self.inward, self.middle = nn.Linear(channels, width), nn.Linear(width, width)
        self.text, self.outward = nn.Linear(8, width), nn.Linear(width, channels)
        self.dropout = nn.Dropout(0.5)

    def denoise(self, z, t, condition, taps):
        tokens, mask = condition.text.tokens, condition.text.mask
        c = (self.text(tokens) * mask[..., None]).sum(1, keepdim=True) + torch.sin(t.float())[:, None, None]
        a = self.dropout(torch.tanh(self.inward(z) + c))
        b = torch.tanh(self.middle(a)) + a
        if taps is not None:
            taps += [a, b]
        return self.outward(b)


@pytest.fixture
def scene():
    g = torch.Generator().manual_seed(3)
    torch.manual_seed(3)
    backbone = Backbone().eval().requires_grad_(False)
    heads = DiscriminatorConfig(width=64, taps=2, groups=8).build()
    cond = (torch.randint(0, 1000, (16,), generator=g), condition_of(torch.randn(16, 5, 8, generator=g)))
    real = torch.randn(16, 6, 4, generator=g)
    fake = torch.randn(16, 6, 4, generator=g) * 0.7 + 0.3
    return backbone, heads, real, fake, cond


def judge(backbone, heads, z, s, condition):
    taps = []
    backbone(z, s, condition, taps)
    return heads(taps)


def _hinge_d(real, fake):
    return torch.relu(1 - real).mean() + torch.relu(1 + fake).mean()


def test_paper_size_is_133_thousand_a_head():
    heads = DiscriminatorConfig().build()
    assert sum(p.numel() for p in heads.parameters()) == 9 * 132_865


def test_one_step_of_the_discriminator_separates_real_from_fake(scene):
    *disc, real, fake, cond = scene

    def gap():
        with torch.no_grad():
            return (judge(*disc, real, *cond).mean() - judge(*disc, fake, *cond).mean()).item()

    before = gap()
    optimizer = torch.optim.AdamW(disc[1].parameters(), lr=1e-3, betas=(0.0, 0.999))
    _hinge_d(judge(*disc, real, *cond), judge(*disc, fake, *cond)).backward()
    optimizer.step()
    assert gap() > before


def test_one_step_of_the_generator_raises_its_score_through_the_frozen_backbone(scene):
    backbone, heads, _, fake, cond = scene
    frozen, trained = ({k: v.clone() for k, v in part.state_dict().items()} for part in (backbone, heads))
    student = nn.Linear(4, 4)
    before = judge(backbone, heads, student(fake), *cond)
    optimizer = torch.optim.AdamW(student.parameters(), lr=1e-2)
    torch.relu(1 - before).mean().backward()
    assert student.weight.grad.abs().max() > 0
    optimizer.step()
    assert judge(backbone, heads, student(fake), *cond).mean() > before.mean()
    assert all(p.grad is None and not p.requires_grad for p in backbone.parameters())
    assert all(torch.equal(v, frozen[k]) for k, v in backbone.state_dict().items())
    assert all(torch.equal(v, trained[k]) for k, v in heads.state_dict().items())


def test_logits_are_dense_and_gradients_reach_every_head(scene):
    backbone, heads, real, _, cond = scene
    logits = judge(backbone, heads, real, *cond)
    assert logits.shape == (16, 6, 2)
    (logits**2).mean().backward()
    assert all(p.grad is not None and p.grad.abs().max() > 0 for p in heads.parameters())


def test_the_heads_judge_each_token_alone(scene):
    _, heads, *_ = scene
    taps = [torch.randn(2, 6, 64), torch.randn(2, 6, 64)]
    whole = heads(taps)
    one = heads([t[:1, 3:4] for t in taps])
    torch.testing.assert_close(one[0, 0], whole[0, 3], atol=1e-5, rtol=0)


def test_a_backbone_with_other_taps_is_refused():
    heads = DiscriminatorConfig(width=64, taps=3, groups=8).build()
    with pytest.raises(InputError, match="2 feature maps for 3"):
        judge(Backbone(), heads, torch.randn(1, 6, 4), torch.tensor([3]), condition_of(torch.randn(1, 5, 8)))


def test_groups_must_divide_the_width():
    with pytest.raises(InputError, match="multiple"):
        DiscriminatorConfig(width=100, groups=32)
