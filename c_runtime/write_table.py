"""Writes the runtime's tables, as the reference has them, and its identity into all of its files.

The identity is a hash of the runtime's text: `make golden` after every change of one of its files.
"""

from pathlib import Path

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.c_runtime.compilers import INCLUDE_DIRECTORY, RUNTIME_FILES
from zerodrift.codegen.generate import make_environment
from zerodrift.codegen.identity import NO_IDENTITY, identify_runtime
from zerodrift.operations.c_text import crc_of_words
from zerodrift.operations.exp2 import OCTAVE_Q29
from zerodrift.operations.tables import NODE_BITS, STEP_BITS, tanh_nodes

GENERATED = ("zd_tanh_table.h", "zd_exp2.h")
"""Headers made of a template of the same name in codegen/templates."""


def compute_lines() -> tuple[IntArray, IntArray]:
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
    if slope.max() >= 2**15 or np.abs(offset).max() >= 2**30 or largest.max() >= 2**31:
        raise AssertionError("a line of the activation table does not fit int32 and int16")
    return offset, slope


def compute_half() -> tuple[IntArray, IntArray]:
    """Return offset in Q0.30 and slope in Q0.19 of the lines from 0 up to the first level one.

    tanh is odd: at -t the slope is that of t and the offset its negative.
    """
    offset, slope = (line[line.size // 2 :] for line in compute_lines())
    last = int(np.argmax(slope == 0))
    return offset[: last + 1], slope[: last + 1]


def render_runtime() -> dict[Path, str]:
    """Return the runtime as it has to be: path -> text, with its tables and its identity."""
    texts = {path: path.read_text(encoding="utf-8") for path in RUNTIME_FILES if path.exists()}
    texts |= _render_tables()
    identified = identify_runtime({path.name: text for path, text in texts.items()})
    return {path: identified[path.name] for path in texts}


def _render_tables() -> dict[Path, str]:
    """Return the generated headers, without an identity."""
    environment = make_environment()
    offset, slope = compute_lines()
    half_offset, half_slope = compute_half()
    slopes = [*slope.tolist(), 0]
    sigmoid = offset + 2 ** (NODE_BITS + STEP_BITS)
    context = {
        "id": NO_IDENTITY,
        "half_offsets": half_offset.tolist(),
        "half_slopes": half_slope.tolist(),
        "half_crc": crc_of_words([*half_offset.tolist(), *half_slope.tolist()]),
        "offsets": offset.tolist(),
        "sigmoid_offsets": sigmoid.tolist(),
        "sigmoid_crc": crc_of_words(sigmoid.tolist()),
        "slopes": slopes,
        "lines_crc": crc_of_words([*offset.tolist(), *slopes]),
        "octave": OCTAVE_Q29,
        "octave_crc": crc_of_words(OCTAVE_Q29),
    }
    return {
        INCLUDE_DIRECTORY / name: environment.get_template(f"{name}.j2").render(context)
        for name in GENERATED
    }


if __name__ == "__main__":
    for path, text in render_runtime().items():
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            temporary = path.with_name(f".{path.name}.part")
            temporary.write_text(text, encoding="utf-8")
            temporary.replace(path)
