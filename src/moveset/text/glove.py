"""Words as the published evaluators read them: a GloVe vector and a class of word, in this order of classes.

The input is not a sentence but HumanML3D's "lemma/PART_OF_SPEECH" tokens. Some words have a class of their own,
whatever part of speech they were tagged as (Guo et al. 2022, appendix; ``utils/word_vectorizer.py`` of their code).

Shapes: B captions, L tokens of the longest (two of them the marks of beginning and end), V words, W width of a vector,
P classes.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from moveset.errors import FormatError, InputError
from moveset.text.words import Said

#: Tokens of a caption that are read.
MAX_TOKENS = 20
BEGIN, END, UNKNOWN, OTHER = "sos", "eos", "unk", "OTHER"

#: In the order of the classes; no word is in two of them.
OWN_CLASSES: dict[str, frozenset[str]] = {
    name: frozenset(words.split())
    for name, words in {
        "Loc_VIP": "left right clockwise counterclockwise anticlockwise forward back backward up down straight curve",
        "Body_VIP": "arm chin foot feet face hand mouth leg waist eye knee shoulder thigh",
        "Obj_VIP": "stair dumbbell chair window floor car ball handrail baseball basketball",
        "Act_VIP": "walk run swing pick bring kick put squat throw hop dance jump turn stumble stop sit lift lower "
        "raise wash stand kneel stroll rub bend balance flap jog shuffle lean rotate spin spread climb",
        "Desc_VIP": "slowly carefully fast careful slow quickly happy angry sad happily angrily sadly",
    }.items()
}
CLASSES = ("VERB", "NOUN", "DET", "ADP", "NUM", "AUX", "PRON", "ADJ", "ADV", *OWN_CLASSES, OTHER)
_CLASS_OF = {word: name for name, words in OWN_CLASSES.items() for word in words}


class GloveWords:
    """Tokens to vectors and classes.

    Args:
        vocabulary: V words, among them "sos", "eos" and "unk".
        vectors: (V, W) their vectors.

    Raises:
        FormatError: a table without those, or words and vectors that do not fit.
    """

    name = "glove"
    classes = len(CLASSES)

    def __init__(self, vocabulary: Sequence[str], vectors: Tensor) -> None:
        if vectors.ndim != 2 or len(vocabulary) != len(vectors):
            raise FormatError(f"{len(vocabulary)} words do not fit vectors of shape {tuple(vectors.shape)}")
        self.vocabulary, self.vectors = tuple(vocabulary), vectors.float()
        self.width = vectors.shape[1]
        self._rows = {word: row for row, word in enumerate(self.vocabulary)}
        if missing := [word for word in (BEGIN, END, UNKNOWN) if word not in self._rows]:
            raise FormatError(
                f"the table of words has no {missing[0]!r}; give the one that the evaluator was trained with"
            )

    def read(self, captions: Sequence[Said | str]) -> tuple[Tensor, Tensor, Tensor]:
        """Vectors (B, L, W), classes (B, L, P) as zeros and ones, and lengths (B,) int64; zeros beyond the length.

        A caption is cut after 20 tokens; "sos" and "eos" come before and after. A word that the table has not is
        "unk" of the class OTHER, and so is a part of speech without a class.

        Raises:
            InputError: no caption, a sentence without tokens, or a token without a part of speech.
        """
        if isinstance(captions, str) or not captions:
            raise InputError(f"words are read of a list of at least one caption, not {captions!r}")
        read = [self._indices(caption) for caption in captions]
        lengths = torch.tensor([len(rows) for rows, _ in read])
        words = torch.zeros(len(read), int(lengths.max()), self.width)
        classes = torch.zeros(len(read), int(lengths.max()), len(CLASSES))
        for k, (rows, kinds) in enumerate(read):
            words[k, : len(rows)] = self.vectors[rows]
            classes[k, torch.arange(len(kinds)), torch.tensor(kinds)] = 1.0
        return words, classes, lengths

    def _indices(self, caption: Said | str) -> tuple[list[int], list[int]]:
        """Rows of the table and numbers of the classes of one caption."""
        if isinstance(caption, str):
            raise InputError(
                f"the sentence {caption[:60]!r} has no word/PART_OF_SPEECH tokens, which this evaluator reads; "
                "give captions of a HumanML3D or KIT-ML text file"
            )
        tokens = [f"{BEGIN}/{OTHER}", *caption.tokens[:MAX_TOKENS], f"{END}/{OTHER}"]
        rows, kinds = [], []
        for token in tokens:
            word, slash, part = token.rpartition("/")
            if not slash:
                raise InputError(f"the token {token!r} has no part of speech; write it as in 'walk/VERB'")
            known = word in self._rows
            name = _CLASS_OF.get(word, part) if known else OTHER
            rows.append(self._rows[word if known else UNKNOWN])
            kinds.append(CLASSES.index(name if name in CLASSES else OTHER))
        return rows, kinds
