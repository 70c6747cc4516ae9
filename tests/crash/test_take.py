"""A take may be killed at any moment: what had been appended is recovered, and nothing else is left."""

import json
import os
from contextlib import suppress

import pytest

from moveset.errors import FormatError
from moveset.io import load
from moveset.io.take_writer import recover_take
from tests.crash.take_victim import motion

pytestmark = [pytest.mark.skipif(os.name == "nt", reason="kills by POSIX signals"), pytest.mark.timeout(600)]


SUFFIXES = (".bvh", ".glb", ".npz", ".html")


@pytest.fixture(scope="module")
def killed(forks, tmp_path_factory):
    """A folder of what killed writers of each format left, and how many of them there were."""
    folder = tmp_path_factory.mktemp("killed")
    assert forks.run("tests.crash.take_victim:kill_all", str(folder), SUFFIXES) == 0, forks.said
    return folder, json.loads((folder / "killed.json").read_text())


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_sigkill_at_every_operation_on_the_disk(suffix, killed):
    folder, kills = killed
    home = folder / suffix
    whole, recovered = motion(), []
    for point in range(kills[suffix] + 1):
        folder, path = home / str(point), home / str(point) / f"take{suffix}"
        noted = [0, *map(int, (home / f"{point}.noted").read_text().split())][-1]
        if (folder / f"take{suffix}.part").exists():
            with suppress(FormatError):
                recovered.append(recover_take(path))
        if not path.exists():
            assert noted == 0
            continue
        found = load(path)
        assert len(found) >= noted
        assert (found.joints - whole.joints[: len(found)]).norm(dim=-1).max() < 1e-4
        assert {file.name for file in folder.iterdir() if ".json" not in file.name} == {path.name}
    assert noted == len(found) == 40
    # Struck in every piece, and in the middle of a piece.
    assert {frames // 10 for frames in recovered} >= {0 if suffix == ".bvh" else 1, 1, 2, 3, 4}
    assert any(frames % 10 for frames in recovered)
