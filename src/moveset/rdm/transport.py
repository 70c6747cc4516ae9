"""Carrying segments between x-space, where the motion is, and y-space, where every segment is diffused alike.

    x = f^(p)(y ; context)        y = f^(-p)(x ; context)        p = min(segment number, depth cap)

Segment 0 is its own y. With cap 1 every later segment is one application away from its y, so neither cost nor error
grows along a stream and there is nothing beyond the trained horizon; a cap of N - 1 is the paper's i-fold composition.
All applications use the segment's own context: earlier prompts need not be remembered.

Shapes: B rows, n frames of a segment, D features, C width of the pooled sentence embedding. A row is one segment,
with its own number and prompt.
Source: RDM (arXiv 2406.07169), Eqs. 9, 10 and 27 to 30, anchored on each segment itself.
"""

from torch import Tensor

from moveset.models.flow import CouplingFlow
from moveset.models.registry import require_range


class Transport:
    """Powers of a flow, by segment number. Gradients are those of the flow: freeze it, or use ``torch.no_grad``.

    Args:
        flow: None for the identity: plain diffusion of every segment.
        depth_cap: the most applications of the flow, from 1.

    Raises:
        InputError: a depth cap outside 1 to 64.
    """

    def __init__(self, flow: CouplingFlow | None, depth_cap: int = 1) -> None:
        require_range("depth_cap", depth_cap, 1, 64)
        self.flow, self.depth_cap = flow, depth_cap

    def depth(self, index_B: Tensor) -> Tensor:
        """Applications (B,) of the flow for segment numbers (B,) >= 0."""
        return index_B.clamp(max=self.depth_cap)

    def push(self, y_BnD: Tensor, index_B: Tensor, pooled_BC: Tensor) -> Tensor:
        """x of y.

        Args:
            y_BnD: segments in y-space, float32.
            index_B: int64 segment numbers >= 0.
            pooled_BC: sentence embedding of each segment's own prompt.
        """
        return self._carry(y_BnD, index_B, pooled_BC, inverse=False)

    def pull(self, x_BnD: Tensor, index_B: Tensor, pooled_BC: Tensor) -> Tensor:
        """y of x; arguments as for ``push``."""
        return self._carry(x_BnD, index_B, pooled_BC, inverse=True)

    def log_det(self, y_BnD: Tensor, index_B: Tensor, pooled_BC: Tensor) -> Tensor:
        """log |det dx/dy| of ``push`` at y by frame (B, n): no frame depends on later ones, so a segment's first frames
        have the sum of theirs.

        Arguments as for ``push``.
        """
        total_Bn = y_BnD.new_zeros(y_BnD.shape[:2])
        if self.flow is None:
            return total_Bn
        depth_B, context_Bc = self.depth(index_B), self.flow.context(pooled_BC, index_B)
        for applied in range(int(depth_B.max())):
            y_BnD, log_scales_BnS = self.flow.log_scales(y_BnD, context_Bc)
            total_Bn = total_Bn + log_scales_BnS.sum(dim=-1) * (depth_B > applied)[:, None]
        return total_Bn

    def _carry(self, z_BnD: Tensor, index_B: Tensor, pooled_BC: Tensor, inverse: bool) -> Tensor:
        if self.flow is None:
            return z_BnD
        depth_B = self.depth(index_B)
        apply = self.flow.inverse if inverse else self.flow
        context_Bc = self.flow.context(pooled_BC, index_B)
        z_BnD = z_BnD.to(self.flow.dtype)
        for applied in range(int(depth_B.max())):
            rows = (depth_B > applied).nonzero()[:, 0]
            if len(rows) == len(z_BnD):
                z_BnD = apply(z_BnD, context_Bc)
            else:
                z_BnD = z_BnD.index_copy(0, rows, apply(z_BnD[rows], context_Bc[rows]))
        return z_BnD
