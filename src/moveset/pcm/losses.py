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


def hinge_discriminator(real_logits: Tensor, fake_logits: Tensor) -> Tensor:
    """What the discriminator minimises: mean ReLU(1 - D(real)) + mean ReLU(1 + D(fake))."""
    return relu(1 - real_logits).mean() + relu(1 + fake_logits).mean()


def hinge_generator(fake_logits: Tensor) -> Tensor:
    """What the student minimises: mean ReLU(1 - D(fake)); no gradient once a fake passes for clearly real."""
    return relu(1 - fake_logits).mean()
