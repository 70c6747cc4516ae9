"""Encoded prompts, each encoded once while it is in use."""

import threading
from collections import OrderedDict

from moveset.data.captions import mirror_text
from moveset.text.encoder import TextEmbedding, TextEncoder


class PromptMemory:
    """Encoded texts, the last ``limit`` that were asked for; may be used by several threads.

    Args:
        encoder: what encodes them, one at a time, so that none depends on another.
        limit: how many are kept; one takes at most a tenth of a megabyte.
    """

    def __init__(self, encoder: TextEncoder, limit: int = 64) -> None:
        self._encoder, self._limit = encoder, limit
        self._known: OrderedDict[str, TextEmbedding] = OrderedDict()
        self._lock = threading.Lock()

    def __call__(self, text: str) -> TextEmbedding:
        """One encoded sentence.

        Raises:
            InputError: text that is not valid Unicode.
        """
        with self._lock:
            if text in self._known:
                self._known.move_to_end(text)
                return self._known[text]
        found = self._encoder.encode([text])
        with self._lock:
            self._known[text] = found
            if len(self._known) > self._limit:
                self._known.popitem(last=False)
        return found

    def mirrored(self, text: str) -> TextEmbedding:
        """What a sentence says of the mirror image, encoded.

        Raises:
            InputError: text that is not valid Unicode.
        """
        return self(mirror_text(text))
