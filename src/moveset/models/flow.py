"""The flow of a recurrent diffusion model: a bijection that carries one motion segment to the next, given its text.

Shapes: B rows, n frames of a segment, D features, P features that a block passes on and Q = D - P that it moves, S all
moved features (the Q of every block together), C width of the pooled sentence embedding, c width of the context.

Every block splits the features by a fixed random permutation, two blocks in a row with exchanged roles, and moves one
part by an affine map whose log-scales and shifts an LSTM reads from the other part:

    (o, mu)_t = net(x_P,1 … x_P,t ; context)        log s = c tanh(o / c)        y_Q = x_Q exp(log s) + mu

The network starts at zero, so a fresh flow is the identity. The LSTM runs forward over the frames of the segment:
frame t of either direction depends on frames up to t only, and padding at the end reaches nothing before it.

Source: Real-NVP (Dinh et al. 2017, arXiv 1605.08803) as used by RDM (arXiv 2406.07169, Sections 3.2 and 10.1): six
blocks, LSTMs of 256, log-scales within +-0.1. The paper does not say what its LSTM runs over. The other reading, an
LSTM over the segments whose state summarises the past, is not offered: the inverse needs the very state that the
forward direction used. A state computed from the segment that is being carried makes the map no bijection at all, and
a remembered one ties a segment to the row, the noise level and the history it was carried with, which a sampler
that restarts, batches or streams segments cannot keep.

Computed in float32 with autocast disabled (in the dtype of the weights, to be exact): bfloat16 loses a tenth of a
unit over four applications there and back.
"""

from dataclasses import dataclass

import torch
from torch import Generator, Tensor, nn

from moveset.errors import InputError
from moveset.models.layers import zeroed
from moveset.models.registry import ModelConfig, register, require_sizes

BOUNDS = ("tanh", "hardtanh")


@dataclass(frozen=True, kw_only=True, slots=True)
class FlowConfig(ModelConfig):
    """Sizes of a ``CouplingFlow``.

    Args:
        features: D, numbers per frame.
        blocks: coupling layers; an even number moves every feature equally often.
        hidden: width of each block's LSTM.
        text_dim: width of the pooled sentence embedding.
        text_context: width of the sentence within the context.
        index_context: width of the segment index within the context.
        max_index: indices from here on share one embedding: 1 for a model that only knows "first" and "later".
        log_scale: the largest |log s| of one block.
        bound: how it is kept: "tanh", or the paper's "hardtanh", which has no gradient beyond the bound.
        seed: of the permutations.
    """

    features: int = 269
    blocks: int = 6
    hidden: int = 256
    text_dim: int = 384
    text_context: int = 64
    index_context: int = 32
    max_index: int = 1
    log_scale: float = 0.1
    bound: str = "tanh"
    seed: int = 0

    def __post_init__(self) -> None:
        require_sizes(self, features=(2, 4096), log_scale=(1e-4, 2.0), seed=(0, 2**31 - 1))
        if self.bound not in BOUNDS:
            raise InputError(f"unknown bound {self.bound!r} of a flow's log-scales; choose from {', '.join(BOUNDS)}")


class _Coupling(nn.Module):
    order: Tensor

    def __init__(self, config: FlowConfig, order_D: Tensor, passed: int) -> None:
        super().__init__()
        self.bound, self.limit, self.passed = config.bound, config.log_scale, passed
        # Saved with the weights: the random numbers of another version of torch may differ. The first ``passed``
        # features in this order are passed on.
        self.register_buffer("order", order_D)
        self.lstm = nn.LSTM(passed + config.text_context + config.index_context, config.hidden, batch_first=True)
        self.head = nn.Sequential(nn.Linear(config.hidden, config.hidden), nn.SiLU())
        self.out = zeroed(nn.Linear(config.hidden, 2 * (config.features - passed)))

    def forward(self, x_BnD: Tensor, context_Bnc: Tensor, inverse: bool) -> tuple[Tensor, Tensor]:
        """The moved segment and the log-scales (B, n, Q); both directions see the same passed features, hence agree."""
        passed, moved = self.order[: self.passed], self.order[self.passed :]
        h_BnH, _ = self.lstm(torch.cat((x_BnD.index_select(-1, passed), context_Bnc), dim=-1))
        raw_BnQ, shift_BnQ = self.out(self.head(h_BnH)).chunk(2, dim=-1)
        if self.bound == "tanh":
            log_scale_BnQ = self.limit * torch.tanh(raw_BnQ / self.limit)
        else:
            log_scale_BnQ = raw_BnQ.clamp(-self.limit, self.limit)
        x_BnQ = x_BnD.index_select(-1, moved)
        if inverse:
            y_BnQ = (x_BnQ - shift_BnQ) * torch.exp(-log_scale_BnQ)
        else:
            y_BnQ = x_BnQ * torch.exp(log_scale_BnQ) + shift_BnQ
        return x_BnD.index_copy(-1, moved, y_BnQ), log_scale_BnQ


class CouplingFlow(nn.Module):
    """f(x; context) and its exact inverse, on normalised features of one segment of any number of frames."""

    def __init__(self, config: FlowConfig) -> None:
        super().__init__()
        self.config = config
        self.text = nn.Linear(config.text_dim, config.text_context)
        self.index = nn.Embedding(config.max_index + 1, config.index_context)
        generator = Generator().manual_seed(config.seed)
        half = config.features // 2
        blocks = []
        for number in range(config.blocks):
            if number % 2 == 0:
                order_D = torch.randperm(config.features, generator=generator)
                blocks.append(_Coupling(config, order_D, half))
            else:  # what was passed on is moved
                blocks.append(_Coupling(config, order_D.roll(-half), config.features - half))
        self.blocks = nn.ModuleList(blocks)

    @property
    def dtype(self) -> torch.dtype:
        """What the flow computes in, and returns: float32, unless its weights were moved to float64."""
        return self.index.weight.dtype

    def context(self, pooled_BC: Tensor, index_B: Tensor) -> Tensor:
        """What a segment is carried by, (B, c). It depends on nothing else: compute it once per segment and prompt.

        Args:
            pooled_BC: the sentence embedding of the segment's own prompt.
            index_B: int64 segment numbers >= 0; those beyond ``config.max_index`` count as that.
        """
        with torch.autocast(pooled_BC.device.type, enabled=False):
            text = self.text(pooled_BC.to(self.dtype))
            return torch.cat((text, self.index(index_B.clamp(max=self.config.max_index))), dim=-1)

    def forward(self, x_BnD: Tensor, context_Bc: Tensor) -> Tensor:
        """The next segment f(x; context), in the flow's dtype whatever that of x."""
        return self._run(x_BnD, context_Bc, inverse=False)[0]

    def inverse(self, y_BnD: Tensor, context_Bc: Tensor) -> Tensor:
        """The segment x with f(x; context) = y."""
        return self._run(y_BnD, context_Bc, inverse=True)[0]

    def log_scales(self, x_BnD: Tensor, context_Bc: Tensor) -> tuple[Tensor, Tensor]:
        """f(x; context), and the log s of all blocks (B, n, S).

        Their sum over the last two dimensions is log |det df/dx|; their mean square says how far f is from an isometry.
        """
        return self._run(x_BnD, context_Bc, inverse=False)

    def _run(self, x_BnD: Tensor, context_Bc: Tensor, inverse: bool) -> tuple[Tensor, Tensor]:
        log_scales = []
        with torch.autocast(x_BnD.device.type, enabled=False):
            x_BnD = x_BnD.to(self.dtype)
            context_Bnc = context_Bc.to(self.dtype)[:, None].expand(-1, x_BnD.shape[1], -1)
            for block in reversed(self.blocks) if inverse else self.blocks:
                x_BnD, log_scale_BnQ = block(x_BnD, context_Bnc, inverse)
                log_scales.append(log_scale_BnQ)
            return x_BnD, torch.cat(log_scales, dim=-1)


register("coupling_flow", FlowConfig, CouplingFlow)
