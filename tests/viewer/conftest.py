"""A browser and a server for the tests of pages: one of each for all of them."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

CHROMIUM = Path("/usr/bin/chromium")
FLAGS = (
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
)  # fmt: skip
PATIENCE = 60.0
SIZE = {"width": 760, "height": 560}
RESET = """(() => {
    const { clip, player } = __moveset;
    for (const box of document.querySelectorAll('#seed, #live-seed')) box.value = '';
    for (const group of ['#steps', '#takes']) document.querySelector(`${group} button`).click();
    clip.restore([]);
    player.pause();
    player.speed = 1;
    player.overlays = { skeleton: false, contacts: false, trail: false };
    for (const toast of document.querySelectorAll('.toast')) toast.remove();
    document.body.classList.remove('settings-open');
})()"""


@pytest.fixture(scope="session")
def browser():
    """Debian's Chromium without a screen, drawing in software."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed: pip install playwright"
    )
    if not CHROMIUM.exists():
        pytest.skip(f"no browser at {CHROMIUM}: apt-get install chromium")
    with playwright.sync_playwright() as running:
        chromium = running.chromium.launch(executable_path=str(CHROMIUM), args=list(FLAGS))
        yield chromium
        chromium.close()


@pytest.fixture(scope="session")
def server():
    """Address of a real ``moveset serve`` with the shipped models."""
    for library in ("fastapi", "uvicorn", "websockets"):
        pytest.importorskip(library, reason=f"{library} is not installed: pip install 'moveset[serve]'")
    command = [sys.executable, "-m", "moveset.cli", "serve", "--port", "0", "--no-open"]
    environment = {**os.environ, "OMP_WAIT_POLICY": "PASSIVE"}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment)
    try:
        line = process.stdout.readline()
        address = re.search(r"http://[\d.]+:\d+", line)
        assert address, line + process.stdout.read()
        yield address.group()
    finally:
        process.terminate()
        process.wait(20)


class Page:
    """A page of the studio that remembers what it complained of and whom it called."""

    def __init__(self, browser, address):
        self.address = address
        self.context = browser.new_context(viewport=SIZE, color_scheme="light", reduced_motion="reduce")
        self.page = self.context.new_page()
        # Blurred glass over a moving picture costs a software renderer more than the picture.
        session = self.context.new_cdp_session(self.page)
        self._media = lambda scheme: session.send(
            "Emulation.setEmulatedMedia",
            {
                "features": [
                    {"name": "prefers-reduced-transparency", "value": "reduce"},
                    {"name": "prefers-reduced-motion", "value": "reduce"},
                    {"name": "prefers-color-scheme", "value": scheme},
                ]
            },
        )
        self.prefer("light")
        self.complaints, self.strangers, self.expected = [], [], []
        self.page.on("console", lambda said: self.complaints.append(said.text) if said.type == "error" else None)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self._called(request.url))
        self.page.on("websocket", lambda socket: self._called(socket.url.replace("ws://", "http://")))

    def _called(self, url):
        if not url.startswith((self.address + "/", "data:", "blob:")):
            self.strangers.append(url)

    def prefer(self, scheme):
        """The system's colours: light or dark."""
        self._media(scheme)

    def sleep(self):
        """End what is live and draw next to nothing: in software a figure takes a core from the tests that follow."""
        self.run("__moveset.live.open && __moveset.live.stop()")
        self.page.set_viewport_size({"width": 1, "height": 1})

    def open(self):
        """Load the page and wait until its greeting stands on the stage."""
        self.page.goto(self.address)
        self.wait("window.__moveset && __moveset.stage.shown")
        return self

    def run(self, expression, argument=None):
        """What a JavaScript expression gives."""
        return self.page.evaluate(expression, argument)

    def wait(self, expression, seconds=PATIENCE):
        """Until an expression is true; the page's own policy forbids the evaluation that wait_for_function does."""
        end = time.monotonic() + seconds
        while not (found := self.page.evaluate(f"() => {{ const found = ({expression}); return found && true }}")):
            assert time.monotonic() < end, f"{expression} did not come true; {self.complaints}"
            time.sleep(0.03)
        return found

    def click(self, selector):
        """Press something without waiting for two still pictures, which are seconds apart in software."""
        self.page.locator(selector).first.dispatch_event("click")

    def say(self, text, key="Enter"):
        """Write into the prompt box and press a key."""
        self.run("text => { const box = document.querySelector('#prompt'); box.focus(); box.select() }")
        self.page.keyboard.insert_text(text)
        self.page.keyboard.press(key)

    def make(self, text):
        """Say something in clip mode and wait for the new take, standing still."""
        before = self.run("__moveset.recent.added")
        self.say(text)
        self.wait(f"__moveset.recent.added > {before}")
        self.run("__moveset.player.pause()")

    def words(self, selector):
        """The text of an element."""
        return self.run("selector => document.querySelector(selector).textContent", selector)

    def reset(self):
        """As after opening it, but for the takes that it remembers."""
        self.page.set_viewport_size(SIZE)
        if self.run("__moveset.live.open"):
            self.run("__moveset.live.stop()")
        self.wait("!__moveset.live.open && document.body.dataset.live !== 'stopping'")
        self.page.keyboard.press("Escape")
        self.click("#mode-clip")
        self.run(RESET)

    def check(self):
        """Whatever it complained of, and whoever else it called, is a failure."""
        complaints = [text for text in self.complaints if not any(part in text for part in self.expected)]
        strangers = list(self.strangers)
        for seen in (self.complaints, self.strangers, self.expected):
            seen.clear()
        assert complaints == []
        assert strangers == []


@pytest.fixture(scope="session")
def opened(browser, server):
    """One page for all tests: in software, compiling the shaders of another one takes seconds."""
    page = Page(browser, server).open()
    page.check()
    page.sleep()
    yield page
    page.context.close()


@pytest.fixture
def studio(opened):
    """The studio in clip mode, with nothing written, no panel open and its take standing still."""
    opened.reset()
    yield opened
    opened.check()
    opened.sleep()
