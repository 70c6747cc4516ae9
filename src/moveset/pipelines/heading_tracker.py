"""How far streams have turned since their sentences began, by what the network makes of the segments in work.

Shapes: B streams that keep step, n frames of a segment, D features.
"""

from collections.abc import Mapping
from typing import Any, Self

import torch
from torch import Tensor


class HeadingTracker:
    """The turns of the last segments one by one, and of all before them in one number a stream.

    Sums are kept on the processor, in double precision, which not every device has.

    Args:
        yaw: where a segment's features have the step of the heading (``NativeCodec.groups``).
        mean: (D,) and
        std: (D,) of features that are not normalised.
        window: segments that may be in work at once: their turns still change.
    """

    def __init__(self, yaw: slice, mean: Tensor, std: Tensor, window: int) -> None:
        self._yaw, self._mean, self._std, self._window = yaw, float(mean[yaw]), float(std[yaw]), window
        self._turns: dict[int, tuple[Tensor, Tensor]] = {}
        self._before: Tensor | float = 0.0

    def turn(self, made_BnD: Tensor) -> Tensor:
        """Radians (B,), float64 on the processor, by which normalised segments turn."""
        return (made_BnD[..., self._yaw].cpu().double() * self._std + self._mean).sum(dim=(1, 2))

    def made(self, segment: int, made_BnD: Tensor, behind_B: Tensor) -> None:
        """What the network makes of a segment, now or once more.

        Args:
            made_BnD: normalised features.
            behind_B: segments of the same sentence that lie before it.
        """
        self._turns[segment] = (self.turn(made_BnD), behind_B.cpu())
        while min(self._turns) < max(self._turns) - self._window:
            turn_B, behind_B = self._turns.pop(min(self._turns))
            self._before = torch.where(behind_B > 0, self._before, 0.0) + turn_B

    def turned(self, segment: int, behind_B: Tensor) -> Tensor:
        """Radians (B,), float32, from where the sentence of a segment begins to where the segment does.

        It is on the device of ``behind_B``.

        >>> course = HeadingTracker(slice(0, 1), torch.zeros(1), torch.ones(1), window=1)
        >>> for k in range(4):
        ...     course.made(k, torch.full((1, 2, 1), 0.5), torch.tensor([k]))
        >>> course.turned(4, torch.tensor([4])), course.turned(4, torch.tensor([1]))
        (tensor([4.]), tensor([1.]))
        """
        return self.total(segment, behind_B).float().to(behind_B.device)

    def total(self, segment: int, behind_B: Tensor) -> Tensor:
        """The same in double precision, on the processor."""
        before_B = behind_B.cpu()
        total_B = torch.zeros(len(before_B), dtype=torch.float64)
        for number, (turn_B, _) in self._turns.items():
            if number < segment:
                total_B += turn_B * (before_B >= segment - number)
        oldest = min(self._turns, default=segment)
        return total_B + (before_B > segment - oldest) * self._before

    def state(self) -> dict[str, Any]:
        """Of a single stream, for JSON."""
        turns = {str(k): [float(turn), int(behind)] for k, (turn, behind) in self._turns.items()}
        return {"before": float(self._before), "turns": turns}

    def restored(self, state: Mapping[str, Any]) -> Self:
        """This course where another was when it gave this state."""
        self._before = torch.tensor([state["before"]], dtype=torch.float64)
        self._turns = {
            int(k): (torch.tensor([turn], dtype=torch.float64), torch.tensor([behind]))
            for k, (turn, behind) in state["turns"].items()
        }
        return self
