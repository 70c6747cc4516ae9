"""Standing still, which no take of the corpus is for: made of moments in which people wait before and after they act.

A stream that nobody has told anything stands, and so does one between two actions. Where a take is quiet for a moment,
with the hands hanging, those frames played forwards and backwards by turns are a person who stands, and sways as people
do. Half of the clips are that, a quarter end in it after an action, and a quarter begin with it.
"""

import random
from dataclasses import replace

import torch

from moveset.data.augment import compose_in_time
from moveset.data.compose import ON_THE_SPOT, TRAVELLING
from moveset.data.corpus import Corpus
from moveset.data.segments import Row
from moveset.data.splits import Split
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.features import FeatureCodec, Normalizer
from moveset.motion.skeleton import HML22

SENTENCES = (
    "a person stands still", "a person stands", "a person is standing", "a person is standing still", "someone stands",
    "someone is standing still", "a man stands still", "a woman stands still", "he stands", "she is standing",
    "stand still", "stand", "stands still", "standing", "standing still", "stay where you are", "stand and wait",
    "a person stands and waits", "a person waits", "wait", "a person does nothing", "do nothing", "stop", "idle",
    "a person stops and stands still", "the person stops", "stand idle", "a person stands idle",
    "the figure stands still",
)  # fmt: skip
QUIET = 0.2  # m/s that no joint exceeds
HANGING = 0.1  # metres over the pelvis that no wrist is
LEAST = 12  # frames of a quiet moment
SLOW = 28  # frames below which it is played at half its speed
LONG = 84  # frames of a clip that is nothing else
HELD = 56  # frames of standing before or after an action
_ACTION = 84  # frames of the action, at most
_BLEND = 12
_WRISTS = [HML22.index(f"{side}_wrist") for side in ("left", "right")]


def make_stills(
    corpus: Corpus, split: Split, codec: FeatureCodec, normalizer: Normalizer, count: int, seed: int = 0
) -> list[Row]:
    """So many clips of one split, none if nobody in it stands still; the same for the same seed."""
    chance = random.Random(f"stills of {split}, seed {seed}")
    takes = {k: corpus.motion(k) for k in corpus.indices(split, composed=False)}
    moments = [(k, *found) for k, motion in takes.items() if (found := quiet_moment(motion)) is not None]
    acting = [k for k in takes if corpus.contents(k)[0] in (*TRAVELLING, *ON_THE_SPOT) and len(takes[k]) >= 3 * _BLEND]
    if not moments:
        return []
    made = []
    for number in range(count):
        take, start, stop = chance.choice(moments)
        mirrored = chance.random() < 0.5
        kind = ("alone", "after", "alone", "before")[number % 4] if acting else "alone"
        frames = LONG if kind == "alone" else HELD
        still = swaying(takes[take][start:stop], frames, chance.randrange(1000))
        still = still.mirrored() if mirrored else still
        if kind == "alone":
            motion, ends, said = still, (frames,), (SENTENCES,)
        else:
            action = chance.choice(acting)
            other = takes[action].mirrored() if mirrored else takes[action]
            words = corpus.captions(action, mirrored)
            if kind == "after":
                other = other[max(0, len(other) - _ACTION) :]
                other = other[: _leaving(other, still)]
                motion, said = compose_in_time(other, still, _BLEND), (words, SENTENCES)
            else:
                other = other[:_ACTION]
                motion, said = compose_in_time(still, other, _BLEND), (SENTENCES, words)
            seam = (len(other) if kind == "after" else frames) - _BLEND // 2
            ends = (seam, len(motion))
        features = normalizer.normalize(codec.encode(motion)).half().numpy()
        made.append(Row(features, ends, said, whole=()))
    return made


def quiet_moment(motion: Motion) -> tuple[int, int] | None:
    """The longest stretch (start, stop) in which somebody stands with hanging hands; None if there is none."""
    joints = motion.joints
    speed = joints.diff(dim=0).norm(dim=-1).amax(dim=1) * motion.fps
    hanging = (joints[:, _WRISTS, 1] < joints[:, :1, 1] + HANGING).all(dim=1)
    quiet = (speed < QUIET) & hanging[1:] & hanging[:-1]
    best, begun = (0, 0), None
    for frame, still in enumerate([*quiet.tolist(), False]):
        if still and begun is None:
            begun = frame
        if not still and begun is not None:
            # `frame` steps in a row join one frame more.
            best = max(best, (begun, frame + 1), key=lambda found: found[1] - found[0])
            begun = None
    return best if best[1] - best[0] >= LEAST else None


def swaying(motion: Motion, frames: int, phase: int = 0) -> Motion:
    """So many frames of a motion played forwards and backwards by turns, beginning at a phase of that."""
    if len(motion) < SLOW:
        motion = replace(motion.resampled(2 * motion.fps), fps=motion.fps)
    last = len(motion) - 1
    place = (torch.arange(frames) + phase) % (2 * last)
    order = torch.where(place > last, 2 * last - place, place)
    return Motion(motion.rotations[order], motion.root[order], motion.fps, motion.skeleton)


def _leaving(action: Motion, still: Motion) -> int:
    """How many frames of the action are shown: up to where, in its last third, its pose is most like the still one."""
    first = max(3 * _BLEND, 2 * len(action) // 3)
    if first >= len(action):
        return len(action)
    # The overlap is compared at its middle, where both count half.
    rows = torch.arange(first, len(action) + 1) - _BLEND // 2
    poses, pose = (rotations.to_6d(q[:, 1:]).flatten(1) for q in (action.rotations[rows], still.rotations))
    gap = torch.cdist(poses, pose[_BLEND // 2 : _BLEND // 2 + 1])[:, 0]
    return first + int(gap.argmin())
