"""Steps that are counted: captions know "several steps" only, and nobody who stops after them.

"Takes three steps forward" is told as "walks forward, then waves with the left hand"; of that walk the last three steps
are kept (``motion.footfalls``), and the arm is made to hang (``said_stops``). Whoever does something else after his
steps is told that instead of the wave.
"""

import re

from moveset.motion.footfalls import Steps
from moveset.motion.standing import Stand
from moveset.motion.steering import Together
from moveset.pipelines.said import AFTER, ALONE, CLAUSE, IN_ORDER, NO_LIMB, THE, Plain, Said, sign
from moveset.pipelines.said_stops import goes, waves
from moveset.pipelines.synonyms import BEFORE_VERBS
from moveset.text.english import inflect, inflections
from moveset.text.familiarity import KnownPrompts
from moveset.text.vocabulary import unread, words_of

_TAKES = inflections("take", "make", "walk", "move", "go")
_STEPS_VERB = inflections("step")
_COUNTS = {"a": 1, "one": 1, "single": 1, "two": 2, "a couple of": 2, "three": 3, "four": 4, "five": 5, "six": 6}
_MOST = 6  # that a clip has time for
_TIMES = {"once": 1, "one time": 1, "twice": 2, "two times": 2, "three times": 3, "four times": 4}
_WHERE = (
    rf"(?:\s+(?:(?P<back>backwards?|back)|(?P<ahead>forwards?|ahead|straight|onwards?)"
    rf"|(?:sideways\s+)?(?:to\s+(?:{THE}\s+)?)?(?P<side>left|right)\b{NO_LIMB}))?"
)
_TAKES_STEPS = re.compile(
    rf"\b(?P<verb>{'|'.join(_TAKES)})\s+(?:exactly\s+|just\s+|only\s+)?(?P<count>{'|'.join(_COUNTS)}|[1-6])\s+"
    rf"(?:(?P<how>big|large|long|slow|quick)\s+)?(?:steps?|paces?){_WHERE}(?![\w-])",
    re.I,
)
_STEPS = re.compile(rf"\b(?P<verb>{'|'.join(_STEPS_VERB)}){_WHERE}\s+(?P<count>{'|'.join(_TIMES)})\b", re.I)


def _steps(found: re.Match[str], text: str, known: KnownPrompts) -> Plain | None:
    forms = _TAKES | _STEPS_VERB
    form, counts = forms[found["verb"].lower()], _COUNTS | _TIMES
    said = " ".join(found["count"].lower().split())
    count = int(said) if said.isdigit() else counts[said]
    before, after = text[: found.start()], AFTER.match(text[found.end() :])
    *_, word = "", *words_of(before)
    if not unread("stands still", known.words):
        return None  # streams know that, and go on without an end
    if after is None or not ALONE.fullmatch(before) or (form == "base" and word not in BEFORE_VERBS):
        return None
    rest, link = after["rest"], after["link"]
    if rest and (not link.strip() or goes(CLAUSE.split(rest)[0], known) or rest.split()[0].endswith("ing")):
        return None
    verb = inflect("walk", form)
    walks = f"{verb.capitalize() if found['verb'][0].isupper() else verb} {_way(found)}"
    if rest:
        then = link if IN_ORDER.search(link) else ", then "
        return f"{before}{walks}{then}{rest}", Steps(count, then=True)
    if unread(waves("x", "present"), known.words):
        return None
    return f"{before}{walks}, then {waves(before + walks, form)}{link}", Together((Stand(), Steps(count)))


def _way(found: re.Match[str]) -> str:
    if found["back"]:
        return "backwards"
    if found["side"]:
        return f"sideways to the {'left' if sign(found['side']) > 0 else 'right'}"
    how = (found.groupdict().get("how") or "").lower()
    return {"slow": "slowly", "quick": "quickly", "": "forward"}.get(how, "with large steps")


STEPS: dict[re.Pattern[str], Said] = {_TAKES_STEPS: _steps, _STEPS: _steps}
