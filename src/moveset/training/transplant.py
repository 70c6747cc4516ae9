"""A student that is given what its teacher has learned since: no training, but a share of the difference of weights.

A student begins as its teacher and stays near it, so a difference between two stages of the teacher means in it much
the same. It reads its guidance scale, which no teacher has, as before. What the teacher has learned to read in between
(``SegmentTransformer.learned_later``) began at zero, and the student reads a share of it.
Source: task arithmetic (arXiv 2212.04089), with the teacher's further training as the task.
"""

import argparse
import sys
from pathlib import Path

import torch

from moveset.errors import InputError, exit_code_of
from moveset.models.registry import require_range
from moveset.models.segment_transformer import SegmentTransformer
from moveset.training import checkpoint

STUDENT = "student_ema"
# What averaged weights are called in checkpoints of teachers of streams and of clips.
TEACHERS = ("denoiser_ema", "teacher_ema")


def transplant(student: Path, before: Path, after: Path, share: float, out: Path) -> Path:
    """Write ``out/step_N``: a student, of clips or streams, with ``share`` of what lies between stages of its teacher.

    Args:
        student: run folder or checkpoint of the student; N is its number of steps. Its averaged weights are taken.
        before: the teacher that it was distilled from.
        after: the same teacher, trained on; whichever flow it has is what the student is packed with.
        share: of the difference, in 0 to 1.
        out: a run folder without checkpoints.

    Raises:
        InputError: no such checkpoints, teachers of other sizes than the student's, a share out of range, or a run
            folder in use.
        FormatError: a file is damaged.
    """
    require_range("share", share, 0.0, 1.0)
    if checkpoint.steps(out):
        raise InputError(f"{out} already holds a training; choose another folder")
    step = checkpoint.resolve(student)
    weights = checkpoint.read_tensors(step, STUDENT)
    old, new = (_teacher(checkpoint.resolve(path)) for path in (before, after))
    added = [key for key in SegmentTransformer.learned_later if key in new and key not in old and key not in weights]
    for stage in (old, weights):
        stage |= {key: torch.zeros_like(new[key]) for key in added}
    for path, stage in ((before, old), (after, new)):
        shapes = {key: value.shape for key, value in weights.items() if key in old or key in new}
        if unfit := {(key, value.shape) for key, value in stage.items()} ^ set(shapes.items()):
            raise InputError(f"{path} has another {min(unfit)[0]} than {student}; give stages of its own teacher")
    for key in old:
        if weights[key].is_floating_point():
            moved = weights[key].double() + share * (new[key].double() - old[key].double())
            weights[key] = moved.to(weights[key].dtype)
    config = checkpoint.read_document(step, "config")
    for key in added:
        config["config"]["model"][SegmentTransformer.learned_later[key]] = True
    documents = {"config": config, "origin": {"student": step.name, "share": share}}
    modules = {STUDENT: weights, STUDENT.removesuffix("_ema"): weights}
    return checkpoint.write(out, int(step.name.removeprefix("step_")), modules, documents)


def _teacher(step: Path) -> dict[str, torch.Tensor]:
    held = [name for name in TEACHERS if (step / f"{name}.safetensors").is_file()]
    return checkpoint.read_tensors(step, held[0] if held else TEACHERS[0])


def main() -> None:
    """Command line: ``python -m moveset.training.transplant STUDENT --before RUN --after RUN --out RUN``."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("student", type=Path, help="run folder of the student")
    parser.add_argument("--before", type=Path, required=True, help="run folder of the teacher it was distilled from")
    parser.add_argument("--after", type=Path, required=True, help="run folder of that teacher, trained on")
    parser.add_argument("--share", type=float, default=0.5, help="of what lies between them")
    parser.add_argument("--out", type=Path, required=True, help="the run folder to write")
    given = parser.parse_args()
    print(transplant(given.student, given.before, given.after, given.share, given.out))


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
