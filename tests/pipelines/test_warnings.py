"""What is said about prompts, by how near they are to the captions and by their words."""

from types import SimpleNamespace

import torch

from moveset.pipelines.warnings import unfamiliar
from moveset.text.familiarity import KnownPrompts

FAR, NEAR = torch.tensor([0.0, 0.0, 1.0]), torch.tensor([0.9, 0.1, 0.0])


def told(*prompts: str, pooled: torch.Tensor, words: frozenset[str]) -> list[str]:
    known = KnownPrompts(("a person walks", "she bows"), torch.eye(2, 3), words)
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
