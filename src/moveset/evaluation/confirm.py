"""Keeping a result although code has changed since: if the first repeat, made anew, comes out the same to the bit.

Repeats depend on the source of the modules that measure and that make the motion (``results``), so that a comment there
would have every row of a paper's tables measured anew. What is random depends on (seed, repeat) alone; code that gives
one repeat of hundreds of motions the same in every measure and every digit has not changed what is measured. (On data
that are the same but for rounding, ``same_data``, it comes out so too.) A result
says when its repeats were kept so, and which code made them; ``same_code`` keeps what was found for rows that cannot be
made again.
"""

import json
import math
from collections.abc import Callable, Mapping
from typing import Any

from moveset.errors import FormatError
from moveset.evaluation import same_code
from moveset.evaluation.results import CODE, COUNTS, REMEDY, Results, depends
from moveset.io.limits import read_limited
from moveset.io.manifest import json_object

Make = Callable[[int], Mapping[str, Any]]
RELATIVE = 1e-5
"""Two processors' corpora differ by some 1e-6 in jerk, which is most sensitive; other takes by 1e-3 and more."""
ABSOLUTE = 1e-9


def confirm(results: Results, make: Make) -> str:
    """Keep the repeats of the result that is there, if its first one comes out the same; what was found, in a sentence.

    Where it does not, the one that was made stays, and the others are still to be made.

    Args:
        results: of what is evaluated now.
        make: a repeat by its number.

    Raises:
        FormatError: the result that is there is damaged.
        MovesetError: what cannot be judged, as ``make`` has it.
    """
    if not results.missing():
        return f"{results.name}: every repeat is of this code already"
    if not results.path.is_file():
        return f"{results.name}: no result to confirm, so every repeat is made"
    there = json_object(read_limited(results.path), results.path, REMEDY)
    try:
        rounded = there["data"] != results.head["data"]  # data that are the same but for rounding
        if other := _other(there, results.head, same_code.load(results.path.parent)):
            return f"{results.name}: the result that is there is of other {other}, so every repeat is made"
        count = len(there["repeats"])
        made = {code: there.get("kept", there)[code] for code in CODE}
        seconds = {
            "generating": float(there["seconds_per_item"]) * int(there["items"]), "all": there["seconds"] / count,
        }  # fmt: skip
        # Older code may have counted less.
        counts = {name: there[name] for name in COUNTS if name in there}
        kept = [
            {"repeat": k, "metrics": dict(values), **counts, "seconds": seconds}
            for k, values in enumerate(there["repeats"])
        ]
        if not all(one["metrics"] for one in kept):
            raise ValueError("a repeat without measures")
    except (KeyError, TypeError, ValueError, ZeroDivisionError, AttributeError) as error:
        raise FormatError(f"{results.path} is no result of an evaluation ({error!r}); give another --out") from error
    anew = make(0)
    results.add(anew)
    compare = far if rounded else _differ
    if differ := compare(kept[0]["metrics"], anew["metrics"]) or _differ(kept[0], anew, tuple(counts)):
        return f"{results.name}: the first repeat came out otherwise ({differ}), so every repeat is made"
    other_code = any(made[code] != results.head[code] for code in CODE)
    results.keep(kept, {"repeats": count, **made} if other_code else None)
    for older in (made, there):
        same_code.note(results.path.parent, older, results.head, results.name)
    how = "but for rounding, as the data are" if rounded else "to the bit"
    return f"{results.name}: the first repeat came out the same {how}, so all {count} are kept"


def _other(there: Mapping[str, Any], now: Mapping[str, Any], same: same_code.SameCode) -> str:
    """What else than code and the rounding of data differs, for people; "" if nothing does."""
    # What is asked now comes from Python, what is there from JSON.
    now = json.loads(json.dumps(depends(now)))
    before = depends({name: there.get(name) for name in now})
    if before["data"] and same.same_data(before["data"]["sha256"], now["data"]["sha256"]):
        before["data"] = now["data"]
    return ", ".join(name for name in now if name not in CODE and now[name] != before[name])


def _differ(there: Mapping[str, Any], now: Mapping[str, Any], names: tuple[str, ...] | None = None) -> str:
    """The first of the named values, all if None, that is not the same in both, for people; "" if there is none."""
    for name in sorted({*there, *now}) if names is None else names:
        if there.get(name) != now.get(name):
            return f"{name} {now.get(name)} instead of {there.get(name)}"
    return ""


def far(there: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """The first measure that differs by more than rounding, for people; "" if none does."""
    for name in sorted({*there, *now}):
        if not (
            name in there and name in now and math.isclose(there[name], now[name], rel_tol=RELATIVE, abs_tol=ABSOLUTE)
        ):
            return f"{name} {now.get(name)} instead of {there.get(name)}"
    return ""
