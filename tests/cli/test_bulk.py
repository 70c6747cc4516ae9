"""Bulk generation: validated before it starts, resumable, and the same bytes however it is cut and shared."""

import json

import pytest

from moveset.cli.__main__ import main

LINES = [
    {"prompt": "a person walks forward", "seconds": 1.0, "seed": 3, "name": "walk"},
    {"prompt": ["a person bows", "a man runs fast"], "seconds": [1.0, 1.5], "name": "two"},
    {"prompt": "someone waves with the left hand", "seconds": 1.2},
    {"prompt": "a person bows", "seconds": 1.0, "name": "bow"},
    {"prompt": "a person bows", "seconds": 1.0, "seed": 1, "name": "bow2"},
]
NAMES = ["take-walk", "take-two", "take-000003", "take-bow", "take-bow2"]


@pytest.fixture
def model(tiny_clips):
    return tiny_clips


@pytest.fixture
def bulk(model, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    (tmp_path / "list.jsonl").write_text("\n".join(json.dumps(line) for line in LINES) + "\n\n")

    def run(*arguments, output="out/take.bvh"):
        code = main(["generate", "--prompts", "list.jsonl", "-o", output, "--model", str(model), *arguments])
        return code, *capsys.readouterr()

    return run


def made(folder):
    return {path.stem: path.read_bytes() for path in folder.glob("*.bvh")}


def test_every_line_becomes_a_file(bulk, tmp_path):
    code, out, _ = bulk("--batch", "2", "--json")
    assert code == 0
    report = json.loads(out)
    assert (report["made"], report["skipped"]) == (5, 0)
    assert sorted(made(tmp_path / "out")) == sorted(NAMES)


def test_batch_one_equals_single_commands(bulk, model, tmp_path):
    assert bulk()[0] == 0
    main(["generate", "a person bows", "--seconds", "1", "--seed", "1", "-o", "alone.bvh", "--model", str(model)])
    assert (tmp_path / "out" / "take-bow2.bvh").read_bytes() == (tmp_path / "alone.bvh").read_bytes()


def test_resuming_and_sharing_change_no_byte(bulk, tmp_path, monkeypatch):
    assert bulk("--batch", "2")[0] == 0
    whole = made(tmp_path / "out")
    for name in ("take-two", "take-bow2"):
        (tmp_path / "out" / f"{name}.bvh").unlink()
    _, out, _ = bulk("--batch", "2", "--json")
    assert (json.loads(out)["made"], json.loads(out)["skipped"]) == (2, 3)
    assert made(tmp_path / "out") == whole

    (tmp_path / "shared").mkdir()
    monkeypatch.setenv("WORLD_SIZE", "2")
    shares = []
    for rank in ("0", "1"):
        monkeypatch.setenv("RANK", rank)
        shares.append(json.loads(bulk("--batch", "2", "--json", output="shared/take.bvh")[1])["made"])
    assert shares == [3, 2]
    assert made(tmp_path / "shared") == whole


def test_finished_work_needs_no_network(bulk, model, tmp_path, monkeypatch):
    assert bulk()[0] == 0
    from moveset.pipelines.text_to_motion import TextToMotion

    monkeypatch.setattr(TextToMotion, "generate", None)
    code, out, _ = bulk()
    assert (code, out) == (0, "made 0 motions, skipped 5 that were there\n")


def test_variants(bulk, tmp_path):
    assert bulk("--num", "2")[0] == 0
    assert sorted(made(tmp_path / "out")) == sorted(f"{name}-{k}" for name in NAMES for k in (0, 1))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("not json", "line 6: a line must be a JSON object"),
        ('["a"]', "must be a JSON object"),
        ('{"text": "a"}', "must be a JSON object"),
        ('{"prompt": "a", "colour": 1}', "must be a JSON object"),
        ('{"prompt": 3}', "prompt 3 must be a text"),
        ('{"prompt": ""}', "line 6: the prompt is empty"),
        ('{"prompt": "a", "seconds": "2"}', "seconds '2' must be a number"),
        ('{"prompt": "a", "seconds": 1e6}', "1e+06 seconds are not in"),
        ('{"prompt": "a", "seed": 1.5}', "seed 1.5 must be a whole number"),
        ('{"prompt": "a", "seed": true}', "seed True must be"),
        ('{"prompt": "a", "name": "../../evil"}', "name '../../evil' must be"),
        ('{"prompt": "a", "name": "walk"}', "uses the name 'walk' more than once"),
        ("[" * 100_000, "must be a JSON object"),
    ],
)
def test_one_wrong_line_stops_everything(bulk, tmp_path, line, message):
    with (tmp_path / "list.jsonl").open("a") as file:
        file.write(line + "\n")
    text = (tmp_path / "list.jsonl").read_text().replace("\n\n", "\n")
    (tmp_path / "list.jsonl").write_text(text)
    code, out, err = bulk()
    assert (code, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1
    assert made(tmp_path / "out") == {}


@pytest.mark.parametrize("data", [b"", b"\n\n", b"\xff\xfe\x00"])
def test_files_without_prompts(bulk, tmp_path, data):
    (tmp_path / "list.jsonl").write_bytes(data)
    assert bulk()[0] == 2


def test_a_file_that_windows_marked_as_utf_8(bulk, tmp_path):
    (tmp_path / "list.jsonl").write_bytes(b'\xef\xbb\xbf{"prompt": "a person walks", "seconds": 1, "name": "walk"}\r\n')
    assert bulk()[0] == 0
    assert list(made(tmp_path / "out")) == ["take-walk"]


def test_a_wrong_share(bulk, monkeypatch):
    monkeypatch.setenv("RANK", "3")
    monkeypatch.setenv("WORLD_SIZE", "2")
    code, _, err = bulk()
    assert (code, "do not belong together" in err) == (2, True)


def test_warnings_are_printed_as_for_one_prompt_each_once(bulk, tmp_path):
    lines = [{"prompt": "a person rides a unicycle", "seconds": 1.0, "seed": k} for k in range(2)]
    (tmp_path / "list.jsonl").write_text("\n".join(map(json.dumps, lines)))
    code, out, err = bulk("--json")
    report = json.loads(out)
    assert code == 0
    assert len(report["warnings"]) == 1
    assert err.splitlines() == [f"moveset: warning: {report['warnings'][0]}"]


def test_prompts_from_standard_input(bulk, tmp_path, monkeypatch, model):
    assert bulk()[0] == 0
    expected = made(tmp_path / "out")
    for path in (tmp_path / "out").iterdir():
        path.unlink()
    with (tmp_path / "list.jsonl").open() as lines:
        monkeypatch.setattr("sys.stdin", lines)
        assert main(["generate", "--prompts", "-", "-o", "out/take.bvh", "--model", str(model)]) == 0
    assert made(tmp_path / "out") == expected
