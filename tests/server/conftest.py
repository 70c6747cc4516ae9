"""A server on tiny models: in this process, or as a program of its own."""

import json
import subprocess
import sys
import time
import urllib.request
from dataclasses import replace

import pytest
from fastapi.testclient import TestClient

from moveset.server.app import create_app
from moveset.server.limits import Limits
from moveset.server.service import Options

HOST = "127.0.0.1"


@pytest.fixture(scope="session")
def models(tiny_clips, tiny_streams):
    """Folders of a tiny model of clips and a tiny model of streams."""
    return tiny_clips, tiny_streams


@pytest.fixture(scope="session")
def serving(models):
    """Open a server in this process: ``with serving(jobs=1) as client``."""

    def make(*, origins=(), hosts=("127.0.0.1",), **limits):
        options = Options(models, "cpu", replace(Limits(), **limits), origins, hosts)
        return TestClient(create_app(options), base_url=f"http://{HOST}")

    return make


@pytest.fixture(scope="module")
def client(serving):
    """One for all tests of a file that leave it as it was."""
    with serving() as client:
        yield client


class Program:
    """``moveset serve`` as a process."""

    def __init__(self, models, *options):
        command = [sys.executable, "-m", "moveset.cli", "serve", "--no-open", "--port", "0", "--device", "cpu"]
        for folder in models:
            command += ["--model", str(folder)]
        self.process = subprocess.Popen([*command, *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        line = self.process.stdout.readline()
        assert "serves at http://" in line, self.process.communicate()
        self.url = line.split()[3].rstrip("/")
        self.address = self.url.removeprefix("http://")
        self.port = int(self.address.rpartition(":")[2])
        while not self.health()["ready"]:
            time.sleep(0.05)

    def health(self):
        with urllib.request.urlopen(f"{self.url}/healthz", timeout=30) as answer:
            return json.load(answer)

    @property
    def memory(self):
        """Resident megabytes."""
        with open(f"/proc/{self.process.pid}/status") as file:
            return next(int(line.split()[1]) / 1024 for line in file if line.startswith("VmRSS"))

    def stop(self):
        if self.process.poll() is None:
            self.process.terminate()
        out, err = self.process.communicate(timeout=60)
        return self.process.returncode, out, err


@pytest.fixture(scope="module")
def program(models):
    running = Program(models, "--streams", "4")
    yield running
    code, _, err = running.stop()
    assert (code, err) == (0, ""), err


@pytest.fixture
def start(models):
    """Start programs that are stopped in the end."""
    running = []

    def begin(*options):
        running.append(Program(models, *options))
        return running[-1]

    yield begin
    for one in running:
        one.stop()
