"""What a sentence says that somebody does: verbs of motion, whatever their form."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from functools import cache

from moveset.data.english import FORMS, inflect

#: Verbs of motion that captions of motion use, commonest first where two share a form.
_LIST = """
    walk turn step jump run bend stand kick dance swing raise lift wave spin sit stretch reach pick lean throw hop
    crouch squat climb punch shake swim sway jog circle rotate balance bow limp stumble crawl march sneak roll
    drink sweep catch clap kneel fall wash wipe box pace stop lower move grab touch twist flap shuffle sprint leap
    lunge duck point scratch drop push pull carry drag hold drive ride hang lie play act pretend perform mimic
    imitate gesture stagger skip creep tiptoe bounce dribble shoot hit strike fight dodge block swat stir chop cut
    dig shovel hammer paint scrub clean rub pat tap stroke mop pour open close unscrew eat smoke talk speak signal
    direct salute greet shrug nod look search watch answer call type write draw conduct strum row paddle fly flip
    somersault cartwheel tumble dive vault swerve strut stride stroll pivot twirl whirl sidestep stomp stamp
    tread wade trip slip slide skate ski surf bowl pitch golf juggle fish hunt aim toss pass give take put place
    set get rise straighten hunch slump rest sleep wait pause relax laugh cry cough sneeze yawn shiver tremble
    wiggle shimmy waltz tango moonwalk thrust uppercut jab guard defend parry stab slash attack retreat approach
    return rock lay extend cross clasp fold tilt nudge shift shove squeeze grind peck peek hide avoid chase escape
    veer strafe land hurdle hug kiss pray exercise
"""
VERBS = tuple(_LIST.split())
#: Verbs of getting somewhere on one's feet, and that of doing nothing.
LOCOMOTION = ("walk", "run", "jog", "march", "sneak", "limp", "stroll", "strut", "stride", "sprint", "pace")
STANDING = "stand"
_ALSO = {"laying": "lie", "lays": "lie", "laid": "lie", "lay": "lie", "fell": "fall", "hopscotch": "hop"}
#: Forms that mostly are no verbs in such sentences.
_LOOKALIKES = """
    place places set box boxes point points circle circles cross block blocks pass stroke strokes ground rock rocks
    bow fish ski bowl close open clean steps step turn turns kick kicks jump jumps walk run stand swing swings rest
    direct slip row rows pitch fly land trip signal signals type draw lower golf dance punch punches rolls roll bend
    hop hops lunge lunges squat squats spin spins stretch stretches look call play drink drive ride skip skips wave
    waves march move moves flip flips rise reach throw catch hit shot guard
"""
_NOUNS = frozenset(_LOOKALIKES.split())
_BEFORE_NOUNS = "a an the his her their its of this that one two three four five several few each"
_DETERMINERS = frozenset(_BEFORE_NOUNS.split())


@cache
def _verb_of() -> dict[str, str]:
    forms: dict[str, str] = {}
    for verb in VERBS:
        for form in FORMS:
            forms.setdefault(inflect(verb, form), verb)
    return forms | _ALSO


def verbs_of(sentence: str) -> tuple[str, ...]:
    """The verbs of motion in a sentence in their order, each once; a noun that looks like one is none.

    >>> verbs_of("A man walks two steps, then sat down and was waving his left hand.")
    ('walk', 'sit', 'wave')
    """
    words, found = re.findall(r"[a-z']+", sentence.lower()), []
    for before, word in zip(["", *words], words, strict=False):
        verb = _verb_of().get(word)
        if verb is not None and not (word in _NOUNS and (before in _DETERMINERS or word in ("left", "ground"))):
            found.append(verb)
    return tuple(dict.fromkeys(found))


def common_verbs(sentences: Sequence[str]) -> tuple[str, ...]:
    """The verbs that at least half of the sentences have, in the order of their means; else the commonest one.

    >>> common_verbs(["a person walks and waves", "someone walks", "walking, then waving"])
    ('walk', 'wave')
    """
    places: dict[str, list[int]] = {}
    for sentence in sentences:
        for place, verb in enumerate(verbs_of(sentence)):
            places.setdefault(verb, []).append(place)
    if not places:
        return ()
    often = max(len(found) for found in places.values())
    least = min(often, -(-len(sentences) // 2))
    kept = {verb: sum(found) / len(found) for verb, found in places.items() if len(found) >= least}
    return tuple(sorted(kept, key=lambda verb: (kept[verb], verb)))


def count_verbs(clips: Iterable[Sequence[str]]) -> Counter[str]:
    """How many clips, each with its sentences, say a verb in any of them; in an order that is the same every time.

    >>> count_verbs([["she sits, jumps, waves and walks", "walking"], ["a man walks, then runs"]])
    Counter({'walk': 2, 'jump': 1, 'sit': 1, 'wave': 1, 'run': 1})
    """
    counts: Counter[str] = Counter()
    for sentences in clips:
        counts.update(sorted({verb for sentence in sentences for verb in verbs_of(sentence)}))
    return counts
