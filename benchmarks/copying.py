"""Does a model copy? Distance from every motion to the nearest clip of the training, as the judge sees both.

    python benchmarks/copying.py real pcm teacher --out docs/metrics/copying.json

Real test motion is the scale: nobody copied it. A model that copies lies nearer to its training than that does.
Euclidean distances in the evaluator's space; median and 5th percentile over the items, of one repeat.
"""

import sys
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from arguments import SPLITS, Parser, report_path, write_report
from moveset.errors import exit_code_of
from moveset.evaluation.evaluator import DEFAULT_EVALUATOR
from moveset.evaluation.generators import Wanted
from moveset.evaluation.protocol import Protocol, Session, features_of, random_of, real_features, seed_of
from moveset.evaluation.run import EvaluationConfig, open_session
from moveset.evaluation.samples import open_test_set
from moveset.evaluation.suites import REAL


def nearest(motion_ME: Tensor, known_NE: Tensor) -> Tensor:
    """(M,) distances from each to the nearest of the others."""
    return torch.cat([torch.cdist(part, known_NE).amin(dim=1) for part in motion_ME.split(256)])


def embedded(session: Session) -> Tensor:
    """(M, E) of what a source makes for the items, as the first repeat of an evaluation asks for it."""
    asked = session.items.draw(random_of(session.protocol, 0, "items"))
    wanted = [Wanted(((d.prompt, d.frames),), seed_of(session.protocol, 0, d.item.name), d) for d in asked]
    made = session.generator.generate(wanted, session.items.codec.fps)
    return session.evaluator.embed_motions(features_of(session.generator, asked, made, session.items.codec))


def main() -> None:
    """See the module."""
    parser = Parser(description=main.__doc__)
    parser.add_argument("model", nargs="+", help="as for moveset evaluate")
    parser.add_argument("--data", type=Path, default=Path("data/corpus.safetensors"))
    parser.add_argument("--evaluator", default=DEFAULT_EVALUATOR)
    parser.add_argument("--split", choices=SPLITS, default="test")
    parser.add_argument("--steps", type=int, help="of the sampler; the network's own by default")
    parser.add_argument("--out", type=report_path, required=True)
    given = parser.parse_args()
    torch.set_num_threads(1)
    config = EvaluationConfig(
        data=given.data, evaluator=given.evaluator, protocol=Protocol(split=given.split, repeats=1), composed=False
    )
    learned = open_test_set(given.data, "train")
    draws = learned.draw(torch.Generator().manual_seed(0))
    found = {}
    known = open_session(config).evaluator.embed_motions(real_features(draws, learned.codec))
    for model in given.model:
        steps = None if model == REAL else given.steps
        distance = nearest(embedded(open_session(replace(config, model=model, steps=steps))), known)
        found[model] = {"median": float(distance.median()), "p5": float(distance.quantile(0.05))}
        print(f"{model}: median {found[model]['median']:.3f}, 5th percentile {found[model]['p5']:.3f}", flush=True)
    write_report(given.out, {"training": len(learned), "split": given.split, "models": found})


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
