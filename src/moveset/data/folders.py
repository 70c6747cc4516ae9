"""Folders to write to."""

from pathlib import Path

from moveset.errors import InputError


def made(folder: Path) -> Path:
    """A folder, which is made with those that it is in where they are missing.

    Raises:
        InputError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder {folder}: {error.strerror or error}; choose another place") from error
    return folder
