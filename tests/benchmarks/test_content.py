"""Content accuracy: clips that were cut from one take are drawn together."""

from pathlib import Path

import pytest
import torch

from moveset.data import phrases
from moveset.data.captions import train_captions
from moveset.data.corpus import Corpus, CorpusWriter, TakeEntry
from moveset.data.synthetic import synthetic_motion
from moveset.errors import InputError
from moveset.evaluation.content_training import content_class
from moveset.pipelines.synonyms import in_known_words
from moveset.text.familiarity import KnownPrompts

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"


def test_prompts_of_one_take_belong_together_and_are_read_if_asked(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    from content import prompts_of

    writer, content = CorpusWriter(), next(iter(phrases.TRAIN))
    for name, take in (("a#0", "a"), ("a#1", "a"), ("b", "b")):
        writer.add_take(
            TakeEntry(
                name=name, take=take, source="synthetic", content=content, style=None,
                captions=tuple(train_captions(content)), split="test", subject="s", motion=synthetic_motion("walk", 40),
            )
        )  # fmt: skip
    corpus = Corpus.open(writer.write(tmp_path / "corpus.safetensors"))
    wanted = prompts_of(corpus, ["test"], {content_class(content)}, copies=2, wording="known")
    assert [take for *_, take in wanted] == ["a", "a", "a", "a", "b", "b"]
    said = prompts_of(corpus, ["test"], {content_class(content)}, copies=2, wording="held-out")
    words = frozenset({"strolls", "walks", "goes"})
    known = KnownPrompts(("a person walks",), torch.ones(1, 2), words)
    read = prompts_of(corpus, ["test"], {content_class(content)}, copies=2, wording="read", known=known)
    assert (
        [text for _, text, *_ in read]
        == [in_known_words(text, known).text for _, text, *_ in said]
        != [text for _, text, *_ in said]
    )
    with pytest.raises(InputError, match="give --model"):
        prompts_of(corpus, ["test"], {content_class(content)}, copies=2, wording="read")
