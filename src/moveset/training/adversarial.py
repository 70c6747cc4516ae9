"""The discriminator and its own step, shared by the distillation of clips and of segments."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from moveset.models.discriminator import DiscriminatorConfig, DiscriminatorHeads
from moveset.pcm.losses import hinge_discriminator
from moveset.training.engine import Loop
from moveset.training.single_network import SingleNetworkTask


class AdversarialTask(SingleNetworkTask):
    """A student, and the discriminator that judges it, if there is one."""

    network = "student"
    heads: DiscriminatorHeads | None = None

    def make_heads(self, width: int, taps: int, loop: Loop) -> None:
        """The discriminator, for so many feature maps of that width."""
        self.heads = DiscriminatorConfig(width=width, taps=taps).build().to(loop.device)
        # Betas as in PCM's public code; the heads see every fake only once.
        self.heads_optimizer = torch.optim.AdamW(
            self.heads.parameters(), self.config.discriminator_lr, betas=(0.0, 0.999), weight_decay=0.0
        )

    def modules(self) -> dict[str, nn.Module]:
        return super().modules() | ({} if self.heads is None else {"discriminator": self.heads})

    def optimizers(self) -> dict[str, torch.optim.Optimizer]:
        return super().optimizers() | ({} if self.heads is None else {"discriminator": self.heads_optimizer})


def of_another(contents: Sequence[Sequence[str]]) -> list[int]:
    """For each row the next one, in a ring, that shows nothing of what it shows: whose text does not match it.

    Where all rows show the same, it is the next one.
    """
    total = len(contents)
    found = []
    for row, own in enumerate(contents):
        ring = [(row + step) % total for step in range(1, total)]
        found.append(next((other for other in ring if not set(own) & set(contents[other])), (row + 1) % total))
    return found


def discriminator_step(
    heads: nn.Module,
    real: list[Tensor],
    fake: list[Tensor],
    mismatched: list[Tensor] | None,
    mismatched_share: float,
    loop: Loop,
) -> dict[str, Tensor]:
    """One update of the heads on features of a frozen backbone (MotionPCM, Eq. 13, with PCM's signs).

    Args:
        heads: feature maps -> logits.
        real, fake: K feature maps (B, N, C) of noised data and of what the student made; no gradient leaves through
            them.
        mismatched: of noised data with the text of others (matching-aware, arXiv 1605.05396), to be called fake too.
        mismatched_share: what these weigh among the fakes.
        loop: its optimizer "discriminator" updates the heads.

    Returns:
        "discriminator", "real_logit", "fake_logit" and, where there is mismatched text, "mismatched_logit".
    """
    with torch.enable_grad():
        real_logits, fake_logits = heads([x.detach() for x in real]), heads([x.detach() for x in fake])
        mismatched_logits = None if mismatched is None else heads([x.detach() for x in mismatched])
        loss = hinge_discriminator(real_logits, fake_logits, mismatched_logits, mismatched_share)
        loop.minimise(loss, "discriminator")
    report = {
        "discriminator": loss.detach(),
        "real_logit": real_logits.mean().detach(),
        "fake_logit": fake_logits.mean().detach(),
    }
    if mismatched_logits is not None:
        report["mismatched_logit"] = mismatched_logits.mean().detach()
    return report
