"""A GRU's block on emulated cores, in assembly and in C: 0 LSB against the reference."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from tests.blocks.test_blocks import make_block
from tests.blocks.test_gru import find_design, list_units
from zerodrift.c_runtime.cores import CORES
from zerodrift.codegen.generate import generate_design
from zerodrift.export.reference import Reference
from zerodrift.verify.vectors import draw_sequences

if any(importlib.util.find_spec(name) is None for name in ("unicorn", "ziglang")):
    pytest.skip("emulation needs the unicorn and ziglang wheels", allow_module_level=True)

from zerodrift.c_runtime.emulator import EmulatedModel


@pytest.mark.spread(
    2,
    ("core", "flags"),
    [(core, ("-O2",)) for core in CORES]
    + [("cortex-m4", ("-Os",)), ("cortex-m4", ("-O2", "-DZD_NO_ASSEMBLY"))]
    + [("cortex-m0plus", ("-Os",)), ("cortex-m0plus", ("-O2", "-DZD_NO_ASSEMBLY"))],
)
def test_cores_give_the_references_bits(core: str, flags: tuple[str, ...], tmp_path: Path) -> None:
    design = find_design()
    model = design.fit(list_units()[2])
    chip = EmulatedModel(
        model, generate_design(design, make_block(design, model)), core, tmp_path, flags
    )
    assert chip.selftest() == 0
    for settled, codes in enumerate(draw_sequences(model, 250).values()):
        expected = Reference(model).run(codes[None], settled=settled % 2 == 0)
        drift, flags_found = chip.run(codes, settled=settled % 2 == 0)
        assert np.array_equal(drift, expected.drift[0])
        assert np.array_equal(flags_found, expected.flags[0])
