"""Who a sentence is about, where it says so first: "a tall man", "someone", "they"."""

import re

_NOUNS = (
    "person|man|woman|human|figure|character|guy|girl|boy|child|kid|lady|gentleman|dancer|performer|individual|"
    "subject|actor|actress|robot|zombie|soldier|hero|player|walker|runner|toddler|teenager|people"
)
PRONOUNS = "he|she|they|it|you|we|i"
SUBJECT = re.compile(
    rf"(?:(?:a|an|the|this|that|one|some|our)\s+(?:[\w'-]+\s+){{0,3}}?(?:{_NOUNS})|someone|somebody|{PRONOUNS})\b",
    re.I,
)
