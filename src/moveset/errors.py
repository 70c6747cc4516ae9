"""The one error tree. Every message names the value, the limit and the remedy in one sentence."""


class MovesetError(Exception):
    """Something went wrong that is not the user's doing (exit code 1)."""

    exit_code = 1


class InputError(MovesetError):
    """What the user gave is wrong: a prompt, a number, a path, a file (exit code 2)."""

    exit_code = 2


class FormatError(InputError):
    """A file is damaged, absurd or not of the format it claims (exit code 2)."""
