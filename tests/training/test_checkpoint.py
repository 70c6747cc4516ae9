import contextlib
import errno
import json
import os
import shutil

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from moveset.errors import FormatError, InputError, MovesetError
from moveset.io.manifest import MAX_JSON
from moveset.training import checkpoint

TENSORS = {
    "net": {"w": torch.arange(6.0).view(2, 3), "b": torch.zeros(0)},
    "rng": {"s": torch.arange(5, dtype=torch.uint8)},
}
DOCUMENTS = {"state": {"step": 3, "pi": 0.1 + 0.2}, "config": {"width": 8}}


def make(folder, step=3):
    return checkpoint.write(folder, step, TENSORS, DOCUMENTS)


def test_what_is_written_is_read(tmp_path):
    path = make(tmp_path / "run")
    assert path == tmp_path / "run" / "step_3"
    assert checkpoint.verify(path)["step"] == 3
    for name, tensors in TENSORS.items():
        read = checkpoint.read_tensors(path, name)
        assert read.keys() == tensors.keys()
        assert all(torch.equal(read[key], value) and read[key].dtype == value.dtype for key, value in tensors.items())
    assert checkpoint.read_document(path, "state") == DOCUMENTS["state"]


def test_views_and_shared_memory_are_saved(tmp_path):
    base = torch.randn(4, 6, generator=torch.Generator().manual_seed(0))
    path = checkpoint.write(tmp_path, 1, {"m": {"a": base, "b": base, "t": base.t(), "row": base[1]}}, {})
    assert torch.equal(checkpoint.read_tensors(path, "m")["t"], base.t())


def test_no_pickle(tmp_path):
    """Neither of the two containers torch.save has used appears, and the sources never unpickle."""
    for file in make(tmp_path).iterdir():
        assert file.suffix in (".safetensors", ".json")
        assert not file.read_bytes().startswith((b"PK", b"\x80"))


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    return make(tmp_path_factory.mktemp("sound"))


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_any_changed_byte_is_noticed(sound, data):
    file = data.draw(st.sampled_from(sorted(f for f in sound.iterdir() if f.name != "manifest.json")))
    original = file.read_bytes()
    position = data.draw(st.integers(0, len(original) - 1))
    how = data.draw(st.sampled_from(["flip", "cut", "grow"]))
    changed = bytearray(original)
    if how == "flip":
        changed[position] ^= data.draw(st.integers(1, 255))
    changed = {"flip": bytes(changed), "cut": original[:position], "grow": original + b"\0"}[how]
    file.write_bytes(changed)
    try:
        with pytest.raises(FormatError, match=file.name):
            checkpoint.verify(sound)
    finally:
        file.write_bytes(original)
    checkpoint.verify(sound)


@pytest.mark.parametrize(
    "manifest",
    [
        b"",
        b"{",
        b"[]",
        b"null",
        b"\xff\xfe",
        b'{"format": 2, "files": {}}',
        b'{"format": 1, "files": []}',
        b'{"format": 1, "files": {"../state.json": {"bytes": 1, "sha256": ""}}}',
        b'{"format": 1, "files": {"/etc/passwd": {"bytes": 1, "sha256": ""}}}',
        b'{"format": 1, "files": {"net.safetensors": 3}}',
        b'{"format": 1, "files": {"absent.safetensors": {"bytes": 1, "sha256": ""}}}',
        b"[" * 100_000,
    ],
)
def test_a_strange_manifest_is_refused(tmp_path, manifest):
    path = make(tmp_path)
    (path / "manifest.json").write_bytes(manifest)
    with pytest.raises(FormatError):
        checkpoint.verify(path)


def test_a_manifest_that_is_too_large_is_not_read(tmp_path):
    path = make(tmp_path)
    with open(path / "manifest.json", "wb") as file:
        file.truncate(MAX_JSON + 1)
    with pytest.raises(FormatError, match="larger than"):
        checkpoint.verify(path)


def test_latest_is_the_highest_valid_number(tmp_path):
    assert checkpoint.latest(tmp_path) is None
    assert checkpoint.latest(tmp_path / "absent") is None
    for step in (9, 10, 100):
        make(tmp_path, step)
    for noise in ("step_007", "step_1e3", "step_-1", "step_", ".tmp-step_200-1"):
        (tmp_path / noise).mkdir()
    (tmp_path / "step_500").write_text("a file")
    assert checkpoint.steps(tmp_path) == [9, 10, 100]
    assert checkpoint.latest(tmp_path) == tmp_path / "step_100"
    (tmp_path / "step_100" / "manifest.json").unlink()
    with pytest.warns(UserWarning, match=r"no manifest\.json"):
        assert checkpoint.latest(tmp_path) == tmp_path / "step_10"


def test_a_path_may_mean_a_run_or_a_checkpoint(tmp_path):
    make(tmp_path, 1), make(tmp_path, 2)
    assert checkpoint.resolve(tmp_path) == tmp_path / "step_2"
    assert checkpoint.resolve(tmp_path / "step_1") == tmp_path / "step_1"
    (tmp_path / "step_1" / "state.json").write_text("{}")
    with pytest.raises(FormatError):
        checkpoint.resolve(tmp_path / "step_1")
    for absent in (tmp_path / "step_3", tmp_path / "nowhere"):
        with pytest.raises(InputError, match="there is no"):
            checkpoint.resolve(absent)


def test_loading_names_what_is_wrong(tmp_path):
    path = make(tmp_path)
    with pytest.raises(InputError, match="holds no 'vae'; it holds net, rng"):
        checkpoint.read_tensors(path, "vae")
    with pytest.raises(InputError, match="does not fit"):
        checkpoint.load_module(nn.Linear(2, 2), path, "net")
    (path / "net.safetensors").write_bytes(b"\xff" * 100)
    with pytest.raises(FormatError, match="not a safetensors file"):
        checkpoint.read_tensors(path, "net")


def test_a_full_disk_at_any_write_leaves_the_last_good_one(tmp_path, monkeypatch):
    make(tmp_path, 1)
    real, failures = os.fsync, 0
    for failing_call in range(50):
        calls = iter(range(1000))

        def fsync(descriptor, calls=calls, failing_call=failing_call):
            if next(calls) == failing_call:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            real(descriptor)

        monkeypatch.setattr(os, "fsync", fsync)
        with contextlib.suppress(MovesetError):
            make(tmp_path, 2)
            break
        failures += 1
        assert not list(tmp_path.glob(".tmp-*"))
        checkpoint.verify(tmp_path / "step_1")
        if failures == len(TENSORS) + len(DOCUMENTS) + 3:  # only the last fsync, of the parent, follows the rename
            checkpoint.verify(tmp_path / "step_2")
            shutil.rmtree(tmp_path / "step_2")
        assert checkpoint.steps(tmp_path) == [1]
    assert failures == len(TENSORS) + len(DOCUMENTS) + 3


def test_a_full_disk_is_one_sentence(tmp_path, monkeypatch):
    def fsync(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(MovesetError, match=r"No space left on device.*older checkpoints are intact: make room"):
        make(tmp_path)


def test_an_unwritable_folder_is_one_sentence(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(MovesetError, match="could not be written"):
        make(tmp_path / "file" / "run")


def test_pruning_and_cleaning(tmp_path):
    for step in (5, 10, 15, 20, 25):
        make(tmp_path, step)
    (tmp_path / ".tmp-step_30-1").mkdir()
    (tmp_path / ".tmp-step_30-1" / "half").write_text("x")
    checkpoint.clean(tmp_path)
    checkpoint.prune(tmp_path, keep_last=1, keep_every=10)
    assert sorted(item.name for item in tmp_path.iterdir()) == ["step_10", "step_20", "step_25"]


def test_a_document_is_strict_json(tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        checkpoint.write(tmp_path, 1, {}, {"state": {"loss": float("nan")}})
    assert list(tmp_path.iterdir()) == []
    path = checkpoint.write(tmp_path, 1, {}, {"state": {"lr": 0.1 + 0.2}})
    assert json.loads((path / "state.json").read_text())["lr"] == 0.1 + 0.2
