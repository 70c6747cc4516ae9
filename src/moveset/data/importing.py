"""Import takes in parallel into a folder of small files, so that an interrupted build goes on where it stopped."""

import json
import re
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path

import torch

from moveset.data import bandai_namco, cmu, more_mocap
from moveset.data.takes import ImportedRun, ImportedTake, RejectedTake, TakeRef
from moveset.errors import FormatError, MovesetError
from moveset.io.limits import atomic_write
from moveset.io.process import end_with_parent

#: Part of every imported take's stamp: raise it when an importer changes.
_IMPORT_VERSION = 4


def _stamp(ref: TakeRef) -> str:
    """What an import depends on: the files, and what the list says of how to read them."""
    files = [path.stat() for path in (ref.path, ref.skeleton) if path is not None and path.is_file()]
    listed = (ref.fps, ref.capture_hz, ref.drop, ref.unit, ref.leave_out)
    return repr((_IMPORT_VERSION, *((file.st_size, file.st_mtime_ns) for file in files), *listed))


def _import_to(ref: TakeRef, cache: Path) -> None:
    from safetensors.torch import save

    reader = {"cmu": cmu, "bandai": bandai_namco}.get(re.split(r"[\d-]", ref.source)[0], more_mocap)
    try:
        take = reader.read_take(ref)
    except (RejectedTake, FormatError) as error:
        take = ImportedTake((), str(error))
    about = {"stamp": _stamp(ref), "reason": take.reason, "first": [run.first_frame for run in take.runs]}
    tensors = {"empty": torch.zeros(0)}
    for k, run in enumerate(take.runs):
        tensors |= {f"rotations{k}": run.rotations.float().contiguous(), f"root{k}": run.root.float().contiguous()}
    with atomic_write(cache) as file:
        file.write(save(tensors, metadata={"take": json.dumps(about)}))


def cache_of(ref: TakeRef, work: Path) -> Path:
    return work / f"{ref.name.replace('/', '__')}.safetensors"


def read_cached(ref: TakeRef, work: Path) -> ImportedTake | None:
    """The cached import of a take, if it is there, whole and of this very file."""
    from safetensors import SafetensorError, safe_open

    cache = cache_of(ref, work)
    if not cache.is_file():
        return None
    try:
        with safe_open(cache, framework="pt") as file:
            about = json.loads((file.metadata() or {}).get("take", "{}"))
            if about.get("stamp") != _stamp(ref):
                return None
            runs = (
                ImportedRun(int(first), file.get_tensor(f"rotations{k}"), file.get_tensor(f"root{k}"))
                for k, first in enumerate(about["first"])
            )
            return ImportedTake(tuple(runs), str(about["reason"]))
    except (SafetensorError, ValueError, KeyError):
        return None


def _prepare_worker() -> None:
    """One thread a worker, and an end when its parent is killed; otherwise it would wait for work for ever."""
    end_with_parent()
    torch.set_num_threads(1)


def import_all(refs: list[TakeRef], work: Path, workers: int) -> None:
    """Import the takes that are not in the folder ``work`` yet, each into a file of its own.

    Raises:
        InputError: a file cannot be read.
        MovesetError: an importer failed.
    """
    from tqdm import tqdm

    todo = {ref: cache_of(ref, work) for ref in refs if read_cached(ref, work) is None}
    bar = tqdm(total=len(todo), desc="takes", unit="", disable=not (todo and sys.stderr.isatty()))
    with bar:
        if workers == 1:
            for ref, cache in todo.items():
                with _naming(ref):
                    _import_to(ref, cache)
                bar.update()
            return
        # Spawned, not forked: a fork would copy torch's thread pools in whatever state they are.
        pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_prepare_worker)
        try:
            jobs = {pool.submit(_import_to, ref, cache): ref for ref, cache in todo.items()}
            for job in as_completed(jobs):
                with _naming(jobs[job]):
                    job.result()
                bar.update()
        finally:
            pool.shutdown(cancel_futures=True)


@contextmanager
def _naming(ref: TakeRef) -> Iterator[None]:
    try:
        yield
    except MovesetError:
        raise
    except Exception as error:
        raise MovesetError(f"importing the take {ref.name!r} failed: {error!r}") from error
