"""Sentences from what data sets say about takes: CMU's short descriptions, and one sentence said in a few ways."""

import re

from moveset.data.english import article, inflect
from moveset.data.verbs import VERBS, verbs_of

#: Descriptions that say nothing about what is done.
_NOTHING = re.compile(
    r"unknown|story|alaskan vacation|motorcycle|nursery rhyme|range of motion|calibration|\brom\b|various|subject \d"
    r"|sequence|^$",
    re.IGNORECASE,
)
_PERSON = re.compile(r"^(?:(?:a|the) (?:person|man|woman|figure)|someone)(?=\s)", re.IGNORECASE)
_SHORT = 3  # letters of a part that may be a word


STANDING_STILL = (
    "a person stands still", "a person stands", "a person is standing still", "someone stands still", "stand still",
    "a man stands still", "a woman stands still", "standing still", "stands still", "a person stands and waits",
    "a person waits", "a person does nothing", "a person stands idle", "the person is standing", "a person is standing",
    "someone is standing in place", "a figure stands in place", "a person stays where they are",
)  # fmt: skip
_ABBREVIATED = {
    "rt": "right", "lf": "left", "rturn": "right turn", "lturn": "left turn", "lhand": "left hand", "rarm": "right arm",
}  # fmt: skip


def spelled_out(sentence: str) -> tuple[str, ...]:
    """Sentences for one that ends in the name of a file; any other as it is.

    >>> spelled_out("a person: walk circle rt 01")[0], spelled_out("a person punches: punch left 45 low")[:2]
    ('a person walks circle right', ('a person punches', 'a person punches left 45 degrees low'))
    """
    head, _, name = sentence.partition(": ")
    if not name:
        words = sentence.split()
        if len(words) > 2 and words[:2] == ["a", "person"] and words[2] in VERBS:
            words[2] = inflect(words[2], "present")
        return (" ".join(words),)
    words = [_ABBREVIATED.get(word, word) for word in name.split() if not re.fullmatch(r"0\d+", word)]
    name = re.sub(r"\b(\d\d+)\b", r"\1 degrees", " ".join(words))
    if head == "a person":
        return described(name)
    told = _inflected(name)
    return (head, f"a person {told}" if told else f"{head}, {name}")


def said_otherwise(sentence: str) -> tuple[str, ...]:
    """A sentence about a person, and the same about others and about nobody.

    >>> said_otherwise("a person jumps over a box")
    ('a person jumps over a box', 'someone jumps over a box', 'the person jumps over a box', 'jumps over a box')
    >>> said_otherwise("a person's left hand waves")
    ("a person's left hand waves",)
    """
    if not (found := _PERSON.match(sentence)):
        return (sentence,)
    rest = sentence[found.end() :].strip()
    return tuple(dict.fromkeys((sentence, f"someone {rest}", f"the person {rest}", rest)))


def without_person(sentence: str) -> str | None:
    """What a sentence says that a person does; None if it does not begin with a person.

    >>> without_person("the man walks."), without_person("walking")
    ('walks.', None)
    """
    found = _PERSON.match(sentence)
    return sentence[found.end() :].strip() or None if found else None


def described(description: str) -> tuple[str, ...]:
    """Sentences for CMU's description of a trial; none where it says nothing.

    >>> described("walk, veer right")[:2], described("chicken (human subject)")[:1], described("Unknown")
    (('a person walks, veers right', 'someone walks, veers right'), ('a person acts like a chicken',), ())
    """
    text = re.sub(r"\(.*?subject.*?\)|CleanedGRS|\(repeated\)", "", description.replace("\xa0", " "))
    animal = "human subject" in description
    text = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Za-z])(?=\d)|(?<=\d)(?=[A-Za-z])|/", " ", text).lower()
    text = re.sub(r"\s+", " ", re.sub(r" \d{1,3}$", "", text)).strip(" .")
    if _NOTHING.search(description) or len(text) < _SHORT or re.search(r"\b[ab]\b.*\b[ab]\b", text):
        return ()
    if animal:
        return said_otherwise(f"a person acts like {article(text)} {text}")
    topic, _, rest = text.rpartition(" - ")
    parts = [_inflected(part.strip()) for part in re.split(r"[,;] ", rest)]
    if parts[0] is None:
        # A noun: what is done is named, not told.
        sentence = f"a person does {rest}" + (f", {topic}" if topic else "")
        return (sentence, rest, f"someone doing {rest}")
    told = ", ".join(part or rest for part, rest in zip(parts, re.split(r"[,;] ", rest), strict=True))
    return said_otherwise(f"a person {told}" + (f", {topic}" if topic else ""))


def _inflected(part: str) -> str | None:
    """The part with its first verb as in "he walks"; None if it does not begin with a verb, or an adverb and one."""
    words = part.split()
    for place, word in enumerate(words[:2]):
        if word in VERBS:
            return " ".join((*words[:place], inflect(word, "present"), *words[place + 1 :]))
    return f"is {part}" if words and words[0].endswith("ing") and verbs_of(words[0]) else None
