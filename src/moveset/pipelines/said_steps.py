"""Steps that are counted: captions know "several steps" only, and nobody who stops after them.

"Takes three steps forward" is told as "walks forward, then waves with the left hand"; of that walk the last three steps
are kept (``motion.footfalls``), and the arm is made to hang (``said_stops``). Whoever does something else after his
steps is told that instead of the wave.
"""

import re

from moveset.motion.footfalls import Steps
from moveset.motion.standing import Stand
from moveset.motion.steering import Together
from moveset.motion.way import side_of
from moveset.pipelines.said import CLAUSE, NO_LIMB, THE, TIMES, Clause, Plain, Said, sign
from moveset.pipelines.said_stops import goes, knows_waves, then_stands
from moveset.text.english import inflections
from moveset.text.familiarity import KnownPrompts
from moveset.text.vocabulary import unread

_TAKES, _STEPS_BY_VERB = inflections("take", "make", "walk", "move", "go"), inflections("step")
_FORMS = _TAKES | _STEPS_BY_VERB
_NUMBERS = {"a single": 1, "a couple of": 2, "a": 1, "one": 1, "two": 2, "three": 3, "four": 4, "five": 5, "six": 6}
_COUNTS = _NUMBERS | TIMES
_WHERE = (
    rf"(?:\s+(?:(?P<back>backwards?|back)|(?P<ahead>forwards?|ahead|straight|onwards?)"
    rf"|(?:sideways\s+)?(?:to\s+(?:{THE}\s+)?)?(?P<side>left|right)\b{NO_LIMB}))?"
)
_TAKES_STEPS = re.compile(
    rf"\b(?P<verb>{'|'.join(_TAKES)})\s+(?:exactly\s+|just\s+|only\s+)?(?P<count>{'|'.join(_NUMBERS)}|[1-6])\s+"
    rf"(?:(?P<how>big|large|long|slow|quick)\s+)?(?:steps?|paces?){_WHERE}(?![\w-])",
    re.I,
)
_STEPS = re.compile(rf"\b(?P<verb>{'|'.join(_STEPS_BY_VERB)}){_WHERE}\s+(?P<count>{'|'.join(TIMES)})\b", re.I)


def _steps(found: re.Match[str], text: str, known: KnownPrompts) -> Plain | None:
    said = " ".join(found["count"].lower().split())
    count = int(said) if said.isdigit() else _COUNTS[said]
    clause = Clause.around(found, text, _FORMS[found["verb"].lower()])
    if not unread("stands still", known.words):
        return None  # streams know that, and go on without an end
    if clause is None or clause.done or goes(CLAUSE.split(clause.rest)[0], known):
        return None
    walks = f"{clause.first}{clause.does('walk')} {_way(found)}"
    if clause.rest:
        return f"{walks}{clause.following}", Steps(count, then=True)
    if not knows_waves(known):
        return None
    return f"{walks}{then_stands(clause)}", Together((Stand(), Steps(count)))


def _way(found: re.Match[str]) -> str:
    if found["back"]:
        return "backwards"
    if found["side"]:
        return f"sideways to the {side_of(sign(found['side']))}"
    how = (found.groupdict().get("how") or "").lower()
    return {"slow": "slowly", "quick": "quickly", "": "forward"}.get(how, "with large steps")


STEPS: dict[re.Pattern[str], Said] = {_TAKES_STEPS: _steps, _STEPS: _steps}
