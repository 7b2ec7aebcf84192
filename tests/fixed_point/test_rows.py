"""The rows kernels, lane by lane on a host: each recurrent layer at 0 LSB against the reference."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.fixed_point.strategies import shapes
from tests.fixed_point.test_random_models import RELAXED, compare
from tests.golden.model_factory import Shape, draw_model
from tests.golden.models import CASES
from tests.golden.vectors import crc_of, load, run_host

from zerodrift.c_runtime.compilers import HOST_MVE_DIRECTORY, find_compilers
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.verify.host_check import check_host
from zerodrift.verify.vectors import draw_sequences

ROWS = ("-DZD_KERNEL=2", f"-I{HOST_MVE_DIRECTORY}")
RECURRENT = [name for name in CASES if load(name).model.recurrents]
STEPS = ("zd_gru_step_rows(", "zd_gru_step_rows_before(", "zd_lstm_step_rows(")
SHIFTS = [(0, 1, 2), (31, 32, 33), (45, 44, 46)]
"""Of multipliers: on either side of where the halves of a 64-bit product meet."""


def draw_scaled_model(reset: str, shifts: tuple[int, int, int]) -> IntegerModel:
    """Return a model of 8-bit weights whose multipliers are shifted by these numbers."""
    model = draw_model(Shape(weights="int8", reset=reset, hidden=6, inputs=2, gain=4.0), 8)
    layer = next(n for n in model.nodes if isinstance(n, IntegerGruLayer))
    assert layer.gru.multiplier is not None
    share = layer.gru.multiplier * 2.0 ** -np.array(layer.gru.multiplier_shift)[:, None]
    limited = np.clip(share * 2.0 ** np.array(shifts)[:, None], 1, 2**31 - 1)
    multiplier = np.round(limited).astype(np.int32)
    gru = replace(layer.gru, multiplier=multiplier, multiplier_shift=shifts)
    nodes = tuple(replace(n, gru=gru) if n is layer else n for n in model.nodes)
    return replace(model, nodes=nodes)


@pytest.mark.spread(3, "name", RECURRENT)
def test_rows_replay_golden_vectors(name: str, tmp_path: Path) -> None:
    golden = load(name)
    code = generate(golden.model)
    assert any(step in code.source for step in STEPS)
    host = HostModel(golden.model, code, tmp_path, find_compilers()[0], flags=("-O1", *ROWS))
    rows = run_host(host, golden.codes, golden.settled)
    np.testing.assert_array_equal(rows[golden.every - 1 :: golden.every], golden.rows)
    assert crc_of(rows) == golden.crc
    assert host.selftest() == 0


@pytest.mark.long
@settings(max_examples=12, deadline=None, derandomize=True, suppress_health_check=RELAXED)
@given(shape=shapes(), seed=st.integers(0, 2**31))
def test_rows_of_random_models_equal_the_reference(shape: Shape, seed: int) -> None:
    """The reset gate on either side of the product, weights of 16 and of 8 bits."""
    compare(shape, seed, steps=300, flags=("-O1", *ROWS))


LSTMS = {
    "one": Shape(inputs=3, layered=(("lstm", 9, (0,)),), gain=3.0, forget_bias=4.0),
    "one unit": Shape(inputs=1, layered=(("lstm", 1, (0,)),), outputs=1),
    "whole vectors": Shape(inputs=8, layered=(("lstm", 16, (0,)),), gain=8.0),
    "stack": Shape(inputs=9, layered=(("lstm", 4, (0,)), ("lstm", 7, (1,))), gain=12.0),
}


@pytest.mark.parametrize("weights", ["int16", "int8"])
@pytest.mark.spread(2, "shape", LSTMS)
def test_rows_of_an_lstm_equal_the_reference(shape: str, weights: str) -> None:
    compare(replace(LSTMS[shape], weights=weights), 5, steps=300, flags=("-O1", *ROWS))


@pytest.mark.parametrize("shifts", SHIFTS)
@pytest.mark.spread(1, "reset", ["after", "before"])
def test_products_of_8_bits_are_rounded_by_any_shift(
    reset: str, shifts: tuple[int, int, int], tmp_path: Path
) -> None:
    model = draw_scaled_model(reset, shifts)
    host = HostModel(model, generate(model), tmp_path, find_compilers()[0], flags=("-O1", *ROWS))
    for name, codes in draw_sequences(model, 200).items():
        check = check_host(host, codes, settled=False)
        assert check.mismatch is None, f"{name}: {check.mismatch}"
