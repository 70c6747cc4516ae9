import errno
import os
import stat

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


def test_the_umask_of_all_threads_is_left_alone(tmp_path, monkeypatch):
    """Two that read it at once, each by setting it to 0 and back, would leave it at 0: a server writes in threads."""
    before = os.umask(0o027)
    try:
        with monkeypatch.context() as patch:
            patch.setattr(os, "umask", None)
            with atomic_write(tmp_path / "a") as file:
                file.write(b"a")
        assert (tmp_path / "a").stat().st_mode & 0o777 == 0o640
    finally:
        os.umask(before)


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


def test_a_link_leads_to_what_is_written_and_stays(tmp_path):
    (tmp_path / "deep").mkdir()
    for name, target in (("a", "deep/take.bin"), ("b", "a"), ("c", "deep/new.bin")):
        (tmp_path / name).symlink_to(target)
    (tmp_path / "deep" / "take.bin").write_bytes(b"old")
    for name in "abc":
        with atomic_write(tmp_path / name) as file:
            file.write(name.encode())
    assert (tmp_path / "deep" / "take.bin").read_bytes() == b"b"
    assert (tmp_path / "deep" / "new.bin").read_bytes() == b"c"
    assert all((tmp_path / name).is_symlink() for name in "abc")
    assert sorted(os.listdir(tmp_path / "deep")) == ["new.bin", "take.bin"]
    with pytest.raises(ValueError, match="no"), atomic_write(tmp_path / "a"):
        raise ValueError("no")
    assert (tmp_path / "a").read_bytes() == b"b"


def test_what_is_no_regular_file_is_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("pipe")
    (tmp_path / "null").symlink_to("/dev/null")
    for name in ("pipe", "link", "null"):
        with pytest.raises(InputError, match="no regular file"), atomic_write(tmp_path / name):
            pass
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)
    assert len(os.listdir(tmp_path)) == 3


def test_folders_that_cannot_be_written_to_are_the_users_mistake(tmp_path, monkeypatch):
    (tmp_path / "file").write_bytes(b"")
    for path in (tmp_path / "missing" / "a", tmp_path / "file" / "a", tmp_path):
        with pytest.raises(InputError, match="cannot write"), atomic_write(path):
            pass

    def refuse(*_):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(os, "open", refuse)
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
    with pytest.raises(InputError, match="File name too long"):
        read_limited(tmp_path / ("a" * 300))
    with pytest.raises(InputError, match="not a regular file"):
        read_limited(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="not a regular file"):
        read_limited(tmp_path / "pipe")
