"""Everyday words that a model was never trained on, read as words that it was: whoever saunters strolls.

Words of the held-out phrases are kept from every training caption, so that what unknown words do can be measured
(``data.held_out_phrases``), and some of them are said every day. Only what means the same *motion* is here: nobody who
crawls should walk. A word is read otherwise only by a model that does not know it and knows the other.
"""

import re
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import Any

from moveset.data.english import inflect
from moveset.pipelines.model_folder import ModelFolder
from moveset.text.familiarity import KnownPrompts
from moveset.text.vocabulary import unread, words_of

#: What verbs are read as; brackets mark what is inflected as they are.
_VERBS = {
    "[stroll]": "amble saunter mosey",
    "[walk]": "march advance",
    "[go]": "proceed travel",
    "[walk] slowly": "creep",
    "[trudge]": "plod traipse lumber",
    "[toddle]": "waddle totter",
    "[walk] fast": "hurry hasten",
    "[walk] around": "wander roam rove",
    "[sidle]": "drift",
    "[back] away": "retreat",
    "[walk] backwards": "backpedal",
    "[turn]": "veer",
    "[jog]": "trot",
    "[scamper]": "scurry scuttle",
    "[run] away": "flee",
    "[sprint]": "bolt charge zoom hurtle",
    "[leap]": "spring vault",
    "[wag]": "flap",
    "[put]": "stick",
    "[escort]": "usher",
    "[yell]": "scream shriek bellow",
    "[dance]": "groove boogie jive",
    "[twirl]": "pirouette",
    "[punch]": "jab",
    "[slash]": "slice hack",
    "[swing]": "wield",
    "[strut]": "sashay",
    "[fence]": "duel",
    "[pick] up": "collect",
    "[shower]": "bathe",
    "[wash]": "rinse",
    "[soap]": "lather",
    "[chuckle]": "giggle",
    "[laugh]": "guffaw",
    "[drink]": "gulp swig guzzle",
}
_NOUNS = {
    "sword": "katana",
    "enemy": "opponent",
    "upper body": "torso",
    "sky": "ceiling",
    "grandmother": "grandma",
    "grandfather": "grandpa",
    "old man": "geezer",
    "old person": "pensioner",
    "baby": "infant",
    "giant": "ogre behemoth",
    "gangster": "hoodlum",
    "exercise": "workout",
}
_PLURALS = {"old man": "old men", "old person": "old people", "upper body": "upper bodies", "sky": "sky"}
_DIRECTIONS = {
    "leftward": "to the left",
    "leftwards": "to the left",
    "rightward": "to the right",
    "rightwards": "to the right",
}
_OTHERS = {
    "hello": "hi",
    "goodbye": "adios",
    "quick": "speedy",
    "quickly": "speedily hurriedly hastily",
    "slow": "sluggish",
    "slowly": "unhurriedly sluggishly lazily",
    "wildly": "frantically",
    "energetically": "enthusiastically",
    "lively": "peppy",
    "happy": "joyous elated ecstatic jolly jovial",
    "joyfully": "joyously gleefully",
    "sad": "melancholy upset",
    "sadly": "glumly",
    "angry": "enraged outraged irritated annoyed",
    "angrily": "grumpily irritably",
    "proud": "haughty smug boastful",
    "proudly": "haughtily",
    "shy": "bashful",
    "shyly": "bashfully",
    "timid": "fearful",
    "timidly": "fearfully",
    "exhausted": "drained lethargic",
    "sleepily": "drowsily lethargically",
    "muscular": "burly brawny",
    "masculine": "macho",
    "girlish": "girly",
    "polite": "respectful",
    "politely": "respectfully",
}
# After these a word is no verb and no direction: "in spring", "with a stick", "the march", "on a leftward diagonal".
_BEFORE_NOUNS = frozenset(words_of("a an the his her their its my your this that one no with in of"))
_ARTICLE = re.compile(r"\b([Aa])n?(\s+)$")
_WORD = re.compile(r"[^\W\d_]+(?:-[^\W\d_]+)*")


@dataclass(frozen=True, slots=True)
class Reading:
    """A sentence as a model is told it, and every word that was read otherwise with what it was read as."""

    text: str
    replaced: tuple[tuple[str, str], ...] = ()


def in_known_words(sentence: str, known: KnownPrompts) -> Reading:
    """The sentence with everyday words that the model does not know said in ones that it does.

    A model of whose words there is no list is told every sentence as it is.
    """
    new = set(unread(sentence, known.words))
    if not new:
        return Reading(sentence)
    out, replaced, start, before = [], {}, 0, ""
    for found in _WORD.finditer(sentence):
        word = found[0].lower()
        by, free = _table().get(word, ("", False))
        if by and word in new and not (free and before in _BEFORE_NOUNS) and _knows(known.words, by):
            by = _without_echo(by, sentence[found.end() :])
            said = by.capitalize() if found[0][0].isupper() else by
            out += [_with_article(sentence[start : found.start()], by), said]
            start = found.end()
            replaced[word] = by
        before = word
    return Reading("".join((*out, sentence[start:])), tuple(replaced.items()))


def _without_echo(phrase: str, text: str) -> str:
    """A phrase without its last word if the text after it begins with that: "wanders around"."""
    first, _, last = phrase.rpartition(" ")
    following = _WORD.match(text.lstrip())
    return first if first and following and following[0].lower() == last else phrase


def _with_article(text: str, word: str) -> str:
    """Text that may end with "a" or "an", as it is before that word."""
    return _ARTICLE.sub(lambda m: f"{m[1]}{'n' if word[0] in 'aeiou' else ''}{m[2]}", text)


def as_written(model: ModelFolder[Any]) -> None:
    """Have an opened model told every sentence as it is: its networks are judged, not what else is known of words."""
    model.captions = replace(model.captions, words=frozenset())


@cache
def _table() -> dict[str, tuple[str, bool]]:
    """By a word in one of its forms: what it is read as, in the same form, and whether it must stand free."""
    table = {word: (by, True) for word, by in _DIRECTIONS.items()}
    table |= {word: (by, False) for by, words in _OTHERS.items() for word in words.split()}
    for by, nouns in _NOUNS.items():
        for noun in nouns.split():
            table |= {noun: (by, False), inflect(noun, "present"): (_PLURALS.get(by) or inflect(by, "present"), False)}
    for phrase, verbs in _VERBS.items():
        for verb in verbs.split():
            for form in ("past", "ing", "present", "base"):
                said = re.sub(r"\[(\w+)\]", lambda m, form=form: inflect(m[1], form), phrase)  # type: ignore[misc]
                table[inflect(verb, form)] = (said, True)
    return table


@lru_cache(maxsize=1024)
def _knows(words: frozenset[str], phrase: str) -> bool:
    return not unread(phrase, words)
