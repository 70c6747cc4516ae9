"""What is said about prompts, by how near they are to the captions and by their words."""

from types import SimpleNamespace

import pytest
import torch

from moveset.pipelines.warnings import too_long, unfamiliar
from moveset.text.familiarity import KnownPrompts

FAR, NEAR = torch.tensor([0.0, 0.0, 1.0]), torch.tensor([0.9, 0.1, 0.0])


def told(
    *prompts: str,
    pooled: torch.Tensor,
    words: frozenset[str],
    captions: tuple[str, str] = ("a person walks", "she bows"),
) -> list[str]:
    known = KnownPrompts(captions, torch.eye(2, 3), words)
    bundle = SimpleNamespace(captions=known, config=SimpleNamespace(far_prompt=0.5))
    return unfamiliar(bundle, prompts, pooled.expand(len(prompts), -1))  # type: ignore[arg-type]


def test_what_is_far_is_told_once_and_what_is_near_by_its_words():
    words = frozenset({"walk", "bow"})
    [far] = told("xyzzy", pooled=FAR, words=words)
    assert far == "'xyzzy' is unlike anything this model was trained on (similarity 0.00); the nearest it knows is " + (
        "'a person walks'"
    )
    one, two = told("a man walks on stilts", "walking", "he juggles five burning torches while riding away",
                    pooled=NEAR, words=words)  # fmt: skip
    assert one == "this model was never trained on the word 'stilts' and guesses what it means; " + (
        "the nearest it knows is 'a person walks'"
    )
    assert "on the words 'juggles', 'five', 'burning', 'torches' … and guesses what they mean" in two


def test_without_a_list_of_words_only_distance_counts():
    assert told("a man walks on stilts", pooled=NEAR, words=frozenset()) == []


@pytest.mark.parametrize(
    ("prompt", "named"),
    [
        ("a person throws a ball", "'throws a ball'"),
        ("throwing the ball, kicks a punch", "'throwing the ball' or 'kicks a punch'"),
        ("a person kicks his ball", ""),
        ("throwing some punches", ""),
        ("a person throws the ball up a tree", None),
    ],
)
def test_known_words_that_no_caption_puts_together_are_told(prompt, named):
    captions = ("a person throws a punch", "a man is kicking the ball")
    words = frozenset({"throws", "punch", "kicking", "ball"})
    found = told(prompt, pooled=NEAR, words=words, captions=captions)
    said = f"this model knows the words of {named} but was never trained on that"
    if named is None:  # a word that was in no caption says enough
        said = "this model was never trained on the word 'tree' and guesses what it means"
    said += f"; the nearest it knows is {captions[0]!r}"
    assert found == ([said] if named != "" else [])


def test_negation_and_figures_are_words_too():
    words = frozenset({"walk", "bow", "times", "step"})
    [one] = told("a person does not walk", pooled=NEAR, words=words)
    assert "the word 'not' and guesses" in one
    [two] = told("a man bows 3 times and walks 2.5 steps in 3", pooled=NEAR, words=words)
    assert "the words '3', '2.5' and guess" in two
    assert told("a man bows 3 times", pooled=NEAR, words=words, captions=("a person walks 2 steps", "she bows")) == []
    assert told("a man bows 3 times", pooled=NEAR, words=frozenset()) == []


@pytest.mark.parametrize(
    ("prompt", "word"),
    [("two people walk", "people"), ("Men bow", "Men"), ("they walk with each  other", "each  other"),
     ("a couple bows", "couple"), ("walk as women's shoes do", ""), ("a woman walks", ""), ("they walk", "")],
)  # fmt: skip
def test_more_than_one_person_is_told(prompt, word):
    found = told(prompt, pooled=NEAR, words=frozenset())
    said = f"this model moves one person alone, not {word!r}; the nearest it knows is 'a person walks'"
    assert found == ([said] if word else [])


def test_more_than_two_stages_are_told_unless_captions_have_as_many():
    three = "a person walks, then bows, then waves"
    [found] = told(three, pooled=NEAR, words=frozenset())
    assert found.startswith(f"{three!r} says 3 things one after the other")
    assert told("a person walks, then bows", pooled=NEAR, words=frozenset()) == []
    assert told("a person walks, then turns left, then bows", pooled=NEAR, words=frozenset()) == []
    long = ("a person walks", "a man bows, then runs, then jumps")
    assert told(three, pooled=NEAR, words=frozenset(), captions=long) == []


def test_words_that_are_read_as_others_are_told_with_those_and_counted_as_read():
    words = frozenset({"walks", "strolls", "jogs", "yells", "laughs", "chuckles", "dances", "turns"})
    [one] = told("he saunters, trots, screams, giggles and guffaws", pooled=NEAR, words=words)
    assert one == "words that this model was never trained on are read as others: " + (
        "'saunters' as 'strolls', 'trots' as 'jogs', 'screams' as 'yells', 'giggles' as 'chuckles' …"
    )
    two, three = told("a man marches on stilts", pooled=NEAR, words=words)
    assert "'marches' as 'walks'" in two
    assert "the word 'stilts'" in three
    # A turn on the way is no stage of its own, of whoever saunters as of whoever strolls.
    [four] = told("he saunters forward, then turns left, then dances", pooled=NEAR, words=words | {"forward", "left"})
    assert "read as others" in four


def test_tokens_are_counted_of_what_is_read():
    encoder = SimpleNamespace(max_tokens=4, token_count=lambda text: len(text.split()))
    known = KnownPrompts(("a person walks",), torch.ones(1, 2), frozenset({"walks", "around", "runs", "away"}))
    [said] = too_long(encoder, ("he walks away", "he wanders and flees"), known)  # type: ignore[arg-type]
    assert said == "the prompt has 6 tokens, of which the text encoder reads 4; its end has no effect"
