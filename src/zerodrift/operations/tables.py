"""The one activation table: tanh by 513 nodes with lines between them; sigmoid from the same.

Input of tanh is `t_q16`, a 20-bit signed number in Q3.16, so that the table spans -8 .. 8; sigmoid
reads the same table at half its argument and so spans -16 .. 16. The interpolated value keeps all
of its bits: nodes in Q0.19 and 11 bits between them give tanh in Q0.30 and sigmoid in Q0.31.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache

import numpy as np
from numpy.typing import NDArray

from zerodrift.operations.arithmetic import IntArray, Wholes, saturate
from zerodrift.operations.c_text import RuntimePart
from zerodrift.operations.node import Writer

Int32Array = NDArray[np.int32]

TANH = RuntimePart("zd_network.h", "zd_tanh_is_sound")
CURVES = RuntimePart("zd_network.h", "zd_gates_are_sound")
"""Of recurrent layers: tanh, and the sigmoid beside it."""

NODES = 513
NODE_BITS = 19
TABLE_BITS = 16
"""Fractional bits of the table's argument."""
STEP_BITS = 11  # 2**11 inputs between two nodes
T_MAX = 2**19 - 1
T_MIN = -(2**19)
NODE_MAX = 2**NODE_BITS - 2 ** (NODE_BITS - 15)
"""1 - 2**-15: a state that follows the table still fits 16 bits when it is copied in Q0.15."""


@cache
def tanh_nodes() -> Int32Array:
    """Return the 513 nodes in Q0.19, odd-symmetric and monotone.

    A chord of tanh lies on one side of the curve, by up to f'' h**2 / 8 for nodes h apart; nodes
    moved by half of that to the other side halve the worst error. 19 bits, where 15 would do for
    tanh, are for the tail of the sigmoid: a unit with a memory of an hour moves by u = 1/3600, and
    a coarse u is a wrong time constant.

    Limits: worst error of the interpolated tanh 1.57 LSB of Q0.15, of the sigmoid 0.79.
    """
    position = np.arange(-(NODES // 2), NODES // 2 + 1) / 32.0
    curve = np.tanh(position)
    bend = -2.0 * curve * (1.0 - curve**2)  # second derivative of tanh
    nodes = np.round((curve - bend / 32.0**2 / 16.0) * 2.0**NODE_BITS)
    return np.clip(nodes, -NODE_MAX, NODE_MAX).astype(np.int32)


@cache
def _starts_and_slopes() -> tuple[Int32Array, Int32Array]:
    """Return the left node of each of the 512 intervals in Q0.30, and its rise in Q0.19."""
    nodes = tanh_nodes()
    return nodes[:-1] << STEP_BITS, np.diff(nodes)


_watchers: list[Callable[[IntArray], object]] = []


@contextmanager
def watching_lines(tell: Callable[[IntArray], object]) -> Iterator[None]:
    """Tell a function the line, 0 .. 511, of every number that is looked up meanwhile."""
    _watchers.append(tell)
    try:
        yield
    finally:
        _watchers.remove(tell)


def is_watched() -> bool:
    """Tell whether someone is told the lines that are looked up."""
    return bool(_watchers)


def tanh_q30(t_q16: Wholes) -> Int32Array:
    """Return tanh(t) in Q0.30 for t in Q3.16, saturating outside -8 .. 8.

    No rounding takes place, hence tanh_q30(-t) = -tanh_q30(t) exactly.

    Limits: between -(2**30 - 2**15) and 2**30 - 2**15.
    """
    starts, slopes = _starts_and_slopes()
    position = saturate(t_q16, T_MIN, T_MAX).astype(np.int32, copy=False) - T_MIN
    index = position >> STEP_BITS
    for tell in _watchers:
        tell(index)
    fraction = position & (2**STEP_BITS - 1)
    # 0 <= index < 512 by the saturation above; mode "clip" only leaves out numpy's own check
    return np.asarray(starts.take(index, mode="clip") + slopes.take(index, mode="clip") * fraction)


def sigmoid_q31(half_t_q16: Wholes) -> Int32Array:
    """Return sigmoid(2 t) = (1 + tanh(t)) / 2 in Q0.31 for t in Q3.16.

    Limits: between 2**15 and 2**31 - 2**15; sigmoid_q31(-t) = 2**31 - sigmoid_q31(t) exactly.
    """
    return np.asarray((1 << 30) + tanh_q30(half_t_q16))


def write_tanh(w: Writer, t_q16: str) -> str:
    """Write tanh in Q0.30 of t in Q3.16, from the one table."""
    nodes = tanh_nodes().astype(np.int64)
    position = w.sub(w.saturate(t_q16, T_MIN, T_MAX), w.constant(T_MIN))
    width = w.constant(1 << STEP_BITS)
    index = w.op("Div", position, width)  # position >= 0
    fraction = w.op("Mod", position, width)
    start = w.op("Gather", w.constant(nodes[:-1] << STEP_BITS), index)
    slope = w.op("Gather", w.constant(np.diff(nodes)), index)
    return w.add(start, w.mul(slope, fraction))


def write_sigmoid(w: Writer, half_t_q16: str) -> str:
    """Write the sigmoid in Q0.31 of twice t in Q3.16."""
    return w.add(write_tanh(w, half_t_q16), w.constant(1 << 30))
