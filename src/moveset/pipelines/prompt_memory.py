"""Encoded prompts, each read (``reading``) and encoded once while it is in use."""

import threading
from collections import OrderedDict

from moveset.data.captions import mirror_text
from moveset.motion.steering import Steering
from moveset.pipelines.reading import read
from moveset.pipelines.said_turns import plain_turn
from moveset.text.encoder import TextEmbedding, TextEncoder
from moveset.text.familiarity import KnownPrompts


class PromptMemory:
    """Texts as networks are told them, the last ``limit`` that were asked for; may be used by several threads.

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
        return self._encoded(read(prompt, self._captions).text)

    def mirrored(self, prompt: str) -> TextEmbedding:
        """What a sentence says of the mirror image, encoded: of how it is read, which may have a side that it lacks.

        Raises:
            InputError: text that is not valid Unicode.
        """
        return self._encoded(mirror_text(read(prompt, self._captions).text))

    def steering(self, prompt: str) -> Steering | None:
        """How the way of a sentence is bent, which nothing encoded tells."""
        reading = read(prompt, self._captions)
        return reading.steering if reading.bent else plain_turn(reading.text, self._captions)

    def _encoded(self, text: str) -> TextEmbedding:
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
