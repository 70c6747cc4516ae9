"""The rollout split: motion much longer than what a model is trained on, judged in windows (RDM, arXiv 2406.07169).

The paper names such a split and prints no number on it. Here a rollout is half a minute of changing prompts. Of a
corpus: clips of the test split one after the other, each with its caption and its own length, the real motion being
the clips themselves, joined. Of a folder: its motions of 200 frames or more, with one caption. Windows slide over the
whole; what a window is told are the (at most two) sentences that hold longest in it. R-precision and FID are of
windows; jerk at seams, drift and the physical measures are of whole rollouts.

F frames, J joints, W windows of a rollout, E width of the evaluator's space.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from moveset.data.humanml3d import Caption
from moveset.errors import InputError
from moveset.evaluation import metrics
from moveset.evaluation.generators import Given, Wanted
from moveset.evaluation.motion_files import then
from moveset.evaluation.protocol import Progress, Session, encoded, made_of, physical, random_of, scores, seed_of
from moveset.evaluation.samples import Sample, text_of
from moveset.motion.hml import HmlCodec
from moveset.motion.join import join
from moveset.motion.measures import windows as measured_windows

SECONDS = 30.0
WINDOW = 196  # rows of features
DRIFT_WINDOW = 5.0  # seconds
SHARE = 0.2  # of a window, below which a sentence is not told of it

Told = tuple[Caption | str, tuple[str, ...]]  # a sentence, or a caption with its tokens; and labels


@dataclass(frozen=True, eq=False)
class Rollout:
    """A long motion to make: clips one after the other; the last may be cut."""

    draws: tuple[Sample, ...]
    frames: tuple[int, ...]

    @property
    def name(self) -> str:
        """Of its first clip."""
        return self.draws[0].item.name

    @property
    def parts(self) -> tuple[tuple[str, int], ...]:
        """(prompt, frames)."""
        return tuple((draw.prompt, count) for draw, count in zip(self.draws, self.frames, strict=True))

    def real(self, codec: HmlCodec) -> tuple[Tensor, list[Tensor]]:
        """The motion itself, clips joined as a timeline's are: joints (F, J, 3), and features of its windows."""
        if self.draws[0].item.motion is None:
            joints = self.draws[0].joints()[: self.frames[0]]
            features = self.draws[0].features()
            return joints, [features[start : start + WINDOW] for start in starts(len(joints))]
        clips = []
        for draw, count in zip(self.draws, self.frames, strict=True):
            assert draw.item.motion is not None
            clips.append(draw.item.motion()[:count])
        joints = join(clips).joints
        return joints, encoded(cut(joints), codec)

    def said(self, start: int, stop: int) -> Told:
        """What is told of frames [start, stop): a sentence, or a caption with its tokens if it is one; and a label."""
        begin, held = 0, []
        for draw, count in zip(self.draws, self.frames, strict=True):
            overlap = min(stop, begin + count) - max(start, begin)
            held.append((overlap, begin, draw))
            begin += count
        longest = sorted(held, key=lambda entry: -entry[0])[:2]
        told = sorted((e for e in longest if e[0] >= SHARE * (stop - start)), key=lambda e: e[1])
        labels = tuple(name for _, _, draw in told for name in draw.item.label or ())
        if len(told) == 1 and not isinstance(caption := told[0][2].caption, str):
            return caption, labels
        return then([text_of(draw.caption) for _, _, draw in told]), labels


def starts(frames: int) -> list[int]:
    """First frames of the windows of a motion, half a window apart.

    >>> starts(600)
    [0, 98, 196, 294, 392]
    """
    return list(range(0, max(frames - WINDOW, 1), WINDOW // 2))


def cut(joints: Tensor) -> list[Tensor]:
    """Windows of joints (F, J, 3), a frame longer than their features will be."""
    return [joints[start : start + WINDOW + 1] for start in starts(len(joints))]


def rollouts(draws: Sequence[Sample], fps: float) -> list[Rollout]:
    """Clips in their order, cut into rollouts of ``SECONDS``; no clip is used twice.

    Raises:
        InputError: not enough clips for one.
    """
    wanted = round(SECONDS * fps)
    out: list[Rollout] = []
    chosen: list[Sample] = []
    lengths: list[int] = []
    for draw in draws:
        left = wanted - sum(lengths)
        chosen.append(draw)
        lengths.append(min(draw.frames, left))
        if draw.frames >= left:
            # A last clip of which only a moment is left would say what nobody can see.
            if left < fps and len(chosen) > 1:
                del chosen[-1], lengths[-1]
            out.append(Rollout(tuple(chosen), tuple(lengths)))
            chosen, lengths = [], []
    if not out:
        total = sum(draw.frames for draw in draws) / fps
        raise InputError(f"the items last {total:g} s in all, and one rollout takes {SECONDS:g}; give more")
    return out


def run_rollout(session: Session, number: int, progress: Progress = lambda stage, done, count: None) -> dict[str, Any]:
    """The measures of one repeat of the rollout split, as ``protocol.run_repeat`` gives them.

    Raises:
        InputError: what is judged cannot go on for so long, or there are too few items.
    """
    begun = time.perf_counter()
    protocol, generator, codec = session.protocol, session.generator, session.items.codec
    chosen = _chosen(session, number)
    wanted = [Wanted(one.parts, seed_of(protocol, number, one.name), one.draws[0]) for one in chosen]
    real = [one.real(codec) for one in chosen]
    _groups(session, number, _told(chosen, [joints for joints, _ in real]))  # too few are refused before hours of work
    if isinstance(generator, Given):
        made, features = [joints for joints, _ in real], [x for _, found in real for x in found]
    else:
        # Of a single window of drift there is none.
        made = made_of(session, wanted, [one.draws[0] for one in chosen], progress, 2 * round(DRIFT_WINDOW * codec.fps))
        features = encoded([window for joints in made for window in cut(joints)], codec)
    generated = time.perf_counter() - begun

    progress("judging", 0, 1)
    told = _told(chosen, made)
    motion = session.evaluator.embed_motions(features)
    text = session.evaluator.embed_texts([sentence for sentence, _ in told])
    of = [k for k, joints in enumerate(made) for _ in starts(len(joints))]
    groups = _groups(session, number, told, of)
    judged = session.evaluator.embed_motions([x for _, found in real for x in found])
    found = scores(protocol, number, text, motion, judged, groups)
    found |= physical(made, codec, generator.segment or protocol.seams)
    found |= drift(made, codec)
    found["spread_change"] = spread_change(motion, [len(starts(len(joints))) for joints in made])
    return {
        "repeat": number,
        "metrics": found,
        "groups": len(groups),
        "rollouts": len(made),
        "windows": len(told),
        "shortened": sum(len(joints) < one.frames for joints, one in zip(made, wanted, strict=True)),
        "seconds": {"generating": round(generated, 4), "all": round(time.perf_counter() - begun, 4)},
    }


def drift(clips: Sequence[Tensor], codec: HmlCodec) -> dict[str, float]:
    """Mean change a minute of what ``measures.windows`` measures: metres, m/s, m/s³ and share of frames."""
    found = [measured_windows(joints, codec.fps, DRIFT_WINDOW, codec.skeleton) for joints in clips]
    names = ("height", "speed", "jerk", "skating")
    return {f"drift_{name}": float(torch.stack([w.drift(name) for w in found]).double().mean()) for name in names}


def spread_change(motion_WE: Tensor, counts: Sequence[int]) -> float:
    """Spread of the last windows of all rollouts over that of the first ones: below 1, motion grows alike with time.

    Args:
        motion_WE: windows, rollout by rollout.
        counts: windows of each rollout.
    """
    of_rollouts = motion_WE.split(list(counts))
    first, last = (torch.stack([windows[k] for windows in of_rollouts]) for k in (0, -1))
    return float((last - last.mean(0)).norm(dim=-1).mean() / (first - first.mean(0)).norm(dim=-1).mean())


def _told(chosen: Sequence[Rollout], clips: Sequence[Tensor]) -> list[Told]:
    """What is said of every window of rollouts of which these are the joints (F, J, 3)."""
    return [
        one.said(start, start + WINDOW)
        for one, joints in zip(chosen, clips, strict=True)
        for start in starts(len(joints))
    ]


def _groups(session: Session, number: int, told: Sequence[Told], of: Sequence[int] | None = None) -> list[list[int]]:
    """Neighbouring windows of a rollout share half of their frames, so a text would find its own motion twice."""
    labels = [label for _, label in told] if session.items.labels else None
    generator = random_of(session.protocol, number, "groups")
    try:
        return metrics.group(labels, len(told), generator, session.protocol.group, of)
    except InputError as error:
        raise InputError(f"of the windows of all rollouts: {error}") from error


def _chosen(session: Session, number: int) -> list[Rollout]:
    """Rollouts of single actions in random order; of a folder its long motions."""
    protocol = session.protocol
    draws = session.items.draw(random_of(protocol, number, "items"))
    if session.items.labels is None:
        limit = round(SECONDS * session.items.codec.fps)
        return [Rollout((draw,), (min(draw.rows, limit),)) for draw in draws]
    single = [draw for draw in draws if draw.item.label is not None and len(draw.item.label) == 1]
    order = torch.randperm(len(single), generator=random_of(protocol, number, "order")).tolist()
    return rollouts([single[k] for k in order], session.items.codec.fps)
