"""The C of every board that QEMU has, built by GNU cross-compilers: 0 LSB against the reference."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from tests.fixed_point.test_emulated_chips import LARGE, SHAPES, draw_codes
from tests.fixed_point.test_rows import SHIFTS, draw_scaled_model
from tests.golden.model_factory import Shape, draw_model
from tests.golden.vectors import load

from zerodrift.c_runtime.qemu import MACHINES, QemuModel, is_available
from zerodrift.codegen.generate import generate
from zerodrift.export.reference import Reference

pytestmark = pytest.mark.board

LEVELS = ("-O0", "-O1", "-O2", "-O3", "-Os")
QUICK = {
    ("cortex-m3", "-Os"),
    ("cortex-m4", "-O2"),
    ("cortex-m7", "-O3"),
    ("cortex-m33", "-O2"),
    ("cortex-m55", "-O2"),
    ("rv32imc", "-Os"),
}
OF_ROWS = ("before", "before, stack", "int8", "int8 before", "lstm", "lstm, int8, stack")
QUICK_SHAPES = {("cortex-m55", shape) for shape in OF_ROWS}
"""What only this board can run of the vector kernels."""
GOLDEN_ROWS = ("reset_before", "int8", "int8_before", "lstm", "lstm_saturated", "lstm_int8")
STREAM = Shape(hidden=11, inputs=3, outputs=2, gain=3.0)
"""Odd in everything: the last pair, vector and block of each kernel are partly filled."""


def require(core: str) -> None:
    if not is_available(core):
        pytest.skip(f"QEMU or the cross-compiler ({core[:6]}) is not there: make setup-qemu")


def compare(core: str, shape: Shape, seed: int, flags: tuple[str, ...], folder: Path) -> None:
    model = draw_model(shape, seed)
    codes = draw_codes(len(model.channels))
    board = QemuModel(model, generate(model), core, folder, flags)
    for settled in (True, False):
        expected = Reference(model).run(codes[None], settled=settled)
        found = board.run(codes, settled=settled)
        np.testing.assert_array_equal(found.drift, expected.drift[0])
        np.testing.assert_array_equal(found.flags, expected.flags[0])
        assert found.selftest == 0


@pytest.mark.parametrize(
    ("core", "level"),
    [
        pytest.param(core, level, marks=() if (core, level) in QUICK else pytest.mark.slow)
        for core in MACHINES
        for level in LEVELS
    ],
)
def test_board_equals_reference_at_every_level(core: str, level: str, tmp_path: Path) -> None:
    require(core)
    compare(core, STREAM, 41, (level,), tmp_path)


@pytest.mark.long
@pytest.mark.parametrize(
    ("core", "shape"),
    [
        pytest.param(core, shape, marks=() if (core, shape) in QUICK_SHAPES else pytest.mark.slow)
        for core in MACHINES
        for shape in SHAPES
    ],
)
def test_board_equals_reference_for_every_shape(core: str, shape: str, tmp_path: Path) -> None:
    require(core)
    compare(core, SHAPES[shape], 42, ("-O2",), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("core", "seed"),
    [(c, k) for c in MACHINES for k in range(8 if c in ("cortex-m4", "cortex-m55") else 2)],
)
def test_board_equals_reference_for_random_models(core: str, seed: int, tmp_path: Path) -> None:
    require(core)
    shape = Shape(
        hidden=1 + (5 * seed) % 17, inputs=1 + seed % 9, outputs=1 + seed % 3, gain=4.0**seed / 64
    )
    compare(core, shape, 100 + seed, ("-O3",), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("core", "name"),
    [
        *itertools.product(
            ("cortex-m4", "cortex-m55", "rv32imc"),
            ("ordinary", "rails", "saturation", "odd_hidden", "effects"),
        ),
        *(("cortex-m55", name) for name in GOLDEN_ROWS),
    ],
)
def test_board_replays_golden_vectors(core: str, name: str, tmp_path: Path) -> None:
    require(core)
    golden = load(name)
    board = QemuModel(golden.model, generate(golden.model), core, tmp_path)
    found = board.run(golden.codes, settled=golden.settled)
    rows = np.column_stack([found.drift, found.flags.astype(np.int32)])
    outputs = len(golden.model.outputs)
    expected = golden.rows[:, : outputs + 1]
    np.testing.assert_array_equal(rows[golden.every - 1 :: golden.every], expected)


@pytest.mark.parametrize("shifts", SHIFTS)
@pytest.mark.parametrize("reset", ["after", "before"])
def test_products_of_8_bits_are_rounded_by_any_shift_on_the_m55(
    reset: str, shifts: tuple[int, int, int], tmp_path: Path
) -> None:
    require("cortex-m55")
    model = draw_scaled_model(reset, shifts)
    codes = draw_codes(len(model.channels))
    found = QemuModel(model, generate(model), "cortex-m55", tmp_path).run(codes, settled=False)
    expected = Reference(model).run(codes[None], settled=False)
    np.testing.assert_array_equal(found.drift, expected.drift[0])


MARKS_55 = {"before": 800, "int8": 1000, "lstm": 1024, "lstm, int8": 1400}
"""Instructions of a step of 16 units on 4 inputs: 0.8 to 1.1 for each multiplication."""


@pytest.mark.parametrize("shape", MARKS_55)
def test_a_step_on_the_m55_takes_no_more_instructions_than_its_mark(
    shape: str, tmp_path: Path
) -> None:
    require("cortex-m55")
    model = draw_model(LARGE[shape], 36)
    board = QemuModel(model, generate(model), "cortex-m55", tmp_path)
    still = np.zeros((1, model.columns), dtype=model.code_type)
    assert 0 < board.run(still).layer_instructions <= MARKS_55[shape]
