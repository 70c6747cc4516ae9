"""Written sentences for labelled motion: many for training, disjoint ones for evaluation, and their mirror images.

Everything is deterministic: a choice among many possible sentences is made by the SHA-256 of what is chosen for.
"""

import hashlib
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache

from moveset.data import phrases, styles
from moveset.errors import InputError
from moveset.text.english import inflect_marked

_SIDE = {"left": "right", "right": "left"}
_SIDE_WORD = re.compile(r"(?<![a-z])(left|right)(?=(?:wards?|most|hand(?:ed|er)?|y)?(?![a-z]))", re.IGNORECASE)
_CLOCK_WORD = re.compile(r"(?<![a-z])(?:(?:counter|anti)[- ]?)?clockwise(?![a-z])", re.IGNORECASE)


def _with_case_of(word: str, model: str) -> str:
    if model.isupper():
        return word.upper()
    return word.capitalize() if model[0].isupper() else word


def mirror_text(text: str) -> str:
    """The sentence for the mirrored motion: left and right exchanged, clockwise and counterclockwise too.

    Its own inverse, up to the spelling of "counterclockwise" (also written with a hyphen, a space or "anti").

    >>> mirror_text("A left-handed person turns right, counter-clockwise, upright.")
    'A right-handed person turns left, clockwise, upright.'
    """
    text = _SIDE_WORD.sub(lambda m: _with_case_of(_SIDE[m[0].lower()], m[0]), text)
    return _CLOCK_WORD.sub(
        lambda m: _with_case_of("counterclockwise" if m[0].lower() == "clockwise" else "clockwise", m[0]), text
    )


# --------------------------------------------------------------------------------------------------------- phrases

_POSSESSIVE = {"he": "his", "she": "her", "man": "his", "guy": "his", "woman": "her", "lady": "her"}


def _possessive(subject: str) -> str:
    return _POSSESSIVE.get(subject.split()[-1], "their")


def render(phrase: str, form: str, their: str) -> str:
    """A verb phrase with its verbs inflected and its possessive filled in.

    >>> render("[walk] and [wave] {their} hand", "ing", "her")
    'walking and waving her hand'
    """
    return inflect_marked(phrase, form).replace("{their}", their)


# -------------------------------------------------------------------------------------------------------- choosing


def _rank(*key: str) -> int:
    return int.from_bytes(hashlib.sha256("\0".join(key).encode()).digest()[:8], "big")


def _pick(options: tuple[str, ...], *key: str) -> str:
    return options[_rank(*key) % len(options)]


def _punctuated(sentence: str, *key: str) -> str:
    # People type both; one in four is written as a proper sentence.
    return sentence[0].upper() + sentence[1:] + "." if _rank("dot", sentence, *key) % 4 == 0 else sentence


def normal_form(sentence: str) -> str:
    """The sentence without case and punctuation, to compare sentences by their words."""
    return " ".join(re.findall(r"[a-z'-]+", sentence.lower()))


def _distinct(sentences: Iterable[str], count: int) -> tuple[str, ...]:
    chosen: dict[str, str] = {}
    for sentence in sentences:
        chosen.setdefault(normal_form(sentence), sentence)
        if len(chosen) == count:
            break
    return tuple(chosen.values())


# ------------------------------------------------------------------------------------------------ training sentences

#: Repeated names are chosen more often.
_SUBJECTS = (
    *("a person",) * 6, *("someone",) * 2, *("a man",) * 2, *("a woman",) * 2, *("a human",) * 2, "the person",
    "a figure", "the man", "the woman", "he", "she",
)  # fmt: skip
_NEUTRAL_SUBJECTS = ("a person", "a person", "someone", "a human", "the person", "a figure")
_FORMS: tuple[tuple[str, str], ...] = (
    ("{s} {v}", "present"),
    ("{s} is {v}", "ing"),
    ("{s} {v}", "past"),
    ("{v}", "base"),
    ("{v}", "ing"),
    ("{v}", "present"),
    ("{s} {v}", "ing"),
)


def _right(label: str) -> bool:
    return "right" in label.split("-")


def _phrases(table: dict[str, tuple[str, ...]], content: str) -> tuple[str, ...]:
    if _right(content):
        return tuple(mirror_text(p) for p in _phrases(table, mirror_text(content)))
    try:
        return table[content]
    except KeyError:
        raise InputError(f"no captions are written for the content {content!r}; known are {', '.join(table)}") from None


def _sided(content: str, write: Callable[[str], tuple[str, ...]]) -> tuple[str, ...]:
    """Write for the left-hand label and mirror, so that captions(mirrored label) = mirrored captions(label)."""
    return tuple(mirror_text(s) for s in write(mirror_text(content))) if _right(content) else write(content)


def _sentence(phrase: str, template: str, form: str, subject: str) -> str:
    if form == "ing" and template == "{s} {v}" and subject in ("he", "she"):
        template = "{s} is {v}"
    their = _possessive(subject) if "{s}" in template else ("the" if form in ("ing", "present") else "your")
    return template.format(s=subject, v=render(phrase, form, their))


def _plain(content: str, count: int) -> tuple[str, ...]:
    def all_sentences() -> Iterable[str]:
        written = phrases.TRAIN[content]
        # The first phrases are the ones people type; they come in every form before the rest is mixed by hash.
        for phrase in written[:2]:
            yield f"a person {render(phrase, 'present', 'their')}"
            yield f"someone {render(phrase, 'present', 'their')}"
            yield f"a person is {render(phrase, 'ing', 'their')}"
            yield render(phrase, "base", "your")
            yield render(phrase, "ing", "the")
            yield render(phrase, "present", "the")
        yield from phrases.SHORT.get(content, ())
        mixed = [(p, t, f) for p in written for t, f in _FORMS]
        for turn in range(4):
            order = {way: _rank(content, str(turn), *way) for way in mixed}
            for p, t, f in sorted(mixed, key=order.__getitem__):
                yield _punctuated(_sentence(p, t, f, _pick(_SUBJECTS, content, p, t, f, str(turn))), content)

    return _distinct(all_sentences(), count)


def _styled_sentence(phrase: str, content: str, style: str, key: str) -> str:
    words = styles.STYLES[style]
    ways = [w for w in ("tail", "tail", "adverb", "adjective", "subject") if w in words]
    way = ways[_rank("way", phrase, content, style, key) % len(ways)]
    template, form = _FORMS[_rank("form", phrase, content, style, key) % len(_FORMS)]
    if way in ("adjective", "subject") and "{s}" not in template:
        template, form = _FORMS[0]
    word = _pick(words[way], way, phrase, content, key)
    subjects = words.get("subject", _SUBJECTS) if style in ("masculine", "feminine") else _SUBJECTS
    if way == "tail" and word.startswith("like"):
        subjects = _NEUTRAL_SUBJECTS  # "a woman walks like a woman" says nothing
    subject = _pick(subjects, "subject", phrase, content, style, key)
    if way == "subject":
        subject = word
    elif way == "adjective":
        noun = "woman" if style == "feminine" else "man" if style == "masculine" else _pick(
            ("person", "person", "man", "woman", "human"), "noun", phrase, content, style, key
        )  # fmt: skip
        subject = f"{'an' if word[0] in 'aeiou' else 'a'} {word} {noun}"
    sentence = _sentence(phrase, template, form, subject)
    if way == "adverb" and (template, form) == _FORMS[0]:
        return f"{subject} {word} {sentence.removeprefix(subject).strip()}"
    if way in ("tail", "adverb"):
        return f"{sentence}{'' if word.startswith(',') else ' '}{word}"
    return sentence


def _styled(content: str, style: str, count: int) -> tuple[str, ...]:
    def all_sentences() -> Iterable[str]:
        written = [p for p in phrases.TRAIN[content] if "," not in p]
        for turn in range(12):
            for p in sorted(written, key=lambda p: _rank("styled", content, style, str(turn), p)):
                yield _punctuated(_styled_sentence(p, content, style, str(turn)), content, style)

    return _distinct(all_sentences(), count)


def names_a_side(content: str) -> bool:
    """Whether a training phrase of the content says left or right; then its mirror image needs mirrored sentences."""
    return any(mirror_text(p) != p for p in _phrases(phrases.TRAIN, content))


@cache
def train_captions(content: str, style: str | None = None, *, plain: int = 44, styled: int = 30) -> tuple[str, ...]:
    """Distinct training sentences for a content, plain ones first, then ones that name the style.

    Raises:
        InputError: an unknown content or style.
    """
    _phrases(phrases.TRAIN, content)
    if style is not None and style not in styles.STYLES:
        raise InputError(f"no captions are written for the style {style!r}; known are {', '.join(styles.STYLES)}")

    def write(label: str) -> tuple[str, ...]:
        sentences = _plain(label, plain)
        if style is None:
            return sentences
        wanted = styled // 3 if style == "normal" else styled
        return sentences + _distinct(_styled(label, style, wanted), wanted)

    return _sided(content, write)


# ------------------------------------------------------------------------------------------- composed sentences


@dataclass(frozen=True)
class _Wording:
    """One way to say two phrases in one sentence; ``a`` and ``b`` name the inflections of the two."""

    template: str
    a: str
    b: str


_IN_TIME = (
    _Wording("{s} {a} and then {b}", "present", "present"),
    _Wording("{s} {a}, then {b}", "present", "present"),
    _Wording("{s} {a}, and after that {b}", "present", "present"),
    _Wording("{s} {a} before {b}", "present", "ing"),
    _Wording("{s} {b} after {a}", "ing", "present"),
    _Wording("after {a}, {s} {b}", "ing", "present"),
    _Wording("{s} first {a} and then {b}", "present", "present"),
    _Wording("{s} {a} and {b}", "present", "present"),
    _Wording("{s} is {a} and then {b}", "ing", "ing"),
    _Wording("{s} {a}, then {b}", "past", "past"),
    _Wording("{a}, then {b}", "base", "base"),
    _Wording("{a} and then {b}", "base", "base"),
    _Wording("{a}, then {b}", "present", "present"),
    _Wording("{s} {a}. Then {they} {b}.", "present", "they"),
    _Wording("{s} {a}. After that, {they} {b}.", "present", "they"),
)
#: a: what the upper body does, b: what the legs do.
_BODY = (
    _Wording("{s} {a} while {b}", "present", "ing"),
    _Wording("{s} is {a} while {b}", "ing", "ing"),
    _Wording("{s} is {b} and {a}", "ing", "ing"),
    _Wording("{s} {b} while {a}", "ing", "present"),
    _Wording("{s} {b} and {a} at the same time", "present", "present"),
    _Wording("{s} {b}, {a}", "ing", "present"),
    _Wording("while {b}, {s} {a}", "present", "ing"),
    _Wording("{a} while {b}", "base", "ing"),
    _Wording("{a} while {b}", "ing", "ing"),
    _Wording("{s} {a} while {b}", "past", "ing"),
)
_PAIR_SUBJECTS = (*("a person",) * 4, "someone", "a man", "a woman", "the person", "a human")
_PRONOUN = {"man": "he", "woman": "she"}


def _compose(wording: _Wording, a: str, b: str, subject: str) -> str:
    pronoun = _PRONOUN.get(subject.split()[-1], "they")
    their = _possessive(subject) if "{s}" in wording.template else ("your" if wording.a == "base" else "the")
    forms = {"they": "base" if pronoun == "they" else "present"}
    sentence = wording.template.format(
        s=subject,
        they=pronoun,
        a=render(a, forms.get(wording.a, wording.a), their),
        b=render(b, forms.get(wording.b, wording.b), their),
    )
    return sentence[0].upper() + sentence[1:] if sentence.endswith(".") else sentence


def _simple(table: dict[str, tuple[str, ...]], content: str) -> tuple[str, ...]:
    """Phrases that stay clear inside a longer sentence."""
    return tuple(p for p in _phrases(table, content) if not re.search(r",|\bthen\b|\bwhile\b", p))


def composed_captions(kind: str, contents: tuple[str, str], key: str, count: int = 4) -> tuple[str, ...]:
    """Training sentences for two contents in one clip.

    Args:
        kind: "in_time" (first, then second) or "body" (upper body, legs).
        contents: the two content labels, in that order.
        key: makes the choice among the many possible sentences; the clip's name.

    Raises:
        InputError: an unknown kind or content.
    """
    wordings = {"in_time": _IN_TIME, "body": _BODY}.get(kind)
    if wordings is None:
        raise InputError(f"no composed captions of kind {kind!r}; use 'in_time' or 'body'")
    first, second = (_simple(phrases.TRAIN, c)[:6] for c in contents)

    def all_sentences() -> Iterable[str]:
        for k in range(8 * count):
            salt = (key, kind, str(k))
            wording = wordings[_rank("wording", *salt) % len(wordings)]
            yield _compose(
                wording, _pick(first, "a", *salt), _pick(second, "b", *salt), _pick(_PAIR_SUBJECTS, "s", *salt)
            )

    return _distinct(all_sentences(), count)
