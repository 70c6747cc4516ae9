"""``moveset stream``: a line for every segment, files that are whole however it ends, and every wrong input."""

import io
import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from moveset import load
from moveset.cli.__main__ import main
from moveset.cli.growing_files import GrowingFiles
from moveset.cli.prompt_lines import PromptLines
from moveset.errors import MovesetError
from moveset.io import read_metadata
from moveset.io.take_writer import Take
from tests.motions import gait

CONTRACT = ["segment", "first_frame", "frames", "prompt", "latency_ms", "network_evaluations"]


@pytest.fixture
def model(tiny_streams):
    return tiny_streams


@pytest.fixture
def stream(model, tmp_path, monkeypatch, capsys):
    """Run in an empty folder; the exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments, folder=model):
        code = main(["stream", *arguments, "--model", str(folder)])
        return code, *capsys.readouterr()

    return run


@pytest.fixture
def process(model, tmp_path):
    """A stream of its own, in an empty folder."""
    started = []

    def start(*arguments, **options):
        command = [sys.executable, "-m", "moveset.cli", "stream", *arguments, "--model", str(model), "--device", "cpu"]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "stdin": subprocess.PIPE, "text": True}
        started.append(subprocess.Popen(command, cwd=tmp_path, **pipes, **options))
        return started[-1]

    yield start
    for child in started:
        child.kill()
        child.wait()
        for pipe in filter(None, (child.stdin, child.stdout, child.stderr)):
            pipe.close()


def rows(out):
    return [json.loads(line) for line in out.splitlines()]


def test_the_json_contract(stream):
    code, out, err = stream("a person walks", "a person bows", "--seconds", "2.8", "1.4", "--json")
    assert code == 0
    found = rows(out)
    assert [list(row) for row in found] == [CONTRACT] * 3
    assert [(r["segment"], r["first_frame"], r["frames"], r["prompt"]) for r in found] == [
        (0, 0, 28, "a person walks"),
        (1, 28, 28, "a person walks"),
        (2, 56, 28, "a person bows"),
    ]
    assert all(row["latency_ms"] > 0 and row["network_evaluations"] == 2 for row in found)
    assert all(line.startswith("moveset: warning: ") for line in err.splitlines())


def test_files_grow_together_and_the_same_seed_gives_the_same_bytes(stream, tmp_path):
    made = []
    for _ in range(2):
        code, out, _ = stream("a person walks", "--total", "3.3", "--seed", "7", "-o", "w.bvh", "w.glb", "w.npz")
        assert code == 0
        assert out.splitlines()[:3] == ["w.bvh", "w.glb", "w.npz"]
        assert out.splitlines()[3].startswith("66 frames at 20 fps, 3.3 s, seed 7, a segment in ")
        made.append({path.name: path.read_bytes() for path in tmp_path.iterdir()})
    assert made[0] == made[1]
    assert set(made[0]) == {"w.bvh", "w.bvh.json", "w.glb", "w.npz"}
    assert [len(load(tmp_path / name)) for name in ("w.bvh", "w.glb", "w.npz")] == [66, 66, 66]
    notes = read_metadata(tmp_path / "w.glb")
    assert (notes["prompt"], notes["seed"], notes["network"], notes["steps"]) == ("a person walks", 7, "pcm-1", 1)


W, B, V = "walk", "bow", "wave"


@pytest.mark.parametrize(
    ("arguments", "prompts", "frames"),
    [
        ("walk|bow", [W] * 4 + [B] * 4, 224),
        ("walk|bow|--seconds|1|0.7", [W, B], 34),
        ("walk|--seconds|1.4|--total|4", [W] * 3, 80),
        ("walk|bow|--seconds|1.4|--total|5.6", [W, B, B, B], 112),
        ("walk|bow|--seconds|1.4|--total|5.6|--loop", [W, B, W, B], 112),
        ("walk, then bow", [W] * 3 + [B] * 3, 168),
        ("walk, then bow|--seconds|5.6|--total|7", [W] * 2 + [B] * 3, 140),
        ("walk, then bow|--no-stages|--total|2.8", ["walk, then bow"] * 2, 56),
        # A short total is shared by all that there is to do; durations that were asked for stay, and so do rounds.
        ("walk, then bow, then wave|--total|8.4", [W] * 2 + [B] * 2 + [V] * 2, 168),
        ("walk|bow, then wave|--total|7", [W] * 2 + [B] * 2 + [V], 140),
        ("walk|bow|--seconds|4.2|--total|4.2", [W] * 3, 84),
        ("walk|bow|--loop|--total|5.6", [W] * 4, 112),
        # There is no segment for everyone: the last stay away, as they would with --seconds.
        ("walk, then bow, then wave|--total|2.8", [W, B], 56),
    ],
)
def test_whose_time_it_is_and_how_long_it_lasts(stream, arguments, prompts, frames):
    found = rows(stream(*arguments.split("|"), "--json")[1])
    assert [row["prompt"] for row in found] == prompts
    assert sum(row["frames"] for row in found) == frames


def test_rounded_durations_are_told(stream):
    _, _, err = stream("walk", "bow", "kick", "--seconds", "2", "3", "1", "--json")
    assert "moveset: prompts change every 1.4 s, so they last 1.4, 4.2 s" in err
    assert "change every" not in stream("walk", "bow", "--seconds", "2.8", "1", "--json")[2]


def test_what_never_comes_is_told(stream):
    _, out, err = stream("a person walks, then waves, then bows", "--total", "2", "--json")
    assert [r["prompt"] for r in rows(out)] == ["a person walks", "a person waves"]
    assert "moveset: the stream ends before 'a person bows'; make it longer" in err.splitlines()
    _, out, err = stream("a person walks", "a person bows", "--seconds", "2.8", "--total", "2", "--json")
    assert {r["prompt"] for r in rows(out)} == {"a person walks"}
    assert "moveset: the stream ends before 'a person bows'; make it longer" in err.splitlines()
    assert "ends before" not in stream("a person walks, then bows", "--total", "2.8")[2]


def test_networks_and_guidance(stream):
    def evaluations(*more):
        return [row["network_evaluations"] for row in rows(stream("a", "--total", "2.8", *more, "--json")[1])]

    assert evaluations("--steps", "2") == [2, 2]
    assert evaluations("--network", "md", "--steps", "5", "--guidance", "1") == [10, 10]
    assert evaluations("--network", "rdm") == [9, 3]


def test_the_staircase_is_chosen_and_noted(stream, tmp_path):
    def made(name, *plan):
        code, out, _ = stream("a", "--total", "2.8", *plan, "-o", name, "--json")
        assert code == 0
        notes = read_metadata(tmp_path / name)
        return [row["network_evaluations"] for row in rows(out)], [notes[n] for n in ("start", "lag", "past_lag")]

    rdm = ("--network", "rdm", "--steps", "3", "--start", "3")
    assert made("one-by-one.npz", *rdm, "--lag", "3") == ([3, 3], [3, 3, 3])
    assert made("noisy.npz", *rdm, "--lag", "3", "--past-lag", "1") == ([3, 3], [3, 3, 1])
    calls, notes = made("overlapping.npz", *rdm, "--lag", "1")
    assert sum(calls) > 6  # the segments after it have been begun by the time that the first two are finished
    assert notes == [3, 1, 1]
    assert made("students.npz", "--network", "pcm-2", "--lag", "1") == ([3, 2], [2, 1, 1])
    assert stream("a", "--total", "1.4", "-o", "student.npz")[0] == 0
    assert not {"start", "lag", "past_lag"} & set(read_metadata(tmp_path / "student.npz"))


def test_in_place(stream, tmp_path):
    assert stream("a", "--total", "2", "-o", "i.npz", "--in-place")[0] == 0
    assert float(load(tmp_path / "i.npz").root[:, [0, 2]].abs().max()) == 0


def test_from_a_clip(stream, tmp_path):
    assert stream("a", "--total", "2", "-o", "clip.npz")[0] == 0
    assert stream("a", "--total", "1.4", "-o", "more.npz", "--from", "clip.npz", "--no-foot-lock")[0] == 0
    clip, more = load(tmp_path / "clip.npz"), load(tmp_path / "more.npz")
    step = (clip.root[-1] - clip.root[-2])[[0, 2]].norm()
    assert float((more.root[0] - clip.root[-1])[[0, 2]].norm()) == pytest.approx(float(step), abs=1e-3)
    assert stream("a", "--from", "missing.bvh")[0] == 2


def test_prompts_from_a_file_take_effect(stream, tmp_path):
    (tmp_path / "lines.txt").write_text("\n  \na person bows\n")
    code, out, _ = stream("--prompts", "lines.txt", "--json", "-o", "w.npz")
    # The end of the input is the end of the stream, once its own prompts are over.
    assert code == 0
    found = rows(out)
    assert len(found) >= 1
    assert found[-1]["prompt"] == "a person bows"
    # The file was begun before these were read, and does not claim another.
    assert not {"prompt", "starts"} & read_metadata(tmp_path / "w.npz").keys()


def test_a_named_pipe_is_read_from_one_writer_after_the_other(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    found = []
    lines = PromptLines(tmp_path / "pipe")
    for text in ("a person bows", "a person waves"):
        (tmp_path / "pipe").write_text(f"{text}\n")
        end = time.monotonic() + 20.0
        while len(found) < 1 or found[-1] != text:
            assert time.monotonic() < end, found
            found += lines.new()
            time.sleep(0.01)
    assert not lines.ended


def test_of_prompts_that_come_at_once_the_last_that_can_be_told_counts(stream, tmp_path):
    (tmp_path / "lines.txt").write_text("a person walks\na person bows\nbad \x01 one\n")
    code, out, err = stream("a person runs", "--prompts", "lines.txt", "--json")
    assert code == 0
    assert rows(out)[-1]["prompt"] == "a person bows"
    assert "control characters" in err
    assert "left out, since a newer prompt came: a person walks\n" in err


def test_a_closed_standard_input_has_no_prompts(stream, monkeypatch):
    monkeypatch.setattr(sys, "stdin", None)
    assert stream("a person walks", "--prompts", "-", "--total", "1.4")[0] == 0


def test_a_source_without_prompts_is_told(stream, tmp_path, monkeypatch):
    (tmp_path / "lines.txt").write_text("\n  \n")
    code, _, err = stream("--prompts", "lines.txt", "-o", "w.npz")
    assert code == 0
    assert "moveset: there is no prompt in 'lines.txt'; write one a line\n" in err

    def breaks_off(*arguments):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr("moveset.cli.prompt_lines.os.read", breaks_off)
    code, _, err = stream("a person bows", "--prompts", "lines.txt", "-o", "w.npz")
    assert code == 0
    assert "no more prompts can be read from 'lines.txt': Input/output error; give a file, a pipe or -\n" in err


def test_motion_that_nobody_keeps_is_told(stream):
    said = "moveset: this motion is not kept; give -o FILE to write it, or --json to be told of it\n"
    assert said in stream("walk", "--total", "1.4")[2]
    assert "not kept" not in stream("walk", "--total", "1.4", "--json")[2]
    assert "not kept" not in stream("walk", "--total", "1.4", "-o", "w.npz")[2]


@pytest.mark.parametrize(("source", "number", "code"), [("-", signal.SIGINT, 130), ("a.txt", signal.SIGTERM, 1)])
def test_prompts_arrive_while_it_runs_and_a_signal_keeps_what_was_made(process, tmp_path, source, number, code):
    (tmp_path / "a.txt").write_text("a person waves\n")
    child = process("a person walks", "--prompts", source, "--forever", "--json", "-o", "w.bvh", "w.glb")
    lines = [child.stdout.readline()]
    child.stdin.write("a person bows\n\na person waves\n")
    child.stdin.close()
    child.stdin = None
    while "waves" not in lines[-1]:
        lines.append(child.stdout.readline())
    # For ever is longer than the prompts.
    lines += [child.stdout.readline() for _ in range(5)]
    assert child.poll() is None
    child.send_signal(number)
    rest, err = child.communicate(timeout=120)
    assert child.returncode == code
    assert "Traceback" not in err
    found = rows("".join(lines) + rest)
    assert found[-1]["prompt"] == "a person waves"
    frame = next(row["first_frame"] for row in found if row["prompt"] == "a person waves")
    assert f"moveset: from frame {frame}: a person waves" in err
    frames = sum(row["frames"] for row in found)
    assert [len(load(tmp_path / name)) for name in ("w.bvh", "w.glb")] == [frames, frames]


def test_a_closed_pipe_ends_quietly(stream, tmp_path, monkeypatch):
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as out:
        monkeypatch.setattr(sys, "stdout", out)
        code, _, err = stream("a person walks", "--forever", "--json", "-o", "w.npz")
        monkeypatch.undo()
    assert (code, err) == (0, "")
    assert len(load(tmp_path / "w.npz")) >= 28


def test_a_full_disk_keeps_what_fits(stream, tmp_path):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
    try:
        code, _, err = stream("a person walks", "--forever", "-o", "w.bvh")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert (code, err.count("\n"), "free some space" in err) == (1, 1, True)
    size = (tmp_path / "w.bvh").stat().st_size
    assert 60_000 < size <= 100_000
    assert len(load(tmp_path / "w.bvh")) > 80
    assert not list(tmp_path.glob("*.part"))


def test_what_is_printed_is_json_whatever_the_terminal_can_show(stream, monkeypatch):
    said = "a person walks to the café 😀"
    with io.TextIOWrapper(io.BytesIO(), "ascii") as out:
        monkeypatch.setattr(sys, "stdout", out)
        stream(said, "--total", "1.4", "--json")
        out.flush()
        assert json.loads(out.buffer.getvalue())["prompt"] == said


def test_a_full_file_is_followed_by_the_next(tmp_path, monkeypatch):
    monkeypatch.setattr(Take, "room", property(lambda take: 60 - take.frames))
    motion, said = gait(28), {"prompt": "a person walks | bows", "starts": "0 | 4"}
    with GrowingFiles([tmp_path / "w.npz"], motion.skeleton, motion.fps, said) as files:
        for _ in range(5):
            files.append(motion)
    assert [path.name for path in files.paths] == ["w.npz", "w-2.npz", "w-3.npz"]
    assert [len(load(path)) for path in files.paths] == [56, 56, 28]
    assert files.frames == 140
    notes = [read_metadata(path) for path in files.paths]
    assert [(of["prompt"], of["starts"]) for of in notes] == [
        ("a person walks | bows", "0 | 4"), ("a person walks | bows", "0 | 1.2"), ("bows", "0")
    ]  # fmt: skip


def test_what_is_said_again_and_again_begins_more_often_than_a_file_could_tell(stream, tmp_path):
    stream("walk", "bow", "--seconds", "1.4", "--total", "5.6", "--loop", "-o", "w.npz")
    notes = read_metadata(tmp_path / "w.npz")
    assert notes["prompt"] == "walk | bow"
    assert "starts" not in notes


def test_one_file_that_fails_does_not_lose_the_others(tmp_path, monkeypatch):
    motion, close = gait(28), Take.close

    def fails(take):
        path = close(take)
        if take.path.name == "a.npz":
            raise MovesetError("cannot finish a.npz")
        return path

    monkeypatch.setattr(Take, "close", fails)
    with (
        pytest.raises(MovesetError, match=r"a\.npz"),
        GrowingFiles([tmp_path / "a.npz", tmp_path / "b.npz"], motion.skeleton, motion.fps, {}) as files,
    ):
        files.append(motion)
    assert len(load(tmp_path / "b.npz")) == 28


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "no prompt was given"),
        (("",), "the prompt is empty"),
        (("a", "--total", "0"), "total of 0 seconds"),
        (("a", "--total", "nan"), "total of nan seconds"),
        (("a", "--total", "3", "--forever"), "exclude each other"),
        (("a", "--loop"), "--loop needs"),
        (("--prompts", "lines.txt", "--seconds", "3"), "--seconds and --loop are for PROMPTs"),
        (("--prompts", "lines.txt", "--loop", "--forever"), "--seconds and --loop are for PROMPTs"),
        (("a", "--device", "tpu"), "unknown device"),
        (("a", "-o", "w.mp4"), "cannot stream to 'w.mp4'"),
        (("a", "-o", "w" * 248 + ".bvh"), "longer than 255 bytes"),
        (("a", "-o", "w.bvh", "w.bvh"), "written twice"),
        (("a", "-o", "nowhere/w.bvh"), "does not exist"),
        (("a", "--prompts", "nowhere.txt"), "there is no file 'nowhere.txt'"),
        (("a", "--secnds", "3"), "--seconds"),
    ],
)
def test_wrong_input_is_one_line_and_leaves_nothing(stream, tmp_path, arguments, said):
    code, out, err = stream(*arguments)
    assert code == 2
    assert out == ""
    assert err.count("\n") == 1
    assert said in err
    assert list(tmp_path.iterdir()) == []


def test_another_kind_of_model_is_named(stream, tiny_clips):
    for folder, said in ((tiny_clips, "is a text-to-motion model"), (Path("nowhere"), "nowhere")):
        code, _, err = stream("a", folder=folder)
        assert (code, said in err) == (2, True)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written_to(stream, tmp_path):
    (tmp_path / "locked").mkdir(mode=0o500)
    assert stream("a", "-o", "locked/w.bvh")[0] == 2


def test_a_mark_of_byte_order_is_no_part_of_a_prompt(stream, tmp_path):
    (tmp_path / "lines.txt").write_bytes("\ufeffa person bows\r\n".encode())
    code, out, _ = stream("--prompts", "lines.txt", "--json")
    assert code == 0
    assert rows(out)[-1]["prompt"] == "a person bows"
