"""The judge of text-to-motion: a co-embedding of sentences and motions where those that belong together are close.

T2M's evaluator (Guo et al. 2022), by which the field's R-precision, FID, multimodal distance and diversity are
measured: a convolutional movement encoder turns four frames into one token, a bidirectional recurrent network reads the
tokens, and another one the sentence's words. With the default sizes the parts have the published counts (1,842,688;
15,747,584; 4,100,288). The movement encoder is trained beforehand, as half of an autoencoder, and frozen.

Shapes: B batch, F frames, D features of a frame, T = F // 4 tokens, C their width, L words, W width of a word,
P classes of speech, E width of the common space.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F
from torch.nn.utils.rnn import pack_padded_sequence

from moveset.errors import InputError
from moveset.models.registry import ModelConfig, register, require_sizes

FRAMES_PER_TOKEN = 4
MAX_FRAMES = 196
#: The last features of a frame, foot contacts, are not judged.
CONTACTS = 4


@dataclass(frozen=True, kw_only=True, slots=True)
class MovementConfig(ModelConfig):
    """Sizes of a movement autoencoder; ``features`` counts a frame's contacts too, which only the decoder knows."""

    features: int = 263
    width: int = 512
    latent: int = 512
    dropout: float = 0.2

    def __post_init__(self) -> None:
        require_sizes(self, features=(CONTACTS + 1, 10_000))


@dataclass(frozen=True, kw_only=True, slots=True)
class EvaluatorConfig(ModelConfig):
    """Sizes of a ``MatchingEvaluator``.

    Args:
        features, movement_width, movement_latent, dropout: sizes of the frozen movement encoder.
        word_width: width of a word's vector (GloVe 300, MiniLM 384).
        speech_classes: length of a word's one-hot class of speech; 0 for word vectors that need none.
        text_hidden: of each direction of the sentence's network.
        motion_hidden: of each direction of the motion's network.
        joint: width E of the common space.
        hidden_dropout: of what the two recurrent networks read, and of what they found; 0 as published.
    """

    features: int = 263
    movement_width: int = 512
    movement_latent: int = 512
    dropout: float = 0.2
    word_width: int = 300
    speech_classes: int = 15
    text_hidden: int = 512
    motion_hidden: int = 1024
    joint: int = 512
    hidden_dropout: float = 0.0

    def __post_init__(self) -> None:
        _ = self.movement
        require_sizes(self, speech_classes=(0, 1000), hidden_dropout=(0.0, 0.9))

    @property
    def movement(self) -> MovementConfig:
        """Sizes of the autoencoder whose encoder this is."""
        return MovementConfig(
            features=self.features, width=self.movement_width, latent=self.movement_latent, dropout=self.dropout
        )


class MovementEncoder(nn.Module):
    """Features without contacts to one token for every four frames."""

    def __init__(self, config: MovementConfig) -> None:
        super().__init__()
        self.config = config
        self.convolutions = nn.Sequential(
            nn.Conv1d(config.features - CONTACTS, config.width, 4, 2, 1),
            nn.Dropout(config.dropout),
            nn.LeakyReLU(0.2),
            nn.Conv1d(config.width, config.latent, 4, 2, 1),
            nn.Dropout(config.dropout),
            nn.LeakyReLU(0.2),
        )
        self.output = nn.Linear(config.latent, config.latent)
        self.apply(_xavier)

    def forward(self, x_BFD: Tensor) -> Tensor:
        """Tokens (B, T, C) of features (B, F, D - 4); a token sees the three frames on either side of its own."""
        return self.output(self.convolutions(x_BFD.transpose(1, 2)).transpose(1, 2))


class MovementAutoencoder(nn.Module):
    """What the movement encoder is trained in: features without contacts in, all features out."""

    def __init__(self, config: MovementConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = MovementEncoder(config)
        self.decoder = nn.Sequential(
            nn.ConvTranspose1d(config.latent, config.width, 4, 2, 1),
            nn.LeakyReLU(0.2),
            nn.ConvTranspose1d(config.width, config.features, 4, 2, 1),
            nn.LeakyReLU(0.2),
        )
        self.output = nn.Linear(config.features, config.features)
        self.decoder.apply(_xavier)
        _xavier(self.output)

    def forward(self, x_BFD: Tensor) -> tuple[Tensor, Tensor]:
        """(reconstruction (B, F, D), tokens (B, T, C)) of features (B, F, D) whose F is a multiple of four."""
        tokens_BTC = self.encoder(x_BFD[..., :-CONTACTS])
        return self.output(self.decoder(tokens_BTC.transpose(1, 2)).transpose(1, 2)), tokens_BTC


class SequenceEncoder(nn.Module):
    """A bidirectional GRU with learned initial states; its two last states become one vector.

    Args:
        hidden: of each direction.
        joint: of the result.
        dropout: of its input, and of the last states.
    """

    def __init__(self, width: int, hidden: int, joint: int, dropout: float) -> None:
        super().__init__()
        self.dropout = dropout
        self.input = nn.Linear(width, hidden)
        self.gru = nn.GRU(hidden, hidden, batch_first=True, bidirectional=True)
        self.hidden = nn.Parameter(torch.randn(2, 1, hidden))
        self.output = nn.Sequential(
            nn.Linear(2 * hidden, hidden), nn.LayerNorm(hidden), nn.LeakyReLU(0.2), nn.Linear(hidden, joint)
        )
        for layer in (self.input, *self.output):
            _xavier(layer)

    def forward(self, x_BTC: Tensor, lengths_B: Tensor) -> Tensor:
        """(B, E) of sequences (B, T, C) of which the first ``lengths_B`` items count, at least one each."""
        read = self._dropped(self.input(x_BTC))
        packed = pack_padded_sequence(read, lengths_B.cpu(), batch_first=True, enforce_sorted=False)
        _, last = self.gru(packed, self.hidden.expand(-1, len(x_BTC), -1).contiguous())
        return self.output(self._dropped(last.transpose(0, 1).flatten(1)))

    def _dropped(self, x: Tensor) -> Tensor:
        return F.dropout(x, self.dropout, self.training)


class SentenceEncoder(SequenceEncoder):
    """Word vectors, with their classes of speech where the configuration has any."""

    def __init__(self, config: EvaluatorConfig) -> None:
        super().__init__(config.word_width, config.text_hidden, config.joint, config.hidden_dropout)
        self.speech = nn.Linear(config.speech_classes, config.word_width) if config.speech_classes else None


class MatchingEvaluator(nn.Module):
    """Motions and sentences to one space; distances there are Euclidean.

    ``mean`` and ``std`` (D,) are those of the features that it was trained on, its weighting of them included.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, config: EvaluatorConfig) -> None:
        super().__init__()
        self.config = config
        self.register_buffer("mean", torch.zeros(config.features))
        self.register_buffer("std", torch.ones(config.features))
        self.movement = MovementEncoder(config.movement)
        self.motion = SequenceEncoder(config.movement.latent, config.motion_hidden, config.joint, config.hidden_dropout)
        self.text = SentenceEncoder(config)

    def embed_motion(self, x_BFD: Tensor, lengths_B: Tensor) -> Tensor:
        """(B, E) of normalised features (B, F, D) of ``lengths_B`` frames each; frames past a clip's end must be zero.

        A clip counts in whole tokens: ``lengths_B // 4``, at least one. As in T2M, whose batches all have 196 frames,
        zeros follow every clip but those of 196 frames: a last token sees what follows it, and a clip's place in a
        batch must not matter.
        """
        frames = x_BFD.shape[1]
        padded = max(frames, min(frames + FRAMES_PER_TOKEN, MAX_FRAMES))
        padded += -padded % FRAMES_PER_TOKEN
        tokens_BTC = self.movement(F.pad(x_BFD[..., :-CONTACTS], (0, 0, 0, padded - frames)))
        return self.motion(tokens_BTC, lengths_B // FRAMES_PER_TOKEN)

    def embed_text(self, words_BLW: Tensor, speech_BLP: Tensor | None, lengths_B: Tensor) -> Tensor:
        """(B, E) of sentences of ``lengths_B`` words.

        Raises:
            InputError: classes of speech are missing, or given to a network that has no use for them.
        """
        if (self.text.speech is None) != (speech_BLP is None):
            raise InputError("classes of speech and an evaluator trained with them belong together; check its words")
        if speech_BLP is not None:
            words_BLW = words_BLW + self.text.speech(speech_BLP)
        return self.text(words_BLW, lengths_B)


def _xavier(layer: nn.Module) -> None:
    if isinstance(layer, nn.Conv1d | nn.ConvTranspose1d | nn.Linear):
        nn.init.xavier_normal_(layer.weight)
        if layer.bias is not None:
            nn.init.zeros_(layer.bias)


register("movement_autoencoder", MovementConfig, MovementAutoencoder)
register("t2m_evaluator", EvaluatorConfig, MatchingEvaluator)
