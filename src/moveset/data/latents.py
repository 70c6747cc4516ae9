"""A dataset as the diffusion models see it: VAE posteriors of clips and crops, with their captions, in one file.

Encoding a clip costs as much as a training step of the denoiser, and the encoder is frozen: so it happens once.
Shapes: M entries, N latent tokens, d latent width, B batch.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open
from safetensors.torch import load_file, save
from torch import Tensor
from tqdm import tqdm

from moveset.data.batch import Batch
from moveset.data.dataset import Dataset
from moveset.data.feature_store import Crop, FeatureStore
from moveset.data.splits import Split
from moveset.errors import InputError
from moveset.io.limits import atomic_write

_SOURCE = "moveset source"


@dataclass(frozen=True, eq=False)
class LatentBatch(Batch):
    """Latents z_0 (B, N, d), clip lengths (B,) in frames, sides (B, 3) that they favour, a caption for each, and labels
    of what it shows, or the caption again where there are none."""

    z0: Tensor
    frames: Tensor
    sides: Tensor
    captions: list[str]
    contents: list[tuple[str, ...]]


class LatentSet:
    """Posteriors of M entries: each clip of a split whole, and windows of it, with both of its captions' wordings.

    Args:
        mean: (M, N, d) posterior means.
        std: (M, N, d) posterior standard deviations.
        frames: (M,) clip lengths.
        clip: (M,) numbers of clips in the dataset and the feature store.
        sides: (M, 3) which sides these clips favour (``motion.sides``).
    """

    def __init__(self, dataset: Dataset, split: Split, tensors: dict[str, Tensor], sides: Tensor) -> None:
        self.mean, self.std = tensors["mean"].float(), tensors["std"].float()
        self.frames, self.clip = tensors["frames"], tensors["clip"]
        self.center, self.scale = tensors["center"], tensors["scale"]
        self.sides = sides[self.clip]
        clips = dataset.split(split)
        weight = dict(zip(clips, dataset.weights(clips, power=0.25, composed_share=0.4).tolist(), strict=True))
        copies = torch.bincount(self.clip, minlength=len(dataset)).double()
        self.weights = torch.tensor([weight[int(c)] for c in self.clip], dtype=torch.float64) / copies[self.clip]
        shown = {clip: dataset.clip(clip) for clip in set(self.clip.tolist())}
        self._captions = {number: clip.captions for number, clip in shown.items()}
        self._contents = {number: clip.contents for number, clip in shown.items()}

    @classmethod
    def of(
        cls,
        dataset: Dataset,
        split: Split,
        store: FeatureStore,
        vae: Any,
        path: Path,
        windows: int = 2,
        batch: int = 64,
        device: torch.device | str = "cpu",
    ) -> "LatentSet":
        """Open ``path``, encoding the split first where it is missing, with the autoencoder where it is.

        Raises:
            InputError: the latents there are of another dataset's clips, or of another split.
        """
        made_of = f"{dataset.fingerprint} {split}"
        if not path.is_file():
            tensors = _encode(_entries(dataset, dataset.split(split), store, windows), store, vae, batch, device)
            with atomic_write(path) as file:
                file.write(save(tensors, {_SOURCE: made_of}))
        with safe_open(path, "pt") as file:
            found = (file.metadata() or {}).get(_SOURCE)
        if found != made_of:
            raise InputError(
                f"{path} was made from other clips; delete {path.parent}/latents-*.safetensors, and they will be made "
                "anew, or train in another folder"
            )
        return cls(dataset, split, load_file(path), store.sides)

    def as_encoded(self) -> "LatentSet":
        """The same latents, not normalised: as the encoder gives them."""
        same = copy(self)
        same.center, same.scale = torch.zeros_like(self.center), torch.ones_like(self.scale)
        return same

    def __len__(self) -> int:
        return len(self.clip)

    def captions(self, entry: int) -> tuple[str, ...]:
        """All captions of an entry; mirrored entries have mirrored text."""
        return self._captions[int(self.clip[entry])]

    def all_captions(self) -> list[str]:
        return sorted({caption for captions in self._captions.values() for caption in captions})

    def batch(self, size: int, seed: int, step: int) -> LatentBatch:
        """The batch of a step: a pure function of (seed, step); latents are drawn from the posterior and normalised."""
        generator = torch.Generator().manual_seed(seed * 1_000_003 + step)
        entries = torch.multinomial(self.weights, size, replacement=True, generator=generator)
        noise = torch.randn(size, *self.mean.shape[1:], generator=generator)
        z0 = (self.mean[entries] + self.std[entries] * noise - self.center) / self.scale
        captions = []
        for entry, pick in zip(entries.tolist(), torch.rand(size, generator=generator).tolist(), strict=True):
            options = self.captions(entry)
            captions.append(options[int(pick * len(options))])
        labels = [self._contents[int(self.clip[entry])] for entry in entries]
        contents = [of or (caption,) for of, caption in zip(labels, captions, strict=True)]
        return LatentBatch(z0, self.frames[entries], self.sides[entries], captions, contents)


def _entries(dataset: Dataset, clips: Sequence[int], store: FeatureStore, windows: int) -> list[Crop]:
    """Every clip whole, and ``windows`` windows of 80-100 % of those that may be cropped."""
    generator = torch.Generator().manual_seed(0)
    crops = []
    for clip in clips:
        crops.append(store.whole(clip))
        total = store.clips[clip].frames
        # A window of a short clip may miss what its caption says.
        if not dataset.clip(clip).croppable or total < 48:
            continue
        for share, place in torch.rand(windows, 2, generator=generator).tolist():
            frames = int(total * (0.8 + 0.2 * share))
            crops.append(Crop(clip, int(place * (total - frames + 1)), frames))
    return crops


@torch.inference_mode()
def _encode(
    crops: list[Crop], store: FeatureStore, vae: Any, batch: int, device: torch.device | str
) -> dict[str, Tensor]:
    crops = sorted(crops, key=lambda crop: crop.frames)
    means, stds = [], []
    for start in tqdm(range(0, len(crops), batch), desc="latents", disable=None):
        found = vae.encode(*(x.to(device) for x in store.batch(crops[start : start + batch])))
        mean, log_variance = (x.cpu() for x in found)
        means.append(mean)
        stds.append((0.5 * log_variance).exp())
    mean, std = torch.cat(means), torch.cat(stds)
    total = (mean.var(dim=0, correction=0) + std.square().mean(0)).sqrt()
    return {
        "mean": mean.half(),
        "std": std.half(),
        "center": mean.mean(0),
        "scale": total,
        "frames": torch.tensor([crop.frames for crop in crops]),
        "clip": torch.tensor([crop.clip for crop in crops]),
    }
