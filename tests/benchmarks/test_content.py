"""Content accuracy: clips that were cut from one take are drawn together."""

from pathlib import Path

from moveset.data import phrases
from moveset.data.captions import train_captions
from moveset.data.corpus import Corpus, CorpusWriter, TakeEntry
from moveset.data.synthetic import synthetic_motion
from moveset.evaluation.content_training import content_class

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"


def test_prompts_of_one_take_belong_together(tmp_path, monkeypatch):
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
