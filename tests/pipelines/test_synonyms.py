"""Everyday words that a model does not know, read as ones that it does: in the same form, and of no others."""

import pytest
import torch

from moveset import MotionStream, TextToMotion
from moveset.data import phrases
from moveset.data.captions import heldout_captions, mirror_text, train_captions
from moveset.pipelines.bundle import Bundle
from moveset.pipelines.stream_bundle import StreamBundle
from moveset.pipelines.synonyms import _table, as_written, in_known_words
from moveset.text.familiarity import KnownPrompts
from moveset.text.vocabulary import unread

SHIPPED = {"motionpcm-small": Bundle, "rdm-small": StreamBundle}


def known(*words):
    return KnownPrompts(("a person walks",), torch.ones(1, 2), frozenset(words))


@pytest.fixture(params=SHIPPED, scope="module")
def shipped(request):
    """What a shipped model was trained on."""
    return SHIPPED[request.param].find(request.param).captions


def test_every_word_is_new_to_the_shipped_models_and_all_it_is_read_as_is_known(shipped):
    for word, (by, *_) in _table().items():
        assert unread(word, shipped.words), word
        assert not unread(by, shipped.words), by


@pytest.mark.parametrize(
    ("sentence", "text"),
    [
        ("A man saunters along.", "A man strolls along."),
        ("Sauntering, then veering  leftward!", "Strolling, then turning  left!"),
        ("she fled; he wanders (slowly)", "she ran away; he walks around (slowly)"),
        ("grandma's opponents sprang up", "grandmother's enemies leaped up"),
        ("a person plodded on, hurrying at last", "a person trudged on, walking fast at last"),
        ("Ogres, pensioners and an infant", "Giants, old people and a baby"),
        ("wandering around, he flees away", "walking around, he runs away"),
        ("a rightward step, at a slant", "a right step, at an angle"),
        ("he rounds a sharp corner, round it", "he walks around a sharp corner, round it"),
        ("a drained man meets a jovial one", "an exhausted man meets a happy one"),
        ("he walks in, saunters to her, hurries away", "he walks in, strolls to her, walks fast away"),
        ("a man that trots, no one. March!", "a man that jogs, no one. Walk!"),
        ("they slowly retreat, then travelled on", "they slowly back away, then went on"),
        ("throws a jab, a marching man", "throws a punch, a walking man"),
        ("he bolts ahead, charging toward the door", "he sprints ahead, sprinting toward the door"),
        ("doing Latin dance moves", "doing Salsa dance moves"),
        ("he turns clockwise, sneaking off", "he turns to the right, walking slowly off"),
        ("turned anticlockwise, she walks clockwise", "turned to the left, she walks turning right"),
        ("he approached the door, entering a room", "he walked toward the door, walking into a room"),
        ("runs in a counter-clockwise circle", "runs in a left circle"),
        ("rotates ninety degrees clockwise", "rotates ninety degrees to the right"),
    ],
)
def test_a_word_keeps_its_form_and_everything_else_its_place(shipped, sentence, text):
    assert in_known_words(sentence, shipped).text == text


@pytest.mark.parametrize(
    "sentence",
    [
        "a fully charged punch", "is charged with energy", "stands as if bolted to the floor", "charges up a punch",
        "the camera zooms in on a man", "walks with rounded shoulders", "rounds his back", "three rounds of boxing",
        "walks in early spring", "like a lightning bolt", "runs without hurry", "a full retreat", "space travel",
        "advanced karate moves", "advances its left foot", "a Latin man", "takes a few hurried steps", "hurry up",
        "drained his glass", "it annoyed him", "creeps on hands and knees", "gulps for air",
        "the approach", "approaches from behind", "enters quickly", "moves both arms clockwise",
        "turns counter clockwise", "turns clockwise to the right",
        "sneaks a quick look", "", " ", "?",
    ],
)  # fmt: skip
def test_what_may_mean_another_motion_is_told_as_it_is(shipped, sentence):
    assert in_known_words(sentence, shipped).text == sentence


@pytest.mark.parametrize(
    ("sentence", "text"),
    [
        ("a person stops walking", "a person stands still"),
        ("Stop running!", "Stand still!"),
        ("he stopped jogging and waves", "he stood still and waves"),
        ("walks, then comes to a sudden halt", "walks, then stands still"),
        ("stops moving his arms", "stops moving his arms"),
        ("a person stops", "a person stops"),
        ("stops walking the dog", "stops walking the dog"),
    ],
)
def test_who_stops_walking_stands_still_where_that_is_known(sentence, text):
    streams, clips = (SHIPPED[name].find(name).captions for name in ("rdm-small", "motionpcm-small"))
    read = in_known_words(sentence, streams)
    assert read.text == text
    assert bool(read.replaced) == (text != sentence)
    assert in_known_words(sentence, clips).text == sentence
    told = KnownPrompts(("he stops walking",), torch.ones(1, 2), frozenset({"stands", "still", "walking", "stops"}))
    assert in_known_words(sentence, told).text == sentence


def test_what_was_read_as_what_is_told_once_each(shipped):
    read = in_known_words("He trots, Trots, and jabs", shipped)
    assert read.text == "He jogs, Jogs, and punches"
    assert read.replaced == (("trots", "jogs"), ("jabs", "punches"))
    assert in_known_words(read.text, shipped).replaced == ()
    twice = in_known_words("wanders, then wanders around", shipped).replaced
    assert twice == (("wanders", "walks around"), ("wanders", "walks"))


def test_only_words_that_are_new_are_read_as_ones_that_are_known():
    sentence = "a man saunters"
    assert in_known_words(sentence, known("strolling")).text == "a man strolls"
    assert in_known_words(sentence, known("strolling", "saunter")).text == sentence
    assert in_known_words(sentence, known("walks")).text == sentence
    assert in_known_words(sentence, known()).text == sentence


def test_what_training_captions_say_is_told_as_it_is(shipped):
    for content in phrases.TRAIN:
        for style in (None, "elderly", "giant"):
            for caption in train_captions(content, style):
                assert in_known_words(caption, shipped).text == caption


def test_left_and_right_are_read_alike(shipped):
    for content in phrases.TRAIN:
        for sentence in heldout_captions(content):
            mirrored = in_known_words(mirror_text(sentence), shipped).text
            assert mirrored == mirror_text(in_known_words(sentence, shipped).text)
    for sentence in ("turns clockwise", "walks around counterclockwise", "runs in a clockwise loop"):
        read = in_known_words(sentence, shipped).text
        assert "right" in read or "left" in read
        assert in_known_words(mirror_text(sentence), shipped).text == mirror_text(read)


def test_a_clip_of_another_word_is_the_clip_of_the_known_one():
    t2m = TextToMotion.from_pretrained(device="cpu")
    said, meant = (t2m(f"a man {verb} forward", seconds=2.0, seed=3) for verb in ("saunters", "strolls"))
    assert torch.equal(said.motion.joints, meant.motion.joints)
    assert said.prompts == ("a man saunters forward",)
    assert said.warnings == ("words that this model was never trained on are read as others: 'saunters' as 'strolls'",)
    assert not meant.warnings
    as_written(t2m.bundle)
    alone = t2m("a man saunters forward", seconds=2.0, seed=3)
    assert not torch.equal(alone.motion.joints, meant.motion.joints)
    assert not alone.warnings


def test_a_stream_of_another_word_is_the_stream_of_the_known_one():
    prompts = ("a man trots forward", "a man jogs forward")
    said, meant = (MotionStream.from_pretrained(prompt=prompt, seed=3, device="cpu") for prompt in prompts)
    assert torch.equal(next(said).motion.joints, next(meant).motion.joints)
    assert said.warnings == ("words that this model was never trained on are read as others: 'trots' as 'jogs'",)
