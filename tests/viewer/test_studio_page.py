"""The studio around its stage: colours, narrow windows, keys, faults told in the server's words."""

import io
import json
import urllib.request

import numpy as np
from PIL import Image

NARROW = {"width": 390, "height": 844}


def brightness(studio):
    """Mean of the stage's upper corner, 0 to 255."""
    picture = studio.page.screenshot(clip={"x": 0, "y": 70, "width": 60, "height": 60})
    return float(np.asarray(Image.open(io.BytesIO(picture)).convert("L")).mean())


def test_dark_and_light(studio):
    studio.prefer("dark")
    studio.wait("__moveset.player.theme === 'dark'")
    assert brightness(studio) < 60
    studio.click("#open-theme")
    assert studio.run("document.documentElement.dataset.theme") == "light"
    assert brightness(studio) > 180
    # The page remembers, and the first thing in it is the prompt box.
    studio.open()
    assert brightness(studio) > 180
    assert studio.run("document.activeElement.id") == "prompt"
    # The player's own switch and the page's are one; what the system says already need not be remembered.
    studio.run("__moveset.player.toggle('dark')")
    assert studio.run("[document.documentElement.dataset.theme, localStorage.length]") == [None, 0]
    studio.prefer("light")
    studio.wait("__moveset.player.theme === 'light'")


BEYOND = """(() => {
    const parts = '.top *, .dock > *, .composer, .composer .settings *, .mv-bar *, .popover *';
    const scrolled = '.chips, .timeline, .strip, .mv-scrub, svg, .hidden';
    const outside = box => box.left < -0.5 || box.right > innerWidth + 0.5;
    return [...document.querySelectorAll(parts)]
        .filter(one => one.getClientRects().length && !one.closest(scrolled) && outside(one.getBoundingClientRect()))
        .map(one => one.outerHTML.slice(0, 90));
})()"""


GAP = (
    "(document.querySelector('.mv-bar').getBoundingClientRect().top"
    " - document.querySelector('.composer').getBoundingClientRect().bottom)"
)


def test_a_phone_has_nothing_beyond_its_edges(studio):
    studio.page.set_viewport_size(NARROW)

    def fits():
        return [studio.run("document.documentElement.scrollWidth"), studio.run(BEYOND)] == [NARROW["width"], []]

    assert fits(), studio.run(BEYOND)
    studio.click("#open-settings")
    assert fits(), studio.run(BEYOND)
    studio.say("a person walks forward", "Control+Enter")
    studio.make("a person waves with the left hand and then turns around to the right")
    assert fits(), studio.run(BEYOND)
    # Bar and dock do not cover one another.
    studio.wait(f"{GAP} >= 4 && {GAP} <= 24")
    for panel in ("#open-downloads", "#open-recent"):
        studio.click(panel)
        assert fits(), studio.run(BEYOND)
    studio.click("#mode-live")
    studio.say("a person walks forward")
    studio.wait("document.body.dataset.live === 'running' && __moveset.live.shown")
    assert fits(), studio.run(BEYOND)


def test_a_phone_held_sideways_shows_the_figure(studio):
    studio.page.set_viewport_size({"width": 844, "height": 390})
    studio.wait("document.querySelector('.composer').getBoundingClientRect().height < 0.4 * innerHeight")
    assert studio.run("document.querySelector('#open-settings').getClientRects().length") == 1


def test_keys_alone_are_enough(studio):
    press = studio.page.keyboard.press
    press("Tab")
    reached = []
    for _ in range(40):
        reached.append(studio.run("document.activeElement.id || document.activeElement.className"))
        press("Tab")
    for wanted in ("go", "seconds", "seed", "add-prompt", "moveset-player", "mv-button mv-play"):
        assert wanted in reached, reached
    assert (
        reached.index("go") < reached.index("seconds") < reached.index("add-prompt") < reached.index("moveset-player")
    )
    # Radio groups have one stop and move by arrows.
    studio.run("document.querySelector('#mode-clip').focus()")
    press("ArrowRight")
    assert studio.run("document.body.dataset.mode") == "live"
    studio.run("document.activeElement.blur()")
    press("1")
    assert studio.run("document.body.dataset.mode") == "clip"
    press("/")
    assert studio.run("document.activeElement.id") == "prompt"
    # Letters belong to the sentence while somebody writes.
    studio.page.keyboard.type("2d")
    assert studio.run("[document.body.dataset.mode, document.querySelector('#prompt').value]") == ["clip", "2d"]
    studio.run("document.activeElement.blur()")
    press("?")
    assert studio.run("document.querySelector('#help').open")
    assert studio.run("document.querySelectorAll('#keys dt').length") > 10
    press("Escape")
    assert not studio.run("document.querySelector('#help').open")
    # And single keys can be switched off.
    studio.run("document.querySelector('#single-keys').click()")
    press("2")
    assert studio.run("document.body.dataset.mode") == "clip"
    studio.run("document.querySelector('#single-keys').click()")


def test_keys_of_the_page_are_heard_in_the_player_too(studio):
    def press(selector, key):
        studio.run("selector => document.querySelector(selector).focus()", selector)
        studio.page.keyboard.press(key)

    for selector in (".moveset-player", ".mv-play", ".mv-scrub input"):
        for key, mode in (("2", "live"), ("1", "clip")):
            press(selector, key)
            assert studio.run("document.body.dataset.mode") == mode, selector
    # What the player has done is not done again, and a button is pressed once.
    for theme in ("dark", None):
        press(".moveset-player", "d")
        assert studio.run("document.documentElement.dataset.theme") == theme
    for key, playing in (("Space", True), ("Enter", False)):
        press(".mv-play", key)
        assert studio.run("__moveset.player.playing") == playing


def test_help_is_closed_by_a_press_beside_it_alone(studio):
    studio.click("#open-help")
    left, top = studio.run("(({ left, top }) => [left, top])(document.querySelector('#help').getBoundingClientRect())")
    studio.page.mouse.click(left + 8, top + 8)
    assert studio.run("document.querySelector('#help').open")
    studio.page.mouse.click(left - 8, top + 8)
    assert not studio.run("document.querySelector('#help').open")


def test_prompts_are_removed_by_touch(browser, studio):
    context = browser.new_context(viewport=NARROW, is_mobile=True, has_touch=True, reduced_motion="reduce")
    page = context.new_page()
    page.goto(studio.address)
    entries = [{"text": text, "seconds": 3, "made": None} for text in ("a person walks forward", "a person bows")]
    page.evaluate("entries => __moveset.clip.restore(entries)", entries)
    seen = page.evaluate("getComputedStyle(document.querySelector('.remove')).opacity")
    context.close()
    assert seen == "1"


def test_everything_has_a_name(studio):
    nameless = studio.run(
        "[...document.querySelectorAll('button, input, select, textarea, [role=slider], [role=dialog], dialog')]"
        ".filter(one => !(one.getAttribute('aria-label') || one.textContent.trim() || one.labels?.length"
        " || document.getElementById(one.getAttribute('aria-labelledby'))?.textContent))"
        ".map(one => one.outerHTML.slice(0, 120))"
    )
    assert nameless == []
    assert studio.run("document.querySelector('#status').getAttribute('aria-live')") == "polite"
    studio.make("a person bows")
    assert "seed" in studio.words("#status")


def test_suggestions_are_those_of_the_modes_model(studio):
    def chips():
        return studio.run("Array.from(document.querySelectorAll('.chip'), (chip) => chip.textContent)")

    def known(model):
        with urllib.request.urlopen(f"{studio.address}/v1/prompts?model={model}") as answer:
            return json.load(answer)["prompts"]

    clips, streams = known("motionpcm-small"), known("rdm-small")
    assert clips != streams
    for mode, wanted in (("live", streams), ("clip", clips)):
        studio.click(f"#mode-{mode}")
        studio.wait(f"document.querySelectorAll('.chip').length === {len(wanted)}")
        assert chips() == wanted


def test_suggestions_that_come_late_are_not_those_of_another_mode(studio):
    clips = studio.run("Array.from(document.querySelectorAll('.chip'), (chip) => chip.textContent)")
    held = []
    studio.page.route("**/v1/prompts?model=rdm-small", lambda route: held.append(route))
    studio.click("#mode-live")
    while not held:
        studio.page.wait_for_timeout(20)
    studio.click("#mode-clip")
    with studio.page.expect_response("**/v1/prompts?model=rdm-small"):
        held[0].continue_()
    studio.page.unroute("**/v1/prompts?model=rdm-small")
    studio.page.wait_for_timeout(200)
    assert studio.run("Array.from(document.querySelectorAll('.chip'), (chip) => chip.textContent)") == clips
    # Of another model there are others.
    with studio.page.expect_request("**/v1/prompts?model=motionpcm-small"):
        studio.run("document.querySelector('#clip-model').dispatchEvent(new Event('change'))")


def test_a_server_that_is_gone_is_told_when_suggestions_are_asked_for(studio):
    studio.expected.append("net::ERR_FAILED")
    studio.page.route("**/v1/prompts?*", lambda route: route.abort())
    studio.click("#mode-live")
    studio.wait("!document.querySelector('#gone').hidden")
    studio.page.unroute("**/v1/prompts?*")
    studio.click("#reconnect")
    studio.wait("document.querySelector('#gone').hidden")
    assert studio.run("document.body.dataset.mode") == "live"


def test_keys_open_no_mode_that_the_server_has_no_model_for(studio):
    studio.run("document.querySelector('#mode-live').disabled = true; document.activeElement.blur()")
    studio.page.keyboard.press("2")
    studio.run("document.querySelector('#mode-live').disabled = false")
    assert studio.run("document.body.dataset.mode") == "clip"


def test_the_page_works_where_the_browser_remembers_nothing(studio):
    page = studio.context.new_page()
    faults = []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.add_init_script(
        "Object.defineProperty(window, 'localStorage', { get() { throw new DOMException('no', 'SecurityError') } })"
    )
    page.goto(studio.address)
    page.wait_for_timeout(300)
    page.locator("#open-theme").dispatch_event("click")
    theme = page.evaluate("[document.documentElement.dataset.theme, typeof __moveset]")
    page.close()
    assert (theme, faults) == (["dark", "object"], [])


def test_a_suggestion_is_one_press_away(studio):
    text = studio.words(".chip")
    studio.click(".chip")
    studio.wait(f"__moveset.stage.shown.title === {json.dumps(text)}")


def test_far_from_known_is_said_gently(studio):
    studio.make("the quarterly budget of a submarine orchestra")
    assert not studio.run("document.querySelector('#notice').hidden")
    assert "submarine" in studio.words("#notice")
    assert studio.run("document.querySelectorAll('.toast').length") == 0
    studio.make("x" * 512)
    assert (
        studio.run("(({ scrollWidth, clientWidth }) => scrollWidth - clientWidth)(document.querySelector('#notice'))")
        == 0
    )
    studio.make("a person walks forward")
    assert studio.run("document.querySelector('#notice').hidden")


def test_faults_are_told_in_the_servers_words(studio):
    studio.expected.append("the server responded with a status of 400")
    studio.run("(() => { const box = document.querySelector('#seconds'); box.value = 33;"
               " box.dispatchEvent(new Event('change')) })()")  # fmt: skip
    before = studio.run("__moveset.recent.added")
    studio.say("a person walks forward")
    studio.wait("document.querySelector('.toast.fault')")
    assert "33" in studio.words(".toast.fault p")
    assert studio.run("__moveset.recent.added") == before


def test_a_lost_server_is_told_and_found_again(studio):
    studio.expected.append("net::ERR_FAILED")
    studio.page.route("**/v1/generate", lambda route: route.abort())
    studio.say("a person walks forward")
    studio.wait("!document.querySelector('#gone').hidden")
    assert "moveset serve" in studio.words("#gone-text")
    studio.page.unroute("**/v1/generate")
    studio.click("#reconnect")
    studio.wait("document.querySelector('#gone').hidden && document.body.dataset.phase === 'shown'")
    # A download is tried again, too, and its success is an answer.
    studio.page.route("**/v1/export?*", lambda route: route.abort())
    studio.click("#open-downloads")
    studio.click("[data-format=bvh]")
    studio.wait("!document.querySelector('#gone').hidden")
    studio.page.unroute("**/v1/export?*")
    with studio.page.expect_download():
        studio.click("#reconnect")
    studio.wait("document.querySelector('#gone').hidden")
    # What failed in one mode is not tried again in the other.
    studio.page.route("**/v1/generate", lambda route: route.abort())
    studio.say("a person bows")
    studio.wait("!document.querySelector('#gone').hidden")
    studio.page.unroute("**/v1/generate")
    studio.click("#mode-live")
    studio.wait("document.querySelector('#gone').hidden")
