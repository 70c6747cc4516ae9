"""``moveset generate``: the JSON contract, bytes, names, and every wrong input before anything is written."""

import json
import shutil

import numpy as np
import pytest

from moveset.cli.__main__ import main
from moveset.cli.generate import prepare
from moveset.io import WRITABLE

PROMPT = "a person walks forward and waves"
CONTRACT = {
    "model", "prompts", "seed", "steps", "network_evaluations", "frames", "fps", "seconds", "files", "timings_ms",
    "warnings",
}  # fmt: skip


@pytest.fixture
def model(tiny_clips):
    return tiny_clips


@pytest.fixture
def generate(model, tmp_path, monkeypatch, capsys):
    """Run in an empty folder; the exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        code = main(["generate", *arguments, "--model", str(model)])
        return code, *capsys.readouterr()

    return run


def test_the_json_contract(generate, tmp_path):
    code, out, err = generate(PROMPT, "-o", "w.bvh", "-o", "w.glb", "--seconds", "2", "--seed", "7", "--json")
    assert code == 0
    report = json.loads(out)
    assert out.count("\n") == 1
    assert set(report) == CONTRACT | {"skating"}
    assert set(report["timings_ms"]) == {"text", "sample", "decode", "export"}
    assert all(spent > 0 for spent in report["timings_ms"].values())
    assert report["prompts"] == [PROMPT]
    assert (report["model"], report["seed"], report["steps"], report["network_evaluations"]) == ("tiny", 7, 1, 1)
    assert (report["frames"], report["fps"], report["seconds"]) == (40, 20, 2.0)
    assert report["files"] == ["w.bvh", "w.glb"]
    assert all((tmp_path / file).stat().st_size for file in report["files"])
    assert set(report["skating"]) == {"before", "after"}
    assert all(line.startswith("moveset: warning: ") for line in err.splitlines())
    assert report["warnings"] == [line.removeprefix("moveset: warning: ") for line in err.splitlines()]


def test_same_seed_same_bytes(generate, tmp_path):
    outputs = [f"-o{name}" for name in ("w.bvh", "w.glb", "w.npz", "w.npy", "w.png", "w.gif")]
    made = []
    for _ in range(2):
        assert generate(PROMPT, *(part for o in outputs for part in ("-o", o[2:])), "--seconds", "1")[0] == 0
        made.append({path.name: path.read_bytes() for path in tmp_path.iterdir()})
    assert {"w.bvh", "w.glb", "w.npz", "w.npy", "w.png", "w.gif"} <= set(made[0])
    assert made[0] == made[1]


def test_an_item_of_many_is_that_item_alone(generate, tmp_path):
    assert generate(PROMPT, "--num", "8", "--seed", "7", "--seconds", "1", "-o", "w.bvh")[0] == 0
    assert sorted(p.name for p in tmp_path.glob("*.bvh")) == [f"w-{k}.bvh" for k in range(8)]
    assert generate(PROMPT, "--seed", "10", "--seconds", "1", "-o", "alone.bvh")[0] == 0
    assert (tmp_path / "w-3.bvh").read_bytes() == (tmp_path / "alone.bvh").read_bytes()
    assert (tmp_path / "w-2.bvh").read_bytes() != (tmp_path / "alone.bvh").read_bytes()


def test_variants_keep_the_whole_extension(generate, tmp_path):
    code, _, _ = generate("a person walks", "--seconds", "1", "--num", "2", "-o", "take.amass.npz", "run.1.npz")
    assert code == 0
    for k in range(2):
        with np.load(tmp_path / f"take-{k}.amass.npz") as made:
            assert made["poses"].shape == (20, 156)
        assert (tmp_path / f"run.1-{k}.npz").exists()


def test_a_timeline(generate):
    _, out, _ = generate("a person bows", "a man runs fast", "--seconds", "1", "2", "-o", "t.npz", "--json")
    report = json.loads(out)
    assert report["prompts"] == ["a person bows", "a man runs fast"]
    assert report["network_evaluations"] == 2
    assert report["seconds"] == 3.0


def test_frame_rate_skeleton_and_place(generate):
    from moveset import load

    code, out, _ = generate(
        PROMPT, "--seconds", "1", "--fps", "60", "--in-place", "-o", "w.npz", "-o", "w.bvh", "--json"
    )
    assert code == 0
    assert json.loads(out)["fps"] == 60
    motion = load("w.npz")
    assert motion.fps == 60
    assert float((motion.root[:, [0, 2]] - motion.root[0, [0, 2]]).abs().max()) < 1e-6
    assert generate(PROMPT, "--seconds", "1", "--skeleton", "mixamo", "-o", "m.bvh")[0] == 0
    assert any("LeftUpLeg" in joint for joint in load("m.bvh").skeleton.joints)


def test_loop_ends_where_it_began(generate):
    from moveset import load

    assert generate(PROMPT, "--seconds", "2", "--loop", "--in-place", "-o", "w.npz")[0] == 0
    motion = load("w.npz")
    steps = (motion.rotations[1:] - motion.rotations[:-1]).abs().amax(dim=(1, 2))
    assert float((motion.rotations[0] - motion.rotations[-1]).abs().max()) <= 3 * float(steps.max())


def test_without_output_a_glb_is_written(generate, tmp_path):
    code, out, _ = generate(PROMPT, "--seconds", "1")
    assert code == 0
    assert out.splitlines()[0] == "motion.glb"
    assert (tmp_path / "motion.glb").is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([""], "the prompt is empty"),
        ([], "no prompt was given"),
        (["a", "--num", "4", "--batch", "4"], "--batch is for many prompts from a file"),
        (["a", "-o", "w.fbx"], "'w.fbx': unknown extension; use one of"),
        (["a", "-o", "w"], "'w': unknown extension"),
        (["a", "-o", "w" * 252 + ".bvh"], "is longer than 255 bytes; give a shorter one"),
        (["a", "-o", "w.bvh", "-o", "w.fbx"], "unknown extension"),
        (["a", "-o", "w.bvh", "-o", "w.bvh"], "'w.bvh' would be written twice"),
        (["a", "-o", "no/such/folder/w.bvh"], "folder 'no/such/folder' does not exist"),
        (["a", "-o", "/proc/w.bvh"], "cannot write to folder '/proc'"),
        (["a", "--fps", "0"], "frame rate 0 is not in 1 to 240"),
        (["a", "--skeleton", "dog"], "unknown skeleton 'dog'; choose one of"),
        (["a", "--device", "abacus"], "unknown device 'abacus'"),
        (["a", "--prompts", "list.jsonl"], "leave them out here"),
        (["--prompts", "list.jsonl"], "cannot read list.jsonl"),
        (["a\udcff"], "not valid Unicode"),
    ],
)
def test_wrong_input_is_one_line_and_leaves_nothing(generate, tmp_path, arguments, message):
    code, out, err = generate(*arguments)
    assert code == 2
    assert out == ""
    assert message in err
    assert err.startswith("moveset: ")
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_no_file(generate, tmp_path):
    (tmp_path / "w.bvh").mkdir()
    code, _, err = generate("a", "-o", "w.bvh")
    assert (code, "it is a folder" in err) == (2, True)


def test_an_unknown_model(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["generate", "a", "--model", "gpt"]) == 2
    assert "unknown model 'gpt'; shipped models:" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_corrupt_weights(model, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    folder = shutil.copytree(model, tmp_path / "model")
    path = folder / "pcm-1.safetensors"
    path.write_bytes(path.read_bytes()[:-1])
    assert main(["generate", PROMPT, "--seconds", "1", "--model", str(folder), "-o", "w.bvh"]) == 2
    err = capsys.readouterr().err
    assert "pcm-1.safetensors is damaged" in err
    assert err.count("\n") == 1
    assert not (tmp_path / "w.bvh").exists()
    assert main(["generate", PROMPT, "--seconds", "1", "--model", str(folder), "--steps", "2", "-o", "w.bvh"]) == 0


def test_a_sentence_without_quotes_is_told(generate, tmp_path):
    code, _, err = generate("a", "person", "walks", "--seconds", "1")
    assert code == 0
    assert (
        'moveset: 3 prompts of a word each follow one another; one sentence is put in quotes: "a person walks"' in err
    )
    assert "in quotes" not in generate("a person walks", "bow", "--seconds", "1")[2]
    assert "in quotes" not in generate("walk", "--seconds", "1")[2]


def test_flags_with_several_values_do_not_swallow_a_prompt():
    assert prepare(["--seconds", "3", "a person walks"]) == ["--seconds", "3", "a person walks"]
    assert prepare(["-o", "a.bvh", "b.glb", "walk to the glb"]) == ["-o", "a.bvh", "-o", "b.glb", "walk to the glb"]
    assert prepare(["a", "--seconds", "-1"]) == ["a", "--seconds", "-1"]
    assert prepare(["3", "--seed", "7", "8"]) == ["3", "--seed", "7", "8"]
    assert prepare(["-o", "my a.npz", "my b.NPZ", "walk"]) == ["-o", "my a.npz", "-o", "my b.NPZ", "walk"]
    assert prepare(["-o", "a.bvh", "b.fbx", "walk"]) == ["-o", "a.bvh", "-o", "b.fbx", "walk"]
    for extension in WRITABLE:
        assert prepare(["-o", f"a{extension}", f"b{extension}"]).count("-o") == 2
