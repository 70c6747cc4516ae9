"""Build a corpus from raw motion capture: import, cut, label, compose, write, and report what was left out and why."""

import json
import re
import shutil
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path

from moveset.data.augment import MAX_FRAMES
from moveset.data.captions import train_captions
from moveset.data.compose import add_compositions, add_continuations
from moveset.data.corpus import CorpusWriter, TakeEntry
from moveset.data.importing import import_all, read_cached
from moveset.data.labels import canonical_style, cmu_content
from moveset.data.raw import find_takes, unpacked
from moveset.data.splits import split_of
from moveset.data.takes import TakeRef
from moveset.errors import MovesetError
from moveset.io.limits import atomic_write
from moveset.motion.clip import Motion

MIN_FRAMES = 24


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
    raw: Path,
    output: Path,
    *,
    workers: int,
    compositions: int = 3000,
    continuations: int = 0,
    keep_work: bool = False,
) -> BuildReport:
    """Import every take, cut, label, compose, and write the corpus with its report beside it.

    Takes already imported by an interrupted build are not imported again: each has its own file in a work folder beside
    the output, which is removed when the corpus is written.

    Args:
        raw: folder with ``dataset-1``, ``dataset-2`` and ``cmu``, or with their archives.
        output: the corpus file; the report is written to ``<output>.report.json``.
        workers: processes.
        compositions: composed training clips to add.
        continuations: training clips to add in which one action goes on for longer than its takes last.
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
    import_all(present, work, workers)
    writer = CorpusWriter()
    trimmed: dict[str, tuple[int, int]] = {}
    for ref in present:
        take = read_cached(ref, work)
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
    composed += add_continuations(writer, train=continuations)
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
