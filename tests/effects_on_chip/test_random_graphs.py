"""Graphs of any operations on any operations: float, integers and C say the same."""

import math
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.effects_on_chip.random_graphs import (
    LSB_PER_UNIT,
    LSBS,
    OPERATIONS,
    Draw,
    build,
    draw_codes,
    quantize_graph,
)

from zerodrift.c_runtime.compilers import find_compilers
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.export.reference import Reference
from zerodrift.operations.operation import Node, list_nodes
from zerodrift.verify.host_check import check_host
from zerodrift.verify.vectors import draw_sequences

pytestmark = pytest.mark.long

LARGEST_ERROR = 2.0**-21
"""RMS, of signals of a size of 1; gains above 1 on the way magnify it."""
draws = st.tuples(
    st.sampled_from(OPERATIONS),
    st.integers(0, 20),
    st.integers(0, 20),
    st.floats(0.0, 1.0, allow_subnormal=False),
    st.floats(0.0, 1.0, allow_subnormal=False),
)
RELAXED = [HealthCheck.too_slow, HealthCheck.data_too_large]


def check(
    plan: list[Draw], seed: int, compiler: int = 0, flags: tuple[str, ...] = ("-O1",)
) -> None:
    """Compare float with integers, and integers with C, of one graph."""
    codes = draw_codes(seed)
    inputs = {f"x{i}": codes[:, i] * lsb for i, lsb in enumerate(LSBS)}
    nodes, values = build(plan, inputs)
    model = quantize_graph(nodes, codes)
    drift = Reference(model).run(codes[None]).drift[0] / LSB_PER_UNIT
    for k, node in enumerate(nodes[-4:]):
        error = float(np.sqrt(np.mean((drift[:, k] - values[node]) ** 2)))
        assert error <= 0.5 / LSB_PER_UNIT + gain_of(node) * LARGEST_ERROR, repr(node)
    with tempfile.TemporaryDirectory() as scratch:
        compilers = find_compilers()
        chosen = compilers[compiler % len(compilers)]
        host = HostModel(model, generate(model), Path(scratch), chosen, flags=flags)
        assert host.selftest() == 0
        for settled, (name, more) in enumerate(draw_sequences(model, 500).items()):
            outcome = check_host(host, more, settled=settled % 2 == 0)
            assert outcome.mismatch is None, f"{name}: {outcome.mismatch}"


def gain_of(node: Node) -> float:
    """Return the product of all gains above 1 that an error may meet on its way."""
    gains = [abs(n.constants[0]) for n in list_nodes([node]) if n.op == "affine"]
    return math.prod(gain for gain in gains if gain > 1.0)


@settings(max_examples=25, deadline=None, derandomize=True, suppress_health_check=RELAXED)
@given(plan=st.lists(draws, min_size=1, max_size=9), seed=st.integers(0, 1000))
def test_random_graph_is_the_same_in_float_integers_and_c(plan: list[Draw], seed: int) -> None:
    check(plan, seed)


@pytest.mark.slow
@settings(max_examples=400, deadline=None, suppress_health_check=RELAXED)
@given(
    plan=st.lists(draws, min_size=1, max_size=16),
    seed=st.integers(0, 10_000),
    compiler=st.integers(0, 1),
    optimise=st.sampled_from(("-O0", "-O2", "-O3", "-Os")),
)
def test_many_random_graphs_are_the_same(
    plan: list[Draw], seed: int, compiler: int, optimise: str
) -> None:
    check(plan, seed, compiler, (optimise,))
