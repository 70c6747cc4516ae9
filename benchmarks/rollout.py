"""Ten minutes without an end in sight: does a stream drift, freeze, shake or forget what it was told, minute by minute?

    python benchmarks/rollout.py --networks rdm md pcm-4 --out results/rollout.json

One rollout for every sentence, and one of a timeline that changes every four seconds; all of a network are one batch.
For every minute: deviation and mean of normalised features (of the takes of training: 1 and 0), skating, root height,
jerk at seams and inside of segments, metres travelled, how far apart a segment and the one before it are (0: frozen),
and the share of windows of four segments that are judged to show what was said. "finished" is what a stream gives out:
seams smoothed and feet locked.
"""

import math
import sys
import time
from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import matplotlib
import torch
from torch import Tensor

from arguments import Parser, at_least, between, known, pairs, positive, report_path, write_report
from moveset.data import phrases
from moveset.data.captions import train_captions
from moveset.data.corpus import Corpus
from moveset.errors import InputError, exit_code_of
from moveset.evaluation.content_classifier import ContentClassifier
from moveset.evaluation.content_training import content_class, pad
from moveset.evaluation.generators import Wanted
from moveset.evaluation.streams import timeline
from moveset.motion.measures import skating
from stream_measures import seam_jerk
from stream_models import Method, Networks, finished_motion, raw_motion, segments_of
from stream_quality import scales

matplotlib.use("Agg")
from matplotlib import pyplot as plt

STAND = "stand"  # no class of the judge's: nobody in the data just stands
TIMELINE = ("walk", "wave-both-hands", "run", "raise-up-right-hand", "walk-turn-left", "bow")
EVERY = 4.0
HELD = 10**9  # frames: no network is told of so much time
WINDOW = 4


def rollouts(names: list[str], fps: float, minutes: float) -> dict[str, list[tuple[str, int]]]:
    """By rollout, contents and for how many frames they are said, these minutes and more."""
    held = {name: [(name, HELD)] for name in names}
    turns = math.ceil(minutes * 60 / EVERY) + 1
    return held | {"timeline": [(TIMELINE[k % len(TIMELINE)], round(EVERY * fps)) for k in range(turns)]}


def sentence(content: str) -> str:
    """What is said for a content."""
    return "a person stands still" if content == STAND else train_captions(content)[0]


def measured(features_FD: Tensor, joints: Tensor, n: int, fps: float) -> dict[str, float]:
    """What can be said of whole segments of normalised features and their joints (F, J, 3), whatever they show."""
    segments = features_FD.view(-1, n, features_FD.shape[1])
    seam, inside = seam_jerk(joints, n, fps)
    return {
        "std": float(segments.std(dim=(1, 2)).mean()),
        "mean": float(segments.mean(dim=(1, 2)).abs().mean()),
        "change": float((segments[1:] - segments[:-1]).square().mean().sqrt()),
        "skating": float(skating(joints, fps)),
        "root_height": float(joints[:, 0, 1].mean()),
        "jerk_seam": float(seam.mean()),
        "jerk_inside": float(inside.mean()),
    }


def minutes(
    judge: ContentClassifier, features_FD: Tensor, joints: Tensor, said: list[str], n: int, fps: float
) -> dict[str, list[float | None]]:
    """Measures of every minute of one rollout.

    Args:
        features_FD: normalised; joints: (F, J, 3) metres.
        said: the content of every segment.
    """
    each = round(60 * fps / n) * n
    out: dict[str, list[float | None]] = {}
    for begin in range(0, len(features_FD), each):
        x, body = features_FD[begin : begin + each], joints[begin : begin + each]
        if len(x) < 4 * n:
            break
        row: dict[str, float | None] = {**measured(x, body, n, fps)}
        row["travelled"] = float(body[:, 0, [0, 2]].diff(dim=0).norm(dim=-1).sum())
        row["content"] = shown(judge, body, said[begin // n : (begin + each) // n], n)
        for name, value in row.items():
            out.setdefault(name, []).append(value)
    return out


def shown(judge: ContentClassifier, joints: Tensor, said: list[str], n: int) -> float | None:
    """Share of windows of one content that are judged to show it; None where the judge does not know any."""
    windows, labels, k = [], [], 0
    while k < len(said):
        end = k
        while end < len(said) and said[end] == said[k] and end - k < WINDOW:
            end += 1
        if content_class(said[k]) in judge.labels and end - k >= 2:
            windows.append(joints[k * n : end * n].float())
            labels.append(content_class(said[k]))
        k = end
    if not windows:
        return None
    found = judge.predict(*pad(windows)).labels
    return sum(a == b for a, b in zip(found, labels, strict=True)) / len(labels)


def roll(
    networks: Networks, method: Method, lines: Sequence[Sequence[tuple[str, int]]], count: int, half: bool
) -> Tensor:
    """Normalised features (B, F, D) of all rollouts."""
    said = [Wanted(tuple((sentence(name), frames) for name, frames in line), seed=k) for k, line in enumerate(lines)]
    return torch.cat([s.clone() for s in islice(segments_of(networks, method, said, None, half), count)], dim=1)


PANELS = ("std", "change", "jerk_seam", "jerk_inside", "skating", "root_height", "travelled", "content")


def picture(path: Path, rows: dict[str, dict[str, dict]]) -> None:
    """One line of panels a network, one line a rollout; dashed: finished."""
    figure, axes = plt.subplots(len(rows), len(PANELS), figsize=(2.4 * len(PANELS), 2.1 * len(rows)), squeeze=False)
    for line, (network, found) in zip(axes, rows.items(), strict=True):
        for axis, measure in zip(line, PANELS, strict=True):
            for k, (name, kinds) in enumerate(found["rollouts"].items()):
                for kind, style in (("raw", "-"), ("finished", "--")):
                    if measure in kinds.get(kind, {}) and None not in kinds[kind][measure]:
                        label = name if kind == "raw" else None
                        values = kinds[kind][measure]
                        axis.plot(range(1, len(values) + 1), values, style, color=f"C{k}", lw=1, label=label)
            axis.set_title(f"{network}: {measure}", fontsize=7)
            axis.tick_params(labelsize=6)
            axis.grid(alpha=0.3)
    axes[0, 0].legend(fontsize=5)
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main() -> None:
    """See the module."""
    parser = Parser()
    parser.add_argument("--runs", type=Path, default=Path("runs/small"))
    parser.add_argument("--model", type=Path, help="a packed stream instead of the runs' latest checkpoints")
    parser.add_argument("--folder", nargs="*", default=[], metavar="NETWORK=FOLDER")
    parser.add_argument("--corpus", type=Path, default=Path("data/corpus.safetensors"))
    parser.add_argument("--classifier", type=Path, default=Path("runs/classifier"))
    parser.add_argument("--networks", nargs="*", default=["rdm", "md", "pcm-1", "pcm-2", "pcm-4"])
    parser.add_argument("--contents", nargs="*", default=["walk", "wave-both-hands", "run", STAND])
    parser.add_argument("--minutes", type=positive, default=10.0)
    parser.add_argument("--steps", type=at_least(1), default=10)
    parser.add_argument("--start", type=at_least(0), help="R of rdm; K by default")
    parser.add_argument("--lag", type=at_least(0), default=0, help="of rdm; K by default")
    parser.add_argument("--eta", type=between(0, 1), default=0.0)
    parser.add_argument("--guidance", nargs="*", default=[], metavar="[NETWORK=]W", help="instead of the model's own")
    parser.add_argument("--half", action="store_true", help="networks in bfloat16")
    parser.add_argument("--threads", type=at_least(1), default=2)
    parser.add_argument("--out", type=report_path)
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    networks = Networks(given.runs, given.model, pairs(given.folder, "--folder"))
    known(given.contents, (*phrases.TRAIN, STAND), "content")
    if not (asked := [name for name in given.networks if networks.has(name)]):
        raise InputError(
            f"none of {', '.join(given.networks)} is there; give --model, or --runs with their checkpoints"
        )
    classifier, w = ContentClassifier.load(given.classifier), scales(given.guidance, networks)
    n, fps = networks.frames, networks.codec.fps
    lines, count = rollouts(given.contents, fps, given.minutes), math.floor(given.minutes * 60 * fps / n)
    rows: dict[str, dict] = {"real": _real(networks, Corpus.open(given.corpus))}
    print("real", rows["real"], flush=True)
    for network in asked:
        student = network.startswith("pcm-")
        steps = int(network.removeprefix("pcm-")) if student else given.steps
        plan = {"start": given.start, "lag": given.lag} if network == "rdm" else {}
        eta, scale = 0.0 if student else given.eta, w[network]
        method = Method(network=network, steps=steps, eta=eta, guidance=scale, **plan)
        begun = time.perf_counter()
        features = roll(networks, method, list(lines.values()), count, given.half)
        spent = time.perf_counter() - begun
        found: dict[str, dict] = {}
        for (name, line), x in zip(lines.items(), features, strict=True):
            contents = timeline(Wanted(tuple(line), seed=0), fps, n / fps, stages=False)
            said = [contents(k) for k in range(count)]
            if not bool(torch.isfinite(x).all()):
                found[name] = {"finite": False}
                continue
            made = {"raw": raw_motion(networks, x).joints, "finished": finished_motion(networks, x).joints}
            found[name] = {k: minutes(classifier, x, joints, said, n, fps) for k, joints in made.items()}
            _say(method.name, name, found[name])
        rows[method.name] = {"seconds": round(spent, 1), "rollouts": found}
        if given.out:
            write_report(given.out, {"minutes": given.minutes, "rows": rows})
            picture(given.out.with_suffix(".png"), {k: v for k, v in rows.items() if "rollouts" in v})


def _real(networks: Networks, corpus: Corpus) -> dict[str, float]:
    """The same numbers of test takes, for comparison."""
    n, fps = networks.frames, networks.codec.fps
    found: dict[str, list[float]] = {}
    for k in corpus.indices("test", composed=False):
        clip = networks.store.clips[2 * k]
        x = torch.tensor(networks.store.features[clip.start : clip.start + clip.frames // n * n])
        if len(x) < 2 * n:
            continue
        row = measured(x, raw_motion(networks, x).joints, n, fps)
        for name, value in row.items():
            found.setdefault(name, []).append(value)
    return {name: round(sum(values) / len(values), 4) for name, values in found.items()}


def _say(method: str, rollout: str, kinds: dict[str, dict]) -> None:
    for kind, measures in kinds.items():
        ends = {k: [None if v is None else round(v, 3) for v in (vs[0], vs[-1])] for k, vs in measures.items()}
        print(method, rollout, kind, "first and last minute:", ends, flush=True)


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
