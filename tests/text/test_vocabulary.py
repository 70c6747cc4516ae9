"""Words that a model was never trained on, told from forms of those that it was."""

import json

import pytest

from moveset.pipelines.model_folder import shipped
from moveset.text.vocabulary import denied, figures_of, unread, words_of

WORDS = ("walk", "waves", "carries", "stop", "quick", "left", "hand", "race", "swing", "huge", "kick")


def test_words_of_any_script_and_no_others():
    assert words_of("Somebody’s   two-step, 3×, über_alles (he said: 走)!") == [
        "somebody", "two-step", "über", "alles", "he", "said", "走",
    ]  # fmt: skip
    assert words_of("") == words_of("42 …") == []


@pytest.mark.parametrize("word", ["not", "cannot", "never", "NOT", "nobody"])
def test_what_is_not_done_is_told_by_words_and_no_parts_of_them(word):
    assert denied(f"a person {word} walks") == word
    assert denied(f"a person un{word}ted walks") == ""


def test_figures_are_no_parts_of_words():
    assert figures_of("3 steps, 1,000 m in 2.5 s; 10x") == ["3", "1,000", "2.5", "10"]
    assert figures_of("mp3 take_7 B2") == figures_of("") == []


@pytest.mark.parametrize(
    "form",
    ["walks", "walked", "walking", "walker", "waving", "wave", "carry", "carried", "carrying", "stopped", "stopping",
     "quickly", "racing", "raced", "WALK", "walk's", "left-hand", "left-handed"],
)  # fmt: skip
def test_forms_of_known_words_are_known(form):
    assert unread(f"a person {form}", WORDS) == ()


@pytest.mark.parametrize("word", ["hug", "rack", "wing", "king", "leftover", "handful", "kickboxes", "waver-x", "sto"])
def test_other_words_are_not(word):
    assert unread(f"a person {word}", WORDS) == (word,)


def test_each_word_once_in_their_order_and_without_grammar():
    said = "The man, who is tired, climbs up a ladder and then climbs down the same ladder"
    assert unread(said, WORDS) == ("tired", "climbs", "ladder")
    assert unread(said, ()) == ()  # what the model was trained on was not written down


@pytest.mark.parametrize("name", ["motionpcm-small", "rdm-small"])
def test_shipped_models_know_their_captions_and_not_everything(name):
    stored = json.loads((shipped()[name] / "prompts.json").read_text())
    words = frozenset(stored["words"])
    assert not {word for caption in stored["captions"] for word in unread(caption, words)}
    assert unread("a person does a cartwheel on a skateboard and knits", words) == ("skateboard", "knits")
