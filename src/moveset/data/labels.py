"""Labels: what a take shows (content) and how it is performed (style), in one vocabulary for all sources."""

from moveset.data.captions import mirror_text

#: Bandai-Namco-Research-Motiondataset-1 and -2 name some styles twice; a text cannot tell them apart.
_SAME_STYLE = {"masculinity": "masculine", "old": "elderly", "tired": "exhausted"}

#: CMU descriptions that are used, and the content they show. What is not named here needs props or ground that the data
#: does not contain (ladders, stools, stairs, uneven terrain), or says nothing ("Unknown" without a sentence).
_CMU_CONTENT = {
    "walk": "walk",
    "slow walk": "walk-slow",
    "slow walk/stride": "walk-slow",
    "brisk walk": "walk-fast",
    "walk/stride": "walk-fast",
    "walk, exaggerated stride": "walk-large-steps",
    "navigate - walk forward, backward, sideways": "walk-around",
    "run": "run",
    "run/jog": "run",
    "jump": "jump",
    "jump, balance": "jump",
    "forward jump": "jump-forward",
    "playground - forward jumps, turn around": "jump-forward",
    "jump up to grab, reach for, tiptoe": "reach-up",
    "bend over, scoop up, rise, lift arm": "pick-up",
    "swordplay": "swordplay",
    "wash self": "wash",
    "laugh": "laugh",
    "boxing": "punch",
    "unscrew bottlecap, drink soda": "drink",
    "unscrew bottlecap, drink soda, screw on bottlecap": "drink",
    "drink soda": "drink",
    "drink soda, screw on bottlecap": "drink",
    "jumping jacks, side twists, bend over, jog": "exercise",
    "salsa dance": "salsa",
    "Empi": "karate",
    "Gedanbarai": "karate",
    "Heiansyodan": "karate",
    "Oiduki": "karate",
    "Syutouuke": "karate",
    "Front Kick": "kick",
    "Mawashigeri": "kick",
    "Yokogeri": "kick",
}
_CMU_PREFIXES = {"dance - ": "ballet", "basketball - ": "dribble", "soccer - kick ball": "kick-ball"}


def canonical_style(style: str) -> str:
    """One name for a style that the sources name differently.

    >>> canonical_style("old"), canonical_style("happy")
    ('elderly', 'happy')
    """
    return _SAME_STYLE.get(style, style)


def cmu_content(description: str, sentences: tuple[str, ...] = ()) -> str | None:
    """Content of a CMU trial by its description; None where there is nothing to train on.

    >>> cmu_content("basketball - forward dribble"), cmu_content("climb ladder"), cmu_content("Unknown", ("Dancing.",))
    ('dribble', None, 'dance')
    """
    for prefix, content in _CMU_PREFIXES.items():
        if description.startswith(prefix):
            return content
    if description == "Unknown":
        # The only trials with this description and a sentence are performances of dancers.
        return "dance" if any("danc" in s.lower() or "ballet" in s.lower() for s in sentences) else None
    return _CMU_CONTENT.get(description)


def mirror_label(label: str) -> str:
    """The label of the mirrored motion.

    >>> mirror_label("wave-left-hand"), mirror_label("walk")
    ('wave-right-hand', 'walk')
    """
    return mirror_text(label)
