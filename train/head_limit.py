"""A head so small that a recurrent network's answer reaches no further than what it learns.

States lie between -1 and 1, so that the sizes of a row's weights add up to the most that it adds.
"""

from collections.abc import Sequence

import numpy as np
from torch import Tensor

from zerodrift.train.sequences import Sequence32

TINY = 1e-9


def measure_swing(sequences: Sequence[Sequence32]) -> list[float]:
    """Return half the distance between the lowest and the highest target of each output [K]."""
    low = np.min([s.target.min(axis=0) for s in sequences], axis=0)
    high = np.max([s.target.max(axis=0) for s in sequences], axis=0)
    return [float(x) for x in (0.5 * (high - low)).tolist()]


def limit_head(head: Tensor, swing: Tensor) -> None:
    """Shrink the rows of S heads, in place, until states of up to 1 add no more than that.

    Args:
        head: [S, K, H].
        swing: [S, K] the most that a row may add, to either side.
    """
    most = head.abs().sum(dim=2).clamp(min=TINY)
    head.mul_((swing / most).clamp(max=1.0)[:, :, None])
