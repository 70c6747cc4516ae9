"""English verbs in the four forms that sentences need, and the article that fits a word."""

import re

FORMS = ("present", "ing", "base", "past")

#: Past tenses that no rule gives.
_PAST = {
    "bear": "bore", "begin": "began", "bend": "bent", "bid": "bid", "break": "broke", "bring": "brought",
    "burst": "burst", "catch": "caught", "come": "came", "creep": "crept", "cut": "cut", "dig": "dug", "do": "did",
    "draw": "drew", "drink": "drank", "drive": "drove", "eat": "ate", "fall": "fell", "fight": "fought", "flee": "fled",
    "fly": "flew", "freeze": "froze", "get": "got", "give": "gave", "go": "went", "grind": "ground", "hang": "hung",
    "hide": "hid", "hit": "hit", "hold": "held", "keep": "kept", "kneel": "knelt", "lead": "led", "leap": "leapt",
    "let": "let", "lie": "lay", "make": "made", "put": "put", "ride": "rode", "rise": "rose", "run": "ran",
    "say": "said", "see": "saw", "set": "set", "shake": "shook", "shoot": "shot", "sit": "sat", "sleep": "slept",
    "slide": "slid", "speak": "spoke", "speed": "sped", "spin": "spun", "spring": "sprang", "stand": "stood",
    "stick": "stuck", "stride": "strode", "strike": "struck", "sweep": "swept", "swim": "swam", "swing": "swung",
    "take": "took", "tear": "tore", "throw": "threw", "thrust": "thrust", "tread": "trod", "uppercut": "uppercut",
    "withdraw": "withdrew", "write": "wrote",
}  # fmt: skip
#: Longer verbs that double their last letter, too.
_DOUBLING = ("begin", "sidestep", "squat", "uppercut")


def _doubles(verb: str) -> bool:
    # One short vowel before one final consonant: jog, step, grab; not walk, look, bow, show.
    return verb in _DOUBLING or bool(re.fullmatch(r"[^aeiou]*[aeiou][^aeiouwxy]", verb))


def inflect(verb: str, form: str) -> str:
    """A verb in one of ``FORMS``; "present" is that of "he walks".

    >>> [inflect("jog", f) for f in ("base", "present", "past", "ing")], inflect("go", "present")
    (['jog', 'jogs', 'jogged', 'jogging'], 'goes')
    """
    if form == "base":
        return verb
    if form == "present":
        if re.search(r"(s|x|z|ch|sh|[^aeiou]o)$", verb):
            return verb + "es"
        return verb[:-1] + "ies" if re.search(r"[^aeiou]y$", verb) else verb + "s"
    if form == "ing":
        if verb.endswith("ie"):
            return verb[:-2] + "ying"
        if re.search(r"[^aeiou]e$|ue$", verb):
            return verb[:-1] + "ing"
        return verb + verb[-1] * _doubles(verb) + "ing"
    if verb in _PAST:
        return _PAST[verb]
    if verb.endswith("e"):
        return verb + "d"
    if re.search(r"[^aeiou]y$", verb):
        return verb[:-1] + "ied"
    return verb + verb[-1] * _doubles(verb) + "ed"


def article(word: str) -> str:
    """The indefinite article before a word, by its first letter.

    >>> article("old"), article("young")
    ('an', 'a')
    """
    return "an" if word[0].lower() in "aeiou" else "a"
