"""What benchmarks of clips ask for and make: sentences by networks, feet locked as users get them."""

import argparse
from argparse import Namespace
from collections.abc import Callable, Sequence
from typing import Any

import torch

from arguments import Parser, at_least, report_path
from moveset.motion.clip import Motion
from moveset.pipelines.bundle import DEFAULT_MODEL
from moveset.pipelines.request import check_method, check_request
from moveset.pipelines.text_to_motion import TextToMotion

Make = Callable[..., tuple[Motion, ...]]


def parser(description: str | None, sentences: Sequence[str]) -> Parser:
    """What every one of them takes."""
    out = Parser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    out.add_argument("--model", default=DEFAULT_MODEL, help="a shipped model of clips, or a folder")
    out.add_argument("--networks", nargs="*", default=["pcm-1"])
    out.add_argument("--sentences", nargs="*", default=list(sentences))
    out.add_argument("--copies", type=at_least(1), default=24)
    out.add_argument("--out", type=report_path)
    return out


def makers(given: Namespace) -> dict[str, Make]:
    """By network what makes ``--copies`` clips of a sentence, on one thread.

    Raises:
        InputError: a sentence, a number of copies or a network that the model does not take.
    """
    torch.set_num_threads(1)
    model = TextToMotion.from_pretrained(given.model, device="cpu")
    asked = {network: _asked(network) for network in given.networks}
    for sentence in given.sentences:
        check_request(model.bundle.config, sentence, None, 0, given.copies)
    for method in asked.values():
        check_method(model.bundle.config, method["solver"], method["steps"], None)

    def make(method: dict[str, Any]) -> Make:
        return lambda sentence, **more: model(sentence, num=given.copies, **method, **more).motions

    return {network: make(method) for network, method in asked.items()}


def _asked(network: str) -> dict[str, Any]:
    """What a network is called by: "pcm-4" are four steps of "pcm"."""
    solver, _, steps = network.partition("-")
    return {"solver": solver, "steps": int(steps) if steps.isdigit() else None}
