"""What a reconstruction is judged by. B batch, F frames, D features, J joints; distances in metres."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as fn

from moveset.motion.contacts import TOE_HEIGHT
from moveset.motion.features import FeatureCodec, Normalizer
from moveset.motion.native import NativeCodec
from moveset.training.segment_losses import below_floor


@dataclass(frozen=True, kw_only=True, slots=True)
class ReconstructionWeights:
    """Weights of the terms of ``reconstruction_loss``."""

    features: float = 1.0
    positions: float = 10.0
    velocity: float = 20.0
    acceleration: float = 20.0
    path: float = 1.5
    heading: float = 1.5
    feet: float = 0.0
    floor: float = 0.0


def reconstruction_loss(
    made: Tensor,
    real: Tensor,
    lengths: Tensor,
    codec: NativeCodec,
    normalizer: Normalizer,
    weights: ReconstructionWeights,
) -> tuple[Tensor, dict[str, Tensor]]:
    """Weighted sum and its parts.

    Features alone do not see what a viewer sees: an error at the hip moves the whole leg, an error in the root's speed
    adds up over the clip, and small independent errors from frame to frame are jitter. So joints are judged after
    forward kinematics: their posture, and their world velocity and acceleration (which also keeps planted feet still,
    and a weight for ``feet`` more so). Who is down is in few frames, so a little in all of them is a body in the floor:
    ``floor`` counts what is under it and was not.

    Args:
        made: (B, F, D) normalised features.
        real: the same of the clip.
        lengths: (B,) frames of each clip; the rest is ignored.
    """
    frames = real.shape[1]
    valid = (torch.arange(frames, device=real.device) < lengths[:, None]).to(real.dtype)
    parts = {"features": _mean(fn.smooth_l1_loss(made, real, reduction="none", beta=0.2).mean(-1), valid)}
    made, real = normalizer.denormalize(made), normalizer.denormalize(real)
    posture, root = codec.posture(made), real[..., codec.groups["root_height"]]
    ground = torch.cat((torch.zeros_like(root), root, torch.zeros_like(root)), dim=-1)
    true_posture = torch.cat(
        (ground[..., None, :], real[..., codec.groups["positions"]].unflatten(-1, (-1, 3))), dim=-2
    )
    parts["positions"] = _mean((posture - true_posture).abs().mean((-1, -2)), valid)
    heading, path = codec.root_path(made)
    true_heading, true_path = codec.root_path(real)
    parts["path"] = _mean((path - true_path)[..., [0, 2]].abs().mean(-1), valid)
    parts["heading"] = _mean((heading - true_heading).abs(), valid)
    world, true_world = _place(posture, heading, path), _place(true_posture, true_heading, true_path)
    error = world - true_world
    step = error[:, 1:] - error[:, :-1]
    parts["velocity"] = _mean(step.abs().mean((-1, -2)), valid[:, 1:])
    parts["acceleration"] = _mean((step[:, 1:] - step[:, :-1]).abs().mean((-1, -2)), valid[:, 2:])
    parts["floor"] = _mean(below_floor(posture[..., 1], true_posture[..., 1]), valid)
    parts["feet"] = _mean(_planted_error(step, true_world[..., 1], codec), valid[:, 1:])
    total = sum(
        (getattr(weights, name) * part for name, part in parts.items()), start=torch.zeros((), device=made.device)
    )
    return total, parts


def published_loss(
    made: Tensor, real: Tensor, lengths: Tensor, codec: FeatureCodec, normalizer: Normalizer
) -> tuple[Tensor, dict[str, Tensor]]:
    """The loss of MLD and MotionLCM-V2: smooth L1 of features and of recovered joints, masked means, weight 1 each."""
    valid = (torch.arange(real.shape[1], device=real.device) < lengths[:, None]).to(real.dtype)
    features = _clip_mean(fn.smooth_l1_loss(made, real, reduction="none").mean(-1), valid)
    joints, true = (codec.joints(normalizer.denormalize(x)) for x in (made, real))
    parts = {
        "features": features,
        "joints": _clip_mean(fn.smooth_l1_loss(joints, true, reduction="none").mean((-1, -2)), valid),
    }
    return parts["features"] + parts["joints"], parts


def kl_divergence(mean: Tensor, log_variance: Tensor) -> Tensor:
    """KL to the standard normal, averaged over all latent numbers (nats per number)."""
    return 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).mean()


def position_errors(made: Tensor, real: Tensor, lengths: Tensor) -> tuple[Tensor, Tensor]:
    """Mean per-joint position error of each clip in millimetres, (B,) root-aligned and (B,) unaligned.

    Args:
        made, real: (B, F, J, 3) joints in metres.
    """
    valid = (torch.arange(real.shape[1], device=real.device) < lengths[:, None]).to(real.dtype)
    aligned = ((made - made[..., :1, :]) - (real - real[..., :1, :])).norm(dim=-1).mean(-1)
    unaligned = (made - real).norm(dim=-1).mean(-1)
    count = valid.sum(1)
    return 1000 * (aligned * valid).sum(1) / count, 1000 * (unaligned * valid).sum(1) / count


def _planted_error(step: Tensor, height: Tensor, codec: NativeCodec) -> Tensor:
    """How far toes that are down move over the floor as they should not (B, F - 1), metres a frame, mean of both.

    Down is what ``motion.measures.skating`` calls so.
    """
    toes = list(codec.skeleton.feet[1::2])
    low = height[..., toes] < TOE_HEIGHT
    wrong = step[..., toes, :][..., [0, 2]].abs().sum(-1)
    return (wrong * (low[:, 1:] & low[:, :-1])).mean(-1)


def _place(posture: Tensor, heading: Tensor, path: Tensor) -> Tensor:
    sin, cos = torch.sin(heading)[..., None], torch.cos(heading)[..., None]
    x, y, z = posture.unbind(-1)
    return torch.stack((cos * x + sin * z + path[..., :1], y, cos * z - sin * x + path[..., 2:]), dim=-1)


def _mean(x: Tensor, valid: Tensor) -> Tensor:
    return (x * valid).sum() / valid.sum()


def _clip_mean(x: Tensor, valid: Tensor) -> Tensor:
    """Mean over each clip's frames, then over clips."""
    return ((x * valid).sum(1) / valid.sum(1)).mean()
