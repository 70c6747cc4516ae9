"""Quality of recurrent diffusion against its baselines at the same number of network calls.

    python benchmarks/stream_quality.py --out results/stream.json                         (all rows)
    python benchmarks/stream_quality.py --splits val --curves --out results/curves.json   (what depends on R, lag and K)

One sequence for every labelled take, of its length, said in held-out or known words and judged as in ``content.py``.
Besides that: laws of segments (Fréchet distances of their principal components to the takes' own segments at the same
places), jerk at seams beside jerk inside (the same frames of real takes beside them), and the spread of samples of one
prompt by segment, which falls where later segments collapse. "real" is the takes; "train takes" are others of the same
contents: what a perfect model would get. Calls and waves are of a sequence of seven segments; with guidance by two
evaluations every call evaluates two rows.
"""

import argparse
import json
import math
import random
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path

import matplotlib
import torch
from torch import Tensor

from arguments import SPLITS, Parser, at_least, between, pairs, report_path, scale, write_report
from content import WORDINGS, prompts_of, report
from moveset.data.captions import train_captions
from moveset.data.corpus import Corpus
from moveset.errors import InputError, exit_code_of
from moveset.evaluation.content_classifier import ContentClassifier
from moveset.evaluation.content_training import clip_features, content_class, labelled_clips
from moveset.evaluation.paired import paired_difference
from moveset.motion.clip import Motion
from stream_measures import SegmentSpace, change, cut, seams, segment_laws, spread
from stream_models import Method, Networks, finished_motion, raw_motion, sample_all

matplotlib.use("Agg")
from matplotlib import pyplot as plt

SPREAD_CONTENTS = ("walk", "run", "wave-both-hands", "raise-up-right-hand", "salsa", "walk-turn-left")
SPREAD_SEGMENTS = 4
HORIZON = 7
STUDENTS = (1, 2, 4)


class Judge:
    """Everything real that samples are compared with."""

    def __init__(self, networks: Networks, corpus: Corpus, classifier: ContentClassifier, given: argparse.Namespace):
        self.networks, self.corpus, self.classifier, self.given = networks, corpus, classifier, given
        clips = [c for s in given.splits for c in labelled_clips(corpus, s) if c.label in classifier.labels]
        if not clips:
            raise InputError(f"{given.corpus} shows nothing that {given.classifier} knows in {', '.join(given.splits)}")
        self.real_features = clip_features(classifier, [c.joints for c in clips]).double()
        classes = set(classifier.labels)
        wanted = prompts_of(corpus, given.splits, classes, given.copies, given.wording, networks.captions)
        if given.items and given.items < len(wanted):
            wanted = sorted(random.Random(0).sample(wanted, given.items), key=wanted.index)
        self.said_of = [take for *_, take in wanted]
        self.labels = [label for label, *_ in wanted]
        self.wanted = [(sentence, min(frames, HORIZON * networks.frames)) for _, sentence, frames, _ in wanted]
        self.takes = [self._features(k) for s in given.splits for k in corpus.indices(s, composed=False)
                      if content_class(corpus.contents(k)[0]) in classifier.labels]  # fmt: skip
        self.by_label: dict[str, list[int]] = {}
        for k in corpus.indices("train", composed=False):
            self.by_label.setdefault(content_class(corpus.contents(k)[0]), []).append(k)
        known = [k for label in classifier.labels for k in self.by_label[label]]
        train = cut([self._features(k) for k in random.Random(0).sample(known, min(400, len(known)))], networks.frames)
        self.space = SegmentSpace.fit(torch.cat(list(train.values())))
        self.real_cut = cut(self.takes, networks.frames)

    def _features(self, record: int) -> Tensor:
        clip = self.networks.store.clips[2 * record]
        return torch.tensor(self.networks.store.features[clip.start : clip.start + clip.frames])

    def judge(self, sequences: list[Tensor], labels: list[str], finished: bool = False) -> dict:
        """All measures of sequences of normalised features (F, D)."""
        make = finished_motion if finished else raw_motion
        motions = [make(self.networks, features) for features in sequences]
        single = [Motion(m.rotations.float(), m.root.float(), m.fps, m.skeleton) for m in motions]
        out = report(self.classifier, single, labels, self.real_features)
        out |= seams([m.joints for m in motions], self.networks.frames, self.networks.codec.fps)
        if not finished:
            out |= segment_laws(self.space, cut(sequences, self.networks.frames), self.real_cut)
        return out

    def reference(self) -> dict[str, dict]:
        """The takes themselves, and as many takes of training of the same contents."""
        labels = [content_class(self.corpus.contents(k)[0]) for s in self.given.splits
                  for k in self.corpus.indices(s, composed=False)
                  if content_class(self.corpus.contents(k)[0]) in self.classifier.labels]  # fmt: skip
        long = [k for k, take in enumerate(self.takes) if len(take) >= 24]
        rows = {"real": self.judge([self.takes[k] for k in long], [labels[k] for k in long])}
        pick = random.Random(0)
        others = [self._features(pick.choice(self.by_label[label])) for label in self.labels]
        kept = [k for k, take in enumerate(others) if len(take) >= 24]
        rows["train takes"] = self.judge([others[k] for k in kept], [self.labels[k] for k in kept])
        rows["train takes"] |= self.real_spread()
        return rows

    def real_spread(self) -> dict:
        """Spread of real takes of one content, by number of the segment, and change from one to the next."""
        n, rows, changes = self.networks.frames, [], []
        for content in SPREAD_CONTENTS:
            takes = [self._features(k) for k in self.by_label[content]]
            takes = [
                take[: SPREAD_SEGMENTS * n].view(SPREAD_SEGMENTS, n, -1)
                for take in takes
                if len(take) >= SPREAD_SEGMENTS * n
            ]
            if len(takes) >= 3:
                rows.append(spread(self.space, torch.stack(takes[:64])))
                changes.append(change(self.space, torch.stack(takes[:64])))
        return _spread_row(rows, changes)

    def sampled_spread(self, method: Method) -> dict:
        """The same of samples of one sentence."""
        n, each = self.networks.frames, self.given.spread
        rows, changes = [], []
        wanted = [(train_captions(c)[0], SPREAD_SEGMENTS * n) for c in SPREAD_CONTENTS for _ in range(each)]
        made = torch.stack(sample_all(self.networks, method, wanted, self.given.half))
        for samples in made.view(len(SPREAD_CONTENTS), each, SPREAD_SEGMENTS, n, -1):
            rows.append(spread(self.space, samples))
            changes.append(change(self.space, samples))
        return _spread_row(rows, changes)

    def row(self, method: Method) -> dict[str, dict]:
        """Rows of one method by name: as sampled, and as a stream gives it out."""
        start = time.perf_counter()
        made = sample_all(self.networks, method, self.wanted, self.given.half)
        if not all(bool(torch.isfinite(features).all()) for features in made):
            return {method.name: {"finite": False}}
        plan = method.staircase(HORIZON)
        rows = {method.name: {"calls": plan.calls, "waves": plan.waves, **self.judge(made, self.labels)}}
        if self.given.spread:
            rows[method.name] |= self.sampled_spread(method)
        rows[method.name]["seconds"] = round(time.perf_counter() - start, 1)
        if self.given.finished:
            rows[f"{method.name} finished"] = self.judge(made, self.labels, finished=True)
        return rows


def _spread_row(rows: list[list[float]], changes: list[float]) -> dict:
    by_segment = torch.tensor(rows).mean(dim=0)
    return {
        "spread": [round(float(s), 3) for s in by_segment],
        "spread_kept": float(by_segment[2:].mean() / by_segment[0]),
        "change": sum(changes) / len(changes),
    }


def methods(networks: Networks, steps: list[int], w: dict[str, float], eta: float) -> list[Method]:
    """The table: RDM in all its ways and MD at each K, and the students."""
    out = []
    for k in steps:
        rdm = Method(network="rdm", steps=k, guidance=w["rdm"], eta=eta)
        out += [
            rdm,
            replace(rdm, lag=1),
            replace(rdm, start=math.ceil(k / 3), lag=1),
            replace(rdm, start=min(HORIZON, k), shape="triangle", lag=1),
            replace(rdm, start=0, lag=1),
            Method(network="md", steps=k, guidance=w["md"], eta=eta),
        ]
    out += [Method(network=f"pcm-{k}", steps=k, guidance=w[f"pcm-{k}"]) for k in STUDENTS]
    return [m for m in out if networks.has(m.network)]


def curves(steps: int, w: float, eta: float) -> dict[str, list[tuple[float, Method]]]:
    """What is varied: R, lag and K, and the guidance scale; x and the method."""
    rdm = Method(network="rdm", steps=steps, guidance=w, eta=eta)
    starts = sorted({0, 1, 2, math.ceil(steps / 5), math.ceil(steps / 3), math.ceil(steps / 2), steps})
    lags = sorted({1, 2, max(1, steps // 5), max(1, steps // 2), steps})
    return {
        "R": [(r, replace(rdm, start=r, lag=1)) for r in starts],
        "lag": [(lag, replace(rdm, lag=lag)) for lag in lags],
        "K": [(k, replace(rdm, steps=k)) for k in (4, 10, 25, 50)],
        "K, R = K/3": [(k, replace(rdm, steps=k, start=math.ceil(k / 3), lag=1)) for k in (4, 10, 25, 50)],
    }


PANELS = ("accuracy", "frechet", "segment_frechet_later", "jerk_ratio", "jerk", "spread_kept")


def picture(path: Path, drawn: dict[str, list[tuple[float, dict]]], rows: dict[str, dict]) -> None:
    """One column a curve, one line of panels a measure; dashed: takes of training."""
    figure, axes = plt.subplots(len(PANELS), len(drawn), figsize=(3 * len(drawn), 1.9 * len(PANELS)), squeeze=False)
    for column, (name, points) in enumerate(drawn.items()):
        for axis, measure in zip(axes[:, column], PANELS, strict=True):
            shown = [(x, row[measure]) for x, row in points if measure in row]
            axis.plot([x for x, _ in shown], [y for _, y in shown], "o-", ms=3, lw=1)
            if measure in rows["train takes"]:
                axis.axhline(rows["train takes"][measure], ls="--", lw=0.8, color="grey")
            axis.set_title(f"{measure} by {name}", fontsize=8)
            axis.tick_params(labelsize=7)
            axis.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def scales(given: list[str], networks: Networks) -> dict[str, float]:
    """Guidance by network: from "W" for all, "NAME=W" for one and "pcm=W" for all students, or else the model's own,
    and 1.5 of runs, which have none. "pcm" is of students that are not named.

    Raises:
        InputError: there is no such network.
    """
    own = {name.partition("-")[0]: w for name, w in networks.guidance.items()}
    out = dict.fromkeys(("rdm", "md", "pcm", *(f"pcm-{k}" for k in STUDENTS)), 1.5) | own | networks.guidance
    # What is said of all first, then of all students, then of one.
    for item in sorted(given, key=lambda item: ("=" in item, "-" in item.partition("=")[0])):
        name, equals, w = item.rpartition("=")
        meant = [one for one in out if not equals or name in (one, one.partition("-")[0])]
        if not meant:
            raise InputError(f"--guidance: {name!r} is none of {', '.join(out)}")
        out |= dict.fromkeys(meant, scale(w))
    return out


def method_of(text: str) -> Method:
    """A row by hand.

    Raises:
        InputError: no JSON object of the fields of ``Method``.
    """
    try:
        method = Method(**json.loads(text))
        method.staircase(HORIZON)
    except (ValueError, TypeError) as error:
        raise InputError(f"--methods {text!r} is no JSON object of fields of Method ({error})") from error
    return method


def main() -> None:
    """See the module."""
    parser = Parser()
    parser.add_argument("--runs", type=Path, default=Path("runs/small"))
    parser.add_argument("--model", type=Path, help="a packed stream instead of the runs' latest checkpoints")
    parser.add_argument("--folder", nargs="*", default=[], metavar="NETWORK=FOLDER")
    parser.add_argument("--corpus", type=Path, default=Path("data/corpus.safetensors"))
    parser.add_argument("--classifier", type=Path, default=Path("runs/classifier"))
    parser.add_argument("--splits", nargs="+", choices=SPLITS, default=["test"])
    parser.add_argument("--wording", choices=WORDINGS, default="held-out")
    parser.add_argument("--copies", type=at_least(1), default=2)
    parser.add_argument("--items", type=at_least(0), default=0, help="only so many sequences, drawn at random")
    parser.add_argument(
        "--spread", type=at_least(0), default=12, help="samples of one sentence; 0 leaves the spread out"
    )
    parser.add_argument("--steps", type=at_least(1), nargs="+", default=[10, 50], help="K of the table")
    parser.add_argument("--guidance", nargs="*", default=[], metavar="[NETWORK=]W", help="instead of the model's own")
    parser.add_argument("--eta", type=between(0, 1), default=0.0)
    parser.add_argument("--only", nargs="*", default=[], metavar="WORD", help="only rows whose names hold all of these")
    parser.add_argument("--methods", nargs="*", default=[], metavar="JSON", help="rows by hand: fields of Method")
    parser.add_argument("--curves", action="store_true", help="R, lag and K instead of the table")
    parser.add_argument("--curve-steps", type=at_least(1), default=20)
    parser.add_argument("--finished", action="store_true", help="judge with seams smoothed and feet locked, too")
    parser.add_argument("--half", action="store_true", help="networks in bfloat16")
    parser.add_argument("--threads", type=at_least(1), default=2)
    parser.add_argument("--out", type=report_path)
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    by_hand = [method_of(text) for text in given.methods]
    networks = Networks(given.runs, given.model, pairs(given.folder, "--folder"))
    judge = Judge(networks, Corpus.open(given.corpus), ContentClassifier.load(given.classifier), given)
    w, drawn = scales(given.guidance, networks), {}
    asked: list[tuple[str, float, Method]] = [("", 0.0, m) for m in methods(networks, given.steps, w, given.eta)]
    if given.curves:
        found = curves(given.curve_steps, w["rdm"], given.eta)
        asked = [(curve, x, method) for curve, points in found.items() for x, method in points]
    if by_hand:
        asked = [("", 0.0, method) for method in by_hand]
    asked = [one for one in asked if all(word in one[2].name.split() for word in given.only)]
    if not asked:
        raise InputError("no row is left of those asked for; leave --only out, or give runs or a model that has them")
    for _, _, method in asked:
        method.staircase(HORIZON)
    rows = judge.reference()
    for name, row in rows.items():
        _say(name, row)
    for curve, x, method in asked:
        if method.name not in rows:
            made = judge.row(method)
            rows |= made
            for name, row in made.items():
                _say(name, row)
        drawn.setdefault(curve, []).append((x, rows[method.name]))
        if given.out:
            _write(given, judge, asked, rows, drawn)
    for name, found in comparisons(judge, [method.name for _, _, method in asked], rows).items():
        print(f"{name}: {found['mean']:+.2f} points [{found['low']:+.2f}, {found['high']:+.2f}]")


def _write(
    given: argparse.Namespace,
    judge: Judge,
    asked: list[tuple[str, float, Method]],
    rows: dict[str, dict],
    drawn: dict[str, list[tuple[float, dict]]],
) -> None:
    """All rows so far, after every row: hours are not lost to the last of them."""
    names = [m.name for _, _, m in asked]
    found = {
        "splits": given.splits,
        "wording": given.wording,
        "sequences": len(judge.wanted),
        "rows": {name: {k: v for k, v in row.items() if k != "hits"} for name, row in rows.items()},
        "comparisons": comparisons(judge, names, rows),
        "curves": {curve: [[x, m.name] for c, x, m in asked if c == curve] for curve in drawn if curve},
    }
    write_report(given.out, found)
    if given.curves:
        picture(given.out.with_suffix(".png"), drawn, rows)


def comparisons(judge: Judge, names: list[str], rows: dict[str, dict]) -> dict[str, dict]:
    """Accuracy of every method less that of the first one, in points, sequence by sequence."""
    out = {}
    hits = {name: rows[name]["hits"] for name in names if "hits" in rows.get(name, {})}
    first, *others = list(hits) or [""]
    for name in others:
        found = paired_difference(hits[name], hits[first], judge.said_of)
        out[f"{name} - {first}"] = {k: round(100 * v, 2) for k, v in asdict(found).items()}
    return out


def _say(name: str, row: dict) -> None:
    shown = {k: round(v, 3) if isinstance(v, float) else v for k, v in row.items() if k not in ("per_class", "hits")}
    print(name, shown, flush=True)


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
