"""Runs as training sees them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array32 = NDArray[np.float32]


@dataclass(frozen=True)
class Sequence32:
    """One stretch of one run: what the network sees, and what it has to learn."""

    group: str
    features: Array32
    """[n, I]."""
    target: Array32
    """[n, K] residual of the physical model, in multiples of each output's scale."""
    skip: int = 0
    """Samples at the start that a held-out sequence only passes through, without being judged."""

    def __len__(self) -> int:
        """Return the number of samples."""
        return int(self.features.shape[0])
