"""``moveset``: one verb, one file. Only the file of the verb that was asked for is imported.

A verb's file has a function of its name, whose signature is the command line, or a dict of them by sub-verb; perhaps
``prepare``, which rewrites the arguments before they are parsed.

Exit codes: 0 done, 2 the input is wrong (with one line on stderr that says what, the limit and the remedy), 1 anything
else. ``MOVESET_DEBUG=1`` shows tracebacks.
"""

import contextlib
import difflib
import functools
import importlib
import inspect
import io
import os
import re
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Annotated, Any, cast, get_args, get_origin

from moveset.errors import InputError, exit_code_of

Command = Callable[..., Any]
#: Each with its line in the overview.
VERBS = {
    "generate": "Turn text into a motion file.",
    "stream": "Turn text into motion that never ends.",
    "serve": "Open the studio in a browser, and serve other programs.",
    "convert": "Convert a motion file; retarget or resample it on the way.",
    "inspect": "Tell what is in a motion file and what convert makes of it.",
    "models": "List the models that come with this installation.",
    "doctor": "Check this installation and time a short self-test.",
    "data": "Build and inspect training data.",
    "evaluate": "Measure models as the papers do, with intervals.",
    "bench": "Measure what motion costs on this machine.",
    "train": "Train or distil a model.",
}


def usage() -> str:
    """The overview that ``moveset --help`` prints."""
    lines = ["usage: moveset VERB …", "", "Text to human motion, on an ordinary computer.", ""]
    lines += [f"  {name:<10}{summary}" for name, summary in VERBS.items()]
    lines += ["", "`moveset VERB --help` explains a verb; `moveset --version` prints the version."]
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; the result is the exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A terminal that is not UTF-8 gets escapes, not a UnicodeEncodeError.
        sys.stdout.reconfigure(errors="backslashreplace")
    return exit_code_of(lambda: _run(arguments))


def _warn(message: Warning | str, category: type[Warning], *place: Any) -> None:
    """Shows a warning in the form of an error, without the line of code that it came from."""
    print(f"moveset: warning: {message}", file=sys.stderr)


def _run(arguments: list[str]) -> int:
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warn
            return _do(arguments)
    except BrokenPipeError:
        # The reader of stdout is gone (`moveset models | head -1`): nothing is left to say, not even at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _do(arguments: list[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help"):
        print(usage(), file=sys.stdout if arguments else sys.stderr)
        return 0 if arguments else 2
    if arguments[0] in ("-V", "--version"):
        from moveset import __version__

        print(f"moveset {__version__}")
        return 0
    if arguments[0] != "bench":  # which shows what OpenMP does by itself
        # Threads that spin are quickest while nothing else runs, and make everything crawl as soon as another process
        # is busy on a core. Before torch is imported; networks have one thread, this is for batches and training.
        os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    return int(_parse(*arguments)() or 0)


def _parse(name: str, *rest: str) -> Callable[[], Any]:
    """The call that a verb and its arguments ask for; the parser's boxed errors become one line."""
    if name not in VERBS:
        near = difflib.get_close_matches(name, VERBS, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"choose one of {', '.join(VERBS)}"
        raise InputError(f"unknown verb {name!r}; {hint}")
    import tyro

    module, prog = importlib.import_module(f"moveset.cli.{name}"), f"moveset {name}"
    given = getattr(module, "prepare", list)(rest)
    command: Command | dict[str, Command] = getattr(module, name)
    heard = io.StringIO()
    try:
        with contextlib.redirect_stderr(heard):
            if isinstance(command, dict):
                table = {name: _deferred(function) for name, function in command.items()}
                return cast(Callable[[], Any], tyro.extras.subcommand_cli_from_dict(table, prog=prog, args=given))
            return tyro.cli(_deferred(command), prog=prog, args=given)
    except SystemExit as stop:
        if not stop.code:  # --help was asked for and printed
            return lambda: 0
        raise InputError(f"{_one_line(heard.getvalue())}; see `{prog} --help`") from None


def _deferred(function: Command) -> Callable[..., Callable[[], Any]]:
    @functools.wraps(function)
    def bind(*args: Any, **kwargs: Any) -> Callable[[], Any]:
        return functools.partial(function, *args, **kwargs)

    signature = inspect.signature(function, eval_str=True)
    options = [one.replace(annotation=_without_none(one.annotation)) for one in signature.parameters.values()]
    bind.__signature__ = signature.replace(parameters=options)  # type: ignore[attr-defined]
    bind.__annotations__ = {one.name: one.annotation for one in options}
    del bind.__wrapped__  # type: ignore[attr-defined]  # whose signature would be read instead
    return bind


def _without_none(hint: Any) -> Any:
    """The annotation of an option that may be left out, whose help does not offer None, nor call it a default."""
    from tyro.conf import arg

    plain, *said = get_args(hint) if get_origin(hint) is Annotated else (hint,)
    if type(None) not in get_args(plain):
        return hint
    names = []
    for kind in (kind for kind in get_args(plain) if kind is not type(None)):
        choices = (True, False) if kind is bool else get_args(kind)
        names.append(f"{{{','.join(map(str, choices))}}}" if choices else kind.__name__.upper())
    return Annotated[plain, arg(metavar="|".join(names), help_behavior_hint=""), *said]


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
    said = re.sub(r"\. Expected one of \(([^)]*)\)", _choices, said)
    return f"{said} (did you mean {near[1]}?)" if near else said


def _choices(found: re.Match[str]) -> str:
    names = re.findall(r"'([^']*)'", found[1])
    if "None" in names:  # of an option that may be left out, in any order
        names = sorted(name for name in names if name != "None")
    return f"; choose one of {', '.join(names)}"


if __name__ == "__main__":
    sys.exit(main())
