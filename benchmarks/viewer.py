"""What a picture of the player costs: time between pictures while one character plays, and time of drawing one.

    python benchmarks/viewer.py --out viewer.json              # three sizes, with and without shadows
    python benchmarks/viewer.py --sizes 760x560 --seconds 10

Writes a page that plays by itself, as ``moveset generate -o walk.html`` does, and opens it in a headless Chromium that
draws in software (SwiftShader, the flags of the viewer's tests). The figures are those of a processor in a graphics
card's place and say nothing about a graphics card. On a busy machine those by the clock are figures of the business.

- Playing: the player as it is, adapting its resolution. Time between two requestAnimationFrame callbacks, time that the
  page's own draw call takes, pixels to a CSS pixel at the end, and processor time a picture.
- Drawing: the resolution held at one pixel to a CSS pixel. The renderer's call and reading one pixel back, which waits
  until everything is drawn.
- Processor time is that of all of Chromium's threads (Linux's schedstat), drawing and composing together. What
  others on the core take is not in it, but it grows with the business too: compare builds in turns.
"""

import argparse
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from arguments import Parser, at_least, library, positive, report_path, write_report
from moveset.bench.machine import describe_machine, load
from moveset.errors import InputError, exit_code_of

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

CHROMIUM = "/usr/bin/chromium"
# Those of tests/viewer/conftest.py.
FLAGS = (
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
)  # fmt: skip
SIZES = ("390x700", "760x560", "1280x720")
_SETTLE = 4.0  # seconds of play within which shaders are compiled and the resolution is found

_PLAY = """async seconds => {
    const { player } = __moveset;
    const times = [];
    const end = performance.now() + 1000 * seconds;
    let last = 0;
    player.play();
    await new Promise((done) => {
        const frame = (now) => {
            if (last) times.push(now - last);
            last = now;
            if (performance.now() < end || times.length < 4) requestAnimationFrame(frame);
            else done();
        };
        requestAnimationFrame(frame);
    });
    const work = player.frameTimes().work.slice(-times.length);
    return { times, work, ratio: player.stage.ratio };
}"""
_DRAW = """async pictures => {
    const { player } = __moveset;
    const { stage } = player;
    const { figures } = player.cast;
    const gl = stage.renderer.getContext();
    const pixel = new Uint8Array(4);
    const times = [];
    for (let k = 0; k < pictures; k++) {
        for (const figure of figures) figure.update((2 * k) % figure.take.frames);
        const begun = performance.now();
        stage.render();
        gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
        times.push(performance.now() - begun);
        await new Promise((done) => setTimeout(done));
    }
    return times;
}"""
# The player as it is, with its adaptation taken out of its way, standing still.
_HOLD = """shadows => {
    const { player } = __moveset;
    player.pause();
    player.spare = () => {};
    player.stage.ratio = 1;
    player.stage.key.castShadow = shadows;
}"""
_SURFACE = """() => {
    const { stage } = __moveset.player;
    const gl = stage.renderer.getContext();
    const named = gl.getExtension('WEBGL_debug_renderer_info');
    return gl.getParameter(named ? named.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
}"""


def summary(times: list[float]) -> dict[str, float]:
    """Median and 95th percentile (nearest rank) of times in ms."""
    ordered = sorted(times)
    return {
        "median_ms": round(statistics.median(ordered), 1),
        "p95_ms": round(ordered[-(-95 * len(ordered) // 100) - 1], 1),
        "count": len(ordered),
    }


def browser_ms() -> float:
    """Processor time (ms) of the browsers that this process has started, all threads together."""
    children: dict[int, list[int]] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(stat.read_text().rsplit(")", 1)[1].split()[1])
        except OSError:  # it has ended meanwhile
            continue
        children.setdefault(parent, []).append(int(stat.parent.name))
    waiting, found = list(children.get(os.getpid(), [])), 0
    while waiting:
        pid = waiting.pop()
        waiting += children.get(pid, [])
        try:
            if "chromium" not in Path(f"/proc/{pid}/cmdline").read_text():
                continue
            for thread in Path(f"/proc/{pid}/task").iterdir():
                found += int((thread / "schedstat").read_text().split()[0])
        except OSError:
            continue
    return found / 1e6


def opened(browser: "Browser", path: Path, size: str) -> "Page":
    """The page at a size, one pixel of the screen to a CSS pixel, when it has drawn its first pictures."""
    width, height = (int(part) for part in size.split("x"))
    context = browser.new_context(viewport={"width": width, "height": height}, color_scheme="light", offline=True)
    page = context.new_page()
    page.goto(path.as_uri())
    page.locator(".mv-time b").wait_for(timeout=120_000)
    end = time.monotonic() + 120
    while not page.evaluate("__moveset.player.frameTimes().work.length > 2"):
        if time.monotonic() > end:
            raise InputError(f"{path} draws nothing; give a page that moveset wrote")
        time.sleep(0.1)
    return page


def measure(page: "Page", seconds: float, pictures: int, repeats: int) -> dict[str, Any]:
    """Everything at one size; of several repeats the one with the least median, by the clock and by processor."""
    page.evaluate(_PLAY, _SETTLE)
    played = []
    for _ in range(repeats):
        before = browser_ms()
        got = page.evaluate(_PLAY, seconds)
        cost = round((browser_ms() - before) / len(got["times"]), 1)
        played.append(
            {
                "interval": summary(got["times"]),
                "page": summary(got["work"]),
                "processor_ms": cost,
                "ratio": got["ratio"],
            }
        )
    found: dict[str, Any] = {"playing": min(played, key=lambda one: one["interval"]["median_ms"])}
    drawn: dict[str, list[dict[str, Any]]] = {"shadows": [], "no_shadows": []}
    for _ in range(repeats):
        # In pairs: what else the machine does meets both.
        for name in drawn:
            page.evaluate(_HOLD, name == "shadows")
            page.evaluate(_DRAW, 2)
            before = browser_ms()
            times = page.evaluate(_DRAW, pictures)
            cost = round((browser_ms() - before) / pictures, 1)
            drawn[name].append({**summary(times), "processor_ms": cost})
    found["drawing"] = {name: min(rows, key=lambda one: one["median_ms"]) for name, rows in drawn.items()}
    found["drawing"]["least_processor_ms"] = {
        name: min(one["processor_ms"] for one in rows) for name, rows in drawn.items()
    }
    return found


def main() -> None:
    """Measure, and print JSON."""
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=report_path)
    parser.add_argument("--page", type=Path, help="a page that moveset wrote; by default one is made")
    parser.add_argument("--sizes", nargs="+", default=SIZES, help="of the window, in CSS pixels")
    parser.add_argument("--seconds", type=positive, default=6.0, help="of play, each time")
    parser.add_argument("--pictures", type=at_least(1), default=20, help="drawn, each time")
    parser.add_argument("--repeats", type=at_least(1), default=3, help="of which the best median counts")
    given = parser.parse_args()
    for size in given.sizes:
        if not re.fullmatch(r"[1-9]\d{1,3}x[1-9]\d{1,3}", size):
            raise InputError(f"size {size!r} is not WIDTHxHEIGHT of 10 to 9999 pixels, such as {SIZES[0]}")
    if given.page and not given.page.is_file():
        raise InputError(f"there is no page {given.page}; leave --page out, and one is made")
    found: dict[str, Any] = {}
    playwright = library("playwright.sync_api", "pip install playwright")
    with tempfile.TemporaryDirectory() as folder, playwright.sync_playwright() as running:
        path = given.page
        if path is None:
            path = Path(folder) / "walk.html"
            command = [sys.executable, "-m", "moveset.cli", "generate", "a person walks forward", "--seed", "1"]
            subprocess.run([*command, "-o", str(path)], check=True, stdout=subprocess.DEVNULL)
        browser = running.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        version = browser.version
        for size in given.sizes:
            page = opened(browser, path.resolve(), size)
            surface = page.evaluate(_SURFACE)
            found[size] = measure(page, given.seconds, given.pictures, given.repeats)
            print(json.dumps({size: found[size]}), file=sys.stderr)
            page.context.close()
        browser.close()
    settings = {"seconds": given.seconds, "pictures": given.pictures, "repeats": given.repeats}
    drawn_by = {"chromium": version, "surface": surface, "load": load()}
    report = {"machine": describe_machine(), **drawn_by, "settings": settings, "sizes": found}
    print(json.dumps(report, indent=1), flush=True)
    if given.out:
        write_report(given.out, report)


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
