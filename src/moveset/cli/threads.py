"""What OpenMP's threads do while they wait for each other.

Threads that spin are quickest while nothing else runs, and make everything crawl as soon as another process is busy on
one of the cores. Networks are called with one thread (``pipelines.device.one_thread``); this is for everything else:
batches, training, evaluation.
"""

import os


def wait_asleep() -> None:
    """Let OpenMP's threads sleep while they wait, unless the environment says otherwise; before torch is imported."""
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
