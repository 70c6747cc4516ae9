"""Fixtures that several tests share."""

import hashlib
import os
import shutil
import tarfile
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from tests.forks import Forks
    from tests.tiny_run import TinyRun

# A test must not fail because the machine was busy.
settings.register_profile("moveset", deadline=None)
settings.load_profile("moveset")

# Fixtures that cost seconds or a browser: tests that use those of a group run in one process, which makes each once.
COSTLY = {"tiny_run": "trainings", "forks": "trainings", "browser": "pages"}
# Files that take longest besides, so that no process is left alone with one of them in the end.
LONG = ("test_researcher.py", "test_shipped.py")
REPOSITORY = Path(__file__).resolve().parents[1]
# What the tests read from the archives; a folder given by MOVESET_RAW or data/raw may hold the whole sets.
MEMBERS = {
    "cmu.tar.xz": (
        "cmu/trials.jsonl",
        *(f"cmu/subjects/{s}/{s}.asf" for s in ("01", "02", "07")),
        *(f"cmu/subjects/02/02_{k}.{form}" for k in ("01", "04", "07") for form in ("amc", "bvh")),
        "cmu/subjects/01/01_07.amc",
        "cmu/subjects/01/01_08.amc",
        "cmu/subjects/01/01_08.bvh",
        "cmu/subjects/06/06_10.bvh",
        "cmu/subjects/07/07_03.amc",
        "cmu/subjects/13/13_01.bvh",
        "cmu/subjects/13/13_18.bvh",
    ),
    "cmu-more.tar.xz": (
        "cmu-more/trials.jsonl",
        *(f"cmu-more/subjects/{k.split('_')[0]}/{k}.bvh" for k in ("23_03", "49_06", "83_24", "140_08")),
    ),
    "more-mocap.tar.xz": (
        "more-mocap/takes.jsonl",
        *(
            f"more-mocap/takes/{name}.bvh"
            for name in (
                "deepmimic/humanoid3d_jump",
                "greta/Fluid_gesture",
                "human-foot/wd2_101",
                "mass/kick",
                "smartbody/ChrBrad-Idle01_ToIdle02",
                "tennis/tennis_KangTennisF19",
                "tilling-patch/itonic3_wd2_walktocrawl_1",
                "time-critical/s_005_3_2",
                "ys2010/wd2_Physics_Raise01",
                "ys2010/wd2_WalkSameSame03",
            )
        ),
    ),
    "bandai-namco.tar.xz": (
        *(f"dataset-1/data/dataset-1_{name}.bvh" for name in ("walk-back_normal_001", "bow_active_001")),
        *(
            f"dataset-2/data/dataset-2_{name}.bvh"
            for name in (
                "walk_active_002",
                "walk-turn-left_normal_001",
                "walk-turn-right_normal_002",
                "wave-left-hand_normal_001",
            )
        ),
    ),
}
SPANS = "humanml3d-cmu.jsonl"  # lies beside the archives


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """With ``--dist loadgroup``: a file's tests run in one process, which makes what they share once; longest first."""
    files = {item.path: _costly(item) for item in items if _costly(item)}
    items.sort(key=lambda item: (item.path not in files, item.path.name not in LONG))
    for item in items:
        name = files.get(item.path) or item.path.relative_to(REPOSITORY)
        item.add_marker(pytest.mark.xdist_group(str(name)))
        if item.path in files and item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(900))  # what is made once takes minutes on a busy machine


def _costly(item: pytest.Item) -> str | None:
    return next((COSTLY[name] for name in COSTLY if name in getattr(item, "fixturenames", ())), None)


@pytest.fixture(scope="session")
def tiny_clips(tmp_path_factory) -> Path:
    """Folder of a tiny model of clips, made once; who changes it takes a copy."""
    from tests.bundles import tiny_bundle

    return tiny_bundle(tmp_path_factory.mktemp("clips") / "tiny")


@pytest.fixture(scope="session")
def tiny_streams(tmp_path_factory) -> Path:
    """Folder of a tiny model of streams, made once; who changes it takes a copy."""
    from tests.streams import tiny_stream

    return tiny_stream(tmp_path_factory.mktemp("streams") / "tiny-stream")


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder with real takes: cmu/, cmu-more/, more-mocap/, dataset-1/, dataset-2/, and sentences of spans of them.

    Tests that use it are skipped where there is none.
    """
    if folder := os.environ.get("MOVESET_RAW"):
        return Path(folder)
    if (REPOSITORY / "data" / "raw" / "cmu").is_dir():
        return REPOSITORY / "data" / "raw"
    archives = {name: REPOSITORY.parent / "shared" / "data" / name for name in MEMBERS}
    if not all(archive.is_file() for archive in archives.values()):
        pytest.skip("no real takes here: set MOVESET_RAW to a folder with cmu/, dataset-1/ and dataset-2/")
    return _unpacked(archives)


def _unpacked(archives: dict[str, Path]) -> Path:
    """The members that tests need, unpacked once into a cache folder that appears whole or not at all."""
    key = hashlib.sha256(repr((MEMBERS, [archive.stat().st_size for archive in archives.values()])).encode())
    cache = Path(tempfile.gettempdir()) / f"moveset-raw-{key.hexdigest()[:16]}"
    if cache.is_dir():
        return cache
    with tempfile.TemporaryDirectory(prefix="moveset-raw-", dir=cache.parent) as scratch:
        fresh = Path(scratch) / "raw"
        for name, archive in archives.items():
            wanted = set(MEMBERS[name])
            with tarfile.open(archive) as tar:
                for member in tar:
                    if member.name in wanted:
                        tar.extract(member, fresh, filter="data")
                        wanted.discard(member.name)
                    if not wanted:
                        break
            if wanted:
                raise RuntimeError(f"{archive} lacks {sorted(wanted)}")
        if (spans := archive.parent / SPANS).is_file():
            shutil.copyfile(spans, fresh / SPANS)
        try:
            fresh.rename(cache)
        except OSError:
            # Another run was quicker.
            if not cache.is_dir():
                raise
    return cache


@pytest.fixture(scope="session")
def forks() -> Iterator["Forks"]:
    """Calls functions in processes that tests may kill."""
    from tests.forks import Forks

    made = Forks()
    yield made
    made.close()


@pytest.fixture(scope="session")
def tiny_run(tmp_path_factory: pytest.TempPathFactory) -> "TinyRun":
    """Trained and exported models of every kind; made once, and read only."""
    from tests.tiny_run import TinyRun

    return TinyRun.make(tmp_path_factory.mktemp("tiny-run"))
