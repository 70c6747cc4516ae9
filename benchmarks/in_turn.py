"""Does a stream do in turn what it is told, how soon, and is it still right when the next sentence comes?

    python benchmarks/in_turn.py rdm-small rdm-small:pcm-1 --segments 5 --out in-turn.json

So many streams, of seeds 0, 1, …, are told one sentence after another, each for the same number of segments. Of each
sentence the share of them that have done what it says (``DONE``) by the end of its first segment, its second, …, and of
those that are as it says in its last one (``last``): who sits goes on sitting, who waves goes on waving or not.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from arguments import Parser, at_least, report_path, sampled, write_report
from moveset.errors import exit_code_of
from moveset.motion.clip import Motion
from moveset.motion.skeleton import HML22
from moveset.pipelines.model_config import StreamConfig
from moveset.pipelines.model_folder import ModelFolder
from moveset.pipelines.stream_batch import StreamBatch
from moveset.pipelines.stream_settings import check_stream

_HIPS, _NECK, _HEAD = (HML22.index(name) for name in ("pelvis", "neck", "head"))
_WRIST = HML22.index("right_wrist")


def _up(joints_FJ3: Tensor) -> bool:
    """Upright on the legs at the end."""
    last = joints_FJ3[-1]
    return float(last[_HIPS, 1]) > 0.8 and float(last[_HEAD, 1] - last[_HIPS, 1]) > 0.4


def _waves(joints_FJ3: Tensor) -> bool:
    """The right hand goes to and fro while it is raised: half a metre of way at least."""
    raised = joints_FJ3[1:, _WRIST, 1] > joints_FJ3[1:, _NECK, 1] - 0.3
    way = (joints_FJ3[:, _WRIST] - joints_FJ3[:, _HIPS]).diff(dim=0).norm(dim=-1)
    return float(way[raised].sum()) > 0.5


#: Whether one segment (F, J, 3) at 20 frames a second shows what a sentence says, in the order that streams are told.
DONE: dict[str, Callable[[Tensor], bool]] = {
    "a person sits down": lambda j: float(j[-1, _HIPS, 1]) < 0.7,
    "a person stands up": _up,
    "a person walks forward": lambda j: float((j[-1, 0] - j[0, 0])[[0, 2]].norm()) > 0.025 * len(j),
    "a person waves with the right hand": _waves,
    "a person jumps": lambda j: float(j[:, list(HML22.feet), 1].amin(dim=1).max()) > 0.12,
    "a person stands still": lambda j: _up(j) and float(j.diff(dim=0).norm(dim=-1).mean(dim=0).max()) * 20 < 0.3,
}


def segments(
    model: str,
    network: str | None,
    steps: int | None,
    copies: int,
    each: int,
    sentences: Sequence[str] = tuple(DONE),
) -> dict[str, list[list[Motion]]]:
    """Of each sentence its segments, of each of these one motion a stream, which stood before."""
    bundle = ModelFolder.open(model, StreamConfig)
    batch = StreamBatch(bundle, check_stream(bundle.config, network=network, steps=steps).settings, device="cpu")
    lanes = [batch.open("a person stands still", seed) for seed in range(copies)]
    batch.step(lanes)
    found = {}
    for sentence in sentences:
        for lane in lanes:
            batch.prompt(lane, sentence)
        found[sentence] = [[segment.motion for segment in batch.step(lanes)] for _ in range(each)]
    return found


def shares(done: Callable[[Tensor], bool], shown: Sequence[Sequence[Motion]]) -> dict[str, Any]:
    """``within`` one segment, two, …, and in the ``last``: shares of the streams of one sentence."""
    right = torch.tensor([[done(motion.joints.float()) for motion in made] for made in shown]).float()
    within = right.cummax(dim=0).values.mean(dim=1)
    return {"within": [round(share, 3) for share in within.tolist()], "last": round(float(right[-1].mean()), 3)}


def main() -> None:
    """See the module."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "model", nargs="+", help="MODEL, MODEL:NETWORK or MODEL:NETWORK:STEPS; a shipped one, or a folder"
    )
    parser.add_argument("--copies", type=at_least(1), default=20)
    parser.add_argument("--segments", type=at_least(1), default=4, help="of each sentence")
    parser.add_argument("--sentences", nargs="+", choices=DONE, default=list(DONE), help="each once, in this order")
    parser.add_argument("--out", type=report_path)
    given = parser.parse_args()
    torch.set_num_threads(1)
    rows = {}
    for asked in given.model:
        made = segments(*sampled(asked), given.copies, given.segments, given.sentences)
        for sentence, shown in made.items():
            rows[f"{asked}: {sentence}"] = shares(DONE[sentence], shown)
            print(asked, sentence, rows[f"{asked}: {sentence}"], flush=True)
    if given.out:
        write_report(given.out, {"copies": given.copies, "segments": given.segments, "rows": rows})


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
