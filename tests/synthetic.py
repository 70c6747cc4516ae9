"""Motion made from formulas: walks, runs, turns, waves, raised arms. Small, instant, and nobody's data, for tests."""

import math
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from moveset.data.bandai_captions import bandai_captions
from moveset.data.compose import add_compositions
from moveset.data.corpus import CorpusWriter
from moveset.data.records import ClipRecord
from moveset.data.splits import Split
from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.skeleton import HML22

#: Content labels, the same as those of real takes.
KINDS = (
    "walk",
    "run",
    "walk-turn-left",
    "walk-turn-right",
    "walk-back",
    "wave-left-hand",
    "wave-right-hand",
    "wave-both-hands",
    "raise-up-left-hand",
    "raise-up-right-hand",
    "raise-up-both-hands",
    "bow",
)


def _about(axis: str, radians: Tensor) -> Tensor:
    return rotations.about(axis, torch.rad2deg(radians))


def synthetic_motion(
    kind: str = "walk", frames: int = 60, *, seed: int = 0, fps: float = 20.0, speed: float | None = None
) -> Motion:
    """A plausible stick-figure motion on ``hml22``.

    Args:
        kind: one of ``KINDS``.
        frames: 1 or more.
        seed: varies tempo, amplitudes and posture a little; the same seed gives the same motion.
        speed: metres per second for kinds that travel; None for a usual one.

    Raises:
        InputError: an unknown kind or no frames.
    """
    if kind not in KINDS or frames < 1:
        raise InputError(f"no synthetic motion {kind!r} of {frames} frames; use 1 or more of {', '.join(KINDS)}")
    vary = 0.9 + 0.2 * torch.rand(8, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    time = torch.arange(frames, dtype=torch.float64) / fps
    progress = torch.linspace(0, 1, frames, dtype=torch.float64)
    local = rotations.identity(frames, len(HML22)).double()

    travels = kind.startswith(("walk", "run"))
    pace = 0.0
    if travels:
        pace = speed if speed is not None else (2.7 if kind == "run" else 1.2) * float(vary[0])
        pace = -abs(pace) * 0.7 if kind == "walk-back" else pace
    # One stride (two steps) of a walk covers about 1.3 m, of a run about 2 m.
    phase = 2 * math.pi * time * abs(pace) / (2.0 if kind == "run" else 1.3) + float(vary[1])
    swing = (0.75 if kind == "run" else 0.45) * float(vary[2]) * travels
    for side, shift in (("left", 0.0), ("right", math.pi)):
        leg = swing * torch.sin(phase + shift)
        bend = swing * (1.1 + 1.1 * torch.sin(phase + shift + 1.1)) + 0.06
        local[:, HML22.index(f"{side}_hip")] = _about("x", -leg)
        local[:, HML22.index(f"{side}_knee")] = _about("x", bend)
        local[:, HML22.index(f"{side}_ankle")] = _about("x", leg - bend)
        out = 1.0 if side == "left" else -1.0
        hang = _about("z", torch.full((frames,), -1.3 * out, dtype=torch.float64))
        local[:, HML22.index(f"{side}_shoulder")] = rotations.mul(_about("x", leg * 0.7), hang)
        fold = (1.2 if kind == "run" else 0.25) * float(vary[3])
        local[:, HML22.index(f"{side}_elbow")] = _about("y", torch.full((frames,), -fold * out, dtype=torch.float64))

    up = torch.sin(progress * math.pi).clamp(0, 0.5) * 2
    up = up * up * (3 - 2 * up)
    for side in ("left", "right"):
        if kind.startswith(("wave", "raise")) and (side in kind or "both" in kind):
            out = 1.0 if side == "left" else -1.0
            lift = -1.3 + up * (2.4 if kind.startswith("raise") else 1.4) * float(vary[4])
            local[:, HML22.index(f"{side}_shoulder")] = _about("z", lift * out)
            shake = (0.9 + 0.5 * torch.sin(2 * math.pi * 1.6 * float(vary[5]) * time)) * kind.startswith("wave")
            local[:, HML22.index(f"{side}_elbow")] = _about("z", up * shake * out)
    if kind == "bow":
        for joint in ("spine1", "spine2", "spine3"):
            local[:, HML22.index(joint)] = _about("x", 0.35 * up * float(vary[6]))

    turn = progress * (math.pi / 2) * (1 if kind.endswith("left") else -1) * ("turn" in kind)
    local[:, 0] = rotations.yaw(turn)
    forward = torch.stack((torch.sin(turn), torch.zeros_like(turn), torch.cos(turn)), dim=-1)
    root = torch.cat((torch.zeros(1, 3, dtype=torch.float64), (forward[:-1] * pace / fps).cumsum(0)))
    motion = Motion(local.float(), root.float(), fps)
    # The lower foot stands on the floor in every frame.
    lowest = motion.joints[:, list(HML22.feet), 1].min(dim=1).values
    return Motion(motion.rotations, motion.root - lowest[:, None] * torch.tensor((0.0, 1.0, 0.0)), fps)


@dataclass(frozen=True, eq=False)
class TakeEntry:
    """A clip to be stored with a run of its own: fields as in ``ClipRecord``, captions as sentences."""

    name: str
    take: str
    source: str
    content: str
    style: str | None
    captions: tuple[str, ...]
    split: Split
    subject: str
    motion: Motion
    first_frame: int = 0


def add_take(writer: CorpusWriter, entry: TakeEntry) -> int:
    """Store a clip with a run of its own; returns its number."""
    record = ClipRecord(
        name=entry.name,
        take=entry.take,
        source=entry.source,
        subject=entry.subject,
        group=entry.take,
        kind="take",
        contents=(entry.content,),
        style=entry.style,
        split=entry.split,
        fps=entry.motion.fps,
        frames=len(entry.motion),
        captions=(),
        first_frame=entry.first_frame,
        run=writer.add_run(entry.take, entry.motion, entry.first_frame),
    )
    return writer.add_clip(record, entry.captions)


def synthetic_corpus(path: str | Path, clips: int = 24, seed: int = 0, held_out: int | None = None) -> Path:
    """A small corpus of synthetic takes in every split, and a few training compositions.

    Args:
        held_out: of them for testing and validation, by turns; by default a fifth.

    Raises:
        InputError: fewer than 12 clips, or the path cannot be written.
    """
    if clips < 12:
        raise InputError(f"a synthetic corpus of {clips} clips cannot fill three splits; use at least 12")
    held_out = max(4, clips // 5) if held_out is None else held_out
    writer = CorpusWriter()
    generator = torch.Generator().manual_seed(seed)
    for k in range(clips):
        kind = KINDS[k % len(KINDS)]
        split: Split = "train" if k < clips - held_out else "val" if k % 2 else "test"
        frames = int(torch.randint(40, 120, (1,), generator=generator))
        add_take(
            writer,
            TakeEntry(
                name=f"synthetic_{kind}_{k:03d}",
                take=f"synthetic_{kind}_{k:03d}",
                source="synthetic",
                content=kind,
                style="normal",
                captions=bandai_captions(kind),
                split=split,
                subject="synthetic",
                motion=synthetic_motion(kind, frames, seed=seed * 1000 + k),
            ),
        )
    add_compositions(writer, train=max(4, clips // 3), seed=seed)
    return writer.write(path)
