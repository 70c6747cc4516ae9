"""Tables say what the results say: best, intervals, differences, what is missing, what is only published."""

import json
import re
from pathlib import Path

import pytest

from moveset.errors import FormatError, InputError, MovesetError
from moveset.evaluation.columns import ALL, Column, places
from moveset.evaluation.intervals import Interval
from moveset.evaluation.latex import latex
from moveset.evaluation.markdown import markdown
from moveset.evaluation.report import page, to_json, write_report
from moveset.evaluation.table import State, Table, load_table
from tests.evaluation.results import result_json, suite_folder

DOCS = Path(__file__).resolve().parents[2] / "docs"

REAL = {"r1": (0.6, 0.01), "fid": (0.01, 0.001), "diversity": (9.0, 0.1), "skating": (0.1, 0.0), "jerk": (60.0, 0.1)}
RESULTS = {
    "real": result_json(REAL, model="real", weights_sha256=None),
    "vae": result_json({"r1": (0.59, 0.01), "fid": (0.05, 0.001)}),
    "teacher": result_json({"r1": (0.5, 0.01), "fid": (0.3, 0.02)}, repeats=5, seconds=0.5),
    "lcm-1": result_json({"r1": (0.4, 0.01), "fid": (0.5, 0.02), "diversity": (8.0, 0.1)}, seconds=0.01),
    "pcm-1": result_json(
        {"r1": (0.45, 0.01), "fid": (0.49, 0.02), "diversity": (9.5, 0.1), "skating": (0.12, 0.0), "jerk": (90.0, 0.1)},
        seconds=0.01,
    ),
    "pcm-4": result_json({"r1": (0.495, 0.01), "fid": (0.2, 0.02)}, seconds=0.04),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return suite_folder(tmp_path, "motionpcm", RESULTS)


@pytest.fixture
def table(folder: Path) -> Table:
    return load_table(folder)


def line(text: str, label: str) -> str:
    """The only row of that label."""
    found = [row for row in text.splitlines() if row.startswith(f"| {label} |")]
    assert len(found) == 1, found
    return found[0]


def ours(text: str) -> str:
    return text[: text.index("The paper's Table 1")]


def test_the_best_is_bold_and_the_second_underlined_among_generated_motion_only(table: Table):
    text = ours(markdown(table)).split("## Physical")[0]
    assert line(text, "PCM, 4 steps") == "| PCM, 4 steps | 20 | <u>0.495 ± 0.010</u> | **0.200 ± 0.020** | – |"
    assert line(text, "Teacher, 50 guided steps") == (
        "| Teacher, 50 guided steps | 5 | **0.500 ± 0.010** | <u>0.300 ± 0.020</u> | – |"
    )
    assert "**" not in line(text, "Real")
    assert "**" not in line(text, "VAE, reconstruction")
    # The nearer to real motion's 9.0 is better, whichever is more.
    assert "**9.500 ± 0.100**" in line(text, "PCM, 1 step")
    assert "<u>8.000 ± 0.100</u>" in line(text, "LCM, 1 step")


def test_equal_printed_numbers_share_a_place():
    column = ALL["fid"]
    rows = {"a": Interval(0.10004, 0.0), "b": Interval(0.09996, 0.0), "c": Interval(0.2, 0.0), "d": Interval(0.3, 0.0)}
    assert places(column, rows, None) == {"a": "best", "b": "best", "c": "second", "d": ""}
    assert places(Column("x", "X", "real"), rows, None) == dict.fromkeys(rows, "")


def test_what_has_not_been_evaluated_is_said_in_its_place(table: Table):
    text = ours(markdown(table))
    order = [row.split("|")[1].strip() for row in text.splitlines() if row.startswith("| ")]
    assert (
        "not evaluated" in text.split("## Physical")[0].split("PCM, 1 step, without discriminator")[1].splitlines()[0]
    )
    assert (
        order.index("Real")
        < order.index("VAE, reconstruction")
        < order.index("LCM, 1 step")
        < order.index("PCM, 1 step, k = 20")
    )


def test_numbers_of_the_evaluation_stand_above_the_table(table: Table):
    text = markdown(table)
    assert "**320 items, 300 distinct texts, 90 distinct contents** of the split “test”" in text
    assert "evaluator t2m-small (`eeeeeeee`)" in text
    assert "corpus.safetensors (`dddddddd`)" in text
    assert "commit c0ffee; measured 2026-01-02" in text
    assert "among the k nearest of 32" in text


def test_published_numbers_are_labelled_and_below_ours(table: Table):
    text = markdown(table)
    block = text[len(ours(text)) :]
    assert "**Published, on HumanML3D, other evaluator: not comparable.**" in block
    assert "MotionPCM (1-step)" in block
    assert "0.054±.003" not in ours(text)
    assert "MotionLCM" not in ours(text)


def test_physical_metrics_have_ratios_to_real(table: Table):
    text = markdown(table).split("## Physical metrics")[1].split("##")[0]
    assert "0.120 ± 0.000 (1.20 ×) | 90.0 ± 0.1 (1.50 ×)" in line(text, "PCM, 1 step")
    assert "×" not in line(text, "Real")


def test_rows_that_were_judged_differently_are_not_put_side_by_side(tmp_path: Path):
    for changed in ({"items": 319}, {"evaluator": {"name": "t2m-small", "sha256": "f" * 64}}, {"commit": "d0d0"}):
        mixed = {**RESULTS, "pcm-4": {**RESULTS["pcm-4"], **changed}}
        with pytest.raises(InputError, match=r"PCM, 4 steps: other (items|evaluator|commit) than Real"):
            markdown(load_table(suite_folder(tmp_path, "motionpcm", mixed)))


def test_rows_with_feet_held_and_not_are_not_put_side_by_side(tmp_path: Path):
    feet = {"lcm-1": True, "pcm-1": True, "pcm-4": False}
    mixed = RESULTS | {key: {**RESULTS[key], "settings": {"foot_lock": held}} for key, held in feet.items()}
    with pytest.raises(InputError, match="PCM, 4 steps: feet are not held, and those of other rows are"):
        markdown(load_table(suite_folder(tmp_path, "motionpcm", mixed)))
    mixed["pcm-4"] = {**RESULTS["pcm-4"], "settings": {"foot_lock": True}}
    assert "PCM, 4 steps" in markdown(load_table(suite_folder(tmp_path, "motionpcm", mixed)))


def test_latex_compiles_by_the_look_of_it(table: Table):
    text = latex(table)
    for opened, closed in (("{", "}"), (r"\begin", r"\end")):
        assert text.count(opened) == text.count(closed)
    assert text.count("$") % 2 == 0
    assert r"PCM, 4 steps & $\underline{0.495}^{\pm .010}$ & $\mathbf{0.200}^{\pm .020}$ & -- \\" in text
    rows = [row for row in text.splitlines() if row.endswith(r"\\")]
    quality = text.split(r"\end{table*}")[0].splitlines()
    assert {row.count("&") for row in rows if row in quality} == {3}
    assert not re.search(r"(?<!\\)%(?! needs)", text)


def test_the_json_says_the_same(table: Table):
    found = json.loads(json.dumps(to_json(table)))
    rows = {row["key"]: row for row in found["rows"]}
    assert rows["pcm-4"]["metrics"]["fid"] == {"mean": 0.2, "interval": 0.02}
    assert (rows["k20"]["repeats"], rows["k20"]["metrics"]) == (0, {})
    assert found["places"]["fid"]["pcm-4"] == "best"
    assert "real" not in found["places"]["fid"]
    assert found["state"]["commit"] == "c0ffee"


def test_a_report_is_files_and_plots_and_can_be_written_again(folder: Path):
    write_report(folder)
    first = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}
    assert {"table.md", "table.tex", "table.json", "motionpcm-bars.png"} <= set(first)
    assert "![motionpcm-bars](motionpcm-bars.png)" in (folder / "table.md").read_text()
    assert all(0 < len(data) < 60_000 for name, data in first.items() if name.endswith(".png"))
    write_report(folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()} == first


def test_what_cannot_stand_in_one_table_leaves_the_older_report(folder: Path):
    write_report(folder)
    names = ("table.md", "table.tex", "table.json", "motionpcm-bars.png")
    before = {name: (folder / name).read_bytes() for name in names}
    (folder / "pcm-4.json").write_text(json.dumps(RESULTS["pcm-4"] | {"items": 7}))
    for write in (write_report, lambda path: page([path], path.parent / "page.md")):
        with pytest.raises(InputError, match="other items"):
            write(folder)
    assert {name: (folder / name).read_bytes() for name in names} == before
    assert [path.name for path in folder.parent.iterdir()] == [folder.name]


def test_a_disk_that_fills_up_leaves_the_older_report(folder: Path, monkeypatch):
    write_report(folder)
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}

    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(MovesetError, match="No space left on device; free some space"):
        write_report(folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()} == before


def test_a_page_of_both_suites(folder: Path, tmp_path: Path):
    other = suite_folder(tmp_path, "rdm", {"real": RESULTS["real"]})
    page([folder, other], tmp_path / "results.md")
    text = (tmp_path / "results.md").read_text()
    assert text.startswith("# Results\n\n**Commit c0ffee; measured 2026-01-02.**\n")
    assert re.findall(r"^## (.*)$", text, re.M) == ["MotionPCM: text to clips", "RDM: motion without end"]
    for name in re.findall(r"!\[.*?\]\((.*?)\)", text):
        assert (tmp_path / name).is_file()


def test_the_published_page_says_what_the_kept_results_say(tmp_path: Path):
    page([DOCS / "results" / suite for suite in ("motionpcm", "rdm")], tmp_path / "results.md")
    assert (tmp_path / "results.md").read_text() == (DOCS / "results.md").read_text()


def test_a_suite_without_results_still_has_a_table(tmp_path: Path):
    path = write_report(suite_folder(tmp_path, "rdm", {}))
    text = path.read_text()
    assert "No row has been evaluated yet." in text
    assert "| RDM-7, overlapping (R = K) | not evaluated |" in text


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("pcm-4.json", "{", "pcm-4.json is not JSON: .*; evaluate that row again"),
        ("pcm-4.json", "{}", "is no result of an evaluation"),
        ("pcm-4.json", '{"metrics": {}, "repeats": []}', "is no result of an evaluation"),
        ("mine.json", "[]", "mine.json"),
    ],
)
def test_damaged_files_are_named(folder: Path, name: str, text: str, message: str):
    (folder / name).write_text(text)
    with pytest.raises(FormatError, match=message):
        load_table(folder)


def test_a_folder_that_is_none_is_refused(tmp_path: Path):
    with pytest.raises(InputError, match=r"there is no folder .*motionpcm"):
        write_report(tmp_path / "motionpcm")
    with pytest.raises(InputError, match="'elsewhere' is no suite"):
        write_report(tmp_path / "elsewhere")


def test_models_that_the_suite_does_not_know_are_rows_too(tmp_path: Path):
    mine = {**RESULTS["pcm-1"], "model": "mine", "network": "pcm-4", "steps": 4}
    table = load_table(suite_folder(tmp_path, "motionpcm", {**RESULTS, "mine-pcm-4": mine}))
    row = table.rows[-1]
    assert (row.key, row.label, row.group, row.steps) == ("mine-pcm-4", "mine, pcm-4", "Others given", 4)
    assert ("mine-pcm-4", "teacher") in {(found.row, found.reference) for found in table.comparisons()}


def test_rows_that_no_table_could_hold_are_refused_before_they_are_made(table: Table):
    rows, now = {row.key: row for row in table.rows}, table.state()
    table.check_alike([rows["k20"]], now, True)
    other = State(**{**vars(now), "commit": "d0d0"})
    with pytest.raises(InputError, match="such as Real, have commit c0ffee instead of d0d0"):
        table.check_alike([rows["k20"]], other, True)
    table.check_alike([rows[key] for key in RESULTS], other, True)


def test_training_motion_has_sentences_of_its_own_and_stands_beside_others_all_the_same(tmp_path: Path):
    learned = result_json(REAL, model="training", weights_sha256=None, items=300, distinct_texts=280, labels=80)
    table = load_table(suite_folder(tmp_path / "a", "motionpcm", {"training": learned, **RESULTS}))
    assert table.state().items == 320
    table.check_alike([table.rows[-1]], table.state(), True)
    foreign = {**learned, "commit": "d0d0"}
    with pytest.raises(InputError, match="Real, of the training: other commit than Real"):
        load_table(suite_folder(tmp_path / "b", "motionpcm", {"training": foreign, **RESULTS})).state()
