"""What is this person doing? A small classifier of joint positions: a second judge beside the standard evaluator.

It is trained on real takes only and sees nothing but joints, so that any representation can be judged. Its penultimate
features also serve for a distance between distributions (``frechet``). Numbers made with it compare models of this
project with each other; they are not comparable with published ones.

Shapes: B batch, F frames, J joints of ``hml22``, C features of a frame, K classes.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import Tensor, nn
from torch.nn import functional as fn

from moveset.errors import FormatError, InputError
from moveset.io.limits import atomic_write, read_limited
from moveset.models.registry import build_model, describe, register, require_range
from moveset.motion.skeleton import HML22

FPS = 20.0
FRAME_FEATURES = 2 * 3 * len(HML22) + 1


@dataclass(frozen=True, kw_only=True, slots=True)
class ContentClassifierConfig:
    """Sizes and class names of a ``ContentClassifier``."""

    labels: tuple[str, ...]
    width: int = 96
    features: int = 64
    dilations: tuple[int, ...] = (1, 2, 4, 8)
    dropout: float = 0.2

    def __post_init__(self) -> None:
        require_range("number of labels", len(self.labels), 1, 10_000)
        require_range("width", self.width, 1, 4096)
        require_range("features", self.features, 1, 4096)
        require_range("number of dilations", len(self.dilations), 1, 64)
        for dilation in self.dilations:
            require_range("dilation", dilation, 1, 1024)
        require_range("dropout", self.dropout, 0.0, 0.9)
        if len(set(self.labels)) != len(self.labels):
            raise InputError("the labels of a classifier must differ from each other")

    def build(self) -> "ContentClassifier":
        """The module with fresh weights."""
        return ContentClassifier(self)


@dataclass(frozen=True)
class Prediction:
    """What the classifier says of B clips.

    Args:
        labels: the most probable class of each.
        probabilities: (B, K), in the order of the configuration's labels.
    """

    labels: tuple[str, ...]
    probabilities: Tensor


class _TemporalBlock(nn.Module):
    """Residual dilated convolution; the norm sees one frame at a time, so clips of a batch cannot mix."""

    def __init__(self, width: int, dilation: int, dropout: float) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.conv = nn.Conv1d(width, width, 5, padding=2 * dilation, dilation=dilation)
        self.out = nn.Conv1d(width, width, 1)
        self.dropout = nn.Dropout(dropout)

    def forward(self, x_BCF: Tensor, mask_B1F: Tensor) -> Tensor:
        h = self.norm(x_BCF.transpose(1, 2)).transpose(1, 2) * mask_B1F
        return x_BCF + self.out(self.dropout(fn.gelu(self.conv(h)))) * mask_B1F


class ContentClassifier(nn.Module):
    """Dilated convolutions over frames, mean and maximum over time, two linear layers."""

    mean: Tensor
    std: Tensor

    def __init__(self, config: ContentClassifierConfig) -> None:
        super().__init__()
        self.config = config
        self.register_buffer("mean", torch.zeros(FRAME_FEATURES))
        self.register_buffer("std", torch.ones(FRAME_FEATURES))
        self.stem = nn.Conv1d(FRAME_FEATURES, config.width, 5, stride=2, padding=2)
        self.blocks = nn.ModuleList(_TemporalBlock(config.width, d, config.dropout) for d in config.dilations)
        self.to_features = nn.Linear(2 * config.width, config.features)
        self.dropout = nn.Dropout(config.dropout)
        self.to_logits = nn.Linear(config.features, len(config.labels))

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the classes, in the order of the logits."""
        return self.config.labels

    def features(self, joints_BFJ3: Tensor, lengths_B: Tensor) -> Tensor:
        """Penultimate features (B, features) of joint positions in metres at 20 fps; padding does not matter."""
        mask = (torch.arange(joints_BFJ3.shape[1], device=lengths_B.device) < lengths_B[:, None])[:, None]
        x = (frame_features(joints_BFJ3, lengths_B) - self.mean) / self.std
        # Generated clips can be arbitrarily far out; a single wild frame should not decide alone.
        x = self.stem(x.clamp(-8.0, 8.0).transpose(1, 2) * mask)
        mask = mask[..., ::2]
        x = x * mask
        for block in self.blocks:
            x = block(x, mask)
        mean = (x * mask).sum(-1) / mask.sum(-1)
        peak = x.masked_fill(~mask, -torch.inf).amax(-1)
        return self.to_features(torch.cat((mean, peak), dim=-1))

    def forward(self, joints_BFJ3: Tensor, lengths_B: Tensor) -> Tensor:
        """Logits (B, K)."""
        return self.to_logits(self.dropout(fn.gelu(self.features(joints_BFJ3, lengths_B))))

    @torch.no_grad()
    def predict(self, joints_BFJ3: Tensor, lengths_B: Tensor | None = None) -> Prediction:
        """Classify clips.

        Args:
            joints_BFJ3: joint positions of ``hml22``, metres, Y up, 20 fps, at least one frame.
            lengths_B: real frames of each clip; None means all of them.

        Raises:
            InputError: another shape.
        """
        if joints_BFJ3.ndim != 4 or joints_BFJ3.shape[2:] != (len(HML22), 3) or joints_BFJ3.shape[1] < 1:
            raise InputError(f"joints must be (B, F, {len(HML22)}, 3) with F >= 1, not {tuple(joints_BFJ3.shape)}")
        if self.training:
            raise RuntimeError("predict needs evaluation mode: call eval() first")
        batch, frames = joints_BFJ3.shape[:2]
        if lengths_B is None:
            lengths_B = torch.full((batch,), frames, device=joints_BFJ3.device)
        probabilities = self(joints_BFJ3, lengths_B).softmax(-1)
        return Prediction(tuple(self.labels[k] for k in probabilities.argmax(-1).tolist()), probabilities)

    def save(self, folder: str | Path) -> Path:
        """Write ``model.json`` and ``model.safetensors`` into a folder, each whole or not at all."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        kind, config = describe(self.config)
        tensors = {name: value.detach().cpu().contiguous() for name, value in self.state_dict().items()}
        with atomic_write(folder / "model.safetensors") as file:
            file.write(safetensors.torch.save(tensors))
        with atomic_write(folder / "model.json") as file:
            file.write(json.dumps({"kind": kind, "config": config}, indent=1).encode())
        return folder

    @staticmethod
    def load(folder: str | Path) -> "ContentClassifier":
        """Read what ``save`` wrote, in evaluation mode.

        Raises:
            InputError: a file is missing.
            FormatError: a file is damaged or holds another kind of model.
        """
        folder = Path(folder)
        try:
            stored = json.loads(read_limited(folder / "model.json", 2**20))
            model = build_model(stored["kind"], stored["config"])
            tensors = safetensors.torch.load(read_limited(folder / "model.safetensors"))
            model.load_state_dict(tensors)
        except (ValueError, KeyError, TypeError, RuntimeError, SafetensorError) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise FormatError(
                f"{folder} does not hold a whole content classifier ({reason}); train it again"
            ) from error
        if not isinstance(model, ContentClassifier):
            raise FormatError(f"{folder} holds a {stored['kind']!r} model, not a content classifier")
        return model.eval()


def frame_features(joints_BFJ3: Tensor, lengths_B: Tensor) -> Tensor:
    """What the classifier sees: (B, F, C) with C = 133, the same wherever a clip stands and whichever way it faces.

    Of every frame, seen from above the pelvis along the heading (across hips and shoulders): positions (m), velocities
    by central difference (m/s), and the turning rate (rad/s). Frames past a clip's length repeat its last one.
    """
    frames = joints_BFJ3.shape[1]
    last = (lengths_B - 1)[:, None]
    here = torch.arange(frames, device=joints_BFJ3.device).expand(len(lengths_B), -1)
    held = _take(joints_BFJ3, here.minimum(last))
    after, before = (here + 1).minimum(last), (here - 1).clamp_min(0).minimum(last)
    seconds = (after - before).clamp_min(1)[..., None] / FPS

    left = [HML22.index(joint) for joint in ("left_hip", "left_shoulder")]
    right = [HML22.index(joint) for joint in ("right_hip", "right_shoulder")]
    across = fn.normalize((held[:, :, left] - held[:, :, right]).sum(2)[..., [0, 2]], dim=-1)  # (B, F, xz)
    positions = held - held[:, :, :1] * held.new_tensor((1.0, 0.0, 1.0))
    velocities = (_take(held, after) - _take(held, before)) / seconds[..., None]
    a, b = _take(across, before), _take(across, after)
    turning = torch.atan2(a[..., 1] * b[..., 0] - a[..., 0] * b[..., 1], (a * b).sum(-1))[..., None] / seconds
    faced = [_face(v, across).flatten(2) for v in (positions, velocities)]
    return torch.cat((*faced, turning), dim=-1)


def _take(x: Tensor, index_BF: Tensor) -> Tensor:
    """Frames of x (B, F, ...) by index."""
    return x[torch.arange(len(x), device=x.device)[:, None], index_BF]


def _face(v: Tensor, across: Tensor) -> Tensor:
    """Vectors (B, F, J, 3) in the frame whose +X is ``across`` (B, F, xz)."""
    ax, az = across[:, :, None, 0], across[:, :, None, 1]
    return torch.stack((ax * v[..., 0] + az * v[..., 2], v[..., 1], ax * v[..., 2] - az * v[..., 0]), dim=-1)


register("content_classifier", ContentClassifierConfig)
