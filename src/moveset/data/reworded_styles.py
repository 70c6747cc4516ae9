"""Other words for what ``styles`` say, for ``rewordings``. For training only."""

#: By style and way, as in ``styles``.
STYLES: dict[str, dict[str, tuple[str, ...]]] = {
    "normal": {
        "adverb": ("ordinarily", "casually"),
        "tail": ("casually", "the usual way", "like anyone else", "without anything special", "the way people do"),
    },
    "active": {
        "adverb": ("dynamically", "eagerly", "briskly"),
        "tail": ("with vigour", "dynamically", "eagerly", "with great drive", "like someone wide awake", "with zest"),
        "adjective": ("dynamic", "vigorous", "eager", "hyperactive"),
    },
    "happy": {
        "adverb": ("gladly", "merrily", "cheerily"),
        "tail": (
            "merrily", "with delight", "smiling",
            "in a good mood", "with glee", ", very pleased", "like a winner",
        ),
        "adjective": ("glad", "merry", "delighted", "smiling"),
    },
    "sad": {
        "adverb": ("mournfully", "miserably", "unhappily"),
        "tail": ("unhappily", "close to tears", "in grief", "miserably", ", very unhappy", "like someone in mourning"),
        "adjective": ("unhappy", "miserable", "gloomy", "crying"),
    },
    "angry": {
        "adverb": ("wrathfully", "crossly", "aggressively"),
        "tail": ("with fury", "aggressively", ", very mad", "like someone furious", "in a fury", "full of hate"),
        "adjective": ("mad", "aggressive", "cross", "irate"),
    },
    "proud": {
        "adverb": ("boldly", "majestically"),
        "tail": ("boldly", "like a king", "with assertiveness", "with a swelled chest", ", very sure of it", "grandly"),
        "adjective": ("bold", "arrogant", "majestic", "assertive"),
    },
    "not-confident": {
        "adverb": ("nervously", "uncertainly", "meekly"),
        "tail": ("nervously", "with doubts", "anxiously", ", afraid to be seen", "uncertainly", "like someone scared"),
        "adjective": ("nervous", "anxious", "meek", "uncertain"),
    },
    "masculine": {
        "tail": ("like a bodybuilder", "in a male way", "like a muscular man", "like a cowboy", "as men do"),
        "adjective": ("manly", "muscular", "virile"),
    },
    "feminine": {
        "adverb": ("daintily", "delicately"),
        "tail": ("daintily", "like a model", "in a female way", "like a princess", "delicately", "as women do"),
        "adjective": ("girlish", "dainty", "ladylike"),
    },
    "childish": {
        "adverb": ("naively", "mischievously"),
        "tail": ("like a small boy", "like a little lass", "in a naive way", "like a baby", "like a five-year-old"),
        "adjective": ("naive", "mischievous", "infantile"),
        "subject": ("a small boy", "a little lass", "a baby", "a schoolboy", "a five-year-old"),
    },
    "elderly": {
        "tail": ("like a grandfather", "like a granny", "with an aching back", "with old bones", "like an aged man"),
        "adjective": ("aged", "ancient", "grey-haired", "senile"),
        "subject": ("a grandfather", "a grandmother", "a granny", "an aged man", "someone of ninety", "an ancient man"),
    },
    "exhausted": {
        "adverb": ("sleepily", "weakly"),
        "tail": (
            "after a sleepless night", "about to collapse", "out of breath",
            "sleepily", "after a marathon", "weakly",
        ),
        "adjective": ("sleepy", "weary", "fatigued", "breathless"),
    },
    "musical": {
        "adverb": ("groovily", "bouncily"),
        "tail": ("to the beat", "with rhythm", "like to a drum", "following the beat", "as if the radio played"),
        "adjective": ("rhythmic", "music-loving"),
    },
    "giant": {
        "adverb": ("ponderously", "massively"),
        "tail": ("like a titan", "ponderously", "like a dinosaur", "with the weight of a mountain", "like a colossus"),
        "subject": ("a titan", "a colossus", "a dinosaur", "a troll", "a monster"),
    },
    "chimpira": {
        "tail": ("like a bully", "like a mobster", "like a delinquent", "threateningly", "looking for a fight"),
        "subject": ("a bully", "a mobster", "a delinquent", "a gangster", "a rowdy"),
    },
    "youthful": {
        "adverb": ("freshly", "nimbly"),
        "tail": ("nimbly", "like a twenty-year-old", "like a student", "full of youth", "with young legs"),
        "adjective": ("nimble", "teenage"),
        "subject": ("a student", "a teen", "a twenty-year-old", "a youngster", "a high-school kid"),
    },
}  # fmt: skip
