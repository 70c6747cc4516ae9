"""Programs that ``python -m`` starts say what is wrong as the command line does: one line, exit code 2."""

import runpy
import sys

import pytest


@pytest.mark.parametrize(
    ("program", "arguments", "message"),
    [
        ("evaluation.report", ["rdm"], "there is no folder rdm"),
    ],
)
def test_a_program_says_in_one_line_what_is_wrong(program, arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [program, *arguments])
    monkeypatch.delitem(sys.modules, f"moveset.{program}", raising=False)
    with pytest.raises(SystemExit) as ended:
        runpy.run_module(f"moveset.{program}", run_name="__main__")
    said = capsys.readouterr().err
    assert (ended.value.code, said.count("\n"), message in said) == (2, 1, True), said
