"""The overview, unknown verbs, parse errors in one line, and what start-up must not import."""

import subprocess
import sys
import warnings

import pytest

from moveset.cli.__main__ import VERBS, main

# What costs more than a tenth of a second to import, or is only needed for training and research.
SLOW = ("torch", "numpy", "scipy", "matplotlib", "transformers", "sklearn", "sentence_transformers", "lightning_fabric",
        "tensorboard", "tyro", "PIL", "imageio_ffmpeg", "roma", "tokenizers")  # fmt: skip
NOT_TO_GENERATE = {*SLOW, "diffusers", "moveset.training", "moveset.data"} - {
    "torch", "numpy", "roma", "tokenizers", "tyro",
}  # fmt: skip


@pytest.mark.parametrize(
    ("code", "unwanted"),
    [
        ("from moveset.cli.__main__ import main; main(['--help'])", SLOW),
        ("import moveset, moveset.io", SLOW),
        ("from moveset import TextToMotion; import moveset.cli.generate", NOT_TO_GENERATE),
    ],
)
def test_what_starts_imports_only_what_it_needs(code, unwanted):
    script = f"{code}\nimport sys\nprint('\\n'.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert not set(done.stdout.split()) & set(unwanted)


def test_overview_names_every_verb(capsys):
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(f"  {verb}" in out for verb in VERBS)


@pytest.mark.parametrize("verb", [*VERBS, "data build", "data info", "data export", "data import-evaluator"])
def test_every_verb_explains_itself_in_words_for_people(verb, capsys):
    assert main([*verb.split(), "--help"]) == 0
    out = capsys.readouterr().out
    assert f"moveset {verb}" in out
    assert "None" not in out


def test_options_that_may_be_left_out_say_what_they_take(capsys):
    assert main(["train", "--help"]) == 0
    out = capsys.readouterr().out
    for option in ("--steps INT", "--vae PATH", "--tensorboard {True,False}", "--precision {auto,32-true,bf16-mixed}"):
        assert option in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["genrate", "a"], "unknown verb 'genrate'; did you mean 'generate'?"),
        (["zzz"], "unknown verb 'zzz'; choose one of generate"),
        (["generate", "a", "--stepz", "3"], "--stepz"),
        (["generate", "a", "--steps", "two"], "--steps"),
        (["generate", "a", "--solver", "euler"], "argument '--solver'; choose one of pcm, lcm, teacher; see"),
        (["convert", "a.bvh", "b.bvh", "--up", "q"], "argument '--up'; choose one of -x, -y, -z, x, y, z; see"),
        (["generate", "a", "-o"], "-o/--output"),
        (["convert", "a.bvh"], "OUT"),
        (["models", "extra"], "extra"),
    ],
)
def test_wrong_arguments_are_one_line(arguments, message, capsys):
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert err.startswith("moveset: ")
    assert err.count("\n") == 1
    assert not set("│╭─") & set(err)


def test_no_verb_shows_the_overview_and_fails(capsys):
    assert main([]) == 2
    assert "usage: moveset" in capsys.readouterr().err


def test_faults_are_one_line_unless_debugging(monkeypatch, capsys):
    import moveset.cli.models as module

    monkeypatch.setattr(module, "models", lambda: 1 / 0)
    assert main(["models"]) == 1
    assert capsys.readouterr().err == "moveset: ZeroDivisionError: division by zero (MOVESET_DEBUG=1 shows where)\n"
    monkeypatch.setenv("MOVESET_DEBUG", "1")
    assert main(["models"]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_a_closed_pipe_is_no_fault():
    command = f"{sys.executable} -m moveset.cli --help | true; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert done.returncode == 0
    assert done.stderr == ""


def test_a_warning_is_one_line_without_code(monkeypatch, capsys):
    def warns() -> int:
        warnings.warn("something is odd; look at it", stacklevel=1)
        return 0

    monkeypatch.setattr("moveset.cli.doctor.doctor", warns)
    assert main(["doctor"]) == 0
    assert capsys.readouterr().err == "moveset: warning: something is odd; look at it\n"
