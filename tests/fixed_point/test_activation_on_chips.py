"""Every line of the activation table and both ends of it, read by each core in each form."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.golden.model_factory import Shape, draw_model

from zerodrift.c_runtime.cores import CORES
from zerodrift.codegen.generate import generate
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.operations.gru.cell import IntegerGru

if any(importlib.util.find_spec(name) is None for name in ("unicorn", "ziglang")):
    pytest.skip("emulation needs the unicorn and ziglang wheels", allow_module_level=True)

from zerodrift.c_runtime.emulator import EmulatedModel

pytestmark = pytest.mark.long

LINES, STEP = 512, 2048
INSIDE = 2**21
SHIFTS = (0, 1, 2, 4)
"""Of the update gate; the assembly of the small form shifts by 2 and more in another way."""


def make_gru(shift: int) -> IntegerGru:
    """Return units in whose gates r, u and n, one each, t = 2048 x[0] + x[1] >> shift.

    Features beyond the table's ends give sums of up to 30 bits.
    """
    w_x = np.zeros((3, 3, 2), dtype=np.int16)
    for gate in range(3):
        w_x[gate, gate] = STEP, 1
    bias = np.zeros((4, 3), dtype=np.int32)
    bias[3, 0] = INSIDE  # the candidate of the first unit is r times this
    bias[1, 0] = bias[1, 2] = bias[2, 1] = 2**29  # gates that are not swept are wide open
    return IntegerGru(w_x, np.zeros((3, 3, 3), np.int16), bias, (shift, shift, shift), "after")


def make_model(gru: IntegerGru) -> IntegerModel:
    """Return a model whose recurrent layer is `gru`."""
    model = draw_model(Shape(inputs=2, hidden=3, outputs=1), 5)
    layer = next(node for node in model.nodes if isinstance(node, IntegerGruLayer))
    nodes = tuple(replace(node, gru=gru) if node is layer else node for node in model.nodes)
    return replace(model, nodes=nodes)


def draw_features(shift: int) -> NDArray[np.int16]:
    """Return features [N, 2] about the ends of each line, between them, and far beyond."""
    lines = np.arange(-LINES // 2 - 3, LINES // 2 + 3) << shift
    lines = np.append(lines, [-32768, -32767, 32767]).clip(-32768, 32767)
    within = [-1, 0, 1, 2**shift - 1, 2**shift, 1023 << shift]
    return np.array([(line, offset) for line in lines for offset in within], dtype=np.int16)


@pytest.mark.parametrize("flags", ["-O2", "-Os", "-Os -DZD_NO_ASSEMBLY"])
@pytest.mark.parametrize(
    "core",
    [
        c if c in ("cortex-m4", "cortex-m0plus") else pytest.param(c, marks=pytest.mark.slow)
        for c in CORES
    ],
)
def test_every_line_is_read_as_the_reference_reads_it(
    core: str, flags: str, tmp_path: Path
) -> None:
    for shift in SHIFTS:
        model = make_model(gru := make_gru(shift))
        folder = tmp_path / str(shift)
        folder.mkdir()
        chip = EmulatedModel(model, generate(model), core, folder, tuple(flags.split()))
        features = draw_features(shift)
        h_q30 = np.array([0, -(2**29), 2**20], dtype=np.int32)
        expected = gru.step(features, np.tile(h_q30, (len(features), 1)).astype(np.int64))
        found = np.array([chip.step_layer(row, h_q30) for row in features])
        np.testing.assert_array_equal(found, expected)
        assert len(np.unique(expected[:, 1])) > 2 * 350  # every line that is not level was read
