"""Train the content classifier on the real takes of a corpus, and tell how far it can be trusted.

``python -m moveset.evaluation.content_training`` writes the one that ``benchmarks/content.py``, ``stream_quality.py``
and ``rollout.py`` judge by.

Shapes: N clips, B batch, F frames, J joints, K classes.
"""

import argparse
import copy
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional as fn

from moveset.data.corpus import Corpus
from moveset.data.labels import mirror_label
from moveset.data.splits import Split
from moveset.errors import InputError, exit_code_of
from moveset.evaluation.content_classifier import FPS, ContentClassifier, ContentClassifierConfig, frame_features
from moveset.motion.skeleton import HML22

#: Labels that joint positions cannot tell apart: one class each.
_SAME_CLASS = {
    "byebye": "bye",
    "walk-slow": "walk",
    "walk-fast": "walk",
    "walk-large-steps": "walk",
    "jump-forward": "jump",
}
_MAX_FRAMES = 200
_MIN_FRAMES = 20


def content_class(label: str) -> str:
    """The class of a content label of a corpus or a prompt.

    >>> content_class("byebye"), content_class("run")
    ('bye', 'run')
    """
    return _SAME_CLASS.get(label, label)


@dataclass(frozen=True, eq=False)
class LabelledClip:
    """Joint positions (F, J, 3) in metres at 20 fps with the class they show, and the take they come from."""

    joints: Tensor
    label: str
    take: str

    def mirrored(self) -> "LabelledClip":
        """Left and right exchanged in joints and label."""
        flipped = self.joints[:, list(HML22.mirror_order)] * self.joints.new_tensor((-1.0, 1.0, 1.0))
        return LabelledClip(flipped, content_class(mirror_label(self.label)), self.take)


@dataclass(frozen=True, eq=False)
class Confusion:
    """How often which class was taken for which.

    Args:
        labels: K class names.
        counts: (K, K) integers; row: what it is, column: what the classifier says.
    """

    labels: tuple[str, ...]
    counts: Tensor

    @property
    def clips(self) -> int:
        """Number of clips judged."""
        return int(self.counts.sum())

    @property
    def accuracy(self) -> float:
        """Share of clips judged right."""
        return float(self.counts.diagonal().sum() / self.counts.sum().clamp_min(1))

    @property
    def balanced_accuracy(self) -> float:
        """Mean over classes (that occur) of the share judged right."""
        present = self.counts.sum(1) > 0
        return float((self.counts.diagonal()[present] / self.counts[present].sum(1)).mean())


@dataclass(frozen=True)
class TrainingCurve:
    """Validation by epoch, and the epoch whose weights were kept."""

    losses: tuple[float, ...]
    accuracies: tuple[float, ...]
    best_epoch: int


def labelled_clips(corpus: Corpus, split: Split) -> list[LabelledClip]:
    """The real takes of a split, compositions left out.

    Raises:
        InputError: the corpus is on another skeleton or frame rate than ``hml22`` at 20 fps.
    """
    clips = []
    for i in corpus.indices(split, composed=False):
        record, motion = corpus.records[i], corpus.motion(i)
        if motion.skeleton.name != HML22.name or motion.fps != FPS:
            found = f"{motion.skeleton.name} at {motion.fps:g} fps"
            raise InputError(f"the classifier judges hml22 at {FPS:g} fps, but {record.name!r} is {found}")
        clips.append(LabelledClip(motion.joints, content_class(record.contents[0]), record.take))
    return clips


def class_names(clips: Sequence[LabelledClip], min_takes: int) -> tuple[str, ...]:
    """Classes shown by at least ``min_takes`` different takes, a mirrored take counting for the mirrored class."""
    takes: dict[str, set[str]] = {}
    for clip in clips:
        takes.setdefault(clip.label, set()).add(clip.take)
        takes.setdefault(content_class(mirror_label(clip.label)), set()).add(clip.take)
    return tuple(sorted(label for label, names in takes.items() if len(names) >= min_takes))


def train_classifier(
    corpus: Corpus,
    *,
    min_takes: int = 8,
    epochs: int = 24,
    patience: int = 10,
    batch: int = 64,
    learning_rate: float = 2e-3,
    width: int = 96,
    seed: int = 0,
    report: Callable[[str], None] | None = None,
) -> tuple[ContentClassifier, TrainingCurve]:
    """Train on the real train takes of a corpus, choose the epoch on its val takes: ``fit`` for a corpus.

    Args:
        min_takes: contents with fewer train takes are not learned.
        epochs, patience, batch, learning_rate, width, seed, report: as in ``fit``.

    Raises:
        InputError: no content has enough takes in train, or none of these occurs in val.
    """
    train, val = labelled_clips(corpus, "train"), labelled_clips(corpus, "val")
    labels = class_names(train, min_takes)
    if not any(clip.label in labels for clip in train) or not any(clip.label in labels for clip in val):
        raise InputError(
            f"no content has {min_takes} train takes and a val take; lower min_takes or build a larger corpus"
        )
    return fit(
        train,
        val,
        labels,
        epochs=epochs,
        patience=patience,
        batch=batch,
        learning_rate=learning_rate,
        width=width,
        seed=seed,
        report=report,
    )


def fit(
    train: Sequence[LabelledClip],
    val: Sequence[LabelledClip],
    labels: tuple[str, ...],
    *,
    epochs: int,
    patience: int = 10,
    batch: int = 64,
    learning_rate: float = 2e-3,
    width: int = 96,
    seed: int = 0,
    report: Callable[[str], None] | None = None,
) -> tuple[ContentClassifier, TrainingCurve]:
    """Train a classifier of ``labels`` and keep the epoch with the lowest loss on ``val``; two minutes on one core.

    Clips of other classes are left out. Classes are drawn by the inverse square root of their size; clips are mirrored
    (with their label) half of the time and cropped in time.

    Args:
        epochs: at most; training also ends after ``patience`` epochs without a better one.
        report: gets one line an epoch.
    """
    train, val = ([clip for clip in clips if clip.label in labels] for clips in (train, val))
    generator = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng(devices=[]):  # initial weights and dropout draw from the global generator
        torch.manual_seed(seed)
        model = ContentClassifierConfig(labels=labels, width=width).build()
        _fit_statistics(model, train)
        optimizer = torch.optim.AdamW(model.parameters(), lr=learning_rate, weight_decay=0.02)
        steps = epochs * math.ceil(len(train) / batch)
        scheduler = torch.optim.lr_scheduler.OneCycleLR(optimizer, learning_rate, total_steps=steps, pct_start=0.1)
        losses: list[float] = []
        accuracies: list[float] = []
        best = copy.deepcopy(model.state_dict())
        for epoch in range(epochs):
            model.train()
            for joints, lengths, targets in _train_batches(train, labels, batch, generator):
                loss = fn.cross_entropy(model(joints, lengths), targets, label_smoothing=0.05)
                optimizer.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
                optimizer.step()
                scheduler.step()
            model.eval()
            losses.append(_loss(model, val))
            accuracies.append(confusion(model, val).accuracy)
            if losses[-1] == min(losses):
                best = copy.deepcopy(model.state_dict())
            if report is not None:
                report(f"epoch {epoch}: val loss {losses[-1]:.3f}, val accuracy {accuracies[-1]:.3f}")
            if epoch - losses.index(min(losses)) >= patience:
                break
    model.load_state_dict(best)
    return model.eval(), TrainingCurve(tuple(losses), tuple(accuracies), losses.index(min(losses)))


@torch.no_grad()
def confusion(model: ContentClassifier, clips: Sequence[LabelledClip]) -> Confusion:
    """Judge clips; those of classes that the model does not know are left out."""
    place = {label: k for k, label in enumerate(model.labels)}
    known = [clip for clip in clips if clip.label in place]
    counts = torch.zeros(len(place), len(place), dtype=torch.long)
    for group in _groups(known):
        joints, lengths = pad([clip.joints for clip in group])
        for clip, k in zip(group, model(joints, lengths).argmax(-1).tolist(), strict=True):
            counts[place[clip.label], k] += 1
    return Confusion(model.labels, counts)


@torch.no_grad()
def clip_features(model: ContentClassifier, joints: Sequence[Tensor]) -> Tensor:
    """Features (N, features) of clips (F, J, 3) of any lengths, in their order."""
    order = sorted(range(len(joints)), key=lambda k: len(joints[k]))
    out = torch.empty(len(joints), model.config.features)
    for start in range(0, len(order), 64):
        chunk = order[start : start + 64]
        out[chunk] = model.features(*pad([joints[k] for k in chunk]))
    return out


def pad(clips: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    """Clips (F, J, 3) as one batch (B, F, J, 3) with their lengths (B,)."""
    lengths = torch.tensor([len(clip) for clip in clips])
    return torch.nn.utils.rnn.pad_sequence(list(clips), batch_first=True), lengths


def _groups(clips: Sequence[LabelledClip], size: int = 64) -> Iterator[Sequence[LabelledClip]]:
    """Clips of similar length together: little padding."""
    ordered = sorted(clips, key=lambda clip: len(clip.joints))
    for start in range(0, len(ordered), size):
        yield ordered[start : start + size]


def _loss(model: ContentClassifier, clips: Sequence[LabelledClip]) -> float:
    place = {label: k for k, label in enumerate(model.labels)}
    total = 0.0
    with torch.no_grad():
        for group in _groups(clips):
            logits = model(*pad([clip.joints for clip in group]))
            total += float(fn.cross_entropy(logits, torch.tensor([place[c.label] for c in group]), reduction="sum"))
    return total / len(clips)


def _fit_statistics(model: ContentClassifier, clips: Sequence[LabelledClip]) -> None:
    rows = torch.cat([frame_features(c.joints[None], torch.tensor([len(c.joints)]))[0] for c in clips])
    model.mean.copy_(rows.mean(0))
    model.std.copy_(rows.std(0).clamp_min(0.02))  # some columns are constant: the pelvis lies above itself


def _train_batches(
    clips: Sequence[LabelledClip], labels: Sequence[str], batch: int, generator: torch.Generator
) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """One epoch: (joints, lengths, targets), drawn with replacement, clips of similar length together."""
    place = {label: k for k, label in enumerate(labels)}
    sizes = Counter(clip.label for clip in clips)
    weights = torch.tensor([sizes[clip.label] ** -0.5 for clip in clips])
    picks = torch.multinomial(weights, len(clips), replacement=True, generator=generator).tolist()
    drawn = [_augment(clips[k], labels, generator) for k in picks]
    batches = list(_groups(drawn, batch))
    for k in torch.randperm(len(batches), generator=generator).tolist():
        joints, lengths = pad([clip.joints for clip in batches[k]])
        yield joints, lengths, torch.tensor([place[clip.label] for clip in batches[k]])


def _augment(clip: LabelledClip, labels: Sequence[str], generator: torch.Generator) -> LabelledClip:
    flip, share, where = torch.rand(3, generator=generator).tolist()
    if flip < 0.5 and content_class(mirror_label(clip.label)) in labels:
        clip = clip.mirrored()
    frames = len(clip.joints)
    kept = min(max(round(frames * (0.7 + 0.3 * share)), _MIN_FRAMES), frames, _MAX_FRAMES)
    start = int(where * (frames - kept + 1))
    return LabelledClip(clip.joints[start : start + kept], clip.label, clip.take)


def main() -> None:
    """Command line: ``python -m moveset.evaluation.content_training --out runs/classifier``."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--corpus", type=Path, default=Path("data/corpus.safetensors"))
    parser.add_argument("--out", type=Path, default=Path("runs/classifier"))
    parser.add_argument("--epochs", type=int, default=24)
    parser.add_argument("--min-takes", type=int, default=8, help="contents with fewer train takes are not learned")
    given = parser.parse_args()
    corpus = Corpus.open(given.corpus)
    model, _ = train_classifier(corpus, min_takes=given.min_takes, epochs=given.epochs, report=print)
    for split in ("val", "test"):
        found = confusion(model, labelled_clips(corpus, split))
        print(f"{split}: {found.accuracy:.1%} of {found.clips} clips, {len(model.labels)} contents")
    print(model.save(given.out))


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
