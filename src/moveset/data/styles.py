"""Words for the styles, as training ``captions`` say them."""

#: How a style is said: adverbs before the verb, phrases after it, adjectives of the subject, subjects of their own.
STYLES: dict[str, dict[str, tuple[str, ...]]] = {
    "normal": {
        "adverb": ("normally", "naturally"),
        "tail": ("in a normal way", "in an ordinary way", "as usual", "in a natural way"),
    },
    "active": {
        "adverb": ("energetically", "actively", "vigorously"),
        "tail": ("with a lot of energy", "in an energetic way", "in an active way", ", full of energy"),
        "adjective": ("energetic", "lively"),
    },
    "happy": {
        "adverb": ("happily", "cheerfully", "joyfully"),
        "tail": ("in a happy mood", "in a cheerful way", ", full of joy"),
        "adjective": ("happy", "cheerful"),
    },
    "sad": {
        "adverb": ("sadly", "gloomily"),
        "tail": ("in a sad mood", "in a sad way", "with a heavy heart", ", looking depressed"),
        "adjective": ("sad", "depressed"),
    },
    "angry": {
        "adverb": ("angrily", "furiously"),
        "tail": ("in anger", "in an angry way", "in a bad temper", ", looking angry"),
        "adjective": ("angry", "furious"),
    },
    "proud": {
        "adverb": ("proudly", "confidently"),
        "tail": ("in a proud way", "with great confidence", ", full of pride"),
        "adjective": ("proud", "confident"),
    },
    "not-confident": {
        "adverb": ("timidly", "hesitantly", "shyly"),
        "tail": ("without confidence", "in an insecure way", "in a shy way", ", unsure of what to do"),
        "adjective": ("shy", "timid", "insecure"),
    },
    "masculine": {
        "tail": ("in a masculine way", "in a manly way", "like a man", "like a strong man"),
        "adjective": ("masculine",),
        "subject": ("a man", "the man", "a guy"),
    },
    "feminine": {
        "adverb": ("elegantly",),
        "tail": ("in a feminine way", "like a woman", "in a ladylike way", "like a lady"),
        "adjective": ("feminine",),
        "subject": ("a woman", "the woman", "a lady"),
    },
    "childish": {
        "adverb": ("childishly", "playfully"),
        "tail": ("like a child", "in a childish way", "like a little kid", "in a playful way"),
        "adjective": ("childish", "playful"),
        "subject": ("a child", "a kid"),
    },
    "elderly": {
        "tail": ("like an elderly person", "like an old person", "in an elderly way", "like someone very old"),
        "adjective": ("elderly", "old"),
        "subject": ("an old man", "an old woman", "an elderly person"),
    },
    "exhausted": {
        "adverb": ("tiredly", "wearily"),
        "tail": ("in an exhausted way", "as if exhausted", "with no energy left", ", looking very tired"),
        "adjective": ("tired", "exhausted"),
    },
    "musical": {
        "adverb": ("rhythmically",),
        "tail": ("to the rhythm of music", "in a musical way", "as if dancing to music", "to a beat"),
        "adjective": ("musical",),
    },
    "giant": {
        "adverb": ("heavily",),
        "tail": ("like a giant", "heavily like a giant", "like a huge monster", "in a giant's way"),
        "subject": ("a giant", "the giant"),
    },
    "chimpira": {
        "tail": ("like a thug", "with a swagger", "like a street punk", ", swaggering like a thug", "like a gangster"),
        "subject": ("a thug", "a street punk"),
    },
    "youthful": {
        "adverb": ("youthfully",),
        "tail": ("in a youthful way", "like a young person", "like a teenager", "with youthful energy"),
        "adjective": ("young", "youthful"),
        "subject": ("a teenager", "a young man", "a young woman"),
    },
}
