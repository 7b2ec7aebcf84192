"""Writes the runtime's one generated file, src/zd_runtime.c, with the reference's tables."""

import numpy as np
from numpy.typing import NDArray

from zerodrift.c_runtime.compilers import RUNTIME_DIRECTORY
from zerodrift.codegen.generate import make_environment
from zerodrift.codegen.layouts import crc_of_words
from zerodrift.operations.exp2 import OCTAVE_Q29
from zerodrift.operations.tables import STEP_BITS, tanh_nodes

RUNTIME_SOURCE = RUNTIME_DIRECTORY / "src" / "zd_runtime.c"


def compute_lines() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return offset [512] in Q0.30 and slope [512] in Q0.19 of every line between two nodes.

    With p = 2**11 i + f, for line i counted from the middle and 0 <= f < 2**11,
    2**11 node_i + (node_{i+1} - node_i) f = offset_i + slope_i p, with slope_i the difference and
    offset_i = 2**11 (node_i - slope_i i): the same integer without taking p apart.

    Raises:
        AssertionError: the table has changed and a value does not fit its type.
    """
    nodes = tanh_nodes().astype(np.int64)
    slope = nodes[1:] - nodes[:-1]
    line = np.arange(slope.size) - slope.size // 2
    offset = (nodes[:-1] - slope * line) * 2**STEP_BITS
    largest = slope * (np.abs(line) + 1) * 2**STEP_BITS
    if slope.max() >= 2**15 or np.abs(offset).max() >= 2**31 or largest.max() >= 2**31:
        raise AssertionError("a line of the activation table does not fit int32 and int16")
    return offset, slope


def compute_half() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return offset in Q0.30 and slope in Q0.19 of the lines from 0 up to the first level one.

    tanh is odd: at -t the slope is that of t and the offset its negative.
    """
    offset, slope = (line[line.size // 2 :] for line in compute_lines())
    last = int(np.argmax(slope == 0))
    return offset[: last + 1], slope[: last + 1]


def render_runtime_source() -> str:
    """Return zd_runtime.c with the tables that the reference uses."""
    template = make_environment().get_template("zd_runtime.c.j2")
    offset, slope = compute_lines()
    half_offset, half_slope = compute_half()
    slopes = [*slope.tolist(), 0]
    return template.render(
        half_offsets=half_offset.tolist(),
        half_slopes=half_slope.tolist(),
        half_crc=crc_of_words([*half_offset.tolist(), *half_slope.tolist(), *OCTAVE_Q29]),
        offsets=offset.tolist(),
        slopes=slopes,
        lines_crc=crc_of_words([*offset.tolist(), *slopes, *OCTAVE_Q29]),
        octave=OCTAVE_Q29,
    )


if __name__ == "__main__":
    temporary = RUNTIME_SOURCE.with_suffix(".part")
    temporary.write_text(render_runtime_source(), encoding="utf-8")
    temporary.replace(RUNTIME_SOURCE)
