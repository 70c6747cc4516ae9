"""The corpus file: what is written is read, compositions stay within their split, and damage is noticed."""

import json
import tracemalloc
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from moveset.data.captions import mirror_text
from moveset.data.corpus import Corpus, CorpusWriter
from moveset.data.records import ClipRecord, Part, Recipe
from moveset.data.weights import corpus_weights
from moveset.errors import FormatError, InputError, MovesetError
from tests.synthetic import TakeEntry, add_take, synthetic_corpus, synthetic_motion


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    return synthetic_corpus(tmp_path_factory.mktemp("corpus") / "corpus.safetensors", clips=24, seed=1)


@pytest.fixture(scope="module")
def corpus(path) -> Corpus:
    return Corpus.open(path)


def entry(name: str, motion, split="train") -> TakeEntry:
    return TakeEntry(name, name, "test", "walk", None, ("a person walks", "walking"), split, "nobody", motion, 7)


def test_what_is_written_is_read(tmp_path):
    motions = [synthetic_motion("walk", 60, seed=1), synthetic_motion("wave-left-hand", 45, seed=2)]
    writer = CorpusWriter()
    for k, motion in enumerate(motions):
        assert add_take(writer, entry(f"take{k}", motion, ("train", "test")[k])) == k
    corpus = Corpus.open(writer.write(tmp_path / "c.safetensors"))
    assert [r.name for r in corpus.records] == ["take0", "take1"]
    assert corpus.records[1].first_frame == 7
    assert corpus.indices("test") == (1,)
    assert corpus.captions(0) == ("a person walks", "walking")
    assert corpus.seconds == pytest.approx(105 / 20)
    for k, motion in enumerate(motions):
        read = corpus.motion(k)
        assert (read.root - motion.root).abs().max() < 1e-3
        assert (read.joints - motion.joints).norm(dim=-1).max() < 1e-3


def test_clips_of_who_is_down_are_drawn_more_often(tmp_path):
    motion, writer = synthetic_motion("walk", 60, seed=1), CorpusWriter()
    down = motion.root - torch.tensor([0.0, 0.6, 0.0]) * (torch.arange(60) > 30)[:, None]
    add_take(writer, entry("up", motion))
    add_take(writer, entry("falls", replace(motion, root=down)))
    recipe = Recipe((Part(1, 0, 20), Part(0, 0, 40)), blend=4)
    record = replace(writer.records[1], name="then", kind="in_time", run=None, frames=56, recipe=recipe)
    writer.add_clip(record, ("a person walks",))
    corpus = Corpus.open(writer.write(tmp_path / "c.safetensors"))
    for clip, least in ((0, motion.root[:, 1].min()), (1, down[:, 1].min()), (2, motion.root[:40, 1].min())):
        assert corpus.lowest(clip) == pytest.approx(float(least), abs=1e-5)
    up, falls = corpus_weights(corpus, (0, 1), power=0.25, composed_share=0.3).tolist()
    assert falls == pytest.approx(3 * up)


def test_clips_of_a_run_may_overlap_and_start_above_the_origin(tmp_path):
    motion, writer = synthetic_motion("walk", 100, seed=1), CorpusWriter()
    run = writer.add_run("take", motion, first_frame=40)
    for k, (first, frames) in enumerate([(40, 60), (80, 60)]):
        record = ClipRecord(
            f"clip{k}", "take", "test", "nobody", "take", "take", ("walk",), None, "train", 20.0, frames, (), first,
            run=run,
        )  # fmt: skip
        writer.add_clip(record, ("a person walks",) if k else ())
    corpus = Corpus.open(writer.write(tmp_path / "c.safetensors"))
    assert corpus.seconds == pytest.approx(5.0)
    assert corpus.indices(captioned=True) == (1,)
    second = corpus.motion(1)
    assert (second.joints - motion[40:].canonical().joints).norm(dim=-1).max() < 1e-3


def test_the_same_clips_give_the_same_bytes(path, tmp_path):
    again = synthetic_corpus(tmp_path / "again.safetensors", clips=24, seed=1)
    assert again.read_bytes() == path.read_bytes()


def test_every_clip_has_the_length_and_labels_of_its_record(corpus):
    assert {"take", "in_time", "bent", "paced"} <= {r.kind for r in corpus.records}
    for i, record in enumerate(corpus.records):
        motion = corpus.motion(i)
        assert len(motion) == record.frames <= 196
        assert len(corpus.contents(i)) == {"take": 1, "paced": 1}.get(record.kind, 2)
        assert corpus.captions(i)
        assert abs(float(motion.root[0, 0])) < 1e-5
        assert abs(float(motion.root[0, 2])) < 1e-5


def test_compositions_use_takes_of_their_own_split_only(corpus):
    for record in corpus.records:
        for part in record.recipe.parts if record.recipe else ():
            assert corpus.records[part.clip].split == record.split
            assert corpus.records[part.clip].kind == "take"


def test_mirrored_clips_are_mirrored_in_motion_words_and_labels(corpus):
    for i in (*corpus.indices(composed=False)[:12], *corpus.indices(composed=True)[:3]):
        assert torch.equal(corpus.motion(i, mirrored=True).root, corpus.motion(i).mirrored().root)
        assert corpus.captions(i, mirrored=True) == tuple(mirror_text(s) for s in corpus.captions(i))
        assert corpus.contents(i, mirrored=True) == tuple(mirror_text(c) for c in corpus.contents(i))


def test_indices_select(corpus):
    everything = set(corpus.indices())
    assert everything == set(range(len(corpus)))
    assert set(corpus.indices(composed=True)) | set(corpus.indices(composed=False)) == everything
    assert sum(len(corpus.indices(s)) for s in ("train", "val", "test")) == len(corpus)
    with pytest.raises(InputError, match="no split"):
        corpus.indices("dev")
    with pytest.raises(InputError, match="no clip"):
        corpus.motion(len(corpus))


@pytest.mark.parametrize("place", [0.0001, 0.01, 0.3, 0.6, 0.9, 0.9999])
def test_one_flipped_bit_anywhere_is_noticed(path, tmp_path, place):
    data = bytearray(path.read_bytes())
    data[int(place * len(data))] ^= 4
    broken = tmp_path / "broken.safetensors"
    broken.write_bytes(data)
    with pytest.raises(FormatError):
        Corpus.open(broken)


@pytest.mark.parametrize("keep", [0, 5, 8, 100, 0.5, 0.999])
def test_truncation_is_noticed(path, tmp_path, keep):
    data = path.read_bytes()
    broken = tmp_path / "broken.safetensors"
    broken.write_bytes(data[: int(keep * len(data)) if isinstance(keep, float) else keep])
    with pytest.raises(FormatError):
        Corpus.open(broken)


def test_absurd_headers_allocate_nothing(tmp_path):
    broken = tmp_path / "broken.safetensors"
    huge = {"rotations": {"dtype": "I16", "shape": [2**40, 22, 3], "data_offsets": [0, 2**47]}}
    headers = [
        (2**62).to_bytes(8, "little") + b"{}",
        b"\x02\x00\x00\x00\x00\x00\x00\x00{}",
        *(
            len(text).to_bytes(8, "little") + text
            for text in (
                json.dumps(huge | {"__metadata__": {"moveset corpus": json.dumps({"version": 1})}}).encode(),
                json.dumps({"__metadata__": {"moveset corpus": json.dumps({"version": 99})}}).encode(),
                json.dumps({"__metadata__": {"moveset corpus": "[" * 100_000}}).encode(),
                b"[" * 100_000,
                b"\xff\xfe" * 50,
            )
        ),
    ]
    for data in headers:
        broken.write_bytes(data)
        tracemalloc.start()
        with pytest.raises(FormatError):
            Corpus.open(broken)
        assert tracemalloc.get_traced_memory()[1] < 20 * 2**20
        tracemalloc.stop()


def test_a_missing_file_names_the_remedy(tmp_path):
    with pytest.raises(InputError, match="moveset data build"):
        Corpus.open(tmp_path / "nothing.safetensors")


def tampered(path: Path, to: Path, change) -> Path:
    """A corpus with another index and a valid checksum: what a hostile file would be."""
    from safetensors.torch import load_file, save_file

    from moveset.data.corpus import _digest

    header = json.loads(path.read_bytes()[8 : 8 + int.from_bytes(path.read_bytes()[:8], "little")])
    index = json.loads(header["__metadata__"]["moveset corpus"])
    tensors = load_file(path)
    del index["sha256"]
    change(index, tensors)
    index["sha256"] = _digest(tensors, index)
    save_file(tensors, to, metadata={"moveset corpus": json.dumps(index)})
    return to


def composed(index):
    return next(r for r in index["records"] if "recipe" in r)


@pytest.mark.parametrize(
    "change",
    [
        lambda i, t: i["records"][0].update(frames=10**9),
        lambda i, t: i["records"][0].update(frames=-1),
        lambda i, t: i["records"][0].update(split="dev"),
        lambda i, t: i["records"][0].update(fps=0),
        lambda i, t: i["records"][0].update(first_frame=5),
        lambda i, t: i["records"][0].update(run=None),
        lambda i, t: i["records"][0].update(weight=0),
        lambda i, t: i["runs"].__setitem__(0, ["a", 0, 10**6]),
        lambda i, t: i["runs"].__setitem__(0, ["a", 0]),
        lambda i, t: i["runs"].append(["a", 0, 1]),
        lambda i, t: i["records"][0].update(captions=10**6),
        lambda i, t: i["records"][0].pop("name"),
        lambda i, t: i["records"].__setitem__(0, 5),
        lambda i, t: i.pop("records"),
        lambda i, t: i.update(skeleton="octopus"),
        lambda i, t: i["caption_sets"].__setitem__(0, [10**6]),
        lambda i, t: composed(i)["recipe"]["parts"].__setitem__(0, [10**6, 0, 5, False]),
        lambda i, t: composed(i)["recipe"]["parts"].__setitem__(0, [len(i["records"]) - 1, 0, 5, False]),
        lambda i, t: composed(i)["recipe"]["parts"][0].__setitem__(2, 10**6),
        lambda i, t: composed(i)["recipe"].update(parts=[[0, 0, 5, False]]),
        lambda i, t: composed(i).pop("recipe"),
        lambda i, t: t.update(root=t["root"][:-1].clone()),
        lambda i, t: t.update(root=t["root"] * float("nan")),
        lambda i, t: t.update(rotations=t["rotations"].int()),
        lambda i, t: t.pop("offsets"),
    ],
)
def test_hostile_indices_are_refused(path, tmp_path, change):
    with pytest.raises(FormatError):
        Corpus.open(tampered(path, tmp_path / "bad.safetensors", change))


def test_the_tampering_itself_is_valid(path, tmp_path):
    assert len(Corpus.open(tampered(path, tmp_path / "good.safetensors", lambda i, t: None))) == len(Corpus.open(path))


def test_the_writer_refuses_nonsense(tmp_path):
    with pytest.raises(InputError, match="no clips"):
        CorpusWriter().write(tmp_path / "empty.safetensors")
    with pytest.raises(InputError, match="at least 12"):
        synthetic_corpus(tmp_path / "small.safetensors", clips=3)


def test_a_failed_write_leaves_nothing(tmp_path, monkeypatch):
    def full_disk(_):
        raise OSError("disk full")

    writer = CorpusWriter()
    add_take(writer, entry("a", synthetic_motion("walk", 30)))
    monkeypatch.setattr("os.fsync", full_disk)
    with pytest.raises(MovesetError, match="disk full"):
        writer.write(tmp_path / "c.safetensors")
    assert list(tmp_path.iterdir()) == []
