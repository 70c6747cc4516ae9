"""The one error tree. Every message names the value, the limit and the remedy in one sentence."""

import os
import sys
from collections.abc import Callable


class MovesetError(Exception):
    """Something went wrong that is not the user's doing (exit code 1)."""

    exit_code = 1


class InputError(MovesetError):
    """What the user gave is wrong: a prompt, a number, a path, a file (exit code 2)."""

    exit_code = 2


class FormatError(InputError):
    """A file is damaged, absurd or not of the format it claims (exit code 2)."""


def fail(message: str, code: int) -> int:
    """Says what is wrong in one line on stderr, after a traceback if ``MOVESET_DEBUG`` is set; gives ``code`` back."""
    if os.environ.get("MOVESET_DEBUG"):
        import traceback

        traceback.print_exc()
    print(f"moveset: {' '.join(message.split())}", file=sys.stderr)
    return code


def exit_code_of(main: Callable[[], int | None]) -> int:
    """Runs a program, ``moveset`` or another; what is wrong is said in one line."""
    try:
        return main() or 0
    except MovesetError as error:
        return fail(str(error), error.exit_code)
    except KeyboardInterrupt:
        return fail("interrupted", 130)
    except Exception as error:
        return fail(f"{type(error).__name__}: {error} (MOVESET_DEBUG=1 shows where)", 1)
