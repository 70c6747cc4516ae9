"""One more way to say a caption: other people, other frames, other verbs. For training only.

The written captions use few subjects and few verbs, and a text encoder that small does not see that an unknown subject
does not matter. Substitutions are form-aligned word for word, so that the sentence stays English and its meaning stays
what it was.
"""

import hashlib
import re

_SUBJECT = re.compile(
    r"^(a person|someone|a man|a woman|a human|a figure|the person|the man|the woman|he|she|they)\b", re.IGNORECASE
)
_PEOPLE = (
    "a dancer", "a boy", "a maid", "a fellow", "a lady", "a kid", "a student", "an athlete", "a soldier", "a robot",
    "the model", "the avatar", "a worker", "a teacher", "my neighbour", "this fellow", "a player", "the mannequin",
    "one person", "a stranger", "an adult", "the figure", "a visitor", "the hero", "a villager",
    "the animated human", "a pedestrian", "the agent", "an avatar", "the lad", "the boy", "this person",
    "a young man", "a young woman", "a passer-by", "the body", "it", "everybody", "a volunteer", "a patient",
    "the guard", "a child", "a runner", "the user", "a participant",
)  # fmt: skip
_FRAMES = (
    "{}", "{}", "{}", "{}", "in this clip {}", "here {}", "in the video {}", "now {}", "you can see how {}",
    "please show how {}", "the animation shows how {}", "a scene in which {}", "i want a clip where {}", "at first {}",
)  # fmt: skip
_VERBS = {
    "walk": ("hike", "tread", "trek", "tramp", "go", "parade", "promenade"),
    "stroll": ("promenade", "walk", "hike"),
    "run": ("jog", "scamper", "gallop", "hustle", "zip"),
    "jog": ("run", "scamper", "hustle"),
    "turn": ("swerve", "curve", "pivot", "rotate", "swivel"),
    "wave": ("wag", "wiggle", "flutter"),
    "raise": ("hoist", "elevate", "throw up", "push up", "uplift"),
    "lift": ("hoist", "elevate", "throw up", "push up", "uplift"),
}
_WORDS = {
    "forward": ("forwards", "to the front", "straight on"),
    "ahead": ("forwards", "to the front", "straight on"),
    "backwards": ("to the rear", "backward"),
    "backward": ("to the rear", "backwards"),
    "then": ("afterwards", "next", "later"),
    "while": ("whilst", "as well as"),
}
_IRREGULAR = {
    "go": ("goes", "going", "went"),
    "jog": ("jogs", "jogging", "jogged"),
    "run": ("runs", "running", "ran"),
    "throw": ("throws", "throwing", "threw"),
    "tread": ("treads", "treading", "trod"),
    "trek": ("treks", "trekking", "trekked"),
    "wag": ("wags", "wagging", "wagged"),
    "zip": ("zips", "zipping", "zipped"),
}


def forms(verb: str) -> tuple[str, str, str, str]:
    """Base, third person, -ing form and past of a verb, the particle behind it kept.

    >>> forms("trek"), forms("push up")
    (('trek', 'treks', 'trekking', 'trekked'), ('push up', 'pushes up', 'pushing up', 'pushed up'))
    """
    head, _, particle = verb.partition(" ")
    if head in _IRREGULAR:
        rest = _IRREGULAR[head]
    else:
        stem = head.removesuffix("e")
        rest = (head + ("es" if head.endswith(("sh", "ch")) else "s"), stem + "ing", stem + "ed")
    made = (head, *rest)
    return tuple(f"{form} {particle}".strip() for form in made)  # type: ignore[return-value]


_SWAPS: dict[str, tuple[str, ...]] = dict(_WORDS)
for _verb, _others in _VERBS.items():
    for _k, _form in enumerate(forms(_verb)):
        _SWAPS[_form] = tuple(forms(other)[_k] for other in _others)
_SWAPPED = re.compile(r"\b(" + "|".join(sorted(_SWAPS, key=len, reverse=True)) + r")\b", re.IGNORECASE)


def paraphrase(caption: str, key: int = 0) -> str:
    """The caption said otherwise; a function of caption and key, and sometimes the caption itself.

    >>> paraphrase("a person walks forward", 3) != "a person walks forward"
    True
    """
    seed = int.from_bytes(hashlib.sha256(f"{key}/{caption}".encode()).digest()[:8], "big")

    def pick(options: tuple[str, ...], place: int) -> str:
        return options[(seed >> (8 * place % 48)) % len(options)]

    def swapped(match: re.Match[str]) -> str:
        # Half of the words stay, so that known and new ones stand side by side.
        return pick(_SWAPS[match[0].lower()], match.start() % 5) if (seed >> match.start() % 40) % 2 else match[0]

    text = _SWAPPED.sub(swapped, caption)
    if _SUBJECT.match(text):
        text = pick(_FRAMES, 5).format(_SUBJECT.sub(lambda _: pick(_PEOPLE, 3), text))
    return text
