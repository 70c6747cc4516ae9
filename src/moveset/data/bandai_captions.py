"""Sentences for the takes of the Bandai-Namco sets, whose names say a content and a style and nothing else."""

from moveset.data.captions import mirror_text
from moveset.data.descriptions import said_otherwise
from moveset.errors import InputError

#: What a person does, by content; contents of the right are told by mirror images.
CONTENTS: dict[str, tuple[str, ...]] = {
    "walk": ("walks forward", "walks", "takes several steps forward"),
    "walk-back": ("walks backwards", "walks backward", "steps back several times"),
    "walk-left": ("walks diagonally to the left", "walks sideways to the left", "steps left while walking"),
    "walk-turn-left": ("walks forward and turns left", "walks around a corner to the left", "takes a left turn"),
    "run": ("runs forward", "runs", "jogs"),
    "dash": ("sprints forward", "dashes forward", "runs as fast as possible"),
    "wave-left-hand": ("waves with the left hand", "waves the left arm", "greets someone with the left hand"),
    "wave-both-hands": ("waves with both hands", "waves both arms", "greets someone with both hands"),
    "raise-up-left-hand": ("raises the left hand", "raises the left arm", "lifts the left hand up"),
    "raise-up-both-hands": ("raises both hands", "raises both arms", "lifts both hands up"),
    "bow": ("bows", "bows politely", "bends forward to bow"),
    "bye": ("waves goodbye with the right hand", "waves goodbye with one hand", "says goodbye with one hand"),
    "byebye": ("waves goodbye with both hands", "waves bye-bye", "says goodbye with both hands"),
    "guide": ("guides someone", "shows someone the way", "points the way for someone"),
    "call": ("calls out to someone", "shouts", "calls for someone"),
    "respond": ("responds to someone", "answers someone's call", "reacts to a call"),
    "dance-short": ("dances", "does a short dance", "dances for a moment"),
    "kick": ("kicks", "kicks forward", "does a kick"),
    "punch": ("punches", "throws a punch", "boxes"),
    "slash": ("slashes with a sword", "swings a sword", "attacks with a sword"),
}
#: How, by style.
STYLES: dict[str, tuple[str, ...]] = {
    "normal": ("in a normal way", "as usual"),
    "active": ("energetically", "with a lot of energy"),
    "angry": ("angrily", "in anger"),
    "childish": ("like a child", "in a playful way"),
    "chimpira": ("like a thug", "with a swagger"),
    "elderly": ("like an old person", "like someone very old"),
    "exhausted": ("tiredly", "with no energy left"),
    "feminine": ("in a feminine way", "elegantly"),
    "giant": ("like a giant", "heavily"),
    "happy": ("happily", "in a cheerful way"),
    "masculine": ("in a masculine way", "in a manly way"),
    "musical": ("rhythmically", "as if to music"),
    "not-confident": ("shyly", "without confidence"),
    "proud": ("proudly", "with great confidence"),
    "sad": ("sadly", "with a heavy heart"),
    "youthful": ("like a young person", "with youthful energy"),
}
#: Styles that the two sets name differently.
SAME_STYLE = {"masculinity": "masculine", "old": "elderly", "tired": "exhausted"}


def bandai_captions(content: str, style: str | None = None) -> tuple[str, ...]:
    """Distinct sentences for a content, and after them ones that name the style.

    >>> bandai_captions("walk-right", "elderly")[0::12][:2]
    ('a person walks diagonally to the right', 'a person walks diagonally to the right like an old person')

    Raises:
        InputError: an unknown content or style.
    """
    right = "right" in content.split("-")
    known = mirror_text(content) if right else content
    if known not in CONTENTS:
        raise InputError(f"no captions are written for the content {content!r}; known are {', '.join(CONTENTS)}")
    if style is not None and style not in STYLES:
        raise InputError(f"no captions are written for the style {style!r}; known are {', '.join(STYLES)}")
    plain = CONTENTS[known]
    styled = (f"{what} {how}" for what in plain for how in STYLES[style]) if style is not None else ()
    sentences = (said for what in (*plain, *styled) for said in said_otherwise(f"a person {what}"))
    return tuple(dict.fromkeys(mirror_text(sentence) if right else sentence for sentence in sentences))
