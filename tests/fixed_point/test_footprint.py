"""Flash, RAM and stack as told, against what the model is known to hold."""

import importlib.util
import re
from dataclasses import replace
from pathlib import Path

import pytest
from tests.golden.model_factory import Shape, draw_model
from tests.golden.vectors import load

from zerodrift.base.errors import CheckError, InputError
from zerodrift.c_runtime.cores import CORES, find_cross_compilers
from zerodrift.c_runtime.footprint import HELPER_STACK_BYTES, measure_footprint
from zerodrift.codegen.generate import generate

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("ziglang") is None, reason="sizes need the ziglang wheel"
)
TABLE_BYTES = 4 * 513


@pytest.mark.spread(2, "core", CORES)
def test_footprint_is_plausible_on_every_core(core: str) -> None:
    model = load("front_end").model
    size = measure_footprint(generate(model), core)
    gru = model.recurrent.gru
    constants = TABLE_BYTES + gru.w_x.nbytes + gru.w_h.nbytes + gru.bias.nbytes
    assert constants + 500 < size.flash_bytes < constants + 8000
    # identity, steps, previous; two low-passes; a line of 5 and its position; 8 hidden units
    assert 4 + 4 + 2 + 16 + 20 + 2 + 32 <= size.ram_bytes <= 96
    assert 60 < size.stack_bytes < 1000
    assert size.core == core


@pytest.mark.long
def test_footprint_follows_the_model() -> None:
    small = measure_footprint(generate(draw_model(Shape(hidden=4), 1)))
    large = measure_footprint(generate(draw_model(Shape(hidden=32), 1)))
    narrow = measure_footprint(generate(draw_model(Shape(hidden=32, weights="int8"), 1)))
    assert large.ram_bytes - small.ram_bytes == 4 * 28
    weights = 3 * (32 * 32 - 4 * 4) * 2
    assert 0.8 * weights < large.flash_bytes - small.flash_bytes < 1.5 * weights
    assert large.flash_bytes - narrow.flash_bytes > 0.7 * 3 * 32 * 32
    assert large.stack_bytes - small.stack_bytes >= 2 * 28


def test_stack_counts_what_a_callee_needs() -> None:
    code = generate(draw_model(Shape(hidden=4), 1))
    measured = measure_footprint(code).stack_bytes
    heavy = replace(code, source=re.sub(
        r"(static void gru_step\(.*\{\n)",
        r"\1    volatile uint8_t waste[400];\n    waste[(uint16_t)x[0] % 400u] = 0;\n",
        code.source,
    ))  # fmt: skip
    assert heavy.source != code.source
    # the compiler may put something else where the waste ends
    assert 350 <= measure_footprint(heavy).stack_bytes - measured <= 416


def test_helpers_of_the_compiler_are_named_and_counted() -> None:
    code = generate(draw_model(Shape(hidden=4), 1))
    small, large = (measure_footprint(code, core) for core in ("cortex-m0plus", "cortex-m4"))
    assert "__aeabi_lmul" in small.helpers  # the Cortex-M0+ has no 64-bit product
    assert "__aeabi_lmul" not in large.helpers
    assert small.stack_bytes > HELPER_STACK_BYTES


def test_unknown_core_is_refused_with_the_nearest() -> None:
    with pytest.raises(InputError, match=r"'cortex-m44'.*did you mean 'cortex-m4'"):
        measure_footprint(generate(draw_model(Shape(hidden=1), 1)), "cortex-m44")


def test_code_that_does_not_compile_is_told() -> None:
    code = generate(draw_model(Shape(hidden=1), 1))
    with pytest.raises(CheckError, match="no_such_type"):
        measure_footprint(replace(code, source=code.source + "no_such_type x;\n"))


@pytest.mark.spread(0, "core", ["cortex-m0plus", "cortex-m4", "rv32imc"])
@pytest.mark.parametrize("name", ["front_end", "effects"])
def test_stack_told_by_both_compilers_covers_what_a_run_touches(
    core: str, name: str, tmp_path: Path
) -> None:
    """-fstack-size-section of clang, -fstack-usage of gcc; the emulator sees the bytes written."""
    if importlib.util.find_spec("unicorn") is None:
        pytest.skip("emulation needs the unicorn wheel")
    from zerodrift.c_runtime.emulator import EmulatedModel

    golden = load(name)
    code = generate(golden.model)
    for compiler in find_cross_compilers(core):
        folder = tmp_path / compiler.name
        folder.mkdir()
        told = measure_footprint(code, core, compiler=compiler.name).stack_bytes
        chip = EmulatedModel(golden.model, code, core, folder, ("-Os",), compiler)
        touched = chip.measure_stack(golden.codes[:20])
        # the wrapper that the emulator calls has a frame of its own
        assert 40 < touched <= told + 16, compiler.name
