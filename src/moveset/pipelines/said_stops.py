"""Standing still: what sentences say of it where captions know nobody who does nothing.

Whoever waves with one hand stands on both feet, and the network has seen that; so "stands still" is told as "waves with
the left hand", "walks, then stops" as "walks, then waves with the left hand", and the arm that waves is made to hang
like the other one (``motion.standing``). Whoever stops and does something else then needs no wave to stand.
"""

import re

from moveset.motion.standing import Stand
from moveset.pipelines.said import CLAUSE, ON_THE_SPOT, Clause, Plain, Said, since_going
from moveset.pipelines.synonyms import TRAVELLING
from moveset.text.english import inflect, inflections
from moveset.text.familiarity import KnownPrompts
from moveset.text.vocabulary import unread

_WAVES = "with the left hand"
_STANDS = inflections("stand", "wait", "pause", "stop", "halt", "freeze", "idle")
_STAYS = inflections("stay", "remain", "keep", "hold")
_COMES, _DOES = inflections("come"), inflections("do")
_GOING = {going: verb for verb in TRAVELLING if (going := inflect(verb, "ing")) in TRAVELLING}
_STILL = r"(?:still|motionless|idle|stationary|at\s+rest)"
_WHERE = rf"(?:there|here|{ON_THE_SPOT}|where\s+(?:he|she|it|they)\s+(?:is|are|stands?)|put)"
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
    clause = Clause.around(found, text, _form(found))
    if clause is None or not knows_waves(known):
        return None
    if not clause.done and found["going"]:  # whoever stops walking walks first
        return f"{clause.first}{clause.does(_GOING[found['going'].lower()])}{then_stands(clause)}", Stand()
    goes_on = since_going(CLAUSE.split(clause.rest)[0], known) is not None
    if clause.rest and not goes_on:
        return (f"{clause.first}{clause.rest}", None) if unread(found[0], known.words) else None
    if clause.done and not goes(CLAUSE.split(clause.done)[-1], known):
        return None
    return f"{clause.first}{clause.does('wave')} {_WAVES}{clause.following}", Stand()


def _form(found: re.Match[str]) -> str:
    verbs = {"stands": _STANDS, "stays": _STAYS, "comes": _COMES, "does": _DOES}
    for group, forms in verbs.items():
        if found[group]:
            return forms[found[group].lower()]
    return "past" if found[0].lower().startswith(("was", "were", "did")) else "present"


def goes(clause: str, known: KnownPrompts) -> bool:
    """Whether a clause is about somebody on his way."""
    return since_going(clause, known) is not None or bool(_TURNS.search(clause))


def knows_waves(known: KnownPrompts) -> bool:
    """Whether a model has the words for what whoever stands is told to do."""
    return not unread(f"waves {_WAVES}", known.words)


def then_stands(clause: Clause) -> str:
    """What whoever stands after what is done in a clause is told, and what follows."""
    return f", then {inflect('wave', clause.form)} {_WAVES}{clause.following}"


STOPS: dict[re.Pattern[str], Said] = {_STANDS_STILL: _stands_still}
