"""``moveset``: one verb, one file. Only the file of the verb that was asked for is imported.

Exit codes: 0 done, 2 the input is wrong (with one line on stderr that says what, the limit and the remedy), 1 anything
else. ``MOVESET_DEBUG=1`` shows tracebacks.
"""

import contextlib
import difflib
import functools
import importlib
import io
import os
import re
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, cast

from moveset.cli.threads import wait_asleep
from moveset.errors import InputError, MovesetError, fail

Command = Callable[..., Any]


@dataclass(frozen=True)
class Verb:
    """Where a verb lives, and its line in the overview.

    Args:
        module: module that holds it.
        attribute: a function whose signature is the command line, or a dict of them by sub-verb.
        summary: one line.
        prepare: rewrites the arguments before they are parsed.
        spins: leave it to OpenMP what its threads do while they wait; others let them sleep.
    """

    module: str
    attribute: str
    summary: str
    prepare: str | None = None
    spins: bool = False


VERBS = {
    "generate": Verb("moveset.cli.generate", "generate", "Turn text into a motion file.", "prepare"),
    "stream": Verb("moveset.cli.stream", "stream", "Turn text into motion that never ends.", "prepare"),
    "serve": Verb("moveset.cli.serve", "serve", "Open the studio in a browser, and serve other programs."),
    "convert": Verb("moveset.cli.convert", "convert", "Convert a motion file; retarget or resample it on the way."),
    "inspect": Verb("moveset.cli.inspect", "inspect", "Tell what is in a motion file and what convert makes of it."),
    "models": Verb("moveset.cli.models", "models", "List the models that come with this installation."),
    "doctor": Verb("moveset.cli.doctor", "doctor", "Check this installation and time a short self-test."),
    "data": Verb("moveset.cli.data", "COMMANDS", "Build and inspect training data."),
    "evaluate": Verb("moveset.cli.evaluate", "evaluate", "Measure models as the papers do, with intervals."),
    "bench": Verb("moveset.cli.bench", "bench", "Measure what motion costs on this machine.", spins=True),
    "train": Verb("moveset.cli.train", "train", "Train or distil a model."),
}


def usage() -> str:
    """The overview that ``moveset --help`` prints."""
    lines = ["usage: moveset VERB …", "", "Text to human motion, on an ordinary computer.", ""]
    lines += [f"  {name:<10}{verb.summary}" for name, verb in VERBS.items()]
    lines += ["", "`moveset VERB --help` explains a verb; `moveset --version` prints the version."]
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; the result is the exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A terminal that is not UTF-8 gets escapes, not a UnicodeEncodeError.
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warn
            return _run(arguments)
    except MovesetError as error:
        return fail(str(error), error.exit_code)
    except KeyboardInterrupt:
        return fail("interrupted", 130)
    except BrokenPipeError:
        # The reader of stdout is gone (`moveset models | head -1`): nothing is left to say, not even at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        return fail(f"{type(error).__name__}: {error} (MOVESET_DEBUG=1 shows where)", 1)


def _warn(message: Warning | str, category: type[Warning], *place: Any) -> None:
    """Shows a warning in the form of an error, without the line of code that it came from."""
    print(f"moveset: warning: {message}", file=sys.stderr)


def _run(arguments: list[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help"):
        print(usage(), file=sys.stdout if arguments else sys.stderr)
        return 0 if arguments else 2
    if arguments[0] in ("-V", "--version"):
        from moveset import __version__

        print(f"moveset {__version__}")
        return 0
    name = arguments[0]
    if name not in VERBS:
        near = difflib.get_close_matches(name, VERBS, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"choose one of {', '.join(VERBS)}"
        raise InputError(f"unknown verb {name!r}; {hint}")
    verb = VERBS[name]
    if not verb.spins:
        wait_asleep()
    module = importlib.import_module(verb.module)
    rest = arguments[1:]
    if verb.prepare:
        rest = getattr(module, verb.prepare)(rest)
    return int(_parse(getattr(module, verb.attribute), f"moveset {name}", rest)() or 0)


def _parse(command: Command | dict[str, Command], prog: str, rest: list[str]) -> Callable[[], Any]:
    """The call that the arguments ask for; the parser's boxed errors become one line."""
    import tyro

    heard = io.StringIO()
    try:
        with contextlib.redirect_stderr(heard):
            if isinstance(command, dict):
                table = {name: _deferred(function) for name, function in command.items()}
                return cast(Callable[[], Any], tyro.extras.subcommand_cli_from_dict(table, prog=prog, args=rest))
            return tyro.cli(_deferred(command), prog=prog, args=rest)
    except SystemExit as stop:
        if not stop.code:  # --help was asked for and printed
            return lambda: 0
        raise InputError(f"{_one_line(heard.getvalue())}; see `{prog} --help`") from None


def _deferred(function: Command) -> Callable[..., Callable[[], Any]]:
    @functools.wraps(function)
    def bind(*args: Any, **kwargs: Any) -> Callable[[], Any]:
        return functools.partial(function, *args, **kwargs)

    return bind


def _one_line(box: str) -> str:
    """What a parser's error box says, without the frame, the title and the excerpt of the help text."""
    # The frame is drawn in dashes alone where stdout is not UTF-8.
    lines = [line.strip("│╭╮╰╯ ") for line in re.sub(r"\x1b\[[0-9;]*m", "", box).splitlines()[1:]]
    if lines and re.fullmatch("-+", lines[0]):
        del lines[0]
    rule = next((k for k, line in enumerate(lines) if re.fullmatch(r"[-─]{4,}", line)), len(lines))
    said = " ".join(lines[:rule]).split("Got errors:")[0]
    near = re.search(r"Perhaps you meant:\s+(--[\w-]+)", " ".join(lines[rule:]))
    said = " ".join(said.split()).rstrip(".") or "these arguments cannot be read"
    return f"{said} (did you mean {near[1]}?)" if near else said


if __name__ == "__main__":
    sys.exit(main())
