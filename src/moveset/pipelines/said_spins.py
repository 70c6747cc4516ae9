"""Turns on the spot: captions know nobody who turns without going anywhere.

"Spins around" is told as "walks slowly, then waves with the left hand", and so are "turns in place" and the like. The
walk is turned on the spot (``motion.steering.Spin``), and the arm is made to hang (``said_stops``). Whoever does
something else then is told that instead of the wave. Streams, which know who stands and have no end, spin on and on.
"""

import math
import re

from moveset.motion.standing import Stand
from moveset.motion.steering import During, Spin, Steering, Together
from moveset.pipelines.said import ON_THE_SPOT, THE, TIMES, Clause, Plain, Said, side, sign
from moveset.pipelines.said_stops import knows_waves, then_stands
from moveset.pipelines.said_turns import DEGREES, TURN_FORMS, count_of
from moveset.pipelines.said_ways import ways_of
from moveset.text.english import inflections
from moveset.text.familiarity import KnownPrompts
from moveset.text.vocabulary import unread

_SPIN_FORMS = inflections("spin", "twirl", "whirl")
_SPINS = re.compile(
    rf"\b(?P<verb>{'|'.join(_SPIN_FORMS)})(?:\s+a?round)?(?:\s+(?:{ON_THE_SPOT}|in\s+(?:an?\s+)?(?:full\s+)?circles?))?"
    rf"{side('before')}(?:\s+(?:by\s+)?{DEGREES}|\s+(?P<times>{'|'.join(TIMES)})\b)?{side('after')}"
    rf"(?!\s+(?:{THE}|an?|on|it|him|them)\b)(?![\w-])",
    re.I,
)
_TURNS = re.compile(
    rf"\b(?P<verb>{'|'.join(TURN_FORMS)}){side('before')}(?:\s+(?P<around>a?round))?(?:\s+(?:by\s+)?{DEGREES})?"
    rf"{side('after')}\s+{ON_THE_SPOT}{side('last')}(?![\w-])",
    re.I,
)
_PLAIN, _MOST = 90, 720  # degrees: of a turn to one side, and what a clip has time for


def _spins(found: re.Match[str], text: str, known: KnownPrompts) -> Plain | None:
    if not unread(found["verb"], known.words):
        return None
    times = TIMES[" ".join(found["times"].lower().split())] if found["times"] else 1
    degrees = count_of(found["degrees"]) if found["degrees"] else 360 * times
    return _turned(found, text, known, _SPIN_FORMS, degrees * sign(found["before"], found["after"]))


def _turns(found: re.Match[str], text: str, known: KnownPrompts) -> Plain | None:
    degrees = count_of(found["degrees"]) if found["degrees"] else 180 if found["around"] else _PLAIN
    return _turned(found, text, known, TURN_FORMS, degrees * sign(found["before"], found["after"], found["last"]))


def _turned(found: re.Match[str], text: str, known: KnownPrompts, forms: dict[str, str], degrees: int) -> Plain | None:
    clause = Clause.around(found, text, forms[found["verb"].lower()])
    if clause is None or not 1 <= abs(degrees) <= _MOST or unread("walks slowly", known.words):
        return None
    spin: Steering = Spin(math.radians(degrees))
    ways = ways_of(clause.done, known)
    if (all_ways := ways + 1 + ways_of(clause.rest, known)) > 1:
        spin = During(spin, ways / all_ways, (ways + 1) / all_ways)
    plain = f"{clause.first}{clause.does('walk')} slowly"
    if clause.rest or not unread("stands still", known.words):
        return f"{plain}{clause.following}", spin
    if not knows_waves(known):
        return None
    return f"{plain}{then_stands(clause)}", Together((Stand(), spin))


SPINS: dict[re.Pattern[str], Said] = {_SPINS: _spins, _TURNS: _turns}
