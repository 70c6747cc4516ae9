"""How many threads a command computes with, and what they do while they wait for each other.

Networks as small as ours have hundreds of short operations. OpenMP threads that spin between them are quickest while
nothing else runs, and make everything crawl as soon as another process is busy on one of the cores. Threads that sleep
never crawl, but two of them take half as long again as one. So commands that evaluate one clip or one segment at a time
use one thread: `docs/decisions.md` has the figures.
"""

import os


def wait_asleep() -> None:
    """Let OpenMP's threads sleep while they wait, unless the environment says otherwise; before torch is imported."""
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


def one_thread() -> None:
    """Compute with one thread, unless ``OMP_NUM_THREADS`` says otherwise."""
    if "OMP_NUM_THREADS" not in os.environ:
        import torch

        torch.set_num_threads(1)
