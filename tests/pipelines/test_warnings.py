"""What is said about prompts, by how near they are to the captions and by their words."""

from types import SimpleNamespace

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


def test_figures_are_words_too():
    words = frozenset({"walk", "bow", "times", "step"})
    [two] = told("a man bows 3 times and walks 2.5 steps in 3", pooled=NEAR, words=words)
    assert "the words '3', '2.5' and guess" in two
    assert told("a man bows 3 times", pooled=NEAR, words=words, captions=("a person walks 2 steps", "she bows")) == []
    assert told("a man bows 3 times", pooled=NEAR, words=frozenset()) == []


def test_several_people_and_what_is_not_done_are_told():
    words = frozenset(["walk", "bow", "not", "people", "men", "stop", "dance", "man", "room", "knot", "nothing"])
    for prompt in ("two people dance", "Men walk", "a man walks and they bow to each other"):
        [one] = told(prompt, pooled=NEAR, words=words | {"two", "they", "each", "other"})
        assert "moves one person alone" in one
    for prompt in ("a man does not walk", "a man doesn't walk", "a man never bows"):
        [one] = told(prompt, pooled=NEAR, words=words | {"never", "doesn't", "doesn"})
        assert "denies; say what is done instead" in one
    assert told("a man walks in the men's room", "a man walks a knot", pooled=NEAR, words=words | {"in", "s"}) == []


def test_a_prompt_that_is_cut_is_told():
    encoder = SimpleNamespace(max_tokens=4, token_count=lambda text: len(text.split()))
    [said] = too_long(encoder, ("he walks away", "he wanders and then flees"))  # type: ignore[arg-type]
    assert said == "the prompt 'he wanders and then flees' has 5 tokens, of which the text encoder reads 4; " + (
        "its end has no effect"
    )
    # Each of several is told, by how it begins.
    one, two = too_long(encoder, ("he walks " * 20, "she bows " * 20))  # type: ignore[arg-type]
    assert one.startswith("the prompt 'he walks he walks he walks he walks he …' has 40 tokens")
    assert two.startswith("the prompt 'she bows ")
