"""Clips in which one action goes on for longer than its takes last."""

from itertools import pairwise

import pytest
import torch

from moveset.data.captions import train_captions
from moveset.data.compose import add_compositions, add_continuations
from moveset.data.corpus import Corpus, CorpusWriter, TakeEntry
from moveset.data.dataset import CorpusDataset, corpus_weights
from moveset.data.labels import mirror_label
from moveset.data.splits import Split
from moveset.data.synthetic import synthetic_motion

CONTENTS = ("walk", "run", "wave-left-hand", "walk-turn-left")
SPLITS: tuple[Split, ...] = ("train", "train", "train", "val")


@pytest.fixture(scope="module")
def writer() -> CorpusWriter:
    writer = CorpusWriter()
    for k in range(24):
        content, name = CONTENTS[k % len(CONTENTS)], f"take_{k}"
        motion = synthetic_motion(content, 50 + 2 * k, seed=k)
        said, style = train_captions(content), ("normal", "happy")[k % 8 // 4]
        writer.add_take(
            TakeEntry(name, name, "test", content, style, said, SPLITS[k // len(CONTENTS) % 4], "nobody", motion)
        )
    add_compositions(writer, train=6)
    return writer


@pytest.fixture(scope="module")
def before(writer, tmp_path_factory) -> Corpus:
    return Corpus.open(writer.write(tmp_path_factory.mktemp("before") / "c.safetensors"))


@pytest.fixture(scope="module")
def corpus(writer, before, tmp_path_factory) -> Corpus:
    assert add_continuations(writer, train=18) > 18
    return Corpus.open(writer.write(tmp_path_factory.mktemp("corpus") / "c.safetensors"))


def going_on(corpus: Corpus) -> list[int]:
    return [k for k, record in enumerate(corpus.records) if record.name.startswith("going_on")]


def test_what_was_there_stays_as_it_is(before, corpus):
    assert corpus.records[: len(before)] == before.records
    assert {corpus.records[k].split for k in going_on(corpus)} == {"train", "val"}
    assert sum(corpus.records[k].split == "train" for k in going_on(corpus)) == 18


def test_one_content_is_shown_by_takes_of_one_split_and_told_by_its_sentences(corpus):
    for k in going_on(corpus):
        record = corpus.records[k]
        assert record.recipe is not None
        assert len(record.contents) == 1
        assert 2 <= len(record.recipe.parts) <= 6
        for part in record.recipe.parts:
            take = corpus.records[part.clip]
            assert take.split == record.split
            assert record.contents[0] == (mirror_label(take.contents[0]) if part.mirrored else take.contents[0])
        assert corpus.captions(k) == train_captions(record.contents[0], record.style)


def test_it_lasts_as_long_as_its_record_says_and_nothing_jumps(corpus):
    lengths = []
    for k in going_on(corpus):
        motion, record = corpus.motion(k), corpus.records[k]
        assert len(motion) == record.frames <= 196
        lengths.append(record.frames)
        fastest = max(
            float(corpus.motion(part.clip).joints.diff(dim=0).norm(dim=-1).max()) for part in record.recipe.parts
        )
        assert float(motion.joints.diff(dim=0).norm(dim=-1).max()) < 1.3 * fastest + 0.02
    assert max(lengths) > 150 > max(record.frames for record in corpus.records if record.kind == "take")


def test_what_travels_may_be_cut_and_anything_else_is_whole(corpus):
    for k in going_on(corpus):
        record = corpus.records[k]
        whole = [(part.start, part.stop) == (0, corpus.records[part.clip].frames) for part in record.recipe.parts]
        assert all(whole) or record.contents[0] in ("walk", "run")
        assert all(a.stop - a.start > 12 < b.stop - b.start for a, b in pairwise(record.recipe.parts))


def test_the_last_take_keeps_its_end_where_there_is_room(corpus):
    kept = 0
    for k in going_on(corpus):
        record = corpus.records[k]
        last = record.recipe.parts[-1]
        ended = last.stop == corpus.records[last.clip].frames
        assert ended or record.frames == 196
        kept += ended
    assert kept > len(going_on(corpus)) / 2


def test_the_same_takes_give_the_same_clips(corpus):
    again = CorpusWriter()
    for k in corpus.indices(composed=False):
        record = corpus.records[k]
        again.add_take(
            TakeEntry(
                record.name, record.take, record.source, record.contents[0], record.style, corpus.captions(k),
                record.split, record.subject, corpus.motion(k),
            )
        )  # fmt: skip
    add_continuations(again, train=18)
    kept = [(r.name, r.contents) for r in again.records if r.kind != "take"]
    assert kept == [(corpus.records[k].name, corpus.records[k].contents) for k in going_on(corpus)]


def test_they_count_as_clips_of_their_content_and_not_as_compositions(corpus):
    records = corpus.indices("train")
    weights = corpus_weights(corpus, records, power=0.5, composed_share=0.4)
    two = torch.tensor([len(corpus.records[k].contents) == 2 for k in records])
    assert float(weights[two].sum()) == pytest.approx(0.4)
    walks = {float(w) for k, w in zip(records, weights, strict=True) if corpus.records[k].contents == ("walk",)}
    assert max(walks) == pytest.approx(min(walks))
    source = CorpusDataset(corpus)
    assert all(source.clip(2 * k).croppable for k in going_on(corpus))
    assert not any(source.clip(2 * int(k)).croppable for k, both in zip(records, two, strict=True) if both)


def test_they_say_nothing_of_how_long_an_action_lasts(corpus):
    source = CorpusDataset(corpus)
    assert {k for k in range(len(corpus)) if source.clip(2 * k).looped} == set(going_on(corpus))


def test_none_of_nothing():
    assert add_continuations(CorpusWriter(), train=10) == 0
