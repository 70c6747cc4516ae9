"""A caption in other words (``reworded_phrases``, ``reworded_styles``), in as many ways as there are keys.

``paraphrase`` swaps words; here the whole phrase of a content is another one, and so is a style's. What a caption says
is found by its words alone: any written caption can be reworded, compositions too. For training only.
"""

import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

from moveset.data import phrases, reworded_phrases, reworded_styles, styles
from moveset.data.captions import mirror_text, normal_form, render
from moveset.text.english import FORMS, article

_POSSESSIVES = ("their", "his", "her", "the", "your")
_WORD = re.compile(r"[A-Za-z'-]+")
_CHOICE = re.compile(r"\(([^()]*)\)")
_ARTICLE = re.compile(r"\b([Aa])n? (?=([a-z]))")
_HARD_TO_JOIN = re.compile(r",|\bthen\b|\bbefore\b|\bwhile\b|\bas\b|\bduring\b")


@dataclass(frozen=True)
class _Found:
    """What some words say: a content in a form, or a style, and whether right is meant where left is written."""

    options: tuple[str, ...]
    form: str
    their: str
    mirrored: bool


def reword(caption: str, key: int) -> str:
    """The caption in other words; a function of caption and key. What is not known stays.

    >>> reword("a person is walking slowly", 2) != reword("a person is walking slowly", 3)
    True
    """
    found = list(_phrases_in(caption))
    text, end = [], 0
    for number, (start, stop, said) in enumerate(found):
        options = said.options
        if len(found) > 1 and said.form:
            # Parts of a longer sentence have to stay apart.
            options = tuple(p for p in options if not _HARD_TO_JOIN.search(p)) or options
        draw = _draws(f"{key}/{number}/{caption}")
        phrase = _spoken(options[next(draw) % len(options)], draw)
        if said.form:
            phrase = render(phrase.replace("{they}", "they"), said.form, said.their)
        if said.mirrored:
            phrase = mirror_text(phrase)
        text += [caption[end:start], phrase.capitalize() if caption[start].isupper() else phrase]
        end = stop
    made = re.sub(r" (?=[ ,.])", "", "".join((*text, caption[end:])))
    return _ARTICLE.sub(lambda m: f"{article(m[1], m[2])} ", made).strip() if found else caption


@cache
def all_words() -> frozenset[str]:
    """Every word that a rewording may bring in, in lower case."""
    written = [p for options in reworded_phrases.PHRASES.values() for p in options]
    said = [render(p, form, their) for p in written for form in FORMS for their in _POSSESSIVES]
    said += [text for ways in reworded_styles.STYLES.values() for options in ways.values() for text in options]
    return frozenset(word for text in said for word in normal_form(text.replace("{they}", "they")).split())


def _phrases_in(caption: str) -> Iterator[tuple[int, int, _Found]]:
    """Where known phrases stand, the longest first wherever several begin; none overlaps another."""
    known, longest = _known()
    words = list(_WORD.finditer(caption))
    at = 0
    while at < len(words):
        for stop in range(min(len(words), at + longest), at, -1):
            said = known.get(" ".join(word[0].lower() for word in words[at:stop]))
            if said is not None:
                yield words[at].start(), words[stop - 1].end(), said
                at = stop
                break
        else:
            at += 1


@cache
def _known() -> tuple[dict[str, _Found], int]:
    """All phrases of contents and styles in all their forms, by their words, and the number of words of the longest.

    What two contents or styles share is left out: it cannot be said which is meant.
    """
    table: dict[str, list[_Found]] = {}
    for content, written in phrases.TRAIN.items():
        options = reworded_phrases.PHRASES[content]
        for phrase in written:
            for form in FORMS:
                for their in _POSSESSIVES if "{their}" in phrase else _POSSESSIVES[:1]:
                    text = render(phrase, form, their)
                    for mirrored in {False, mirror_text(text) != text}:
                        words = normal_form(mirror_text(text) if mirrored else text)
                        table.setdefault(words, []).append(_Found(options, form, their, mirrored))
    for style, ways in styles.STYLES.items():
        for way, written in ways.items():
            others = reworded_styles.STYLES[style].get(way, ())
            for text in written if others else ():
                table.setdefault(normal_form(text), []).append(_Found(others, "", "", False))
    clear = {words: said[0] for words, said in table.items() if len({(s.options, s.mirrored) for s in said}) == 1}
    return clear, max(len(words.split()) for words in clear)


def _spoken(phrase: str, draw: Iterator[int]) -> str:
    """One of each choice."""

    def one(match: re.Match[str]) -> str:
        options = match[1].split("|")
        return options[next(draw) % len(options)]

    while _CHOICE.search(phrase):
        phrase = _CHOICE.sub(one, phrase)
    return " ".join(phrase.split()).replace(" ,", ",")


def _draws(key: str) -> Iterator[int]:
    """Endless numbers that follow from the key."""
    count = 0
    while True:
        digest = hashlib.sha256(f"{count}/{key}".encode()).digest()
        yield from (int.from_bytes(digest[k : k + 2], "big") for k in range(0, 32, 2))
        count += 1
