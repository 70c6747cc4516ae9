"""Keeping a result although code has changed since: if the first repeat, made anew, comes out the same to the bit.

Repeats depend on the source of the modules that measure and that make the motion (``results``), so that a comment there
would have every row of a paper's tables measured anew. What is random depends on (seed, repeat) alone; code that gives
one repeat of hundreds of motions the same in every measure and every digit has not changed what is measured. A result
says when its repeats were kept so, and which code made them; ``same_code`` keeps what was found for rows that cannot be
made again.
"""

import json
from collections.abc import Callable, Mapping
from typing import Any

from moveset.errors import FormatError
from moveset.evaluation import same_code
from moveset.evaluation.results import CODE, COUNTS, REMEDY, Results, depends
from moveset.io.limits import read_limited
from moveset.pipelines.verified_folder import json_object

Make = Callable[[int], Mapping[str, Any]]


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
        if other := _other(there, results.head):
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
    if differ := _differ(kept[0]["metrics"], anew["metrics"]) or _differ(kept[0], anew, tuple(counts)):
        return f"{results.name}: the first repeat came out otherwise ({differ}), so every repeat is made"
    other_code = any(made[code] != results.head[code] for code in CODE)
    results.keep(kept, {"repeats": count, **made} if other_code else None)
    for older in (made, there):
        same_code.note(results.path.parent, older, results.head, results.name)
    return f"{results.name}: the first repeat came out the same to the bit, so all {count} are kept"


def _other(there: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """What else than code differs, for people; "" if nothing does."""
    # What is asked now comes from Python, what is there from JSON.
    now = json.loads(json.dumps(depends(now)))
    before = depends({name: there.get(name) for name in now})
    return ", ".join(name for name in now if name not in CODE and now[name] != before[name])


def _differ(there: Mapping[str, Any], now: Mapping[str, Any], names: tuple[str, ...] | None = None) -> str:
    """The first of the named values, all if None, that is not the same in both, for people; "" if there is none."""
    for name in sorted({*there, *now}) if names is None else names:
        if there.get(name) != now.get(name):
            return f"{name} {now.get(name)} instead of {there.get(name)}"
    return ""
