"""Labels: what a take shows (content) and how it is performed (style), in one vocabulary for all sources."""

from moveset.data.captions import mirror_text

#: Bandai-Namco-Research-Motiondataset-1 and -2 name some styles twice; a text cannot tell them apart.
_SAME_STYLE = {"masculinity": "masculine", "old": "elderly", "tired": "exhausted"}


def canonical_style(style: str) -> str:
    """One name for a style that the sources name differently.

    >>> canonical_style("old"), canonical_style("happy")
    ('elderly', 'happy')
    """
    return _SAME_STYLE.get(style, style)


def mirror_label(label: str) -> str:
    """The label of the mirrored motion.

    >>> mirror_label("wave-left-hand"), mirror_label("walk")
    ('wave-right-hand', 'walk')
    """
    return mirror_text(label)
