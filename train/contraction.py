"""Recurrent weights so small that an error of the state shrinks, whatever the features are.

What is bounded here of GRUs is, unit by unit, what the proof of the error bound adds up
(`zerodrift.operations.gru.error`), for features of any value that the chip can hold: with the reset
after the product

    sum |Un| + (sum |Un| + |cn|) / 4 sum |Ur| + sum |Uu| <= GROWTH

and, before it, sum |Un| (1 + max sum |Ur| / 4) + sum |Uu| <= GROWTH. The argument of the update
gate stays at -SLOWEST or above, where the table of the sigmoid is fine.

Of LSTMs (`zerodrift.operations.lstm.error`), the arguments of whose input and forget gate the
features move by up to SPREAD, with q = i / (1 - f) at the largest i and f,

    q <= RATIO      q (sum |Ug| + sum |Ui| / 4 + sum |Uf|) <= GROWTH / 4      sum |Uo| <= GROWTH.

The arguments of candidate and output gate stay within 2 HELD, and each feature moves them by up to
HELD: so the chip's format of their weights holds FINE_GRID, to which the recurrent ones are
trimmed, and rounds none of these.

Source: Bonassi, Farina and Scattolini, "On the stability properties of gated recurrent units neural
networks", 2021, arXiv 2011.06806: such a condition, there kept by a penalty.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from zerodrift.base.arrays import Array
from zerodrift.train.sequences import Sequence32

TINY = 1e-9


# A head so small that a recurrent network's answer reaches no further than what it learns.
#
# States lie between -1 and 1, so that the sizes of a row's weights add up to the most that it adds.


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


# Recurrent weights so small that an error of the state shrinks, whatever the features are.

GROWTH = 0.5
"""What a step adds at most to errors of the states that are all 1, for what it forgets of them."""
SLOWEST = 7.0
"""A unit moves by at least 1 / 1100 of its distance per step."""
LEAST_ROOM = 1.0
"""Of that, what is left to the features and states that the update gate reads."""
HEADROOM = 2.0
"""The chip holds features up to this multiple of their largest, rounded up to a power of two."""
SPREAD = 1.0
RATIO = 8.0
"""A cell state can go up to this, an error of what is added to it grow by as much."""
FINE_GRID = 2.0**-12
"""As `GRID`, of the LSTM's, which are smaller."""
HELD = 7.9
"""FINE_GRID is one count of a state, of 2**15, where 2**27 counts are 1. Then 16 bits hold a weight
of a feature of 2**15 that moves the argument by 8, and 32 bits a sum of 16."""
GRID = 2.0**-10
"""What the trained recurrent weights are rounded to. They are small beside the weights of the
features, with which they share a format on the chip: finer ones would be rounded there, as an error
of the chip. Like this it is the float network that has them."""


def measure_reach(sequences: Sequence[Sequence32]) -> list[float]:
    """Return the largest absolute value of each feature [I] that the chip can hold."""
    largest = np.max([np.abs(s.features).max(axis=0) for s in sequences], axis=0)
    return [float(2.0 ** np.ceil(np.log2(max(HEADROOM * x, TINY)))) for x in largest.tolist()]


def round_weights(w_h: Array) -> Array:
    """Return recurrent weights as they leave the training."""
    return np.asarray(np.round(w_h / GRID) * GRID)


def trim_weights(w_h: Array) -> Array:
    """Return an LSTM's recurrent weights as they leave the training, none of them larger."""
    return np.asarray(np.trunc(w_h / FINE_GRID) * FINE_GRID)


def contract(w_x: Tensor, w_h: Tensor, bias: Tensor, reset: str, reach: Tensor) -> None:
    """Shrink the weights of S GRUs where they are too large; in place.

    Args:
        w_x: [S, 3, H, I], gates in the order r, u, n.
        w_h: [S, 3, H, H].
        bias: [S, 4, H]: r, u, n outside the reset product, n inside it.
        reset: "after" or "before".
        reach: [S, I] largest absolute values of the features.
    """
    r, u, n = w_h.abs().sum(dim=3).unbind(dim=1)
    if reset == "after":
        growth = n + 0.25 * (n + bias[:, 3].abs()) * r + u
        w_h *= _shrink(GROWTH, growth)[:, None, :, None]
    else:
        w_h[:, 0] *= _shrink(4.0 * GROWTH, r)[..., None]
        largest = r.amax(dim=1, keepdim=True).clamp(max=4.0 * GROWTH)
        growth = n * (1.0 + 0.25 * largest) + u
        w_h[:, 1:] *= _shrink(GROWTH, growth)[:, None, :, None]
    bias[:, 1].clamp_(min=LEAST_ROOM - SLOWEST)
    lowered = (w_x[:, 1].abs() * reach[:, None]).sum(dim=2) + w_h[:, 1].abs().sum(dim=2)
    factor = _shrink(SLOWEST + bias[:, 1], lowered)[..., None]
    w_x[:, 1] *= factor
    w_h[:, 1] *= factor


def contract_lstm(w_x: Tensor, w_h: Tensor, bias: Tensor, reach: Tensor) -> None:
    """Shrink the weights of S LSTMs where they are too large; in place.

    Args:
        w_x: [S, 4, H, I], gates in the order i, f, g, o.
        w_h: [S, 4, H, H].
        bias: [S, 4, H].
        reach: [S, I] largest absolute values of the features.
    """
    most = GROWTH * torch.tensor([1.0, 0.25, 0.25, 1.0], device=w_h.device)[:, None]
    w_h *= _shrink(most, w_h.abs().sum(dim=3))[..., None]
    moved = (w_x[:, :2].abs() * reach[:, None, None]).sum(dim=3)
    w_x[:, :2] *= _shrink(SPREAD, moved)[..., None]
    moved = moved.clamp(max=SPREAD) + w_h[:, :2].abs().sum(dim=3)
    bias[:, 1] = torch.minimum(bias[:, 1], SLOWEST - moved[:, 1])
    slow = 1.0 + torch.exp(bias[:, 1] + moved[:, 1])
    allowed = torch.logit((RATIO / slow).clamp(max=1.0 - TINY), eps=TINY)
    bias[:, 0] = torch.minimum(bias[:, 0], allowed - moved[:, 0])
    ratio = slow * torch.sigmoid(bias[:, 0] + moved[:, 0])
    i, f, g, _ = w_h.abs().sum(dim=3).unbind(dim=1)
    w_h[:, :3] *= _shrink(0.25 * GROWTH, ratio * (g + 0.25 * i + f))[:, None, :, None]
    bias[:, 2:].clamp_(-HELD, HELD)
    w_x[:, 2:] *= _shrink(HELD, w_x[:, 2:].abs() * reach[:, None, None])
    moved = (w_x[:, 2:].abs() * reach[:, None, None]).sum(dim=3)
    left = 2.0 * HELD - bias[:, 2:].abs() - w_h[:, 2:].abs().sum(dim=3)
    w_x[:, 2:] *= _shrink(left, moved)[..., None]


def _shrink(most: float | Tensor, found: Tensor) -> Tensor:
    """Return the factors that bring numbers down to what is allowed, 1 where they are below."""
    return (most / found.clamp(min=TINY)).clamp(max=1.0)
