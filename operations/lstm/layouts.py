"""The orders in which the kernels read an LSTM's weights; laid out once, here."""

from collections.abc import Callable

import numpy as np

from zerodrift.operations.lstm.cell import IntegerLstm


def arrange_by_unit(lstm: IntegerLstm, field: str) -> list[int]:
    """Return an array in the order of the C: unit by unit, within a unit gate by gate.

    [4, H, n] becomes [H][4][n], [4, H] becomes [H][4].
    """
    array = np.asarray(getattr(lstm, field))
    return [int(v) for v in np.moveaxis(array, 1, 0).ravel()]


FILTERS: dict[str, Callable[..., object]] = {"lstm_by_unit": arrange_by_unit}
"""What the templates of an LSTM call."""
