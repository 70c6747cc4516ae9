"""``convert``, ``models``, ``doctor``, and what ``train`` refuses."""

import json
import os
import shutil

import pytest
import torch

from moveset import load
from moveset.cli.__main__ import main
from moveset.errors import InputError
from moveset.io import read_metadata
from moveset.io.take_writer import open_take
from moveset.pipelines import model_folder
from moveset.pipelines.text_to_motion import TextToMotion


@pytest.fixture
def model(tiny_clips):
    return tiny_clips


@pytest.fixture
def clip(model, tmp_path):
    return TextToMotion.from_pretrained(model)("a person walks", seconds=1.0).motion.save(tmp_path / "clip.bvh")


@pytest.fixture
def shipped(model, monkeypatch):
    monkeypatch.setattr(model_folder, "shipped", lambda: {"tiny": model})


def test_convert_retargets_and_resamples(clip, tmp_path, capsys):
    target = tmp_path / "clip.npz"
    assert main(["convert", str(clip), str(target), "--skeleton", "vrm", "--fps", "30"]) == 0
    assert "on vrm" in capsys.readouterr().out
    assert load(target).fps == 30


def test_convert_shows_and_is_told_which_joint_is_which(clip, tmp_path, capsys):
    assert main(["convert", str(clip), "--show-map"]) == 0
    assert "left_wrist      left_wrist" in capsys.readouterr().out
    table = tmp_path / "map.json"
    table.write_text('{"left_wrist": "left_elbow", "left_elbow": null}')
    assert main(["convert", str(clip), "--map", str(table), "--show-map"]) == 0
    assert "left_wrist      left_elbow                       as given" in capsys.readouterr().out
    for text, message in (("[]", "no object of parts"), ("{", "is not JSON"), ('{"tail": "x"}', "no part 'tail'")):
        table.write_text(text)
        assert main(["convert", str(clip), str(tmp_path / "a.glb"), "--map", str(table)]) == 2
        assert message in capsys.readouterr().err


def test_convert_is_told_axes_and_unit(clip, tmp_path):
    target = tmp_path / "clip.npz"
    before = load(clip)
    assert main(["convert", str(clip), str(target), "--up", "z", "--facing=-y", "--scale", "0.02"]) == 0
    assert torch.allclose(load(target).root[:, 1], 2 * before.root[:, 2], atol=1e-4)
    assert main(["convert", str(clip), str(target), "--scale", "-1"]) == 2


@pytest.mark.parametrize(("suffix", "kept", "frames"), [(".gif", 20, 20), (".mp4", 30, 29), (".bvh", 60, 58)])
def test_convert_tells_the_rate_that_the_file_has(clip, tmp_path, capsys, suffix, kept, frames):
    target = tmp_path / f"clip{suffix}"
    assert main(["convert", str(clip), str(target), "--fps", "60"]) == 0
    out, err = capsys.readouterr()
    assert f"{frames} frames at {kept} fps" in out
    assert err == ("" if kept == 60 else f"moveset: {target} has {kept} frames a second, not 60\n")


@pytest.mark.parametrize("suffix", [".bvh", ".glb", ".html", ".npz", ".amass.npz", ".png"])
def test_convert_keeps_what_was_said(clip, tmp_path, suffix):
    (tmp_path / "clip.bvh.json").write_text('{"prompt": "a person walks", "seed": 3}')
    other = tmp_path / f"other{suffix}"
    for middle in (clip, tmp_path / "middle.glb"):
        assert main(["convert", str(clip), str(middle)]) == 0
        assert main(["convert", str(middle), str(other), "--fps", "30", "--skeleton", "smpl"]) == 0
        told = read_metadata(other)
        assert (told.pop("fps", 30), told.pop("skeleton", "smpl")) == (30, "smpl")
        assert told == {"prompt": "a person walks", "seed": 3}
    (tmp_path / "clip.bvh.json").write_text("no JSON")
    assert main(["convert", str(clip), str(other)]) == 0
    assert read_metadata(other).keys() <= {"fps", "skeleton"}


@pytest.mark.parametrize("suffix", [".bvh", ".glb", ".npz"])
def test_convert_rescues_a_take_that_was_cut_off(clip, tmp_path, suffix):
    motion = load(clip)
    take = open_take(tmp_path / f"take{suffix}", motion.skeleton, motion.fps)
    take.append(motion)
    shutil.copy(tmp_path / f"take{suffix}.part", tmp_path / f"left{suffix}.part")  # as after a kill: never closed
    take.close()
    assert main(["convert", str(tmp_path / f"left{suffix}.part"), str(tmp_path / "rescued.glb")]) == 0
    rescued = load(tmp_path / "rescued.glb")
    assert len(rescued) == len(motion)
    assert float((rescued.joints - motion.joints).abs().max()) < 1e-4
    assert not (tmp_path / f"left{suffix}.part").exists()


@pytest.mark.parametrize(
    ("source", "target", "message"),
    [
        ("none.bvh", "b.glb", "none.bvh"),
        ("clip.bvh", "b.fbx", "unknown extension"),
        ("half.bvh", "b.glb", "half.bvh"),
        ("empty.bvh", "b.glb", "empty.bvh"),
        ("text.glb", "b.bvh", "text.glb"),
    ],
)
def test_convert_refuses_in_one_line(clip, tmp_path, monkeypatch, capsys, source, target, message):
    monkeypatch.chdir(tmp_path)
    data = clip.read_bytes()
    (tmp_path / "half.bvh").write_bytes(data[: len(data) // 2])
    (tmp_path / "empty.bvh").write_bytes(b"")
    (tmp_path / "text.glb").write_bytes(b"hello")
    before = sorted(tmp_path.iterdir())
    assert main(["convert", source, target]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("suffix", [".bvh", ".npy", ".amass.npz"])
def test_a_name_with_no_room_for_its_notes_is_refused_before_anything_is_written(clip, tmp_path, capsys, suffix):
    before = sorted(tmp_path.iterdir())
    target = tmp_path / ("a" * (254 - len(suffix)) + suffix)
    assert main(["convert", str(clip), str(target)]) == 2
    assert "longer than 255 bytes" in capsys.readouterr().err
    with pytest.raises(InputError, match="longer than 255 bytes"):
        load(clip).save(target)
    assert sorted(tmp_path.iterdir()) == before
    assert main(["convert", str(clip), str(target.with_name("a" * 246 + ".glb"))]) == 0


def test_convert_writes_through_links_and_not_over_pipes(clip, tmp_path, capsys):
    (tmp_path / "link.glb").symlink_to("real.glb")
    assert main(["convert", str(clip), str(tmp_path / "link.glb")]) == 0
    assert (tmp_path / "link.glb").is_symlink()
    assert len(load(tmp_path / "real.glb")) == len(load(clip))
    os.mkfifo(tmp_path / "pipe.glb")
    assert main(["convert", str(clip), str(tmp_path / "pipe.glb")]) == 2
    assert "no regular file" in capsys.readouterr().err


def test_doctor_is_content_with_a_whole_installation(shipped, model, capsys):
    assert main(["doctor", "--model", str(model), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["ok"]
    assert set(report["checks"]) == {"device", "weights", "video", "self_test"}
    assert report["checks"]["self_test"]["frames"] == 20
    assert report["versions"]["torch"]


def test_doctor_tests_a_stream_model(shipped, tiny_streams, capsys):
    assert main(["doctor", "--model", str(tiny_streams), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["checks"]["self_test"]["frames"] == 56


def test_doctor_names_what_is_damaged(model, tmp_path, monkeypatch, capsys):
    folder = shutil.copytree(model, tmp_path / "tiny")
    path = folder / "vae.safetensors"
    path.write_bytes(path.read_bytes()[:-4])
    monkeypatch.setattr(model_folder, "shipped", lambda: {"tiny": folder})
    assert main(["doctor", "--model", str(folder)]) == 1
    out = capsys.readouterr().out
    assert "ok    device" in out
    assert "FAIL  weights: error" in out
    assert "FAIL  self_test" in out
    assert "vae.safetensors is damaged" in out


def test_what_a_training_or_all_of_them_would_ignore_is_refused(tmp_path, capsys):
    of_one = (("--steps", "5"), ("--set", "lr=1"), ("--seed", "0"), ("--save-every", "5"), ("--vae", "runs/vae"))
    for option in (*of_one, ("--folder", str(tmp_path)), ("--tensorboard", "True")):
        assert main(["train", "all", "--out", str(tmp_path / "runs"), *option]) == 2
        assert f"{option[0]} is of one training, not of 'all'" in capsys.readouterr().err
    for what, option in (("rdm-7", "--teacher"), ("length", "--vae"), ("vae", "--vae")):
        assert main(["train", what, "--folder", str(tmp_path / "runs"), option, "nowhere"]) == 2
        assert f"{option} is of trainings that stand on one, not of '{what}'" in capsys.readouterr().err
    given = ["train", "all", "--out", str(tmp_path / "runs"), "--raw", "raw", "--corpus", str(tmp_path)]
    assert main(given) == 2
    assert "leave --raw out" in capsys.readouterr().err
    for option in (("--share", "0.5"), ("--only", "vae"), ("--jobs", "2"), ("--raw", str(tmp_path)), ("--tables",)):
        for what in ("vae", "export"):
            assert main(["train", what, "--folder", str(tmp_path / "runs"), *option]) == 2
            assert f"{option[0]} is of 'all', not of '{what}'" in capsys.readouterr().err
    for option in (("--device", "cpu"), ("--resume",)):
        assert main(["train", "export", "--folder", str(tmp_path / "runs"), *option]) == 2
        assert f"{option[0]} is of trainings, not of 'export'" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()
