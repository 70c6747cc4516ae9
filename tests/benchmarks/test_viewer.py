"""The viewer's benchmark: percentiles have closed forms, and the time of browsers that it started is counted."""

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.fixture
def viewer(monkeypatch):
    pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install playwright")
    monkeypatch.delitem(sys.modules, "viewer", raising=False)
    import viewer

    yield viewer
    sys.modules.pop("viewer", None)


def test_percentiles_are_of_the_nearest_rank(viewer):
    assert viewer.summary([float(k) for k in range(100, 0, -1)]) == {"median_ms": 50.5, "p95_ms": 95.0, "count": 100}
    assert viewer.summary([7.0]) == {"median_ms": 7.0, "p95_ms": 7.0, "count": 1}
    assert viewer.summary([1.0, 2.0, 30.0])["p95_ms"] == 30.0


@pytest.mark.skipif(not Path("/proc/self/schedstat").is_file(), reason="needs Linux's schedstat")
def test_processor_time_is_that_of_browsers_started_here(viewer):
    before = viewer.browser_ms()
    work = "import sys, time\nwhile time.process_time() < 0.2: pass\nprint(flush=True); sys.stdin.read()"
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", work, "chromium"], **pipes) as one:
        one.stdout.readline()
        assert viewer.browser_ms() - before >= 190
        one.stdin.close()


def test_its_browser_is_that_of_the_tests(viewer):
    from tests.viewer import conftest

    assert conftest.FLAGS == viewer.FLAGS
    assert str(conftest.CHROMIUM) == viewer.CHROMIUM
