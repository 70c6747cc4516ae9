"""Fixtures of the integrations: the add-on's modules that need no Blender, the clients, and a server that runs."""

import importlib.util
import sys
import threading
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def addon():
    """The add-on as a package; its modules without Blender can be imported from it."""
    folder = REPOSITORY / "integrations" / "blender"
    sys.path.insert(0, str(folder))
    try:
        yield importlib.import_module("moveset_blender")
    finally:
        sys.path.remove(str(folder))


@pytest.fixture(scope="session")
def served(tiny_clips, tiny_streams):
    """Address of a server with tiny models of random weights."""
    from moveset.server.app import create_app
    from moveset.server.run import listen, make_server
    from moveset.server.service import Options

    opened = threading.Event()
    socket = listen("127.0.0.1", 0)
    server = make_server(create_app(Options(models=(tiny_clips, tiny_streams), device="cpu")), opened=opened.set)
    thread = threading.Thread(target=server.run, args=([socket],), daemon=True)
    thread.start()
    assert opened.wait(60)
    yield f"http://127.0.0.1:{socket.getsockname()[1]}"
    server.should_exit = True
    thread.join(30)
    assert not thread.is_alive()
