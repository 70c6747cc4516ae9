"""English verbs in the four forms that sentences need, and the article that fits a word."""

import re

FORMS = ("present", "ing", "base", "past")

#: verb: (past tense, -ing form); all others are regular.
_IRREGULAR = {
    "bear": ("bore", "bearing"), "begin": ("began", "beginning"), "bend": ("bent", "bending"),
    "bid": ("bid", "bidding"), "break": ("broke", "breaking"), "bring": ("brought", "bringing"),
    "burst": ("burst", "bursting"), "come": ("came", "coming"), "creep": ("crept", "creeping"),
    "cut": ("cut", "cutting"), "do": ("did", "doing"), "drink": ("drank", "drinking"), "fight": ("fought", "fighting"),
    "flee": ("fled", "fleeing"), "fly": ("flew", "flying"), "freeze": ("froze", "freezing"), "get": ("got", "getting"),
    "give": ("gave", "giving"), "go": ("went", "going"),
    "hang": ("hung", "hanging"), "hide": ("hid", "hiding"), "hit": ("hit", "hitting"),
    "hold": ("held", "holding"), "keep": ("kept", "keeping"),
    "lead": ("led", "leading"), "let": ("let", "letting"), "make": ("made", "making"), "put": ("put", "putting"),
    "run": ("ran", "running"), "say": ("said", "saying"), "see": ("saw", "seeing"), "shake": ("shook", "shaking"),
    "set": ("set", "setting"), "shoot": ("shot", "shooting"), "sidestep": ("sidestepped", "sidestepping"),
    "sleep": ("slept", "sleeping"), "speak": ("spoke", "speaking"), "speed": ("sped", "speeding"),
    "spin": ("spun", "spinning"), "spring": ("sprang", "springing"),
    "stand": ("stood", "standing"),
    "stick": ("stuck", "sticking"), "stride": ("strode", "striding"), "strike": ("struck", "striking"),
    "sweep": ("swept", "sweeping"), "swing": ("swung", "swinging"), "take": ("took", "taking"),
    "tear": ("tore", "tearing"), "throw": ("threw", "throwing"), "thrust": ("thrust", "thrusting"),
    "tread": ("trod", "treading"), "withdraw": ("withdrew", "withdrawing"),
    "catch": ("caught", "catching"), "dig": ("dug", "digging"), "draw": ("drew", "drawing"),
    "drive": ("drove", "driving"), "eat": ("ate", "eating"), "fall": ("fell", "falling"),
    "grind": ("ground", "grinding"), "kneel": ("knelt", "kneeling"), "leap": ("leapt", "leaping"),
    "lie": ("lay", "lying"), "ride": ("rode", "riding"), "rise": ("rose", "rising"), "sit": ("sat", "sitting"),
    "slide": ("slid", "sliding"), "squat": ("squatted", "squatting"), "swim": ("swam", "swimming"),
    "uppercut": ("uppercut", "uppercutting"), "write": ("wrote", "writing"),
}  # fmt: skip


def _doubles(verb: str) -> bool:
    # One short vowel before one final consonant: jog, step, grab; not walk, look, bow, show.
    return bool(re.fullmatch(r"[^aeiou]*[aeiou][^aeiouwxy]", verb))


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
    if verb in _IRREGULAR:
        return _IRREGULAR[verb][form == "ing"]
    if form == "ing":
        if re.search(r"[^aeiou]e$|ue$", verb):
            return verb[:-1] + "ing"
        return verb + verb[-1] * _doubles(verb) + "ing"
    if verb.endswith("e"):
        return verb + "d"
    if re.search(r"[^aeiou]y$", verb):
        return verb[:-1] + "ied"
    return verb + verb[-1] * _doubles(verb) + "ed"


def article(a: str, word: str) -> str:
    """The indefinite article before a word, by its first letter; ``a`` is "a" or "A".

    >>> article("A", "old"), article("a", "young")
    ('An', 'a')
    """
    return f"{a}n" if word[0].lower() in "aeiou" else a
