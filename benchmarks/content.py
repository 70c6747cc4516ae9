"""Does a generated clip show what its prompt says? Content accuracy, jerk, skating and diversity beside real takes.

Beside the standard evaluation (``moveset evaluate``), which reads sentences: a classifier trained on real training
takes judges clips generated from held-out wordings, one for every labelled test take, of that take's length, all models
with the same seeds.

    python benchmarks/content.py --model src/moveset/weights/motionpcm-small --out results/content.json
"""

import sys
import time
from dataclasses import asdict
from itertools import combinations
from pathlib import Path

import torch
from torch import Tensor

from arguments import SPLITS, Parser, at_least, between, known, report_path, write_report
from moveset.data.captions import heldout_captions, train_captions
from moveset.data.corpus import Corpus
from moveset.errors import InputError, exit_code_of
from moveset.evaluation.content_classifier import ContentClassifier
from moveset.evaluation.content_training import clip_features, content_class, labelled_clips, pad
from moveset.evaluation.frechet import frechet_distance
from moveset.evaluation.paired import paired_difference
from moveset.motion.clip import Motion
from moveset.motion.features import get_codec
from moveset.motion.measures import jerk, skating
from moveset.pipelines.bundle import Bundle
from moveset.pipelines.request import Method, Request
from moveset.pipelines.synonyms import as_written, in_known_words
from moveset.pipelines.text_to_motion import TextToMotion
from moveset.text.familiarity import KnownPrompts

#: Of the sentences: of words never trained on; these with everyday words read as users' are; or trained on.
WORDINGS = ("held-out", "read", "known")


def prompts_of(
    corpus: Corpus, splits: list[str], classes: set[str], copies: int, wording: str, known: KnownPrompts | None = None
) -> list[tuple[str, str, int, str]]:
    """(content class, sentence, frames, take) for every judged take of the splits, ``copies`` sentences each.

    Raises:
        InputError: sentences that are to be read by what is not known to be anybody's words.
    """
    if wording == "read" and known is None:
        raise InputError("wording 'read' needs a model's own words; give --model")
    out = []
    for split in splits:
        for k in corpus.indices(split, composed=False):
            label, frames = corpus.contents(k)[0], corpus.records[k].frames
            if content_class(label) not in classes or frames < 24:
                continue
            wordings = train_captions(label) if wording == "known" else heldout_captions(label)
            take = corpus.records[k].take
            out += [(content_class(label), wordings[(k + 3 * c) % len(wordings)], frames, take) for c in range(copies)]
    if wording != "read" or known is None:
        return out
    return [(label, in_known_words(text, known).text, frames, take) for label, text, frames, take in out]


def report(classifier: ContentClassifier, motions: list[Motion], labels: list[str], real: Tensor | None) -> dict:
    """Accuracy over clips and over classes, means of jerk and skating, diversity, distance to real."""
    said = []
    joints = [motion.joints for motion in motions]
    for k in range(0, len(joints), 64):
        said += classifier.predict(*pad(joints[k : k + 64])).labels
    right = torch.tensor([a == b for a, b in zip(said, labels, strict=True)]).float()
    classes = sorted(set(labels))
    per_class = {c: right[[k for k, label in enumerate(labels) if label == c]] for c in classes}
    features = clip_features(classifier, joints).double()
    spread = [
        torch.pdist(features[[k for k, label in enumerate(labels) if label == c]]).mean()
        for c in classes
        if labels.count(c) > 1
    ]
    out = {
        "accuracy": float(right.mean()),
        "balanced_accuracy": float(torch.stack([r.mean() for r in per_class.values()]).mean()),
        "jerk": float(torch.stack([jerk(j, 20.0) for j in joints]).mean()),
        "skating": float(torch.stack([skating(j, 20.0) for j in joints]).mean()),
        "diversity": float(torch.stack(spread).mean()),
        "hits": right.int().tolist(),
        "per_class": {c: [round(float(r.mean()), 3), len(r)] for c, r in per_class.items()},
    }
    if real is not None:
        out["frechet"] = frechet_distance(features, real)
    return out


@torch.inference_mode()
def reconstructed(bundle: Bundle, motion: Motion) -> Motion:
    """A motion through the autoencoder and back: what no denoiser can do better."""
    codec, n, vae = get_codec(bundle.config.codec), bundle.normalizer, bundle.module("vae")
    features, lengths = (codec.encode(motion) - n["feature_mean"]) / n["feature_std"], torch.tensor([len(motion)])
    made = vae.decode(vae.encode(features[None], lengths)[0], lengths, len(motion))[0]
    return codec.decode(made * n["feature_std"] + n["feature_mean"])


def main() -> None:
    """See the module."""
    parser = Parser()
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--corpus", type=Path, default=Path("data/corpus.safetensors"))
    parser.add_argument("--classifier", type=Path, default=Path("runs/classifier"))
    parser.add_argument("--networks", nargs="*", default=["teacher", "lcm-1", "pcm-1", "pcm-2", "pcm-4"])
    parser.add_argument(
        "--guidance", type=between(0, 30), nargs="*", default=[], help="instead of the model's own scales"
    )
    parser.add_argument("--splits", nargs="+", choices=SPLITS, default=["test"])
    parser.add_argument("--copies", type=at_least(1), default=2)
    parser.add_argument("--wording", choices=WORDINGS, default="held-out")
    parser.add_argument("--threads", type=at_least(1), default=2)
    parser.add_argument("--out", type=report_path)
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    bundle, corpus = Bundle.find(given.model), Corpus.open(given.corpus)
    classifier = ContentClassifier.load(given.classifier)
    known(given.networks, bundle.config.guidance, f"network of {bundle.config.name!r}")
    clips = [c for split in given.splits for c in labelled_clips(corpus, split) if c.label in classifier.labels]
    if not clips:
        raise InputError(f"{given.corpus} shows nothing that {given.classifier} knows in {', '.join(given.splits)}")
    real_features = clip_features(classifier, [c.joints for c in clips]).double()
    classes = set(classifier.labels)
    wanted = prompts_of(corpus, given.splits, classes, given.copies, given.wording, bundle.captions)
    as_written(bundle)
    requests = [Request((text,), (frames,), seed) for seed, (_, text, frames, _) in enumerate(wanted)]
    labels, takes = [label for label, *_ in wanted], [take for *_, take in wanted]
    t2m = TextToMotion(bundle, "cpu")
    real_motions = [corpus.motion(k) for s in given.splits for k in corpus.indices(s, composed=False)]
    shown = [content_class(corpus.contents(k)[0]) for s in given.splits for k in corpus.indices(s, composed=False)]
    keep = [k for k, c in enumerate(shown) if c in classifier.labels and len(real_motions[k]) >= 24]
    rows = {"real": report(classifier, [real_motions[k] for k in keep], [shown[k] for k in keep], None)}
    print(
        "real",
        {k: v for k, v in rows["real"].items() if k not in ("per_class", "hits")},
        len(keep),
        "takes",
        flush=True,
    )
    made_again = [reconstructed(t2m.bundle, real_motions[k]) for k in keep]
    rows["reconstructed"] = report(classifier, made_again, [shown[k] for k in keep], real_features)
    print(
        "reconstructed", {k: v for k, v in rows["reconstructed"].items() if k not in ("per_class", "hits")}, flush=True
    )
    hits: dict[str, list[int]] = {}
    order = sorted(range(len(requests)), key=lambda k: requests[k].frames[0] or 0)
    for network in given.networks:
        solver, _, steps = network.partition("-")
        for w in given.guidance or [t2m.bundle.config.guidance[network]]:
            method = Method(solver, network, int(steps or 50), w)
            start = time.perf_counter()
            made = t2m.generate([requests[k] for k in order], method, batch=64, foot_lock=True)
            for kind in ("raw", "motions"):
                name = f"{network} w={w:g}" + (" foot lock" if kind == "motions" else "")
                motions = [getattr(g, kind)[0] for g in made]
                rows[name] = report(classifier, motions, [labels[k] for k in order], real_features)
                rows[name]["seconds"] = round(time.perf_counter() - start, 1)
                print(name, {k: v for k, v in rows[name].items() if k not in ("per_class", "hits")}, flush=True)
                if kind == "motions":
                    hits[f"{network} w={w:g}"] = rows[name]["hits"]
    comparisons = {}
    for one, other in combinations(hits, 2):
        found = paired_difference(hits[one], hits[other], [takes[k] for k in order])
        comparisons[f"{one} - {other}"] = {k: round(100 * v, 2) for k, v in asdict(found).items()}
        print(f"{one} - {other}: {100 * found.mean:+.2f} points [{100 * found.low:+.2f}, {100 * found.high:+.2f}]")
    for row in rows.values():
        row.pop("hits")
    if given.out:
        found = {"splits": given.splits, "clips": len(requests), "rows": rows, "comparisons": comparisons}
        write_report(given.out, found)


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
