"""Captions of mirrored motion."""

import re

_SIDE = {"left": "right", "right": "left"}
_SIDE_WORD = re.compile(r"(?<![a-z])(left|right)(?=(?:wards?|most|hand(?:ed|er)?|y)?(?![a-z]))", re.IGNORECASE)
_CLOCK_WORD = re.compile(r"(?<![a-z])(?:(?:counter|anti)[- ]?)?clock[- ]?wise(?![a-z])", re.IGNORECASE)


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
        lambda m: _with_case_of("counterclockwise" if m[0].lower().startswith("clock") else "clockwise", m[0]), text
    )
