"""Clips in the studio: a sentence, a timeline, several takes, and files to take home."""

import base64
import io
import json
import urllib.request

import numpy as np
import pytest
from PIL import Image

import moveset
from moveset.io.packets import unpack_packets
from moveset.motion.kinematics import fk

POSITIONS = "frames => frames.map(frame => Array.from(__moveset.player.jointPositions(frame, 0)))"


def positions(motion):
    """(F, J, 3) joint positions of a motion."""
    return fk(motion.rotations, motion.root, motion.skeleton)[1].numpy()


def drawn(studio, frames):
    """(n, J, 3) joint positions as the page draws them."""
    return np.array(studio.run(POSITIONS, frames), dtype=np.float64).reshape(len(frames), -1, 3)


def picture(studio):
    """(H, W, 3) what the stage shows above the dock, once the camera has come to rest."""
    top = studio.run("document.querySelector('.dock').getBoundingClientRect().top")
    clip = {"x": 0, "y": 60, "width": 760, "height": top - 60}
    last = None
    for _ in range(40):
        now = np.asarray(Image.open(io.BytesIO(studio.page.screenshot(clip=clip))).convert("RGB"), dtype=int)
        if last is not None and np.array_equal(now, last):
            return now
        last = now
    raise AssertionError("the picture of a motion that stands still goes on changing")


def shown(studio):
    """The first take on the stage: frames, seed, prompts."""
    return studio.run(
        "(() => { const one = __moveset.stage.shown.takes[0];"
        " return { frames: one.take.frames, seed: one.seed, prompts: one.prompts } })()"
    )


def generate(address, **body):
    """What the server answers to the same wish."""
    request = urllib.request.Request(
        f"{address}/v1/generate", json.dumps(body).encode(), {"Content-Type": "application/json"}
    )
    with urllib.request.urlopen(request, timeout=60) as answer:
        return json.load(answer)


def test_a_sentence_moves_the_character_as_the_server_says(studio):
    before = studio.run("__moveset.recent.added")
    studio.say("a person waves with both hands")
    studio.wait(f"__moveset.recent.added > {before}")
    begun = studio.run("__moveset.player.frame")
    studio.wait(f"__moveset.player.playing && __moveset.player.frame !== {begun}")
    studio.run("__moveset.player.pause()")
    take = shown(studio)
    same = generate(
        studio.address, prompts=[{"text": "a person waves with both hands"}], steps=1, seed=take["seed"], num=1
    )
    motion = unpack_packets(base64.b64decode(same["takes"][0]["data"])).motion
    assert take["frames"] == len(motion.root)
    frames = [0, 7, take["frames"] // 2, take["frames"] - 1]
    assert np.abs(drawn(studio, frames) - positions(motion)[frames]).max() < 1e-3
    # Another moment is another picture, by far more than the noise of drawing it.
    pictures = []
    for frame in (0, 20, 20):
        studio.run("frame => __moveset.player.seek(frame)", frame)
        pictures.append(picture(studio))
    moved, noise = (np.count_nonzero(np.abs(a - pictures[1]).max(-1) > 40) for a in (pictures[0], pictures[2]))
    assert moved > 300
    assert noise < moved / 10
    assert "seed" in studio.words("#made")


def test_scrubbing_shows_the_moment(studio):
    studio.make("a person walks forward")
    slider = "document.querySelector('.mv-bar input[type=range]')"
    studio.wait(f"{slider}.max > 1.5")  # the bar is as long as the take from the next picture on
    studio.run(f"(() => {{ {slider}.value = 1.5; {slider}.dispatchEvent(new Event('input')) }})()")
    assert studio.run("__moveset.player.frame") == pytest.approx(30, abs=0.1)
    # Keys work from the page as well, as long as nobody writes.
    studio.run("document.activeElement.blur()")
    studio.page.keyboard.press("ArrowRight")
    assert studio.run("__moveset.player.frame") == pytest.approx(31, abs=0.1)
    studio.run("__moveset.player.toggle('contacts')")
    assert studio.run("__moveset.player.overlays.contacts")


def test_a_timeline_is_lined_up_dragged_and_made(studio):
    studio.say("a person walks forward", "Control+Enter")
    studio.make("a person waves with the left hand")
    kept = studio.run("__moveset.recent.added")
    assert [prompt["text"] for prompt in shown(studio)["prompts"]] == [
        "a person walks forward", "a person waves with the left hand",
    ]  # fmt: skip
    seed = shown(studio)["seed"]
    # By pointer: the first edge, half its block to the left.
    box = studio.run(
        "(() => { const edge = document.querySelector('[data-handle=\"0\"]').getBoundingClientRect();"
        " const block = document.querySelector('.timeline .block').getBoundingClientRect();"
        " return { x: edge.left + edge.width / 2, y: edge.top + 20, width: block.width } })()"
    )
    before = studio.run("__moveset.clip.timeline.seconds(__moveset.clip.timeline.entries[0])")
    mouse = studio.page.mouse
    mouse.move(box["x"], box["y"])
    mouse.down()
    mouse.move(box["x"] - box["width"] / 2, box["y"], steps=3)
    mouse.up()
    studio.wait(f"__moveset.recent.added === {kept + 1}")
    seconds = studio.run("__moveset.clip.timeline.entries[0].seconds")
    assert seconds == pytest.approx(before / 2, abs=0.35)
    take = shown(studio)
    assert take["seed"] == seed
    assert take["prompts"][1]["firstFrame"] == pytest.approx(20 * seconds, abs=1)
    # By keys: the second edge. Within the page, so that they come together however busy the machine is: one take.
    studio.run("document.querySelector('[data-handle=\"1\"]').focus()")
    studio.run(
        "(() => { for (const [key, shiftKey] of [['Home', false], ['ArrowRight', true], ['ArrowRight', false]])"
        " document.activeElement.dispatchEvent(new KeyboardEvent('keydown', { key, shiftKey, bubbles: true })) })()"
    )
    assert studio.run("document.activeElement.getAttribute('aria-valuenow')") == "2.1"
    studio.wait(f"__moveset.recent.added === {kept + 2}")
    assert shown(studio)["frames"] == pytest.approx(20 * (seconds + 2.1), abs=2)
    studio.page.keyboard.press("Shift+ArrowRight")
    studio.wait(f"__moveset.recent.added === {kept + 3}")
    assert shown(studio)["frames"] == pytest.approx(20 * (seconds + 3.1), abs=2)
    # And back to one prompt.
    studio.run("document.querySelectorAll('.timeline .words')[1].focus()")
    studio.page.keyboard.press("Delete")
    assert studio.run("document.querySelector('#timeline').hidden")
    assert studio.run("document.activeElement.id") == "prompt"


def test_a_double_click_on_an_edge_leaves_the_length_to_the_model(studio):
    entries = [{"text": text, "seconds": 3, "made": None} for text in ("a person walks forward", "a person bows")]
    studio.run("entries => __moveset.clip.restore(entries)", entries)
    x, y = studio.run(
        "(({ left, top, width }) => [left + width / 2, top + 20])"
        "(document.querySelector('[data-handle=\"0\"]').getBoundingClientRect())"
    )
    studio.page.mouse.dblclick(x, y)
    assert studio.run("__moveset.clip.timeline.entries.map((entry) => entry.seconds)") == [None, 3]


def test_a_block_that_is_chosen_by_a_key_keeps_the_focus(studio):
    entries = [{"text": text, "seconds": 3, "made": None} for text in ("a person walks forward", "a person bows")]
    studio.run("entries => __moveset.clip.restore(entries)", entries)
    studio.run("document.querySelectorAll('.timeline .words')[1].focus()")
    studio.page.keyboard.press("Enter")
    assert studio.run("document.querySelector('#prompt').value") == "a person bows"
    assert studio.run("document.activeElement === document.querySelectorAll('.timeline .words')[1]")


def test_what_is_written_meanwhile_is_no_part_of_what_is_made(studio):
    held = []
    studio.page.route("**/v1/generate", lambda route: held.append(route))
    before = studio.run("__moveset.recent.added")
    studio.say("a person walks forward")
    while not held:
        studio.page.wait_for_timeout(20)
    studio.say("a person", "Control+Enter")
    held[0].continue_()
    studio.wait(f"__moveset.recent.added > {before}")
    studio.page.unroute("**/v1/generate")
    assert studio.run("__moveset.recent.kept[0].entries.map((entry) => entry.text)") == ["a person walks forward"]
    # How long it became is told of the prompt that was made, and of no other.
    assert studio.run("__moveset.clip.timeline.entries.map((entry) => entry.made === null)") == [False, True]


def test_several_seeds_stand_side_by_side(studio):
    studio.click("#takes button:nth-child(3)")
    studio.run("document.querySelector('#seed').value = 11")
    studio.make("a person bows")
    assert studio.run("__moveset.stage.shown.takes.map(take => take.seed)") == [11, 12, 13]
    assert studio.run("[...document.querySelectorAll('.mv-label')].map(one => one.textContent)") == [
        "Seed 11", "Seed 12", "Seed 13",
    ]  # fmt: skip


def test_every_format_is_taken_home_whole(studio, tmp_path):
    studio.run("(() => { const box = document.querySelector('#seconds'); box.value = 1.5;"
               " box.dispatchEvent(new Event('change')) })()")  # fmt: skip
    studio.make("a person waves with both hands")
    frames = shown(studio)["frames"]
    assert frames == 30
    seen = drawn(studio, list(range(frames)))
    studio.click("#open-downloads")
    offered = studio.run("[...document.querySelectorAll('.format')].map(one => one.dataset.format)")
    assert {"bvh", "glb", "gltf", "vrma", "npz", "amass.npz", "mp4", "webm"} <= set(offered)
    # Slow enough for a video of several pictures wherever these are drawn in software.
    studio.run("__moveset.player.speed = 0.5")
    for form in offered:
        with studio.page.expect_download() as download:
            studio.click(f'[data-format="{form}"]')
        path = tmp_path / f"take.{form}"
        download.value.save_as(path)
        assert download.value.suggested_filename.endswith(form)
        if form == "vrma":  # of a VRM character, whose joints have another order
            assert len(moveset.load(path)) == frames
        elif form in ("bvh", "glb", "gltf", "npz", "amass.npz"):
            motion = moveset.load(path)
            assert np.abs(positions(motion) - seen).max() < 1e-3, form
            assert motion.fps == pytest.approx(20, rel=1e-3)
        elif form in ("mp4", "webm"):
            assert video_frames(path) >= (frames if form == "mp4" else 1)
        else:
            assert path.read_text().startswith("<!doctype html>")
        studio.wait(f"""!document.querySelector('[data-format="{form}"]').disabled""")
    # The preset and the frame rate of the panel arrive in the file.
    studio.run("document.querySelector('#skeleton').value = 'mixamo'; document.querySelector('#fps').value = '60'")
    with studio.page.expect_download() as download:
        studio.click("[data-format=bvh]")
    download.value.save_as(tmp_path / "mixamo.bvh")
    motion = moveset.load(tmp_path / "mixamo.bvh")
    assert motion.skeleton.joints[0].endswith("Hips")
    assert motion.fps == pytest.approx(60, rel=1e-3)


def test_a_take_with_many_words_is_taken_home(studio):
    text = ("a person walks forward and waves with the left hand " * 8).strip()
    before = studio.run("__moveset.recent.added")
    studio.run(
        "text => __moveset.clip.restore([{ text, seconds: 1, made: null }, { text, seconds: 1, made: null }])", text
    )
    studio.run("__moveset.clip.submit()")
    studio.wait(f"__moveset.recent.added > {before}")
    assert studio.run("__moveset.stage.shown.title.length") > 512
    studio.click("#open-downloads")
    with studio.page.expect_download() as download:
        studio.click("[data-format=bvh]")
    assert download.value.suggested_filename.startswith("a-person-walks-forward")


def test_of_a_take_that_is_too_long_for_a_file_the_newest_part_is_taken_home(studio, tmp_path):
    frames, root = studio.run("""(() => {
        const { stage } = __moveset;
        const shown = stage.shown.takes[0];
        const take = shown.take.copy();
        const more = () => ({ joints: 22, frames: take.frames, firstFrame: take.frames, fps: take.fps, latencyMs: 0,
                              rows: take.allRows(), contacts: take.allContacts() });
        while (take.frames < 50_000) take.append(more());
        stage.shown = { ...stage.shown, takes: [{ ...shown, take }] };
        return [take.frames, take.root(take.frames - 1)];
    })()""")
    studio.click("#open-downloads")
    for chosen in ("#skeleton", "#fps"):  # as made, whatever was chosen before
        studio.page.select_option(chosen, "")
    with studio.page.expect_download() as download:
        studio.click("[data-format=npz]")
    download.value.save_as(tmp_path / "long.npz")
    motion = moveset.load(tmp_path / "long.npz")
    assert 45_000 < len(motion) < frames
    assert motion.root[-1].tolist() == pytest.approx(root, abs=1e-6)
    studio.wait("document.querySelector('.toast')")
    assert studio.words(".toast p").startswith("Only the last 37:")


def video_frames(path):
    """Frames of a video, as a decoder counts them."""
    import imageio_ffmpeg

    reader = imageio_ffmpeg.read_frames(str(path))
    next(reader)
    return sum(1 for _ in reader)


def test_recent_takes_come_back(studio):
    studio.make("a person walks forward")
    first = shown(studio)
    studio.make("a person sits down")
    assert shown(studio)["frames"] != first["frames"] or shown(studio)["seed"] != first["seed"]
    studio.click("#open-recent")
    studio.click(".shelf li:nth-child(2) button")
    assert shown(studio) == first
    assert studio.run("document.querySelector('#prompt').value") == "a person walks forward"
    # The die and a change of length mean the take that is shown, not the one that was made last.
    studio.click("#pin-seed")
    assert studio.run("document.querySelector('#seed').value") == str(first["seed"])
    kept = studio.run("__moveset.recent.added")
    studio.click("#takes button:nth-child(2)")
    studio.wait(f"__moveset.recent.added > {kept}")
    assert shown(studio)["seed"] == first["seed"]


def test_a_take_that_came_back_is_not_replaced_by_what_was_in_work(studio):
    studio.make("a person walks forward")
    held, kept = [], studio.run("__moveset.recent.added")
    studio.page.route("**/v1/generate", lambda route: held.append(route))
    studio.expected.append("ERR_ABORTED")
    studio.say("a person sits down")
    while not held:
        studio.page.wait_for_timeout(20)
    studio.click("#open-recent")
    studio.click(".shelf li:nth-child(1) button")
    held[0].continue_()
    studio.page.unroute("**/v1/generate")
    studio.page.wait_for_timeout(1000)
    assert studio.run("__moveset.recent.added") == kept
    assert studio.run("__moveset.stage.shown.title") == "a person walks forward"
    assert studio.run("document.body.dataset.phase") == "shown"
