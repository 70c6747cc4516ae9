"""How compositions are told.

The fields: {a} and {b} halves of sentences, {s} who, {v} and {g} a verb ("walks", "walking"), {side} and {clock} where.
"""

THEN = ("{a} and then {b}", "{a}, then {b}", "{a} and {b}", "{a}. then {b}", "first {a}, then {b}")
STOPS = (
    "{a} and stops", "{a}, then stops", "{a} and then stands still", "{a}, stops and stands still",
    "{a} and comes to a halt", "{a} and ends up standing still",
)  # fmt: skip
STARTS = ("{s} stands still, then {b}", "{s} stands and then {b}", "after standing still {s} {b}")
WHILE = ("{b} while {a}", "{b} and {a} at the same time", "{b}, {a}")
CIRCLE = (
    "{s} {v} in a circle to the {side}", "{s} {v} in a circle {clock}", "{s} {v} {clock} in a circle",
    "{s} {v} around in a circle, turning {side}", "{s} {v} a full circle to the {side}",
)  # fmt: skip
CORNER = (
    "{s} {v} forward and turns {side}", "{s} {v} around a corner to the {side}", "{s} {v}, turns {side} and {v} on",
    "{s} {v} and makes a {side} turn", "{s} {v} ahead, then turns {side}",
)  # fmt: skip
BACK = (
    "{s} {v} forward, turns around and {v} back", "{s} {v}, turns around to the {side} and comes back",
    "{s} {v} and turns around", "{s} {v} away, turns back and returns", "{s} {v}, makes a u-turn and {v} back",
)  # fmt: skip
CURVE = ("{s} {v} in a curve to the {side}", "{s} {v} and veers {side}", "{s} {v} forward, bending to the {side}")
SPOT = (
    "{s} {v} in place", "{s} {v} on the spot", "{s} {v} without moving forward", "{s} {v} in one place",
    "{s} is {g} in place", "{s} keeps {g} on the spot", "{s} stays where they are and {v}",
)  # fmt: skip
# Of who does not just walk, the clip's own sentence says how.
HOW = {
    CIRCLE: (
        "{a} in a circle to the {side}",
        "{a}, {clock} in a circle",
        "{a}, going around in a circle to the {side}",
    ),
    CORNER: ("{a} and turns {side}", "{a}, then turns {side}", "{a}, around a corner to the {side}"),
    BACK: ("{a}, turns around and comes back", "{a} and turns around to the {side}", "{a}, then turns around"),
    CURVE: ("{a} in a curve to the {side}", "{a} and veers {side}", "{a}, bending to the {side}"),
    SPOT: ("{a} in place", "{a} on the spot", "{a}, without moving from the spot"),
}
UP = (
    "{s} stands up", "{s} gets up", "{s} stands back up", "{s} gets back up", "{s} rises", "{s} gets up and stands",
    "{s} rises and stands still", "{s} stands up and stands still",
)  # fmt: skip
SUBJECTS = ("a person", "a person", "someone", "a man", "the person", "a woman")
