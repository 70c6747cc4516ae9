"""Building: archives that cannot hurt, cuts that lose nothing, and a build that survives being killed."""

import errno
import io
import json
import os
import signal
import subprocess
import sys
import tarfile
import time
from collections.abc import Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from threading import Thread
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from moveset.data.build import build_corpus, clean_sentences, cut
from moveset.data.compose import add_compositions
from moveset.data.corpus import Corpus, CorpusWriter
from moveset.data.raw import FREE, find_takes, unpacked
from moveset.data.splits import split_of
from moveset.errors import FormatError, InputError, MovesetError
from moveset.io.process import locked
from tests.synthetic import synthetic_motion


@given(st.integers(1, 5000))
def test_cuts_cover_everything_in_even_pieces(frames):
    pieces = cut(frames)
    assert pieces[0][0] == 0
    assert pieces[-1][1] == frames
    assert all(a[1] == b[0] for a, b in pairwise(pieces))
    lengths = [stop - start for start, stop in pieces]
    assert max(lengths) <= 196
    assert max(lengths) - min(lengths) <= 1
    assert min(lengths) >= min(frames, 40)


def test_advertisements_are_no_sentences():
    assert clean_sentences(
        ["A person walks.", "so visit <a href=http://x.com/>the bus</a>", " A  person walks. ", "", "see www.x.com"]
    ) == ("A person walks.",)


def archive(path: Path, members: dict[str, bytes], links: dict[str, str] | None = None) -> None:
    with tarfile.open(path, "w:xz") as tar:
        for name, data in members.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            tar.addfile(info, io.BytesIO(data))
        for name, target in (links or {}).items():
            info = tarfile.TarInfo(name)
            info.type, info.linkname = tarfile.SYMTYPE, target
            tar.addfile(info)


def test_archives_are_unpacked_once(tmp_path):
    raw, scratch = tmp_path / "raw", tmp_path / "scratch"
    raw.mkdir()
    archive(raw / "cmu.tar.xz", {"cmu/trials.jsonl": b"", "cmu/subjects/01/01.asf": b"x"})
    assert unpacked(raw, scratch) == scratch
    assert (scratch / "cmu" / "subjects" / "01" / "01.asf").read_bytes() == b"x"
    before = (scratch / "cmu" / "trials.jsonl").stat().st_mtime_ns
    unpacked(raw, scratch)
    assert (scratch / "cmu" / "trials.jsonl").stat().st_mtime_ns == before
    assert unpacked(scratch, tmp_path / "elsewhere") == scratch
    assert not (tmp_path / "elsewhere").exists()


def test_an_archive_beside_folders_is_not_left_out(tmp_path):
    (tmp_path / "cmu").mkdir()
    archive(tmp_path / "cmu-more.tar.xz", {"cmu-more/trials.jsonl": b""})
    with pytest.raises(InputError, match=r"has cmu as a folder and cmu-more\.tar\.xz still packed"):
        unpacked(tmp_path, tmp_path / "scratch")
    assert unpacked(tmp_path, tmp_path / "scratch", ("cmu",)) == tmp_path
    (tmp_path / "cmu-more").mkdir()
    assert unpacked(tmp_path, tmp_path / "scratch") == tmp_path


def archives_of_all(raw: Path) -> Path:
    raw.mkdir()
    for name in FREE:
        archive(raw / f"{name}.tar.xz", {f"{name}/x.txt": name.encode()})
    (raw / "humanml3d-cmu.jsonl").write_text("\n")
    return raw


def test_what_an_interrupted_build_left_packed_is_unpacked_beside_the_rest(tmp_path, monkeypatch):
    raw = archives_of_all(tmp_path / "raw")
    whole, done = tarfile.TarFile.extractall, []

    def interrupted(tar: tarfile.TarFile, *args: Any, **settings: Any) -> None:
        if done:
            raise KeyboardInterrupt
        done.append(tar)
        whole(tar, *args, **settings)

    with monkeypatch.context() as patched:
        patched.setattr(tarfile.TarFile, "extractall", interrupted)
        with pytest.raises(KeyboardInterrupt):
            unpacked(raw, raw)
    assert [name for name in FREE if (raw / name).is_dir()] == [FREE[0]]
    (raw / FREE[0] / "x.txt").write_text("not unpacked again")
    (tmp_path / "same").symlink_to(raw)
    assert unpacked(raw, tmp_path / "same").samefile(raw)
    assert [(raw / name / "x.txt").read_text() for name in FREE] == ["not unpacked again", *FREE[1:]]


def test_sources_can_be_added_where_archives_are_unpacked_in_place(tmp_path):
    raw = archives_of_all(tmp_path / "raw")
    for sources in (("more-mocap",), ("cmu", "more-mocap"), FREE):
        assert unpacked(raw, raw, sources) == raw
        assert {name for name in FREE if (raw / name).is_dir()} == {*sources}


def test_half_of_an_archive_is_completed_and_no_folder_replaced(tmp_path):
    archive(tmp_path / "bandai-namco.tar.xz", {"dataset-1/x.txt": b"packed", "dataset-2/x.txt": b"packed"})
    (tmp_path / "dataset-1").mkdir()
    (tmp_path / "dataset-1" / "x.txt").write_text("there")
    unpacked(tmp_path, tmp_path, ("bandai-namco",))
    assert [(tmp_path / f"dataset-{k}" / "x.txt").read_text() for k in (1, 2)] == ["there", "packed"]


def test_who_comes_second_waits_until_all_is_unpacked(tmp_path):
    raw, scratch = tmp_path / "raw", tmp_path / "scratch"
    raw.mkdir()
    archive(raw / "cmu.tar.xz", {"cmu/trials.jsonl": b""})
    second = Thread(target=unpacked, args=(raw, scratch))
    with locked(scratch):
        second.start()
        second.join(0.3)
        assert second.is_alive()
        assert not (scratch / "cmu").exists()
    second.join(10)
    assert (scratch / "cmu" / "trials.jsonl").is_file()


def test_archives_cannot_write_elsewhere(tmp_path):
    raw, scratch = tmp_path / "raw", tmp_path / "inner" / "scratch"
    raw.mkdir()
    for members, links in (
        ({"../../escaped": b"x", "cmu/a": b""}, {}),
        ({str(tmp_path / "absolute"): b"x"}, {}),
        ({}, {"cmu": "../../.."}),
    ):
        archive(raw / "cmu.tar.xz", members, links)
        with suppress(FormatError):
            unpacked(raw, scratch)
        assert not (tmp_path / "escaped").exists()
        assert not (tmp_path / "absolute").exists()
        assert not any(p.is_symlink() for p in tmp_path.rglob("*"))


@pytest.mark.parametrize("keep", [lambda data, half: data[:half], lambda data, half: data[:half] + data[half + 99 :]])
def test_a_damaged_archive_leaves_nothing(tmp_path, keep):
    raw, scratch = tmp_path / "raw", tmp_path / "scratch"
    raw.mkdir()
    archive(raw / "cmu.tar.xz", {f"cmu/{k}": os.urandom(200_000) for k in range(3)})
    data = (raw / "cmu.tar.xz").read_bytes()
    (raw / "cmu.tar.xz").write_bytes(keep(data, len(data) // 2))
    with pytest.raises(FormatError, match="cannot be unpacked"):
        unpacked(raw, scratch)
    assert [path.name for path in scratch.iterdir()] == [".lock"]


def test_a_full_disk_is_no_fault_of_the_archive(tmp_path, monkeypatch):
    raw = archives_of_all(tmp_path / "raw")

    def full(*_: Any, **__: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(tarfile.TarFile, "extractall", full)
    with pytest.raises(MovesetError, match="No space left on device; make room") as said:
        unpacked(raw, tmp_path / "scratch")
    assert said.value.exit_code == 1
    assert [path.name for path in (tmp_path / "scratch").iterdir()] == [".lock"]


def test_no_data_names_the_remedy(tmp_path):
    with pytest.raises(InputError, match="raw data"):
        build_corpus(tmp_path, tmp_path / "c.safetensors", workers=1)
    with pytest.raises(InputError, match="no takes"):
        find_takes(tmp_path)


def own_capture(raw: Path, names: Sequence[str], sentence: str = "a person walks") -> Path:
    """Takes as people lay out their own."""
    folder = raw / "more-mocap"
    folder.mkdir(parents=True)
    about = {"source": "studio", "file": "take.bvh", "unit_m": 0.01, "sentence": sentence}
    synthetic_motion("walk", 60).save(folder / "take.bvh")
    (folder / "takes.jsonl").write_text("".join(json.dumps({"take": name, **about}) + "\n" for name in names))
    return raw


def test_spans_of_takes_that_are_not_there_decide_no_split(tmp_path):
    every = [f"{k:02d}_01" for k in range(99)]
    names = [next(name for name in every if split_of(name) == side) for side in ("train", "val", "test")]
    raw = own_capture(tmp_path / "raw", names)
    # Of a take that is not there, and of one of CMU whose name an own take happens to have.
    spans = [{"id": "1", "trial": t, "start": 0, "end": 3, "use": "train", "sentences": ["hi"]} for t in ("x", *names)]
    (raw / "humanml3d-cmu.jsonl").write_text("".join(json.dumps(span) + "\n" for span in spans))
    build_corpus(raw, tmp_path / "c.safetensors", workers=1, sources=("more-mocap",), compositions=0)
    corpus = Corpus.open(tmp_path / "c.safetensors")
    assert {record.take: record.split for record in corpus.records} == {name: split_of(name) for name in names}
    assert "hi" not in {caption for k in range(len(corpus)) for caption in corpus.captions(k)}


def test_typos_are_mended_in_what_people_typed_of_spans_alone(tmp_path):
    raw = own_capture(tmp_path / "raw", ["walk-1"], sentence="a person mowing the lawn")
    span = {"id": "1", "trial": "x", "start": 0, "end": 3, "use": "train", "sentences": ["moving"] * 30}
    (raw / "humanml3d-cmu.jsonl").write_text(json.dumps(span))
    assert split_of("walk-1") == "train"
    build_corpus(raw, tmp_path / "c.safetensors", workers=1, sources=("more-mocap",), compositions=0)
    assert Corpus.open(tmp_path / "c.safetensors").captions(0)[0] == "a person mowing the lawn"


def test_takes_none_of_which_gives_a_clip_have_their_reason_said(tmp_path):
    raw = own_capture(tmp_path / "raw", ["a", "b"])
    (raw / "more-mocap" / "take.bvh").unlink()
    with pytest.raises(InputError, match=r"of 2 takes none gives a clip; 'a' for one: its file take\.bvh is missing"):
        build_corpus(raw, tmp_path / "c.safetensors", workers=1, sources=("more-mocap",))


def test_takes_are_imported_anew_where_the_list_says_otherwise(tmp_path):
    raw, settings = own_capture(tmp_path / "raw", ["a"]), {"workers": 1, "sources": ("more-mocap",), "compositions": 0}
    build_corpus(raw, tmp_path / "c.safetensors", keep_work=True, **settings)
    listing = raw / "more-mocap" / "takes.jsonl"
    listing.write_text(json.dumps(json.loads(listing.read_text()) | {"quality": "spikes"}))
    with pytest.raises(InputError, match="its joints jump"):
        build_corpus(raw, tmp_path / "c.safetensors", keep_work=True, **settings)


def test_one_process_at_a_time_builds_a_corpus(tmp_path):
    raw, output = own_capture(tmp_path / "raw", ["a"]), tmp_path / "c.safetensors"
    with locked(tmp_path / f"{output.name}.work"), pytest.raises(InputError, match="another process is building"):
        build_corpus(raw, output, workers=1, sources=("more-mocap",), compositions=0)
    assert not output.exists()
    build_corpus(raw, output, workers=1, sources=("more-mocap",), compositions=0)
    assert sorted(path.name for path in tmp_path.iterdir()) == [output.name, f"{output.name}.report.json", "raw"]


@pytest.mark.parametrize("place", ["folder", "file/c.safetensors"])
def test_an_output_that_cannot_be_written_is_said_before_anything_is_read(tmp_path, place):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"^cannot (write|make)"):
        build_corpus(tmp_path / "nothing", tmp_path / place, workers=1)


def test_takes_that_would_be_kept_in_one_file_are_refused(tmp_path):
    raw = own_capture(tmp_path / "raw", ("a/walk", "a__walk"))
    with pytest.raises(InputError, match=r"'a/walk' of studio and 'a__walk' of studio count as one name"):
        build_corpus(raw, tmp_path / "c.safetensors", workers=1, sources=("more-mocap",))


def test_compositions_of_nothing_are_none():
    assert add_compositions(CorpusWriter(), train=10) == 0


@pytest.fixture(scope="module")
def few_takes(real_data, tmp_path_factory) -> Path:
    """A dozen real takes, so that a build is a matter of seconds."""
    raw = tmp_path_factory.mktemp("raw")
    for ref in find_takes(real_data, SOURCES):
        if not ref.path.is_file() or (len(ref.name) > 10 and not ref.name.endswith(("_001", "_002"))):
            continue
        if ref.name in NAMES:
            for path in (ref.path, *([ref.skeleton] if ref.skeleton else [])):
                target = raw / path.relative_to(real_data)
                target.parent.mkdir(parents=True, exist_ok=True)
                if not target.exists():
                    target.symlink_to(path)
    (raw / "cmu" / "trials.jsonl").symlink_to(real_data / "cmu" / "trials.jsonl")
    return raw


SOURCES = ("cmu", "bandai-namco")
NAMES = {
    "dataset-2_walk_active_002", "dataset-2_walk-turn-left_normal_001",
    "dataset-2_wave-left-hand_normal_001", "dataset-1_bow_active_001", "dataset-1_walk-back_normal_001", "07_03",
    "02_07", "13_18",
}  # fmt: skip


@pytest.fixture(scope="module")
def built(few_takes, tmp_path_factory) -> Path:
    output = tmp_path_factory.mktemp("built") / "corpus.safetensors"
    report = build_corpus(few_takes, output, workers=2, sources=SOURCES, compositions=12)
    assert 0 < report.compositions <= 12
    assert sorted(p.name for p in output.parent.iterdir()) == [output.name, f"{output.name}.report.json"]
    return output


def test_a_build_of_real_takes(built):
    corpus = Corpus.open(built)
    report = json.loads((built.parent / f"{built.name}.report.json").read_text())
    assert "21 clean frames" in report["rejected"]["dataset-1_walk-back_normal_001"]
    names = [r.name for r in corpus.records if r.kind == "take"]
    assert {"02_07#0", "07_03#0", "dataset-1_bow_active_001#0"} <= set(names)
    walk = names.index("07_03#0")
    assert "a person walks" in corpus.captions(walk)
    assert corpus.contents(walk) == ("walk",)
    turn = names.index("dataset-2_walk-turn-left_normal_001#0")
    assert corpus.records[turn].style == "normal"
    assert corpus.motion(turn).root[-1, 0] > 1.0
    cut_up = [r for r in corpus.records if r.take == "02_07" and r.kind == "take"]
    assert len(cut_up) == 2
    assert all(b.first_frame == a.first_frame + a.frames for a, b in pairwise(cut_up))


def test_a_killed_build_continues_and_gives_the_same_bytes(built, few_takes, tmp_path):
    output = tmp_path / "corpus.safetensors"
    command = (
        "from pathlib import Path\nfrom moveset.data.build import build_corpus\n"
        "if __name__ == '__main__':\n"
        f"    build_corpus(Path({str(few_takes)!r}), Path({str(output)!r}), workers=2, sources={SOURCES}, "
        "compositions=12)\n"
    )
    script = tmp_path / "build.py"
    script.write_text(command)
    process = subprocess.Popen([sys.executable, str(script)])
    work = tmp_path / "corpus.safetensors.work"
    deadline = time.monotonic() + 120
    while not list(work.glob("*.safetensors")) and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not output.exists(), "the build was over before it could be killed"
    done = {p: p.stat().st_mtime_ns for p in work.glob("*.safetensors")}
    assert done
    build_corpus(few_takes, output, workers=1, sources=SOURCES, compositions=12, keep_work=True)
    assert output.read_bytes() == built.read_bytes()
    assert all(p.stat().st_mtime_ns == t for p, t in done.items())
    # A damaged cache file is made again.
    (work / "07_03.safetensors").write_bytes(b"half a fi")
    build_corpus(few_takes, output, workers=1, sources=SOURCES, compositions=12)
    assert output.read_bytes() == built.read_bytes()
    assert not work.exists()
