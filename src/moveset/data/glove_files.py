"""Tables of word vectors as they are handed round: the ``our_vab`` files of HumanML3D, and GloVe's own text files.

Shapes: V words, W numbers in a vector.
"""

from pathlib import Path

import torch
from torch import Tensor

from moveset.data.plain_pickle import read_plain_pickle
from moveset.errors import FormatError, InputError
from moveset.io.numpy_file import read_array

PREFIX = "our_vab"
MAX_WORDS = 2_000_000
MAX_WIDTH = 4096
_MAX_LINE = 64 * 2**10


def read_glove(path: str | Path) -> tuple[tuple[str, ...], Tensor]:
    """The words and their vectors (V, W) float32 of a folder with ``our_vab_*`` files, or of a GloVe text file.

    Raises:
        InputError: files are missing.
        FormatError: a file is damaged, or they do not belong together.
    """
    path = Path(path)
    return read_vocabulary(path) if path.is_dir() else read_glove_text(path)


def read_vocabulary(folder: str | Path) -> tuple[tuple[str, ...], Tensor]:
    """HumanML3D's table: ``our_vab_words.pkl`` (a list), ``our_vab_idx.pkl`` (rows by word), ``our_vab_data.npy``.

    The pickles are read by ``plain_pickle``, which runs nothing.

    Raises:
        InputError: a file is missing.
        FormatError: a file is damaged, or a word has no row.
    """
    folder = Path(folder)
    names = {part: folder / f"{PREFIX}_{part}" for part in ("words.pkl", "idx.pkl", "data.npy")}
    for path in names.values():
        if not path.is_file():
            raise InputError(f"{folder} has no {path.name}; give the unpacked glove folder of HumanML3D")
    words, rows = read_plain_pickle(names["words.pkl"]), read_plain_pickle(names["idx.pkl"])
    if not isinstance(words, list) or not all(isinstance(word, str) for word in words) or not words:
        raise FormatError(f"{names['words.pkl']} is no list of words; restore the original")
    vectors = read_array(names["data.npy"])
    if vectors.ndim != 2 or not 1 <= vectors.shape[1] <= MAX_WIDTH or not torch.isfinite(vectors).all():
        raise FormatError(
            f"{names['data.npy']} of shape {tuple(vectors.shape)} is no table of finite vectors; restore it"
        )
    words = list(dict.fromkeys(words))
    if not isinstance(rows, dict):
        raise FormatError(f"{names['idx.pkl']} is no dictionary of rows by word; restore the original")
    for word in words:
        row = rows.get(word)
        if not isinstance(row, int) or not 0 <= row < len(vectors):
            raise FormatError(
                f"{names['idx.pkl']} gives {word!r} the row {row!r} of {len(vectors)}; the files do not fit"
            )
    return tuple(words), vectors[torch.tensor([rows[word] for word in words])]


def read_glove_text(path: str | Path) -> tuple[tuple[str, ...], Tensor]:
    """A GloVe text file: a word and its numbers a line.

    Raises:
        InputError: the file is missing or unreadable.
        FormatError: it is no such file, or has lines or words without end.
    """
    path = Path(path)
    vectors: dict[str, Tensor] = {}  # of words that come twice the first
    width = 0
    try:
        with path.open("rb") as file:
            for number, line in enumerate(iter(lambda: file.readline(_MAX_LINE), b""), start=1):
                word, *numbers = line.decode().rstrip().split(" ")
                width = width or len(numbers)
                if not 1 <= len(numbers) <= MAX_WIDTH or len(numbers) != width or number > MAX_WORDS:
                    raise ValueError(f"line {number} has {len(numbers)} numbers, the first {width}")
                vectors.setdefault(word, torch.tensor([float(value) for value in numbers]))
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}; check the path") from None
    except ValueError as error:
        raise FormatError(
            f"{path} is no GloVe text file ({str(error)[:80]}); give a word and its numbers a line"
        ) from None
    if not vectors:
        raise FormatError(f"{path} has no words; give a GloVe text file")
    table = torch.stack(list(vectors.values()))
    if not torch.isfinite(table).all():
        raise FormatError(f"{path} holds numbers that are not finite; restore the original")
    return tuple(vectors), table
