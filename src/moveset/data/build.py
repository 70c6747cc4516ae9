"""Build a corpus from raw motion capture: parallel over takes, restartable, with a report of what was left out."""

import json
import os
import re
import shutil
import sys
import tarfile
import threading
from collections import Counter
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from multiprocessing import get_context, parent_process
from pathlib import Path

import torch

from moveset.data import bandai_namco, cmu
from moveset.data.augment import MAX_FRAMES
from moveset.data.captions import train_captions
from moveset.data.compose import add_compositions
from moveset.data.corpus import CorpusWriter, TakeEntry
from moveset.data.labels import canonical_style, cmu_content
from moveset.data.splits import split_of
from moveset.data.takes import RejectedTake, TakeRef
from moveset.errors import FormatError, InputError, MovesetError
from moveset.io.limits import atomic_write
from moveset.motion.clip import Motion

MIN_FRAMES = 24
MIN_CUT_FRAMES = 40
#: Part of every cached take's stamp: raise it when an importer changes.
_IMPORT_VERSION = 1
_ARCHIVES = {"bandai-namco.tar.xz": ("dataset-1", "dataset-2"), "cmu.tar.xz": ("cmu",)}
_MAX_UNPACKED = 16 * 2**30
_MAX_MEMBERS = 200_000


@dataclass(frozen=True)
class BuildReport:
    """What came of a build.

    Args:
        corpus: path of the corpus.
        takes: takes found.
        clips: clips stored (takes longer than 196 frames are cut).
        compositions: composed clips added.
        seconds: duration of the clips, compositions not counted.
        rejected: take name -> why it is not in the corpus.
        trimmed: take name -> [first, last) frames that were kept, for takes whose beginning was cut off.
    """

    corpus: str
    takes: int
    clips: int
    compositions: int
    seconds: float
    rejected: dict[str, str] = field(default_factory=dict)
    trimmed: dict[str, tuple[int, int]] = field(default_factory=dict)


# ------------------------------------------------------------------------------------------------------- raw data


def unpacked(raw: Path, scratch: Path) -> Path:
    """The folder that holds ``dataset-1``, ``dataset-2`` and ``cmu``; archives in ``raw`` are unpacked to ``scratch``.

    Raises:
        InputError: ``raw`` holds neither the folders nor the archives.
        FormatError: an archive is damaged, tries to write elsewhere, or is absurdly large.
    """
    folders = [f for names in _ARCHIVES.values() for f in names]
    if any((raw / f).is_dir() for f in folders):
        return raw
    archives = [raw / name for name in _ARCHIVES if (raw / name).is_file()]
    if not archives:
        raise InputError(f"{raw} holds none of {', '.join((*folders, *_ARCHIVES))}; give the folder with the raw data")
    scratch.mkdir(parents=True, exist_ok=True)
    for archive in archives:
        if not all((scratch / f).is_dir() for f in _ARCHIVES[archive.name]):
            _unpack(archive, scratch)
    return scratch


def _unpack(archive: Path, to: Path) -> None:
    # Into a hidden folder first: a folder with its final name is always complete.
    partial = to / f".{archive.name}.part"
    shutil.rmtree(partial, ignore_errors=True)
    print(f"unpacking {archive.name} …", file=sys.stderr)
    try:
        with tarfile.open(archive, "r:xz") as tar:
            tar.extractall(partial, members=_bounded(tar, archive), filter="data")
    except (tarfile.TarError, EOFError, OSError) as error:
        shutil.rmtree(partial, ignore_errors=True)
        raise FormatError(f"{archive} cannot be unpacked ({error}); copy or download it again") from error
    for folder in _ARCHIVES[archive.name]:
        if (partial / folder).is_dir():
            shutil.rmtree(to / folder, ignore_errors=True)
            os.replace(partial / folder, to / folder)
    shutil.rmtree(partial, ignore_errors=True)


def _bounded(tar: tarfile.TarFile, archive: Path) -> Iterator[tarfile.TarInfo]:
    size = 0
    for count, member in enumerate(tar):
        size += member.size
        if size > _MAX_UNPACKED or count > _MAX_MEMBERS:
            limits = f"{_MAX_UNPACKED >> 30} GB or {_MAX_MEMBERS} files"
            raise FormatError(f"{archive} unpacks to more than {limits}; check where it is from")
        if member.isfile() or member.isdir():
            yield member


def find_takes(raw: Path) -> list[TakeRef]:
    """All takes below a folder of unpacked data, in the order of their sources and names.

    Raises:
        InputError: there are none.
    """
    refs: list[TakeRef] = []
    if any((raw / f).is_dir() for f in ("dataset-1", "dataset-2")):
        refs += bandai_namco.list_takes(raw)
    if (raw / "cmu").is_dir():
        refs += cmu.list_takes(raw / "cmu")
    if not refs:
        raise InputError(f"{raw} holds no takes; give the folder with dataset-1, dataset-2 or cmu")
    return refs


# --------------------------------------------------------------------------------------------------- one take


@dataclass(frozen=True, eq=False)
class _Imported:
    motion: Motion | None
    span: tuple[int, int]
    reason: str


def _stamp(ref: TakeRef) -> str:
    stat = ref.path.stat()
    return f"{_IMPORT_VERSION} {stat.st_size} {stat.st_mtime_ns}"


def _import_to(ref: TakeRef, cache: Path) -> None:
    """Import one take into its cache file; runs in a worker process."""
    from safetensors.torch import save

    torch.set_num_threads(1)
    reader = cmu if ref.source.startswith("cmu") else bandai_namco
    tensors, reason, span = {"empty": torch.zeros(0)}, "", (0, 0)
    try:
        take = reader.read_take(ref)
        tensors = {"rotations": take.motion.rotations.contiguous(), "root": take.motion.root.contiguous()}
        span = take.span
    except (RejectedTake, FormatError) as error:
        reason = str(error)
    about = {"stamp": _stamp(ref), "reason": reason, "span": list(span)}
    with atomic_write(cache) as file:
        file.write(save(tensors, metadata={"take": json.dumps(about)}))


def _from_cache(ref: TakeRef, cache: Path) -> _Imported | None:
    """The cached import of a take, if it is there, whole and of this very file."""
    from safetensors import SafetensorError, safe_open

    if not cache.is_file():
        return None
    try:
        with safe_open(cache, framework="pt") as file:
            about = json.loads((file.metadata() or {}).get("take", "{}"))
            if about.get("stamp") != _stamp(ref):
                return None
            if about["reason"]:
                return _Imported(None, (0, 0), about["reason"])
            return _Imported(Motion(file.get_tensor("rotations"), file.get_tensor("root")), tuple(about["span"]), "")
    except (SafetensorError, ValueError, KeyError):
        return None


def _end_with_parent() -> None:
    """Make a worker end when its parent is killed; otherwise it would wait for work for ever."""

    def watch() -> None:
        parent = parent_process()
        if parent is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _import_all(refs: list[TakeRef], work: Path, workers: int) -> None:
    from tqdm import tqdm

    todo = [(ref, work / f"{ref.name}.safetensors") for ref in refs]
    todo = [(ref, cache) for ref, cache in todo if _from_cache(ref, cache) is None]
    if not todo:
        return
    # Spawned, not forked: a fork would copy torch's thread pools in whatever state they are.
    with ProcessPoolExecutor(
        min(workers, len(todo)), mp_context=get_context("spawn"), initializer=_end_with_parent
    ) as pool:
        jobs = {pool.submit(_import_to, ref, cache): ref for ref, cache in todo}
        for job in tqdm(as_completed(jobs), total=len(jobs), desc="takes", unit="", disable=not sys.stderr.isatty()):
            try:
                job.result()
            except InputError:
                raise
            except Exception as error:
                for other in jobs:
                    other.cancel()
                raise MovesetError(f"importing the take {jobs[job].name!r} failed: {error!r}") from error


# ------------------------------------------------------------------------------------------------------- clips


def cut(frames: int, longest: int = MAX_FRAMES) -> list[tuple[int, int]]:
    """Consecutive pieces of nearly equal length, none longer than ``longest``.

    >>> cut(100), cut(400)
    ([(0, 100)], [(0, 133), (133, 267), (267, 400)])
    """
    pieces = -(-frames // longest)
    edges = [round(k * frames / pieces) for k in range(pieces + 1)]
    return list(pairwise(edges))


def clean_sentences(sentences: Iterable[str]) -> tuple[str, ...]:
    """Sentences without advertisements, stray spaces and doubles.

    >>> clean_sentences(["A human is  walking", "Visit <a href=x>our shop</a>", "A human is walking"])
    ('A human is walking',)
    """
    tidy = (re.sub(r"\s+", " ", s).strip() for s in sentences)
    return tuple(dict.fromkeys(s for s in tidy if s and not re.search(r"https?:|www\.|[<>]", s)))


def _labels(ref: TakeRef) -> tuple[str | None, str | None, tuple[str, ...]]:
    """Content, style and the take's own sentences."""
    if ref.source.startswith("bandai"):
        return ref.content, canonical_style(ref.style) if ref.style else None, ()
    sentences = clean_sentences(ref.sentences)
    return cmu_content(ref.description or "", sentences), None, sentences


def _entries(ref: TakeRef, motion: Motion) -> Iterator[TakeEntry]:
    content, style, sentences = _labels(ref)
    if content is None:
        return
    spans = cut(len(motion))
    for number, (start, stop) in enumerate(spans):
        # A long sentence tells a course of events, which a piece of the take does not show.
        own = tuple(s for s in sentences if len(spans) == 1 or len(s.split()) <= 14)
        yield TakeEntry(
            name=ref.name if len(spans) == 1 else f"{ref.name}#{number}",
            take=ref.name,
            source=ref.source,
            content=content,
            style=style,
            captions=tuple(dict.fromkeys(own + train_captions(content, style))),
            split=split_of(ref.name),
            subject=ref.subject,
            motion=motion[start:stop].canonical(),
            first_frame=start,
        )


def build_corpus(
    raw: Path, output: Path, *, workers: int, compositions: int = 3000, keep_work: bool = False
) -> BuildReport:
    """Import every take, cut, label, compose, and write the corpus with its report beside it.

    Takes already imported by an interrupted build are not imported again: each has its own file in a work folder beside
    the output, which is removed when the corpus is written.

    Args:
        raw: folder with ``dataset-1``, ``dataset-2`` and ``cmu``, or with their archives.
        output: the corpus file; the report is written to ``<output>.report.json``.
        workers: processes.
        compositions: composed training clips to add.
        keep_work: keep the imported takes for the next build.

    Raises:
        InputError: no raw data, or the output cannot be written.
        FormatError: an archive is damaged.
    """
    output.parent.mkdir(parents=True, exist_ok=True)
    raw = unpacked(raw, output.parent / "raw")
    refs = find_takes(raw)
    work = output.parent / f"{output.name}.work"
    work.mkdir(exist_ok=True)
    rejected = {ref.name: f"its file {ref.path.name} is missing" for ref in refs if not ref.path.is_file()}
    present = [ref for ref in refs if ref.path.is_file()]
    _import_all(present, work, workers)
    writer = CorpusWriter()
    trimmed: dict[str, tuple[int, int]] = {}
    for ref in present:
        take = _from_cache(ref, work / f"{ref.name}.safetensors")
        if take is None:
            raise MovesetError(f"the imported take {ref.name!r} vanished from {work}; run the build again")
        entries = list(_entries(ref, take.motion)) if take.motion is not None else []
        if take.motion is None:
            rejected[ref.name] = take.reason
        elif len(take.motion) < MIN_FRAMES:
            rejected[ref.name] = f"only {len(take.motion)} frames, fewer than {MIN_FRAMES}"
        elif not entries:
            rejected[ref.name] = f"nothing to say about it: described only as {ref.description!r}"
        else:
            for entry in entries:
                writer.add_take(entry)
            if take.span[0] > 0:
                trimmed[ref.name] = take.span
    clips = len(writer.records)
    seconds = sum(len(m) / m.fps for m in writer.motions)
    composed = add_compositions(writer, train=compositions, progress=sys.stderr.isatty())
    writer.write(output)
    report = BuildReport(str(output), len(refs), clips, composed, round(seconds, 1), rejected, trimmed)
    with atomic_write(output.parent / f"{output.name}.report.json") as file:
        file.write(json.dumps({**asdict(report), "corpus": output.name}, indent=1).encode())
    if not keep_work:
        shutil.rmtree(work)
    return report


def summarize_rejections(report: BuildReport) -> str:
    """Counts of rejected takes by reason, one line each."""
    reasons = Counter(re.sub(r"\d+", "N", reason.split(": ")[-1]) for reason in report.rejected.values())
    return "\n".join(f"{count:5d}  {reason}" for reason, count in reasons.most_common())
