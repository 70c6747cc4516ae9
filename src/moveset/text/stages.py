"""What a sentence says happens one after the other: "walks, then waves" has two *stages*.

A stream says one thing to each of its segments, so a sentence of several stages must be taken apart first. Only words
that always mean an order do that ("then", "after that", "before waving"); a plain "and" may mean at the same time. A
turn to one side is no stage of its own where somebody walks or runs before it: it is how the way goes on.
"""

import re

MOST = 8  # stages of a sentence; what is beyond them stays with the last

_NOUNS = (
    "person|man|woman|human|figure|character|guy|girl|boy|child|kid|lady|gentleman|dancer|performer|individual|"
    "subject|actor|actress|robot|zombie|soldier|hero|player|walker|runner|toddler|teenager|people"
)
_PRONOUNS = "he|she|they|it|you|we|i"
# Whom a sentence is about, where it says so first: "a tall man", "someone", "they".
_SUBJECT = re.compile(
    rf"(?:(?:a|an|the|this|that|one|some|our)\s+(?:[\w'-]+\s+){{0,3}}?(?:{_NOUNS})|someone|somebody|{_PRONOUNS})\b",
    re.I,
)

_PRONOUN = re.compile(rf"(?P<who>{_PRONOUNS})\s+(?:(?:is|are|am|'s|'re)\s+)?", re.I)
_BESIDES = re.compile(
    r"^(?:(?:is|are|was|were)\s+)?(?:first(?:ly)?,?\s+|(?:starts|begins)\s+(?:off\s+)?(?:by|with)\s+)", re.I
)
# Between two stages in their order. "then" does it alone; others need a comma, a full stop or an "and" before them.
_NEXT = re.compile(
    r"""(?<!\bnow)(?<!\bnow\ and)(?: \s*[,;.]\s*(?:and\s+|but\s+)? | \s+and\s+ | \s+but\s+ | \s+ ) then\b,?\s+(?=\w)
      | (?: \s*[,;.]\s*(?:and\s+)? | \s+and\s+ )
        (?: after\s+that | afterwards? | next(?!\s+to\b) | later(?:\s+on)? | finally | lastly | subsequently
          | finish(?:es)?\s+(?:off\s+)?(?:by|with) | ends?\s+by )\b,?\s+(?=\w)
      | \s*,?\s+(?:and\s+)?(?:is\s+)?followed\s+by\s+(?=\w)
      | \s*,?\s+before\s+(?=\w+ing\b)""",
    re.I | re.X,
)
_AFTER = re.compile(r"\s*,?\s+after\s+(?=\w+ing\b)", re.I)
_AFTER_FIRST = re.compile(r"after\s+(?P<first>\w+ing\b[^,;]*)[,;]\s*(?P<second>.+)", re.I | re.S)

_TRAVELS = re.compile(
    r"\b(?:(?:walk|stroll|hik|trek|tramp|parad|promenad|march|wander|strid|step|jog|sprint|scamper|gallop|hustl|ambl"
    r"|saunter|mosey|plod|traips|waddl|totter|hurr(?:y|i)|hasten|roam|trot|scurr(?:y|i)|scuttl|hurtl|advanc)\w*"
    r"|tread(?:s|ing)?|trod|zip(?:s|ping|ped)?|runs?|ran|running|strode|go|goes|going|went)\b", re.I
)  # fmt: skip
# A limb that does something by itself, and what of it a person may be said to do with it ("waves", not "is raised").
_LIMB = re.compile(
    r"(?P<limb>(?:his|her|their|its|my|your|the|a|an|one|both)\s+(?:(?:left|right|other)\s+)?"
    r"(?:(?P<one>hand|arm|leg|foot|knee|elbow|head|fist)|hands|arms|legs|feet|knees|elbows|fists))\s+(?P<does>\w.*)",
    re.I | re.S,
)
_DOES = re.compile(r"(?:(?:is|was)\s+\w+ing|(?!is\b|was\b)\w+(?:s|ed))\b", re.I)
# And nothing besides, of which only the manner may be told.
_TURNS = re.compile(
    r"""(?:(?:is|are|was|were)\s+)?
        (?: (?:turn|veer|swerv|curv|pivot|rotat|swivel)(?:e|s|es|ed|ing)?\s+
            (?:(?:to|towards?)\s+)?(?:(?:the|his|her|their|its)\s+)?
          | (?:mak(?:es?|ing)|made|tak(?:es?|ing)|took)\s+an?\s+ )(?:left|right)\b
        (?!.*\b(?:and|while|as|but)\b)""",
    re.I | re.X | re.S,
)


def split_stages(sentence: str) -> tuple[str, ...]:
    """The stages of a sentence in order of time, each a sentence of its own; a sentence of one stage as it is.

    >>> split_stages("a person walks forward, then waves with the left hand")
    ('a person walks forward', 'a person waves with the left hand')
    >>> split_stages("a man bows after running")
    ('a man running', 'a man bows')
    >>> split_stages("a man walks, then his left hand waves")
    ('a man walks', 'a man waves with his left hand')
    >>> split_stages("a woman walks and waves")
    ('a woman walks and waves',)
    >>> split_stages("someone runs, then turns left, then bows")
    ('someone runs and then turns left', 'someone bows')
    """
    # A run of spaces would be searched from each of them to its end, and again.
    text = " ".join(sentence.split()).rstrip(".!")
    subject = _SUBJECT.match(text)
    who = subject.group() if subject else ""
    pieces = [text]
    if opening := _AFTER_FIRST.match(text):
        found = _SUBJECT.match(opening["second"])
        who = found.group() if found else ""
        pieces = [opening["first"], opening["second"]]
    ordered: list[str] = []
    for piece in pieces:
        for part in _NEXT.split(piece):
            # What is named last in "bows after running" comes first.
            ordered += reversed(_AFTER.split(part))
    stages = [stage for part in _on_their_way(ordered) if (stage := _alone(part, who))]
    if len(stages) < 2:
        return (sentence,)
    return (*stages[: MOST - 1], ", then ".join(stages[MOST - 1 :])) if len(stages) > MOST else tuple(stages)


def _on_their_way(parts: list[str]) -> list[str]:
    """The parts, with a turn in one with the walking before it."""
    out: list[str] = []
    turned = False
    for part in parts:
        who = _SUBJECT.match(bare := _bare(part))
        turns = _TURNS.match(bare[who.end() :].strip() if who else bare)
        if out and turns and not turned and _TRAVELS.search(out[-1]):
            out[-1], turned = f"{_bare(out[-1])} and then {bare}", True
        else:
            turned = False
            out.append(part)
    return out


def _bare(part: str) -> str:
    return part.strip(" \t\n,;.")


def _alone(part: str, who: str) -> str:
    """A part as a sentence of its own: about ``who``, unless it is a command or says itself whom it is about."""
    part = _bare(part)
    if pronoun := _PRONOUN.match(part):
        part = part[pronoun.end() :]
        # "they wave" has the form of a command, and "a person wave" would be no English.
        if pronoun["who"].lower() not in ("he", "she", "it") and not part.split(" ", 1)[0].endswith("ing"):
            return part
    elif subject := _SUBJECT.match(part):
        who, part = subject.group(), part[subject.end() :].strip()
        if part.startswith(("'", "’")):  # what moves is theirs
            return who + part
    part = _BESIDES.sub("", part)
    if limb := _LIMB.fullmatch(part):
        told = who and limb["one"] and _DOES.match(limb["does"])
        return f"{who} {limb['does']} with {limb['limb']}" if told else part
    return f"{who} {part}".strip() if part else ""
