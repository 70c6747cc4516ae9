"""What a network is told in training: of captions and a segment's circumstances a share, since not all uses know them.

Shapes: B rows, n frames of a segment, D features.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from moveset.motion.features import FeatureCodec, Normalizer
from moveset.motion.hml import HmlCodec

CORRECTED = 0.5
"""Share of what a way has gone astray that a segment of a walk takes back."""
_STANDS, _WALKS = 0.2, 0.6  # metres a second: whoever is slower takes nothing back, whoever is faster all of the share


def drop_captions(captions: Sequence[str], share: float, generator: torch.Generator) -> list[str]:
    """Captions, about this share of them replaced by "", for guidance. Drawn on the generator's device."""
    dropped_B = torch.rand(len(captions), generator=generator, device=generator.device) < share
    return ["" if dropped else caption for dropped, caption in zip(dropped_B.tolist(), captions, strict=True)]


def drop_heading_change(turned_B: Tensor, share: float, generator: torch.Generator) -> Tensor:
    """Turns (B,), of which about this share is told and the others are NaN.

    Drawn on the generator's device; for a share of 0 nothing is drawn, so that such trainings stay what they were.
    """
    if not share:
        return torch.full_like(turned_B, torch.nan)
    hidden_B = torch.rand(len(turned_B), generator=generator, device=generator.device) < 1 - share
    return turned_B.masked_fill(hidden_B.to(turned_B.device), torch.nan)


def perturb_heading(
    clean_BnD: Tensor,
    turned_B: Tensor,
    begun_B: Tensor,
    deviation: float,
    codec: FeatureCodec,
    normalizer: Normalizer,
    generator: torch.Generator,
) -> tuple[Tensor, Tensor]:
    """Segments whose way has turned by some radians more or less than it should have, and that take half of it back.

    Takes do not show what to do then: whoever walks straight on never went astray. On the spot nothing is taken back,
    since planted feet would slide. What is taken back begins and ends gently (a Hann window over the frames).

    Args:
        clean_BnD: normalised.
        turned_B: how far the way has turned since the sentence began, in radians as the codec's yaw steps have them
            (``hml``: of half the angle).
        begun_B: whether the sentence began before the segment; others cannot have gone astray.
        deviation: of how far astray they are, in radians.

    Returns:
        The segments, and how far their ways have turned.
    """
    yaw, planar = codec.groups["root_yaw"], codec.groups["root_velocity"]
    mean, std = normalizer.mean.to(clean_BnD.device), normalizer.std.to(clean_BnD.device)
    astray_B = torch.randn(len(clean_BnD), generator=generator, device=generator.device).to(clean_BnD.device)
    astray_B = astray_B * deviation * _yaw_of_a_radian(codec) * begun_B
    step_Bn2 = clean_BnD[..., planar] * std[planar] + mean[planar]
    # KIT-ML's lengths are in millimetres.
    unit = codec.convention.unit if isinstance(codec, HmlCodec) else 1.0
    speed_B = step_Bn2.mean(dim=1).norm(dim=-1) * codec.fps * unit
    back_B = CORRECTED * astray_B * ((speed_B - _STANDS) / (_WALKS - _STANDS)).clamp(0.0, 1.0)
    window_n = torch.hann_window(clean_BnD.shape[1] + 2, periodic=False, device=clean_BnD.device)[1:-1]
    steered = clean_BnD.clone()
    steered[..., yaw] -= (back_B[:, None] * window_n / window_n.sum())[..., None] / std[yaw]
    return steered, turned_B + astray_B


def perturb_past(
    previous_BnD: Tensor,
    index_B: Tensor,
    rate: float,
    codec: FeatureCodec,
    normalizer: Normalizer,
    generator: torch.Generator,
) -> Tensor:
    """Normalised segments with a steady turn of normally distributed speed added, but where ``index_B`` says none is.

    A network that is told its own past, slightly bent, learns to walk on straight instead of round.

    Args:
        rate: deviation of the turn in radians a second.
        generator: drawn from on its own device.
    """
    yaw = codec.groups["root_yaw"]
    turn_B = torch.randn(len(previous_BnD), generator=generator, device=generator.device)
    turn_B = turn_B * rate * _yaw_of_a_radian(codec) / codec.fps
    turn_B = turn_B.to(previous_BnD.device) * (index_B > 0)
    bent = previous_BnD.clone()
    bent[..., yaw] += turn_B[:, None, None] / normalizer.std[yaw].to(previous_BnD.device)
    return bent


def _yaw_of_a_radian(codec: FeatureCodec) -> float:
    return 0.5 if isinstance(codec, HmlCodec) else 1.0
