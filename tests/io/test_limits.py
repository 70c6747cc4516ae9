import errno
import os
import tempfile

import pytest

from moveset.errors import FormatError, InputError, MovesetError
from moveset.io.limits import atomic_write, read_limited


def test_a_file_appears_whole(tmp_path):
    path = tmp_path / "take.bin"
    with atomic_write(path) as file:
        file.write(b"abc")
        assert not path.exists()
    assert path.read_bytes() == b"abc"
    assert os.listdir(tmp_path) == ["take.bin"]
    mask = os.umask(0)
    os.umask(mask)
    assert path.stat().st_mode & 0o777 == 0o666 & ~mask


@pytest.mark.parametrize("error", [ValueError("no"), KeyboardInterrupt(), OSError(errno.ENOSPC, "No space left")])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path, error):
    path = tmp_path / "take.bin"
    path.write_bytes(b"old")
    expected = MovesetError if isinstance(error, OSError) else type(error)

    def interrupted():
        with atomic_write(path) as file:
            file.write(b"half")
            raise error

    with pytest.raises(expected):
        interrupted()
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["take.bin"]


def test_a_full_disk_at_the_very_end_leaves_nothing(tmp_path, monkeypatch):
    def full(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(MovesetError, match="No space left") as caught, atomic_write(tmp_path / "take.bin") as file:
        file.write(b"abc")
    assert not isinstance(caught.value, InputError)
    assert os.listdir(tmp_path) == []


def test_folders_that_cannot_be_written_to_are_the_users_mistake(tmp_path, monkeypatch):
    (tmp_path / "file").write_bytes(b"")
    for path in (tmp_path / "missing" / "a", tmp_path / "file" / "a", tmp_path):
        with pytest.raises(InputError, match="cannot write"), atomic_write(path):
            pass

    def refuse(**_):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(tempfile, "mkstemp", refuse)
    with pytest.raises(InputError, match="Permission denied"), atomic_write(tmp_path / "a"):
        pass


def test_reading_is_limited(tmp_path):
    path = tmp_path / "take.bin"
    path.write_bytes(b"12345")
    assert read_limited(path, 5) == b"12345"
    with pytest.raises(FormatError, match="larger than the limit"):
        read_limited(path, 4)
    with pytest.raises(InputError, match="cannot read"):
        read_limited(tmp_path / "missing")
    with pytest.raises(InputError, match="not a regular file"):
        read_limited(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="not a regular file"):
        read_limited(tmp_path / "pipe")
