"""Turns that a model was never told of: what sentences mean by them, and where the motions that are made end."""

import itertools
import math

import pytest
import torch

from moveset import MotionStream, TextToMotion
from moveset.data import phrases
from moveset.data.captions import heldout_captions, mirror_text, train_captions
from moveset.motion import rotations
from moveset.motion.corners import Corners, FigureEight
from moveset.motion.steering import Circle, During, Stay, Turn
from moveset.pipelines.bundle import Bundle
from moveset.pipelines.reading import read
from moveset.pipelines.said_turns import plain_turn
from moveset.pipelines.said_ways import ZIGZAG
from moveset.pipelines.stream_group import StreamGroup
from moveset.pipelines.stream_settings import check_stream
from moveset.pipelines.synonyms import as_written
from moveset.text.familiarity import KnownPrompts

THERE_AND_BACK = Corners(1, math.pi, 2, 3.0)


@pytest.fixture(scope="module")
def shipped():
    """What the shipped clips were trained on; streams share the captions that count here."""
    return Bundle.find("motionpcm-small").captions


def known(*sentences, words=("walks", "turns")):
    return KnownPrompts(sentences or ("a person walks",), torch.ones(max(len(sentences), 1), 2), frozenset(words))


def turn(degrees):
    return Turn(math.radians(degrees))


@pytest.mark.parametrize(
    ("sentence", "text", "steering"),
    [
        ("a person walks in a circle", "a person walks", Circle(1)),
        ("A man walks around in a big circle to the right.", "A man walks.", Circle(-1, radius=2.5)),
        ("he walks clockwise in a circle, waving", "he walks, waving", Circle(-1)),
        ("jogging in a slow counter-clockwise circle", "jogging", Circle(1)),
        ("she runs in circles", "she runs", Circle(1, once=False)),
        ("a man saunters in tight circles", "a man strolls", Circle(1, once=False, radius=0.8)),
        ("he walked a full circle turning right", "he walked", Circle(-1)),
        ("bows, then walks in a circle, then waves", "bows, then walks, then waves", Circle(1)),
        ("a person turns around", "a person turns to the left", turn(180)),
        ("Turn around to the right!", "Turn to the right!", turn(-180)),
        ("walks, turns around and walks back", "walks, turns to the left and walks", turn(180)),
        ("turned round clockwise, waves back and forth", "turned to the right, waves back and forth", turn(-180)),
        ("he makes a U-turn", "he turns to the left", turn(180)),
        ("doing an about-face to the right", "turning to the right", turn(-180)),
        ("takes a quarter turn to the right", "turns to the right", turn(-90)),
        ("she turns 45 degrees to the right", "she turns to the right", turn(-45)),
        ("turns left by 270° while waving", "turns to the left while waving", turn(270)),
        ("rotates ninety degrees clockwise", "turns to the right", turn(-90)),
        ("made a 90-degree left turn", "turned to the left", turn(90)),
        ("take a 120 degree turn to the right", "turn to the right", turn(-120)),
        ("turns three hundred and sixty degrees", "turns to the left", turn(360)),
        (
            "a man walks a little, then heads off to the right",
            "a man walks a little, then turns to the right",
            turn(-90),
        ),
        ("Head left!", "Turn to the left!", turn(90)),
        ("walks around the room in circles", "walks around the room", Circle(1, once=False)),
        ("he walks slowly and proudly in a circle", "he walks slowly and proudly", Circle(1)),
        ("a person jogs in place", "a person jogs", Stay()),
        ("marching on the spot, she waves", "walking, she waves", Stay()),
        ("a person walks back and forth", "a person walks", THERE_AND_BACK),
        ("he paces to and fro", "he paces", THERE_AND_BACK),
        ("runs up and down the corridor to the right", "runs", Corners(-1, math.pi, 2, 3.0)),
        ("a person walks in a square", "a person walks", Corners(1, math.pi / 2, 4)),
        ("walks in a small square shape to the right", "walks", Corners(-1, math.pi / 2, 4, 1.5 * 0.8)),
        ("jogging in a triangle clockwise", "jogging", Corners(-1, 2 * math.pi / 3, 3)),
        ("a person runs in a zigzag", "a person runs", ZIGZAG),
        ("walks in a zig-zag pattern", "walks", ZIGZAG),
        ("he walks in an S shape", "he walks", ZIGZAG),
        ("a person zigzags", "a person walks", ZIGZAG),
        ("Zigzag!", "Walk!", ZIGZAG),
        ("walks in a figure eight", "walks", FigureEight(1)),
        ("she walked a big figure of 8 to the right", "she walked", FigureEight(-1, 2.5)),
        (
            "walks forward, then walks in a circle",
            "walks forward, then walks",
            During(Circle(1), 0.5, 1.0),
        ),
        ("runs back and forth, then jogs", "runs, then jogs", During(THERE_AND_BACK, 0.0, 0.5)),
        ("jogs, then waves, then jogs in place", "jogs, then waves, then jogs", During(Stay(), 0.5, 1.0)),
    ],
)
def test_the_turn_is_taken_out_of_the_sentence(shipped, sentence, text, steering):
    reading = read(sentence, shipped)
    assert reading.text == text
    [bend] = reading.bent
    assert bend.steering == steering
    assert bend.said in sentence
    assert not read(text, shipped).bent


@pytest.mark.parametrize(
    "sentence",
    [
        "waves both arms in circles", "walks while drawing a circle with the left hand", "sits in a circle of friends",
        "walks and swings the arms in big circles", "a person walks, moving the head in a circle", "a circle",
        "turns around the corner", "turns the wheel around", "turns around and around", "turns a page around",
        "turns 0 degrees", "turns 900 degrees", "turns to the left", "turns 3 times", "stands in a full circle",
        "turns the head left", "his head turns left", "nods the head to the left", "heads toward the door",
        "raises the left arm by 90 degrees", "makes a left turn", "walks back", "spins the wheel around",
        "puts it in place", "jumps in place", "turns around himself", "turns around three times", "turns around again",
        "moves the ball in a circle", "runs a finger in circles", "walks to a chair and puts it in place",
        "dances on the spot", "walks and moves the arms in place", "", " ", "?", "sways back and forth",
        "moves the arm back and forth", "walks up and down the stairs", "a zigzag", "draws a square",
        "sits in a square", "walks to the square", "walks around the square of the town",
        "swings the arm in a figure eight",
    ],
)  # fmt: skip
def test_what_is_another_turn_or_none_is_told_as_it_is(shipped, sentence):
    reading = read(sentence, shipped)
    assert (reading.text, reading.bent) == (sentence, ())


def test_captions_keep_their_turns(shipped):
    for content in phrases.TRAIN:
        for caption in train_captions(content, None):
            never = "forth" in caption  # of which no take was kept
            assert bool(read(caption, shipped).bent) == never, caption
        for caption in heldout_captions(content):
            assert bool(read(caption, shipped).bent) == (" off to the " in caption), caption


def test_the_mirrored_sentence_is_bent_to_the_other_side(shipped):
    for sentence in (
        "walks in a circle to the left", "turns 90 degrees to the right", "turns left by 30 degrees",
        "makes a 45 degree right turn", "runs clockwise in a big circle", "turns around counterclockwise",
    ):  # fmt: skip
        one, other = read(sentence, shipped), read(mirror_text(sentence), shipped)
        assert other.text == mirror_text(one.text)
        [bend], [bent] = one.bent, other.bent
        assert bend.steering.says.replace("left", "right") == bent.steering.says.replace("left", "right")
        assert bend.steering != bent.steering


@pytest.mark.parametrize(
    ("sentence", "caption"),
    [
        ("walks in a circle", "someone walked in circles"),
        ("he turns around", "a person turns around and waves"),
        ("turns 90 degrees", "a person turns 180 degrees"),
        ("makes a u-turn", "a man made a U-turn"),
    ],
)
def test_a_model_that_was_told_of_such_turns_is_told_of_them(sentence, caption):
    assert read(sentence, known()).bent
    assert read(sentence, known("a person walks", caption)).text == sentence
    assert read(sentence, known(words=())).text == sentence  # nobody knows what it was told


def headings(motions):
    """Degrees, to the left, from the first to the last frame of motions that follow one another."""
    heading = rotations.heading_angle(torch.cat([m.rotations[:, 0] for m in motions]).double())
    return math.degrees(float((torch.remainder(heading.diff() + math.pi, 2 * math.pi) - math.pi).sum()))


@pytest.fixture(scope="module")
def t2m():
    return TextToMotion.from_pretrained(device="cpu")


def test_clips_end_at_their_angle_and_say_so(t2m):
    prompts = ["a person turns around", "a person turns 45 degrees to the right", "a man walks in a circle"]
    for prompt, degrees in zip(prompts, (180, -45, 360), strict=True):
        made = t2m(prompt, seed=4, seconds=5.0)
        assert headings([made.motion]) == pytest.approx(degrees, abs=15)
        [warning] = made.warnings
        assert warning.startswith(f"this model was never trained on {prompt.split(' ', 2)[2].removeprefix('walks ')!r}")
    root = made.motion.root[:, [0, 2]]
    assert (root[-1] - root[0]).norm() < 0.1 * root.diff(dim=0).norm(dim=1).sum()


def test_who_is_told_to_stay_steps_on_the_spot(t2m):
    made = t2m("a person jogs in place", seed=4, seconds=5.0)
    assert (made.motion.root[:, [0, 2]] == 0).all()
    assert made.motion.joints[:, made.motion.skeleton.index("left_ankle"), 1].std() > 0.03
    assert made.warnings == ("this model was never trained on 'in place': feet step on the spot",)
    stream = MotionStream.from_pretrained(prompt="a person walks on the spot", seed=5, device="cpu")
    way = torch.cat([next(stream).motion.root for _ in range(6)])[:, [0, 2]]
    assert float(way.norm(dim=1).max()) < 0.3  # a body that stands drifts as much


def test_each_clip_of_a_batch_is_bent_as_its_own_prompt_says(t2m):
    timeline = t2m(["a person walks", "a person walks in a circle", "a person walks"], seed=4, seconds=5.0, batch=3)
    apart = [t2m.bundle.config.fps * k * 5.0 for k in range(4)]
    parts = [timeline.motion[int(a) : int(b)] for a, b in itertools.pairwise(apart)]
    turned = [headings([part]) for part in parts]
    assert turned == pytest.approx([0, 355, 0], abs=25)


def test_networks_that_are_judged_are_told_what_is_written():
    t2m = TextToMotion.from_pretrained(device="cpu")
    as_written(t2m.bundle)
    made = t2m("a person walks in a circle", seed=4, seconds=5.0)
    assert abs(headings([made.motion])) < 90
    assert not made.warnings


def test_a_stream_turns_around_and_its_mirror_image_to_the_other_side():
    for side, degrees in (("left", 180), ("right", -180)):
        stream = MotionStream.from_pretrained(prompt=f"a person turns around to the {side}", seed=5, device="cpu")
        assert headings([next(stream).motion for _ in range(9)]) == pytest.approx(degrees, abs=35)


def test_a_stream_goes_back_and_forth():
    stream = MotionStream.from_pretrained(prompt="a person walks back and forth", seed=5, device="cpu")
    motions = [next(stream).motion for _ in range(16)]
    assert headings(motions) > 500.0  # three times around, and on
    root = torch.cat([motion.root for motion in motions])[:, [0, 2]]
    assert float((root - root[0]).norm(dim=1).max()) < 7.0  # of a way of 27 m


def test_a_stream_goes_in_circles_until_it_is_told_otherwise():
    stream = MotionStream.from_pretrained(prompt="a person walks in a circle", seed=5, device="cpu")
    round_and_round = headings([next(stream).motion for _ in range(8)])
    assert 300 < round_and_round < 650  # 13 m at a radius of 1.5 m
    stream.prompt("a person walks")
    next(stream)
    assert abs(headings([next(stream).motion for _ in range(8)])) < 60
    assert "in a circle" in MotionStream.from_pretrained(prompt="a person walks in a circle", device="cpu").warnings[0]


@pytest.mark.parametrize(
    ("sentence", "side"),
    [
        ("a person turns left", 1), ("walks and turns to the right", -1), ("turning to their left, waves", 1),
        ("go left", 1), ("goes right ahead", 0), ("goes right through the door", 0),
        ("a man takes a right turn", -1), ("she made a left", 1), ("veers right", -1),
        ("turns to the left hand", 0), ("keeps turning left", 0), ("turns left again and again", 0),
        ("turns left, then turns right", 0), ("turns", 0), ("waves with the left hand", 0), ("turns the page left", 0),
    ],
)  # fmt: skip
def test_plain_turns_are_those_that_name_a_side_once(sentence, side):
    turn = plain_turn(sentence, known())
    assert plain_turn(sentence, known(words=())) is None
    assert plain_turn(sentence, known("he turns around")) is None
    assert (0 if turn is None else math.copysign(1, turn.angle)) == side


def test_plain_turns_of_streams_end_at_those_of_takes():
    """Unbent, these end at -96 to -218 degrees, takes at -91."""
    for seed in range(3):
        stream = MotionStream.from_pretrained(prompt="a person turns right", seed=seed, device="cpu")
        assert headings([next(stream).motion for _ in range(10)]) == pytest.approx(-90, abs=12)
        assert not stream.warnings


@pytest.mark.parametrize(
    "prompt",
    [
        "a person walks in a circle", "a person turns around", "walks, then turns around",
        "walks back and forth", "runs in a zigzag",
    ],
)  # fmt: skip
def test_a_stream_that_is_restored_or_grouped_is_bent_as_it_is_alone(bundle, encoder, prompt):
    def opened():
        request = check_stream(bundle.config, prompt, seed=3, network="pcm-1")
        return MotionStream(bundle, request, device="cpu", encoder=encoder)

    alone = opened()
    want = [next(alone).motion.joints for _ in range(5)]
    first = opened()
    next(first), next(first)
    again = opened().restore(first.state())
    assert all(torch.equal(next(again).motion.joints, joints) for joints in want[2:])
    settings = check_stream(bundle.config, network="pcm-1").settings
    group = StreamGroup(bundle, settings, device="cpu", encoder=encoder)
    lane = group.open(prompt, 3)
    for joints in want:
        [piece] = group.advance([lane])
        assert float((piece.segment.motion.joints - joints).norm(dim=-1).max()) < 1e-4
