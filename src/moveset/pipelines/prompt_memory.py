"""Encoded prompts, each read (``synonyms``) and encoded once while it is in use."""

import threading
from collections import OrderedDict

from moveset.pipelines.synonyms import in_known_words
from moveset.text.encoder import TextEmbedding, TextEncoder
from moveset.text.familiarity import KnownPrompts


class PromptMemory:
    """Prompts by text, the last ``limit`` that were asked for; may be used by several threads.

    Args:
        encoder: what encodes them, one at a time, so that none depends on another.
        known: what the model was trained on, in whose words they are read.
        limit: how many are kept; one takes at most a tenth of a megabyte.
    """

    def __init__(self, encoder: TextEncoder, known: KnownPrompts, limit: int = 64) -> None:
        self._encoder, self._captions, self._limit = encoder, known, limit
        self._known: OrderedDict[str, TextEmbedding] = OrderedDict()
        self._lock = threading.Lock()

    def __call__(self, prompt: str) -> TextEmbedding:
        """One encoded sentence.

        Raises:
            InputError: text that is not valid Unicode.
        """
        with self._lock:
            if prompt in self._known:
                self._known.move_to_end(prompt)
                return self._known[prompt]
        found = self._encoder.encode([in_known_words(prompt, self._captions).text])
        with self._lock:
            self._known[prompt] = found
            if len(self._known) > self._limit:
                self._known.popitem(last=False)
        return found
