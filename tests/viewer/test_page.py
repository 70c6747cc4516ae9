"""A page of motions in a real browser: it plays by itself, shows what Python computed, and lets nothing in or out."""

import json
import math
import time
from urllib.parse import urlsplit

import pytest

from moveset.io import save
from moveset.io.html import Scene, Shown, write_html
from moveset.motion.retarget import retarget
from tests.motions import gait, wander

NASTY = "</script><img src=x onerror=\"document.title='owned'\"><b>a person walks</b> 💃"


class Opened:
    """A page in a tab, with what went wrong on it and what it asked for."""

    def __init__(self, browser, path, size=(480, 400), scheme="light", motion="no-preference", script=""):
        self.context = browser.new_context(
            viewport={"width": size[0], "height": size[1]}, color_scheme=scheme, reduced_motion=motion, offline=True
        )
        self.tab = self.context.new_page()
        self.tab.add_init_script(script)
        self.tab.set_default_timeout(60_000)
        self.complaints, self.requests = [], []
        self.tab.on("console", self._heard)
        self.tab.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.tab.on("request", lambda request: self.requests.append(request.url))
        self.tab.goto(path.resolve().as_uri())
        self.tab.locator(".mv-time b").wait_for()
        self.wait("player.frameTimes().work.length > 0")

    def _heard(self, message):
        # Chromium's own remark on drawing without a graphics card is none of the page's.
        if message.type in ("error", "warning") and "GPU stall" not in message.text:
            self.complaints.append(message.text)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.context.close()

    def wait(self, expression, seconds=60.0):
        """Until an expression is true; the page's policy forbids the evaluation that wait_for_function does."""
        end = time.monotonic() + seconds
        while not self.ask(expression):
            assert time.monotonic() < end, f"{expression} did not come true; {self.complaints}"
            time.sleep(0.03)

    def ask(self, expression, value=None):
        return self.tab.evaluate(f"value => {{ const player = __moveset.player; return {expression}; }}", value)

    def shown(self):
        """A picture of the stage alone."""
        return self.tab.locator("canvas").screenshot()


def place_at(opened, frame, take=0):
    flat = opened.ask("[...player.jointPositions(value[0], value[1])]", [frame, take])
    return [flat[k : k + 3] for k in range(0, len(flat), 3)]


def distance(ours, theirs):
    """Between the joints of two poses, at most, in metres."""
    return max(math.dist(a, b) for a, b in zip(ours, theirs, strict=True))


@pytest.fixture(scope="module")
def walk():
    return gait(40)


@pytest.fixture
def page(browser, walk, tmp_path):
    save(walk, tmp_path / "walk.html", metadata={"prompt": "a person walks | a person stands", "starts": "0 | 1.5"})
    with Opened(browser, tmp_path / "walk.html") as opened:
        yield opened


def test_it_plays_by_itself_and_asks_for_nothing(page):
    before = page.shown()
    assert page.ask("player.playing")
    page.wait("player.frame > 3")
    assert page.shown() != before
    page.wait("document.querySelector('.mv-caption').textContent === 'a person stands'")
    assert [urlsplit(url).scheme for url in page.requests] == ["file"]
    assert page.complaints == []


def test_it_stands_still_until_it_is_asked_where_less_motion_is_wanted(browser, walk, tmp_path):
    save(walk, tmp_path / "a.html")
    with Opened(browser, tmp_path / "a.html", size=(240, 240), motion="reduce") as page:
        assert not page.ask("player.playing")
        page.tab.keyboard.press("Space")
        page.wait("player.frame > 0")


def test_joints_are_where_python_puts_them(page, walk):
    for frame in (0, 17, 39):
        assert distance(place_at(page, frame), walk.joints[frame].tolist()) < 1e-5
    # Between two frames: half-way along every arc, as `resampled` goes.
    between = walk.resampled(40.0).joints[21].tolist()
    assert distance(place_at(page, 10.5), between) < 1e-4


def test_keys_steer_it(page):
    press = page.tab.keyboard.press
    press("Space")
    assert not page.ask("player.playing")
    press("Home")
    assert page.ask("player.frame") == 0
    press("ArrowRight")
    press("ArrowRight")
    assert page.ask("player.frame") == pytest.approx(2)
    press("ArrowLeft")
    assert page.ask("player.frame") == pytest.approx(1)
    press("Shift+ArrowRight")
    assert page.ask("player.frame") == pytest.approx(21)
    press("End")
    assert page.ask("player.frame") == pytest.approx(39)
    press("ArrowUp")
    assert page.ask("player.speed") == 1.5
    for key, state in (("l", "loop"), ("s", "overlays.skeleton"), ("c", "overlays.contacts"), ("t", "overlays.trail")):
        before = page.ask(f"player.{state}")
        press(key)
        assert page.ask(f"player.{state}") is not before, key
    press("f")
    assert page.ask("player.camera") == "orbit"
    assert page.complaints == []


def test_every_control_has_a_name_and_a_state(page):
    page.tab.keyboard.press("Space")
    bar = page.tab.get_by_role("group", name="Playback")
    bar.get_by_role("button", name="Play", exact=True).click()
    assert page.ask("player.playing")
    page.tab.keyboard.press("Space")
    assert not page.ask("player.playing")
    for name in ("Repeat", "Follow the figure", "Show the skeleton", "Show planted feet", "Show the way"):
        bar.get_by_role("button", name=name, exact=True).click()
    assert page.ask("player.overlays") == {"skeleton": True, "contacts": True, "trail": True}
    slider = bar.get_by_role("slider", name="Time")
    assert "seconds" in slider.get_attribute("aria-valuetext")
    bar.get_by_role("button", name="Go to: a person stands").click()
    assert page.ask("player.frame") == pytest.approx(30, abs=0.1)


def test_what_is_laid_over_shows(page):
    page.tab.keyboard.press("Space")
    page.tab.keyboard.press("Home")
    plain = page.shown()
    for overlay in ("skeleton", "contacts", "trail"):
        page.ask("(player.overlays = {[value]: true}) && 0", overlay)
        page.ask("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
        assert page.shown() != plain, overlay
        page.ask("(player.overlays = {[value]: false}) && 0", overlay)


def test_a_still_picture_is_sharper_than_a_moving_one_in_software(page):
    assert page.ask("player.stage.software")
    page.wait("player.stage.ratio <= 1")
    page.tab.keyboard.press("Space")
    page.wait("player.stage.ratio === player.stage.full")
    assert page.ask("player.canvas.width") == math.floor(480 * 1.6)
    page.tab.keyboard.press("Space")
    page.wait("player.stage.ratio <= 1 && player.canvas.width <= 480")
    assert page.complaints == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_fits_a_phone_in_both_themes(browser, walk, tmp_path, scheme):
    walks = tuple(Shown(walk, f"take {k}") for k in range(3))
    path = write_html(tmp_path / "a.html", [Scene(f"scene {k}, with a rather long title", walks) for k in range(5)])
    with Opened(browser, path, size=(390, 700), scheme=scheme) as page:
        assert page.ask("player.theme") == scheme
        assert page.ask("document.documentElement.scrollWidth") == 390
        outside = """[...document.querySelectorAll('.mv-bar *')].filter(e => { const box = e.getBoundingClientRect();
            return box.width > 0 && (box.left < 0 || box.right > innerWidth || box.bottom > innerHeight); }).length"""
        assert page.ask(outside) == 0
        assert page.complaints == []


def test_scenes_are_chosen_from_a_list(browser, walk, tmp_path):
    other = wander(20, seed=5)
    scenes = [Scene("walk", (Shown(walk),)), Scene("sway", (Shown(other, "a"), Shown(walk, "b")))]
    path = write_html(tmp_path / "a.html", scenes, title="two")
    with Opened(browser, path, size=(900, 500)) as page:
        page.tab.get_by_role("button", name="sway").click()
        page.tab.keyboard.press("Space")
        assert page.tab.locator(".mv-label").all_text_contents() == ["a", "b"]
        assert place_at(page, 7)[15] == pytest.approx(other.joints[7, 15].tolist(), abs=1e-5)
        assert place_at(page, 7, take=1)[15] == pytest.approx(walk.joints[7, 15].tolist(), abs=1e-5)
        assert page.tab.title() == "two"
        page.tab.keyboard.press("n")
        assert page.tab.locator("[aria-current=true]").inner_text() == "walk"
        assert page.complaints == []


def test_prompts_cannot_run(browser, walk, tmp_path):
    save(walk, tmp_path / "a.html", metadata={"prompt": NASTY})
    with Opened(browser, tmp_path / "a.html") as page:
        assert page.tab.locator(".mv-caption").text_content() == NASTY
        assert page.tab.title() == NASTY
        assert page.tab.locator("img").count() == 0
        # Even a script that came in would not run: the policy knows one hash.
        page.ask("document.body.append(Object.assign(document.createElement('script'), {text: 'window.owned = 1'}))")
        assert page.ask("window.owned === undefined")
        assert "Content Security Policy" in " ".join(page.complaints)


def test_other_skeletons_get_a_body_too(browser, walk, tmp_path):
    mixamo = retarget(walk, "mixamo")
    save(mixamo, tmp_path / "a.html")
    with Opened(browser, tmp_path / "a.html") as page:
        assert place_at(page, 11)[5] == pytest.approx(mixamo.joints[11, 5].tolist(), abs=1e-5)
        # Fewer limbs than joints have a shape of their own (fingers and ends have none), but a whole body's are there.
        assert page.ask("player.cast.figures[0].limbs.length") >= 17
        assert page.complaints == []


def test_a_video_can_be_recorded(browser, tmp_path):
    save(gait(60), tmp_path / "a.html")
    with Opened(browser, tmp_path / "a.html", size=(240, 240)) as page:
        head = page.ask(
            "player.recordVideo().then(async video => [video.type, video.size,"
            " [...new Uint8Array(await video.slice(0, 4).arrayBuffer())]])"
        )
        assert head[0] == "video/webm"
        assert head[1] > 1000
        assert head[2] == [0x1A, 0x45, 0xDF, 0xA3], "an EBML head"
        assert page.complaints == []


def test_a_recording_that_is_ended_by_hand_is_saved_once(browser, tmp_path):
    save(gait(60), tmp_path / "a.html")
    with Opened(browser, tmp_path / "a.html", size=(240, 240)) as page:
        saved = []
        page.tab.on("download", lambda download: saved.append(download.suggested_filename))
        page.tab.keyboard.press("v")
        page.wait("player.recording !== null")
        page.tab.wait_for_timeout(300)
        page.tab.keyboard.press("v")
        page.wait("player.recording === null")
        page.tab.wait_for_timeout(500)
        assert saved == ["motion.webm"]
        assert page.complaints == []


def test_no_video_is_offered_where_the_browser_cannot_record_one(browser, walk, tmp_path):
    save(walk, tmp_path / "a.html")
    cannot = "MediaRecorder.isTypeSupported = () => false"
    with Opened(browser, tmp_path / "a.html", size=(240, 240), script=cannot) as page:
        page.tab.keyboard.press("Space")
        assert page.tab.get_by_role("button", name="Record a video").count() == 0
        page.tab.keyboard.press("v")
        assert not page.ask("player.playing")
        assert page.complaints == []


def test_a_still_picture_comes_back_with_the_graphics_card(page):
    page.tab.keyboard.press("Space")
    page.wait("player.stage.ratio === player.stage.full")
    before, later = None, page.shown()
    while later != before:  # the view comes to rest after the motion does
        before, later = later, page.shown()
    page.ask("(window.lost = player.canvas.getContext('webgl2').getExtension('WEBGL_lose_context')).loseContext()")
    page.wait("player.stage.renderer.getContext().isContextLost()")
    page.ask("lost.restoreContext()")
    end = time.monotonic() + 20
    while page.shown() != before:
        assert time.monotonic() < end, "the picture is gone for good"


def test_the_view_is_moved_with_the_right_button_and_no_menu_opens(page):
    assert not page.ask("player.canvas.dispatchEvent(new MouseEvent('contextmenu', { cancelable: true }))")


def test_a_notebook_frame_plays(browser, walk, tmp_path):
    (tmp_path / "a.html").write_text(f"<!doctype html><body style='margin:0'>{walk._repr_html_()}")
    context = browser.new_context(viewport={"width": 500, "height": 500}, offline=True)
    tab = context.new_page()
    tab.goto((tmp_path / "a.html").resolve().as_uri())
    slider = tab.frame_locator("iframe").get_by_role("slider", name="Time")
    slider.wait_for(timeout=60_000)
    first = slider.input_value()
    end = time.monotonic() + 60
    while slider.input_value() == first:
        assert time.monotonic() < end, "nothing moves in the notebook's frame"
        time.sleep(0.05)
    context.close()


def test_a_page_that_is_still_being_written_plays(browser, walk, tmp_path):
    from moveset.io.take_writer import open_take

    with open_take(tmp_path / "a.html", walk.skeleton, walk.fps, metadata={"prompt": "a person walks"}) as take:
        take.append(walk[:25])
        (tmp_path / "so-far.html").write_bytes((tmp_path / "a.html.part").read_bytes())
        take.append(walk[25:])
    for name, frames in (("so-far.html", 25), ("a.html", 40)):
        with Opened(browser, tmp_path / name) as page:
            assert page.ask("Math.round(player.duration * player.fps) + 1") == frames
            assert json.dumps(page.complaints) == "[]"
