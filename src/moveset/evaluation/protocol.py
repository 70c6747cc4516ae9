"""One repeat of an evaluation: draw captions, crops, noise and groups, make the motions, and measure them.

The rules are those of Guo et al. 2022 as MLD and MotionLCM use them, with three repairs: motion of whatever codec is
judged from its joints, padding is zero after normalising, and what is random depends on (seed, repeat) alone, so that
repeats may be computed in any order, on any machine, and after an interruption.

Shapes: M items, F frames, J joints, D features, E width of the evaluator's space, T texts of n motions each.
"""

import hashlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.evaluation import metrics
from moveset.evaluation.evaluator import Evaluator
from moveset.evaluation.generators import Given, Reconstruction, Source, Wanted
from moveset.evaluation.samples import Sample, TestSet
from moveset.evaluation.sides import named_side, on_named_side
from moveset.motion.hml import HmlCodec
from moveset.motion.measures import boundary_jerk, measure

ENCODED = 64  # clips turned into features at once
PHYSICAL = ("skating", "penetration", "floating", "jerk", "root_drift")

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, kw_only=True)
class Protocol:
    """How models are judged.

    Args:
        split: "test", "val" or "rollout" (``evaluation.rollout``).
        repeats: how often everything random is drawn again.
        multimodality: texts of which ``samples`` motions are made in each repeat; 0 leaves it out.
        samples: motions of each of them.
        pairs: of motions of a text.
        group: items of a group for R-precision.
        seams: seconds between the places where jerk is measured as at seams, for motion without segments; 0 for none.
    """

    split: str = "test"
    repeats: int = 20
    seed: int = 0
    multimodality: int = 100
    samples: int = 30
    pairs: int = 10
    diversity: int = 300
    group: int = metrics.GROUP
    seams: float = 0.0

    def __post_init__(self) -> None:
        for name, low, high in (
            ("repeats", 1, 1000), ("seed", 0, 2**31 - 1), ("multimodality", 0, 10_000), ("samples", self.pairs, 1000),
            ("diversity", 2, 100_000), ("group", 3, 1024), ("seams", 0, 60),
        ):  # fmt: skip
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError(f"{name} {value} is not in {low} to {high}")

    def fitted(self, items: TestSet, random: bool) -> "Protocol":
        """With as many texts and pairs as there are items for; nothing that is random where nothing is.

        Raises:
            InputError: too few items, or kinds of them, for one group.
        """
        if len(items) < self.group:
            raise InputError(
                f"{items.name} has {len(items)} items, and R-precision needs {self.group} at least; give more"
            )
        if self.split != "rollout":
            # As every repeat will, so that what cannot be grouped is refused before anything is made.
            metrics.group(items.labels, len(items), torch.Generator(), self.group)
        texts = min(self.multimodality, len(items), items.texts) if random and self.split != "rollout" else 0
        return replace(self, multimodality=texts, diversity=min(self.diversity, len(items)))


@dataclass(eq=False)
class Session:
    """What all repeats share.

    Args:
        protocol: already ``fitted``.
    """

    protocol: Protocol
    items: TestSet
    generator: Source
    evaluator: Evaluator

    def __post_init__(self) -> None:
        card, codec = self.evaluator.card, self.items.codec
        if card.codec != codec.name:
            raise InputError(
                f"evaluator {card.name!r} judges {card.codec!r} features, and {self.items.name} has {codec.name!r} "
                "ones; take the evaluator of that data set"
            )
        self._real: Tensor | None = None

    @property
    def judged(self) -> TestSet:
        """The items that motions are made for: the real ones, unless motions come with prompts of their own."""
        given = self.generator.items if isinstance(self.generator, Given) else None
        return given or self.items

    def real(self, draws: Sequence[Sample]) -> Tensor:
        """(M, E) of the real motions of a repeat; read once where crops do not change."""
        if self._real is None or any(draw.item.cropped for draw in draws):
            self._real = self.evaluator.embed_motions(real_features(draws, self.items.codec))
        return self._real


def run_repeat(session: Session, number: int, progress: Progress = lambda stage, done, count: None) -> dict[str, Any]:
    """The measures of one repeat, as JSON has them.

    Args:
        progress: told of progress: a stage, how much of it is done, and how much there is.

    Raises:
        InputError: motions that cannot be judged, or too few items or texts.
    """
    begun = time.perf_counter()
    protocol, generator = session.protocol, session.generator
    asked = session.judged.draw(random_of(protocol, number, "items"))
    real = asked if session.judged is session.items else session.items.draw(random_of(protocol, number, "items"))
    wanted = [Wanted(((d.prompt, d.frames),), seed_of(protocol, number, d.item.name), d) for d in asked]
    made = made_of(session, wanted, asked, progress)
    generated = time.perf_counter() - begun

    progress("judging", 0, 1)
    motion = session.evaluator.embed_motions(features_of(generator, asked, made, session.items.codec))
    text = session.evaluator.embed_texts([draw.caption for draw in asked])
    judged, random = session.judged, random_of(protocol, number, "groups")
    groups = metrics.group(judged.labels, len(asked), random, protocol.group, judged.takes)
    found = scores(protocol, number, text, motion, session.real(real), groups)
    texts = {}
    if protocol.multimodality:
        found["multimodality"], texts["texts"] = _multimodality(session, asked, number, progress)
    found |= physical(made, session.items.codec, generator.segment or protocol.seams)
    if session.judged is session.items and not isinstance(generator, Given):
        found |= _sides(asked, made, session.items.codec)
    if isinstance(generator, Reconstruction):
        found |= _errors(asked, made)
    shorter = sum(len(joints) < d.frames for joints, d in zip(made, asked, strict=True))
    return {
        "repeat": number,
        "metrics": found,
        "groups": len(groups),
        **texts,
        "shortened": 0 if isinstance(generator, Given) else shorter,
        "seconds": {"generating": round(generated, 4), "all": round(time.perf_counter() - begun, 4)},
    }


def made_of(
    session: Session, wanted: Sequence[Wanted], asked: Sequence[Sample], progress: Progress, least: int = 5
) -> list[Tensor]:
    """Joints (F, J, 3) of what is judged, with progress told.

    Raises:
        InputError: positions that are not finite, of another number of joints, or of fewer than ``least`` frames.
    """
    done = 0

    def tick(count: int) -> None:
        nonlocal done
        done += count
        progress("motions", done, len(wanted))

    codec, who = session.items.codec, session.generator.slug
    made = session.generator.generate(wanted, codec.fps, tick)
    for joints, draw in zip(made, asked, strict=True):
        if joints.ndim != 3 or tuple(joints.shape[1:]) != (len(codec.skeleton), 3):
            raise InputError(
                f"{who} gives joints {tuple(joints.shape)} for {draw.item.name!r}, and the evaluator judges "
                f"(frames, {len(codec.skeleton)}, 3); give motion on its skeleton"
            )
        if not torch.isfinite(joints).all():
            raise InputError(f"{who} gives positions that are not finite for {draw.item.name!r}; nothing can be judged")
        if len(joints) < least:
            raise InputError(f"{who} gives {len(joints)} frames for {draw.item.name!r}; at least {least} can be judged")
    return made


def scores(
    protocol: Protocol, number: int, text_ME: Tensor, motion_ME: Tensor, real_ME: Tensor, groups: list[list[int]]
) -> dict[str, float]:
    """R-precision, MM-Dist, FID and diversity of embedded texts and motions, real ones beside them."""
    top = metrics.r_precision(text_ME, motion_ME, groups)
    found = {f"r{k}": float(rate) for k, rate in enumerate(top, start=1)}
    found["mm_dist"] = metrics.matching_score(text_ME, motion_ME, groups)
    found["fid"] = metrics.frechet_distance(real_ME, motion_ME)
    pairs = min(protocol.diversity, len(motion_ME))
    return found | {"diversity": metrics.diversity(motion_ME, random_of(protocol, number, "diversity"), pairs)}


def seed_of(protocol: Protocol, number: int, *key: str | int) -> int:
    """A seed for everything random that has this key in this repeat."""
    said = "\0".join(map(str, (protocol.seed, number, *key)))
    return int.from_bytes(hashlib.sha256(said.encode()).digest()[:7], "big")


def random_of(protocol: Protocol, number: int, *key: str | int) -> torch.Generator:
    """A generator with ``seed_of`` the key."""
    return torch.Generator().manual_seed(seed_of(protocol, number, *key))


def features_of(generator: Source, asked: Sequence[Sample], made: Sequence[Tensor], codec: HmlCodec) -> list[Tensor]:
    """(F - 1, D) features of joints; real motion has its own already."""
    if isinstance(generator, Given):
        return real_features(asked, codec)
    return encoded(made, codec)


def real_features(draws: Sequence[Sample], codec: HmlCodec) -> list[Tensor]:
    """(rows, D) features of items: those that are stored, or of many motions at once."""
    if any(draw.item.motion is None for draw in draws):
        return [draw.features() for draw in draws]
    return encoded([draw.joints() for draw in draws], codec)


def encoded(clips: Sequence[Tensor], codec: HmlCodec) -> list[Tensor]:
    """(F - 1, D) features of joints (F, J, 3), many at once."""
    return [x for start in range(0, len(clips), ENCODED) for x in codec.encode_world(clips[start : start + ENCODED])]


def physical(clips: Sequence[Tensor], codec: HmlCodec, segment: float = 0.0) -> dict[str, float]:
    """Means over clips of joints (F, J, 3), and jerk at seams (m/s³) where segments have so many seconds."""
    found = [measure(joints, codec.fps, skeleton=codec.skeleton) for joints in clips]
    out = {name: float(torch.stack([one[name] for one in found]).double().mean()) for name in PHYSICAL}
    frames = round(segment * codec.fps)
    # A seam needs two frames on both sides, to be a place among others.
    near = [
        boundary_jerk(joints, codec.fps, list(range(frames, len(joints) - 1, frames))).near
        for joints in clips
        if frames and len(joints) > frames + 2
    ]
    if near:
        out["boundary_jerk"] = float(torch.stack(near).double().mean())
    return out


def _multimodality(session: Session, asked: Sequence[Sample], number: int, progress: Progress) -> tuple[float, int]:
    """Of texts drawn at random, each with the length of its item; and how many these are."""
    protocol = session.protocol
    order = torch.randperm(len(asked), generator=random_of(protocol, number, "texts")).tolist()
    # A prompt that two items happen to share counts once.
    chosen = list({asked[k].prompt: asked[k] for k in order}.values())[: protocol.multimodality]
    draws = [draw for draw in chosen for _ in range(protocol.samples)]
    wanted = [
        Wanted(((draw.prompt, draw.frames),), seed_of(protocol, number, draw.item.name, k % protocol.samples), draw)
        for k, draw in enumerate(draws)
    ]
    made = made_of(session, wanted, draws, progress)
    motion = session.evaluator.embed_motions(encoded(made, session.items.codec))
    motion_TnE = motion.view(len(chosen), protocol.samples, -1)
    return metrics.multimodality(motion_TnE, random_of(protocol, number, "pairs"), protocol.pairs), len(chosen)


def _sides(asked: Sequence[Sample], made: Sequence[Tensor], codec: HmlCodec) -> dict[str, float]:
    """Share of motions that do what is said of left or right, where an item's own motion does; nothing if none does."""
    named = [(named_side(draw.prompt), draw, joints) for draw, joints in zip(asked, made, strict=True)]
    judged = [
        on_named_side(side, joints, codec.skeleton)
        for side, draw, joints in named
        if side is not None and on_named_side(side, draw.joints(), codec.skeleton)
    ]
    return {"sides": sum(judged) / len(judged)} if judged else {}


def _errors(asked: Sequence[Sample], made: Sequence[Tensor]) -> dict[str, float]:
    """Mean joint errors of reconstructions, metres: where they are, and with the root put where it should be."""
    real = [draw.joints() for draw in asked]
    pairs = [(a[: len(b)], b[: len(a)]) for a, b in zip(made, real, strict=True)]
    return {
        name: float(torch.stack([metrics.mpjpe(a, b, aligned=aligned) for a, b in pairs]).mean())
        for name, aligned in (("mpjpe", False), ("mpjpe_aligned", True))
    }
