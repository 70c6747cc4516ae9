"""Losses of distillation: the distance of consistency, and the two sides of the adversarial game.

Real latents have high logits. MotionPCM prints Eq. 13 with real and fake exchanged, which no minimisation by the
discriminator and the student together can satisfy; these are PCM's signs (Wang et al. 2024, arXiv 2405.18407).
"""

import torch
from torch import Tensor
from torch.nn.functional import relu


def pseudo_huber(prediction: Tensor, target: Tensor, c: float = 0.5) -> Tensor:
    """mean(sqrt(d² + c²) - c), d = prediction - target: quadratic below c, linear above (MotionPCM, Eq. 12).

    MotionLCM-V2 uses c = 0.5 with 10 solver points.
    """
    return huber(prediction - target, c).mean()


def huber(difference: Tensor, c: float) -> Tensor:
    """sqrt(d² + c²) - c of every element."""
    square = difference.square()
    # The same value without subtracting two nearly equal numbers when d is small.
    return square / (torch.sqrt(square + c * c) + c)


def hinge_discriminator(
    real_logits: Tensor, fake_logits: Tensor, mismatched_logits: Tensor | None = None, mismatched: float = 0.5
) -> Tensor:
    """What the discriminator minimises: mean ReLU(1 - D(real)) + mean ReLU(1 + D(fake)).

    Args:
        mismatched_logits: of real latents with the text of others, which are to be called fake too (Reed et al. 2016,
            arXiv 1605.05396, Section 4.1).
        mismatched: their share of what fakes weigh; both kinds together must weigh what real latents do, or to call
            everything fake is the best answer for all that cannot be told.
    """
    fakes = relu(1 + fake_logits).mean()
    if mismatched_logits is not None:
        fakes = (1 - mismatched) * fakes + mismatched * relu(1 + mismatched_logits).mean()
    return relu(1 - real_logits).mean() + fakes


def hinge_generator(fake_logits: Tensor) -> Tensor:
    """What the student minimises: mean ReLU(1 - D(fake)); no gradient once a fake passes for clearly real."""
    return relu(1 - fake_logits).mean()
