"""Helper processes that end with the one that started them: whoever is killed cannot stop its helpers any more."""

import multiprocessing
import os
import threading


def end_with_parent() -> None:
    """Let this process, which another one started by ``multiprocessing``, end as soon as that one is gone."""
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
