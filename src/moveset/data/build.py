"""Build a corpus from raw motion capture: import, level, cut, tell, compose, write, and say what was left out.

Clips are the spans of takes that sentences tell of, and what is left between these, which nobody tells about.
"""

import json
import re
import shutil
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from itertools import groupby, pairwise
from pathlib import Path

from torch import Tensor

from moveset.data import posture
from moveset.data.augment import MAX_FRAMES, quiet_moments
from moveset.data.bandai_captions import bandai_captions
from moveset.data.compose import add_compositions
from moveset.data.corpus import CorpusWriter
from moveset.data.descriptions import STANDING_STILL, described, said_otherwise, spelled_out
from moveset.data.importing import cache_of, import_all, read_cached
from moveset.data.raw import FREE, find_spans, find_takes, unpacked
from moveset.data.records import ClipRecord
from moveset.data.spans import Span
from moveset.data.splits import Split, free_parts, overlap, split_of
from moveset.data.takes import TakeRef
from moveset.data.typos import mend, word_list
from moveset.data.verbs import common_verbs
from moveset.errors import InputError, MovesetError
from moveset.io.limits import make_folder, write_text, written_to
from moveset.io.process import locked
from moveset.motion.clip import Motion

FPS = 20.0
#: Frames of the shortest clip that sentences tell of, and of one that nothing is told about.
MIN_FRAMES, MIN_UNTOLD, MAX_STAND = 24, 40, 100
#: The share of a span that a clean run has to hold for the span's sentences to be true of it.
_WHOLE = 0.8
#: Sets whose takes are long and alike count as so many clips, whatever they are cut into.
_MOST = 24.0
_ALIKE = ("vsports", "tennis", "react-idle")


@dataclass(frozen=True)
class BuildReport:
    """What came of a build.

    Args:
        clips: clips stored (what is longer than 196 frames is cut).
        seconds: duration of the runs, compositions not counted.
        rejected: take name -> why it is not in the corpus.
        trimmed: take name -> what of it was cut out.
        spans: name of a span with sentences -> why it is no clip.
        mended: sentence as typed -> how the corpus has it.
    """

    corpus: str
    takes: int
    clips: int
    compositions: int
    seconds: float
    rejected: dict[str, str]
    trimmed: dict[str, str]
    spans: dict[str, str]
    mended: dict[str, str]


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


#: First frame in the capture, and the motion from there on.
_Run = tuple[int, Motion]


@dataclass(frozen=True)
class _Piece:
    """Frames [start, stop) of a capture that become a clip."""

    name: str
    start: int
    stop: int
    split: Split
    sentences: tuple[str, ...]


class _Spans:
    """Which frames of which take are told about, by which sentences, and which are on a held-out side."""

    def __init__(self, refs: Sequence[TakeRef], spans: dict[str, list[Span]]) -> None:
        # Those of takes that are not here decide nothing, nor do CMU's tell of another set's take of the same name.
        self.spans = {ref.name: spans[ref.name] for ref in refs if ref.name in spans and ref.source.startswith("cmu")}
        self.failed: dict[str, str] = {}
        self.mended: dict[str, str] = {}
        self._words = word_list(sentence for told in spans.values() for span in told for sentence in span.sentences)
        self._held_out: dict[str, list[tuple[int, int, Split]]] = {}
        for ref in refs:
            for span in self.spans.get(ref.name, ()):
                if span.split in ("val", "test"):
                    self._held_out.setdefault(ref.group, []).append((*_frames(span), span.split))

    def told(self, ref: TakeRef) -> list[tuple[int, int, Split, Span]]:
        """Spans of a take that may become clips."""
        found = []
        for span in self.spans.get(ref.name, ()):
            start, stop = _frames(span)
            if span.split is None:
                continue
            others = [side for a, b, side in self._held_out.get(ref.group, ()) if overlap((a, b), (start, stop))]
            if ("test" in others and span.split != "test") or ("val" in others and span.split == "train"):
                self.failed[span.name] = "its seconds are held out"
                continue
            found.append((start, stop, span.split, span))
        return found

    def sentences(self, span: Span) -> tuple[str, ...]:
        """What is said of a span; in training without obvious typos."""
        typed = clean_sentences(span.sentences)
        if span.split != "train":
            return typed
        mended = {sentence: mend(sentence, self._words) for sentence in typed}
        self.mended |= {sentence: told for sentence, told in mended.items() if told != sentence}
        return tuple(dict.fromkeys(mended.values()))

    def held_out(self, ref: TakeRef) -> list[tuple[int, int]]:
        """Frames of a take that belong to validation or testing."""
        return [(start, stop) for start, stop, _ in self._held_out.get(ref.group, ())]


def _frames(span: Span) -> tuple[int, int]:
    return round(span.start * FPS), round(span.end * FPS)


def _pieces(ref: TakeRef, runs: Sequence[_Run], spans: _Spans) -> Iterator[tuple[int, _Piece]]:
    whole = _said_of_all(ref) if ref.name not in spans.spans else ()
    default: Split = "train" if spans.spans else split_of(ref.name if ref.source.startswith("bandai") else ref.group)
    told = spans.told(ref)
    done = set()
    for number, (first, motion) in enumerate(runs):
        last = first + len(motion)
        taken = spans.held_out(ref)
        for start, stop, split, span in told:
            a, b = max(start, first), min(stop, last)
            if b - a >= max(MIN_FRAMES, _WHOLE * (stop - start)):
                b = min(b, a + MAX_FRAMES)
                done.add(span.name)
                taken.append((a, b))
                yield number, _Piece(f"{ref.name}@{span.name}", a, b, split, spans.sentences(span))
        least = MIN_FRAMES if whole else MIN_UNTOLD
        for a, b in free_parts(first, last, taken):
            if b - a < least:
                continue
            parts = cut(b - a)
            # What is told in order is not told of each piece.
            sentences = whole if len(parts) == 1 else tuple(said for said in whole if not _in_order(said))
            for start, stop in parts:
                yield number, _Piece(f"{ref.name}#{a + start}", a + start, a + stop, default, sentences)
    if default == "train":
        yield from _stands(ref, runs, spans.held_out(ref))
    for _, _, _, span in told:
        if span.name not in done:
            spans.failed[span.name] = "too few of its frames are clean"


def _stands(ref: TakeRef, runs: Sequence[_Run], held_out: list[tuple[int, int]]) -> Iterator[tuple[int, _Piece]]:
    """The longest moment of a take in which somebody just stands, where nobody may look at it in testing."""
    found = [
        (b - a, number, a, b)
        for number, (first, motion) in enumerate(runs)
        for start, stop in quiet_moments(motion, MIN_UNTOLD)
        for a, b in free_parts(first + start, first + stop, held_out)
        if b - a >= MIN_UNTOLD
    ]
    if found:
        length, number, start, _ = max(found)
        order = int.from_bytes(sha256(ref.name.encode()).digest()[:4], "big")
        said = tuple(STANDING_STILL[(order + 5 * k) % len(STANDING_STILL)] for k in range(4))
        yield number, _Piece(f"{ref.name}~{start}", start, start + min(length, MAX_STAND), "train", said)


def _said_of_all(ref: TakeRef) -> tuple[str, ...]:
    """Sentences for all of a take, from what its set says about it."""
    if ref.source.startswith("bandai"):
        return bandai_captions(ref.content, ref.style)
    if ref.sentence:
        return tuple(dict.fromkeys(said for told in spelled_out(ref.sentence) for said in said_otherwise(told)))
    return described(ref.description or "")


def _in_order(sentence: str) -> bool:
    return bool(re.search(r"\bthen\b|\bafter|\bbefore\b|, \w+s\b", sentence))


def build_corpus(
    raw: Path,
    output: Path,
    *,
    workers: int,
    sources: Sequence[str] = FREE,
    compositions: int = 3000,
    keep_work: bool = False,
) -> BuildReport:
    """Import every take, make it upright, cut, tell, compose, and write the corpus with its report beside it.

    Takes already imported by an interrupted build are not imported again: each has its own file in a work folder beside
    the output, which is removed when the corpus is written.

    Args:
        raw: folder with the sources' folders, or with their archives.
        output: the corpus file; the report is written to ``<output>.report.json``.
        sources: of ``raw.SOURCES``; those that ``raw`` does not hold are left out.
        compositions: composed training clips to add.
        keep_work: keep the imported takes for the next build.

    Raises:
        InputError: no raw data, two takes of one name, none that gives a clip, the output cannot be written, or
            another process is building it.
        FormatError: an archive or a list is damaged.
    """
    make_folder(output.parent)
    written_to(output)
    raw = unpacked(raw, output.parent / "raw", sources)
    refs, told = find_takes(raw, sources), find_spans(raw)
    work = make_folder(output.parent / f"{output.name}.work")
    present = [ref for ref in refs if ref.path.is_file()]
    _refuse_doubles(present, work)
    with locked(work, f"another process is building {output}; wait for it, or choose another output"):
        import_all(present, work, workers)
        report = _written(output, refs, present, work, told, compositions)
    if not keep_work:
        shutil.rmtree(work)
    return report


def _written(
    output: Path,
    refs: Sequence[TakeRef],
    present: Sequence[TakeRef],
    work: Path,
    told: dict[str, list[Span]],
    compositions: int,
) -> BuildReport:
    """The corpus of takes that are imported, and its report."""
    rejected = {ref.name: f"its file {ref.path.name} is missing" for ref in refs if not ref.path.is_file()}
    trimmed: dict[str, str] = {}
    writer, spans = CorpusWriter(), _Spans(present, told)
    for _, performed in groupby(present, key=lambda ref: (ref.source.split("-")[0], ref.subject)):
        for ref, runs in _upright(list(performed), work, rejected, trimmed):
            pieces = list(_pieces(ref, runs, spans))
            if not pieces:
                frames = sum(len(motion) for _, motion in runs)
                rejected[ref.name] = f"its {frames} clean frames are too short a run, or held out"
            _add(writer, ref, runs, pieces)
    clips = len(writer.records)
    if not clips:
        name, reason = next(iter(rejected.items()))
        raise InputError(f"of {len(refs)} takes none gives a clip; {name!r} for one: {reason}")
    composed = add_compositions(writer, train=compositions, progress=sys.stderr.isatty())
    writer.records[:] = _weighed(writer.records)
    writer.write(output)
    found = rejected, trimmed, spans.failed, spans.mended
    report = BuildReport(str(output), len(refs), clips, composed, round(writer.frames / FPS, 1), *found)
    write_text(
        output.parent / f"{output.name}.report.json", json.dumps({**asdict(report), "corpus": output.name}, indent=1)
    )
    return report


def _refuse_doubles(refs: Sequence[TakeRef], work: Path) -> None:
    """Imported takes are found again by their names."""
    first: dict[Path, TakeRef] = {}
    for ref in refs:
        other = first.setdefault(cache_of(ref, work), ref)
        if other is not ref:
            both = f"{other.name!r} of {other.source} and {ref.name!r} of {ref.source}"
            raise InputError(f"the takes {both} count as one name; give one of them another in its list")


def _upright(
    refs: Sequence[TakeRef], work: Path, rejected: dict[str, str], trimmed: dict[str, str]
) -> Iterator[tuple[TakeRef, list[_Run]]]:
    """The takes of one performer, upright and with the floor at height 0."""
    found: list[tuple[TakeRef, list[tuple[int, Tensor, Tensor]]]] = []
    for ref in refs:
        take = read_cached(ref, work)
        if take is None:
            raise MovesetError(f"the imported take {ref.name!r} vanished from {work}; run the build again")
        if not take.runs:
            rejected[ref.name] = take.reason
            continue
        if take.reason:
            trimmed[ref.name] = take.reason
        found.append((ref, [(run.first_frame, run.rotations, run.root) for run in take.runs]))
    if not found:
        return
    if found[0][0].levelled:
        leaning = posture.leanings([(local, root) for _, runs in found for _, local, root in runs])
        if leaning is not None:
            found = [
                (ref, [(first, *posture.upright(local, root, leaning)) for first, local, root in runs])
                for ref, runs in found
            ]
    own = [min(posture.floor_of(local, root) for _, local, root in runs) for _, runs in found]
    for (ref, runs), floor in zip(found, posture.floors(own), strict=True):
        yield ref, [(first, posture.on_floor(local, root, floor)) for first, local, root in runs]


def _add(writer: CorpusWriter, ref: TakeRef, runs: Sequence[_Run], pieces: Sequence[tuple[int, _Piece]]) -> None:
    """Store a take's runs, as far as clips are in them, and its clips."""
    stored: dict[int, int] = {}
    for number, piece in pieces:
        if number not in stored:
            first, motion = runs[number]
            stored[number] = writer.add_run(ref.name, motion, first)
        content = (ref.content,) if ref.content else common_verbs(piece.sentences) or ("move",)
        record = ClipRecord(
            name=piece.name,
            take=ref.name,
            source=ref.source,
            subject=ref.subject,
            group=ref.group,
            kind="take",
            contents=content if piece.sentences else (),
            style=ref.style,
            split=piece.split,
            fps=FPS,
            frames=piece.stop - piece.start,
            captions=(),
            first_frame=piece.start,
            run=stored[number],
        )
        writer.add_clip(record, piece.sentences)


def _weighed(records: Sequence[ClipRecord]) -> list[ClipRecord]:
    """The records with less weight where a set's takes are long and alike."""
    counts = Counter(record.source for record in records)
    return [
        replace(record, weight=min(1.0, _MOST / counts[record.source])) if record.source in _ALIKE else record
        for record in records
    ]
