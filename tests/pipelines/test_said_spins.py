"""Turns on the spot: what sentences mean by them, and where the motions that are made end."""

import math

import pytest
import torch

from moveset import MotionStream, TextToMotion
from moveset.data import phrases
from moveset.data.captions import heldout_captions, mirror_text, train_captions
from moveset.motion import rotations
from moveset.motion.standing import Stand
from moveset.motion.steering import During, Spin, Together
from moveset.pipelines.bundle import Bundle
from moveset.pipelines.reading import read
from moveset.pipelines.stream_bundle import StreamBundle
from moveset.text.familiarity import KnownPrompts

THEN_STANDS = "then waves with the left hand"


@pytest.fixture(scope="module")
def shipped():
    return Bundle.find("motionpcm-small").captions


def spin(degrees):
    return Spin(math.radians(degrees))


@pytest.mark.parametrize(
    ("sentence", "text", "steering"),
    [
        ("a person spins around", f"a person walks slowly, {THEN_STANDS}", spin(360)),
        ("She spins to the right.", f"She walks slowly, {THEN_STANDS}.", spin(-360)),
        ("whirling around clockwise", "walking slowly, then waving with the left hand", spin(-360)),
        ("spins once to the left", f"walks slowly, {THEN_STANDS}", spin(360)),
        ("Spin!", "Walk slowly, then wave with the left hand!", spin(360)),
        ("he spun around twice", "he walked slowly, then waved with the left hand", spin(720)),
        ("a person spins by 180 degrees to the right", f"a person walks slowly, {THEN_STANDS}", spin(-180)),
        ("a person turns left in place", f"a person walks slowly, {THEN_STANDS}", spin(90)),
        ("turns around on the spot", f"walks slowly, {THEN_STANDS}", spin(180)),
        ("rotates 45 degrees to the right in place", f"walks slowly, {THEN_STANDS}", spin(-45)),
    ],
)
def test_who_spins_is_told_to_walk_and_stand(shipped, sentence, text, steering):
    reading = read(sentence, shipped)
    assert reading.text == text
    [bend] = reading.bent
    assert bend.steering == Together((Stand(), steering))
    assert reading.seconds == steering.seconds
    assert not reading.cut


@pytest.mark.parametrize(
    ("sentence", "text", "steering"),
    [
        ("he spins around and bows", "he walks slowly, then bows", spin(360)),
        ("he spins around, then walks on", "he walks slowly, then walks on", During(spin(360), 0.0, 0.5)),
        (
            "he walks forward and spins around, then bows",
            "he walks forward, then walks slowly, then bows",
            During(spin(360), 0.5, 1.0),
        ),
        ("waves, then spins around, then bows", "waves, then walks slowly, then bows", spin(360)),
    ],
)
def test_only_the_turn_is_on_the_spot(shipped, sentence, text, steering):
    reading = read(sentence, shipped)
    assert reading.text == text
    assert [bend.steering for bend in reading.bent] == [steering]


@pytest.mark.parametrize(
    "sentence",
    [
        "spins a ball", "spins the wheel", "spins on tiptoe", "the spin", "a spin", "spins 900 degrees",
        "spins 0 degrees", "turns left", "turns the wheel in place", "he spins while waving",
        "spins around three times", "a person twirls",
    ],
)  # fmt: skip
def test_what_is_something_else_is_told_as_it_is(shipped, sentence):
    assert (read(sentence, shipped).text, read(sentence, shipped).bent) == (sentence, ())


def test_captions_and_models_that_know_it_are_left_alone(shipped):
    for content in phrases.TRAIN:
        for caption in (*train_captions(content, None), *heldout_captions(content)):
            for bend in read(caption, shipped).bent:
                assert not isinstance(bend.steering, Spin | Together), caption

    def known(*sentences, words="walks slowly waves with the left hand"):
        return KnownPrompts(sentences, torch.ones(len(sentences), 2), frozenset(words.split()))

    for sentence in ("he spins around", "he turns in place"):
        assert read(sentence, known("he walks")).bent
        assert read(sentence, known("he walks", words="walks")).text == sentence
    assert read("he spins around", known("he spins")).text == "he spins around"
    assert read("he turns in place", known("he turns around in place")).text == "he turns in place"
    assert read("he spins", known("he walks", words="walks slowly")).text == "he spins"


def test_the_mirrored_sentence_spins_to_the_other_side(shipped):
    for sentence in ("a person spins to the right", "a person turns left in place"):
        [one], [other] = read(sentence, shipped).bent, read(mirror_text(sentence), shipped).bent
        assert one.steering.steering[1].angle == -other.steering.steering[1].angle


def turned(motions):
    heading = rotations.heading_angle(torch.cat([m.rotations[:, 0] for m in motions]).double())
    return math.degrees(float((torch.remainder(heading.diff() + math.pi, 2 * math.pi) - math.pi).sum()))


@pytest.mark.parametrize(("sentence", "degrees"), [("spins around", 360), ("turns right in place", -90)])
def test_clips_turn_on_the_spot_and_stand(sentence, degrees):
    made = TextToMotion.from_pretrained(device="cpu")(f"a person {sentence}", seed=4)
    motion = made.motion
    assert turned([motion]) == pytest.approx(degrees, abs=30)
    assert float((motion.root - motion.root[0])[:, [0, 2]].norm(dim=1).max()) < 0.1
    assert abs(turned([motion[-30:]])) < 10
    assert len(made.warnings) == 1


def test_a_stream_spins_until_it_is_told_otherwise():
    captions = StreamBundle.find("rdm-small").captions
    reading = read("a person spins around", captions)
    assert reading.text == "a person walks slowly"
    assert [bend.steering for bend in reading.bent] == [spin(360)]
    stream = MotionStream.from_pretrained(prompt="a person spins around", seed=5, device="cpu")
    assert turned([next(stream).motion for _ in range(6)]) == pytest.approx(6 * 1.4 * 110, rel=0.15)
    stream.prompt("a person walks")
    next(stream)
    assert abs(turned([next(stream).motion for _ in range(4)])) < 60
