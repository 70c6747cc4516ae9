"""A sentence as a model is told it: in words that it knows, and without what only its motion is bent for."""

from dataclasses import replace
from functools import lru_cache

from moveset.pipelines.said import first_said
from moveset.pipelines.said_spins import SPINS
from moveset.pipelines.said_steps import STEPS
from moveset.pipelines.said_stops import STOPS
from moveset.pipelines.said_turns import TURNS
from moveset.pipelines.said_ways import WAYS
from moveset.pipelines.synonyms import Bend, Reading, in_known_words
from moveset.text.familiarity import KnownPrompts

_KINDS = (STEPS | SPINS, STOPS, TURNS | WAYS)  # of either one is taken out of a sentence


@lru_cache(maxsize=256)
def read(sentence: str, known: KnownPrompts) -> Reading:
    """A sentence as a model is told it. A model that has a caption of such words is told them as they are.

    Args:
        sentence: what a person does.
        known: what the model was trained on; if nobody wrote its words down, every sentence is told as it is.
    """
    bends, left_out = [], []
    for patterns in _KINDS if known.words else ():
        if found := first_said(sentence, known, patterns):
            sentence, said, steering = found
            if steering is None:
                left_out.append((said, "then"))
            else:
                bends.append(Bend(said, steering))
    reading = in_known_words(sentence, known)
    return replace(reading, replaced=(*left_out, *reading.replaced), bent=tuple(bends))
