"""Under which conditions a model fails, in words that hold on runs left out.

Errors may be concentrated in some place, or be of one sign here and of the other there. Outputs
that fail in the same place are told by the same words: the cause is one.
"""

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.diagnosis.concentrations import find_concentrations, find_place
from zerodrift.diagnosis.contrasts import find_contrast
from zerodrift.diagnosis.scan import Pattern, Scan

ALL = -1
"""Number that stands for all outputs together; no descriptor is of this one alone."""


def find_patterns(scan: Scan, error: Array, square: Array) -> list[Pattern]:
    """Return the patterns of all outputs, those of one output most telling first.

    Args:
        scan: the descriptors.
        error: [M, K] mean error of each block.
        square: [M, K] mean squared error of each block beyond the floor, not negative; zeros for
            outputs that are not to be searched.
    """
    whole = square.sum(axis=0)
    searched = np.flatnonzero(whole > 0.0)
    shared = None
    if searched.size > 1:
        together = (square[:, searched] / whole[searched]).sum(axis=1)
        shared = find_place(scan, ALL, together, np.ones(together.size, dtype=np.bool_))
    patterns: list[Pattern] = []
    for k in searched.tolist():
        own = error[:, k], square[:, k]
        patterns += find_concentrations(scan, k, *own, shared) or find_contrast(scan, k, *own)
    return patterns
