"""What benchmarks ask of their arguments before hours are spent: numbers in range, names that exist, a place to write.

What is wrong ends a benchmark in one line, as it ends ``moveset`` (``errors.exit_code_of``).
"""

import argparse
import importlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from moveset.cli.output import check_folder
from moveset.errors import InputError
from moveset.io.limits import atomic_write

SPLITS = ("train", "val", "test")


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, without the usage.

    Raises:
        InputError: arguments that cannot be read.
    """

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message}; see `python benchmarks/{self.prog} --help`")


def at_least(low: int) -> Callable[[str], int]:
    """The type of a whole number that is not smaller."""

    def number(text: str) -> int:
        value = int(text)
        if value < low:
            raise argparse.ArgumentTypeError(f"{value} is less than {low}")
        return value

    return number


def between(low: float, high: float) -> Callable[[str], float]:
    """The type of a number in a range, which nan is not."""

    def number(text: str) -> float:
        value = float(text)
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{value:g} is not in {low:g} to {high:g}")
        return value

    return number


positive = between(1e-3, 1e6)


def sampled(asked: str) -> tuple[str, str | None, int | None]:
    """Model, network and steps of MODEL, MODEL:NETWORK or MODEL:NETWORK:STEPS; None is the model's own choice.

    Raises:
        InputError: steps that are no number.
    """
    model, _, more = asked.partition(":")
    network, _, steps = more.partition(":")
    if steps and not steps.isdecimal():
        raise InputError(f"{asked!r} ends in {steps!r}, which is no number of steps; give such as rdm-small:rdm:2")
    return model, network or None, int(steps) if steps else None


def report_path(text: str) -> Path:
    """The type of a report's file; its folder is made, and must be one that can be written to."""
    path = Path(text)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        check_folder(path.parent)
    except OSError as error:
        raise argparse.ArgumentTypeError(f"cannot write {text!r}: {error.strerror or error}") from None
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    if path.is_dir():
        raise argparse.ArgumentTypeError(f"{text!r} is a folder; give the path of a file")
    return path


def write_report(path: Path, report: Any, indent: int | None = 1) -> None:
    """Writes JSON, whole or not at all.

    Raises:
        InputError: the folder is gone.
        MovesetError: the disk is full.
    """
    with atomic_write(path) as file:
        file.write((json.dumps(report, indent=indent) + "\n").encode())


def library(name: str, install: str) -> Any:
    """A module that not every installation has.

    Raises:
        InputError: it is missing; says what installs it.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        raise InputError(f"this needs {name.partition('.')[0]}; install it with {install}") from None
