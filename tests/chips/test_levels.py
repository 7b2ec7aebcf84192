"""Every core at every optimisation by every compiler, under unicorn: 0 LSB, and a long run."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from tests.fixed_point.test_emulated_chips import draw_codes
from tests.fixed_point.test_million_steps import walk_slowly
from tests.golden.model_factory import LINEAR, Shape, draw_model

from zerodrift.c_runtime.cores import CORES, find_cross_compilers
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.export.reference import Reference

if importlib.util.find_spec("unicorn") is None:
    pytest.skip("emulation needs the unicorn wheel", allow_module_level=True)

from zerodrift.c_runtime.emulator import EmulatedModel

pytestmark = pytest.mark.long

FLAGS = (("-O0",), ("-O1",), ("-O2",), ("-O3",), ("-Os",), ("-Os", "-DZD_SMALL"))
SHAPE = Shape(hidden=11, inputs=3, outputs=2, gain=3.0)


@pytest.mark.parametrize("flags", FLAGS, ids=" ".join)
@pytest.mark.parametrize(
    "core", [c if c == "cortex-m4" else pytest.param(c, marks=pytest.mark.slow) for c in CORES]
)
def test_core_equals_reference_at_every_level(
    core: str, flags: tuple[str, ...], tmp_path: Path
) -> None:
    model = draw_model(SHAPE, 51)
    codes = draw_codes(SHAPE.inputs)
    expected = Reference(model).run(codes[None])
    compilers = find_cross_compilers(core)
    assert compilers
    for compiler in compilers:
        folder = tmp_path / compiler.name
        folder.mkdir()
        chip = EmulatedModel(model, generate(model), core, folder, flags, compiler)
        drift, told = chip.run(codes, settled=True)
        np.testing.assert_array_equal(drift, expected.drift[0])
        np.testing.assert_array_equal(told, expected.flags[0])
        assert chip.selftest() == 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("core", CORES)
def test_core_equals_reference_for_random_models(core: str, seed: int, tmp_path: Path) -> None:
    """Shapes, sizes of weights, front ends and levels from the seed; by every compiler there is."""
    draw = np.random.default_rng(900 + seed)
    count = int(draw.integers(0, 4))
    shape = Shape(
        hidden=int(draw.integers(1, 24)),
        inputs=int(draw.integers(1, 9)),
        outputs=int(draw.integers(1, 4)),
        gain=float(2.0 ** draw.uniform(-4, 4)),
        reset=str(draw.choice(["after", "before"])),
        weights=str(draw.choice(["int16", "int8"])),
        front_end=tuple(str(kind) for kind in draw.choice(LINEAR, count, replace=False)),
        code_limit=15000,
        drift_limit=80.0,
    )
    model = draw_model(shape, 900 + seed)
    codes = draw_codes(len(model.channels))
    expected = Reference(model).run(codes[None])
    for compiler in find_cross_compilers(core):
        folder = tmp_path / compiler.name
        folder.mkdir()
        level = FLAGS[int(draw.integers(0, len(FLAGS)))]
        chip = EmulatedModel(model, generate(model), core, folder, level, compiler)
        drift, told = chip.run(codes, settled=True)
        np.testing.assert_array_equal(drift, expected.drift[0])
        np.testing.assert_array_equal(told, expected.flags[0])
        assert chip.selftest() == 0


@pytest.mark.slow
def test_a_million_steps_on_the_cortex_m4_equal_the_host(tmp_path: Path) -> None:
    """The host equals the reference by tests/fixed_point/test_million_steps.py."""
    model = draw_model(Shape(hidden=16, inputs=4, outputs=1, update_bias=-5.0), 11)
    code = generate(model)
    codes = walk_slowly(1_000_000, 4)
    expected = HostModel(model, code, tmp_path / "host", observe=False).run(codes, settled=False)
    (tmp_path / "chip").mkdir()
    chip = EmulatedModel(model, code, "cortex-m4", tmp_path / "chip")
    drift, flags = chip.run(codes, settled=False)
    np.testing.assert_array_equal(drift, expected.drift)
    np.testing.assert_array_equal(flags, expected.flags)
