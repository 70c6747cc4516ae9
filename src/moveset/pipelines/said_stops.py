"""Standing still: what sentences say of it where captions know nobody who does nothing.

Whoever waves with one hand stands on both feet, and the network has seen that; so "stands still" is told as "waves with
the left hand", "walks, then stops" as "walks, then waves with the left hand", and the arm that waves is made to hang
like the other one (``motion.standing``). Whoever stops and does something else then needs no wave to stand.
"""

import re

from moveset.motion.standing import Stand
from moveset.pipelines.said import AFTER, BEFORE, CLAUSE, IN_ORDER, Plain, Said, since_going
from moveset.pipelines.synonyms import BEFORE_VERBS, TRAVELLING
from moveset.text.english import inflect, inflections
from moveset.text.familiarity import KnownPrompts
from moveset.text.vocabulary import unread, words_of

_WAVES = "with the left hand"
_STANDS = inflections("stand", "wait", "pause", "stop", "halt", "freeze")
_STAYS = inflections("stay", "remain", "keep", "hold")
_COMES, _DOES = inflections("come"), inflections("do")
_GOING = {going: verb for verb in TRAVELLING if (going := inflect(verb, "ing")) in TRAVELLING}
_STILL = r"(?:still|motionless|idle|stationary|at\s+rest)"
_WHERE = r"(?:there|here|in\s+(?:one\s+)?place|on\s+the\s+spot|where\s+(?:he|she|it|they)\s+(?:is|are|stands?)|put)"
_HOW_LONG = (
    r"for\s+(?:a|an|one|two|three|four|five|ten|some|several|a\s+few|a\s+couple\s+of|\d+)\s+"
    r"(?:little\s+|short\s+|brief\s+|long\s+)?(?:moments?|while|seconds?|bit|time|minutes?)"
)
_MANNER = r"upright|straight|tall|quiet|\w+ly|without\s+moving|at\s+the\s+end"
_HOW = rf"(?:\s+(?:{_STILL}|{_WHERE}|{_MANNER}|{_HOW_LONG}))*"
_STANDS_STILL = re.compile(
    rf"""\b(?: (?P<stands>{"|".join(_STANDS)})(?:\s+(?P<going>{"|".join(sorted(_GOING))}))?
          | (?P<stays>{"|".join(_STAYS)})\s+(?:standing(?:\s+{_STILL})?|{_STILL}|{_WHERE})
          | (?P<comes>{"|".join(_COMES)})\s+to\s+an?\s+(?:\w+\s+)?(?:stop|halt|standstill)
          | (?P<does>{"|".join(_DOES)})\s+(?:nothing|not\s+move)|(?P<doesnt>(?:does|do|did)n['’]t\s+move)
          | (?P<idle>(?:is|are|was|were)\s+{_STILL}) ){_HOW}(?![\w-])""",
    re.I | re.X,
)
_TURNS = re.compile(rf"\b(?:{'|'.join(inflections('turn'))})\b", re.I)


def _stands_still(found: re.Match[str], text: str, known: KnownPrompts) -> Plain | None:
    before, after = BEFORE.fullmatch(text[: found.start()]), AFTER.match(text[found.end() :])
    if before is None or after is None or unread(f"waves {_WAVES}", known.words):
        return None
    done, link, who, rest = before["done"], before["link"], before["who"], after["rest"]
    form = _form(found)
    if (done and not link.strip()) or (form == "base" and not _commands(before, text)):
        return None
    if not done and found["going"]:  # whoever stops walking walks first
        verb = inflect(_GOING[found["going"].lower()], form)
        done, link, who = f"{link}{who}{verb.capitalize() if found[0][0].isupper() else verb}", ", then ", ""
    first = done + (link if not done or IN_ORDER.search(link) else ", then ") + who
    if not rest:
        if done and not goes(CLAUSE.split(done)[-1], known):
            return None
        return f"{first}{waves(first, form)}{after['link']}", Stand()
    conjunction = after["link"].strip(" ,;.!")
    if not after["link"].strip() or (not conjunction and rest.split()[0].endswith("ing")):
        return None
    if since_going(CLAUSE.split(rest)[0], known) is not None:
        if done and not goes(CLAUSE.split(done)[-1], known):
            return None
        link = after["link"] if IN_ORDER.search(conjunction) else ", then "
        return f"{first}{waves(first, form)}{link}{rest}", Stand()
    if not unread(found[0], known.words):
        return None
    return f"{first}{rest}", None


def _form(found: re.Match[str]) -> str:
    verbs = {"stands": _STANDS, "stays": _STAYS, "comes": _COMES, "does": _DOES}
    for group, forms in verbs.items():
        if found[group]:
            return forms[found[group].lower()]
    return "past" if found[0].lower().startswith(("was", "were", "did")) else "present"


def _commands(before: re.Match[str], text: str) -> bool:
    """Whether a verb as it stands in a dictionary is one here, and no noun."""
    *_, word = "", *words_of(text[: before.end()])
    return word in BEFORE_VERBS


def goes(clause: str, known: KnownPrompts) -> bool:
    """Whether a clause is about somebody on his way."""
    return since_going(clause, known) is not None or bool(_TURNS.search(clause))


def waves(before: str, form: str) -> str:
    """What whoever stands still is told to do, after these words."""
    verb = inflect("wave", form)
    return f"{verb} {_WAVES}" if before.strip() else f"{verb} {_WAVES}".capitalize()


STOPS: dict[re.Pattern[str], Said] = {_STANDS_STILL: _stands_still}
