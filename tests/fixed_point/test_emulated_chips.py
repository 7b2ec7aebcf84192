"""The C of every core, dual multiplier included, run on an emulator: 0 LSB against the reference.

Reason for a test of its own beside the host's: the kernels take another path where a chip has DSP
instructions, and another compiler back end makes the code.
"""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.golden.model_factory import Draw, Shape, draw_model

from zerodrift.c_runtime.cores import CORES, find_cross_compilers
from zerodrift.c_runtime.footprint import measure_footprint
from zerodrift.codegen.generate import generate
from zerodrift.export.reference import Reference

if any(importlib.util.find_spec(name) is None for name in ("unicorn", "ziglang")):
    pytest.skip("emulation needs the unicorn and ziglang wheels", allow_module_level=True)

from zerodrift.c_runtime.emulator import EmulatedModel

SHAPES = {
    "everything": Shape(
        front_end=("lowpass", "product", "delay", "difference", "power"),
        hidden=9, outputs=2, code_limit=15000, drift_limit=80.0,
    ),
    "int8 before": Shape(weights="int8", reset="before", hidden=7, inputs=3, gain=20.0),
    "effects": Shape(
        front_end=("exp2", "root", "play", "clip", "late", "mix", "warm_up", "load"),
        hidden=4, inputs=3, outputs=2, code_limit=15000, drift_limit=1e5, measured=(1,),
    ),
    "before": Shape(reset="before", hidden=9, inputs=3, gain=4.0, update_bias=-3.0),
    "before, stack": Shape(reset="before", hidden=6, upper=(3,), inputs=1, outputs=2),
    "int8": Shape(weights="int8", hidden=9, inputs=5, gain=4.0, update_bias=-3.0),
    "int8, stack": Shape(weights="int8", hidden=6, upper=(16,), inputs=4, outputs=2, gain=20.0),
    "lstm": Shape(inputs=5, layered=(("lstm", 9, (0,)),), outputs=2, gain=3.0, forget_bias=4.0),
    "stack of lstms": Shape(
        inputs=1, layered=(("lstm", 4, (0,)), ("lstm", 7, (1,))), outputs=2, gain=12.0
    ),
    "lstm on gru": Shape(
        inputs=3, layered=(("gru", 5, (0,)), ("lstm", 3, (0, 1))), outputs=1, forget_bias=8.0
    ),
    "lstm, int8": Shape(
        weights="int8", inputs=5, layered=(("lstm", 9, (0,)),), outputs=2, gain=3.0, forget_bias=4.0
    ),
    "lstm, int8, stack": Shape(
        weights="int8", inputs=1, layered=(("lstm", 4, (0,)), ("lstm", 7, (1,))), gain=12.0
    ),
    "layer norm": Shape(
        inputs=3,
        layered=(("relu", 5, (0,)), ("norm", 5, (1,)), ("gru", 17, (0, 2)), ("norm", 17, (3,))),
        outputs=2,
        gain=4.0,
    ),
    "window": Shape(window=4, hidden=6, inputs=1, outputs=1),
}  # fmt: skip
QUICK = {
    ("cortex-m0plus", "effects"),
    ("cortex-m0plus", "everything"),
    ("cortex-m4", "everything"),
    ("cortex-m4", "int8 before"),
    ("cortex-m0plus", "before"),
    ("cortex-m0plus", "lstm"),
    ("cortex-m0plus", "stack of lstms"),
    ("cortex-m4", "before"),
    ("cortex-m4", "int8"),
    ("cortex-m4", "int8, stack"),
    ("cortex-m4", "lstm"),
    ("cortex-m4", "stack of lstms"),
    ("cortex-m4", "layer norm"),
    ("cortex-m0plus", "layer norm"),
    ("rv32imc", "layer norm"),
    ("cortex-m4", "lstm, int8"),
    ("cortex-m4", "lstm, int8, stack"),
}
"""What `make test` runs; the rest of cores and shapes are slow tests."""
STEPS = 600


def draw_codes(channels: int) -> np.ndarray[tuple[int, int], np.dtype[np.int16]]:
    """Return rails, noise and a walk, one after the other."""
    draw, third = Draw(6), STEPS // 3
    rails = np.where(draw.uniform(0.0, 1.0, third, channels) < 0.5, -32768, 32767)
    noise = draw.codes(-32768, 32767, third, channels)
    walk = draw.uniform(-900.0, 900.0, third, channels).cumsum(axis=0)
    return np.concatenate([rails, noise, np.clip(walk, -32768, 32767)]).astype(np.int16)


@pytest.mark.spread(
    3,
    ("core", "shape"),
    [
        pytest.param(core, shape, marks=() if (core, shape) in QUICK else pytest.mark.slow)
        for core in CORES
        for shape in SHAPES
    ],
)
def test_chip_equals_reference(core: str, shape: str, tmp_path: Path) -> None:
    model = draw_model(SHAPES[shape], 31)
    chip = EmulatedModel(model, generate(model), core, tmp_path)
    codes = draw_codes(len(model.channels)).astype(model.code_type)
    for k, channel in enumerate(model.channels):
        if channel.bits > 16:
            codes[:, k] *= 2**15  # a raw output, also far beyond its load's limits
    for settled in (True, False):
        expected = Reference(model).run(codes[None], settled=settled)
        drift, flags = chip.run(codes, settled=settled)
        np.testing.assert_array_equal(drift, expected.drift[0])
        np.testing.assert_array_equal(flags, expected.flags[0])
    assert chip.selftest() == 0


@pytest.mark.spread(
    2,
    ("core", "shape"),
    [
        *(("cortex-m4", s) for s in SHAPES if s.startswith(("before", "int8, ", "lstm", "stack"))),
        *(("cortex-m0plus", s) for s in ("before", "before, stack", "lstm", "stack of lstms")),
    ],
)
@pytest.mark.spread(
    2, "flags", [("-Os",), ("-O2", "-DZD_NO_ASSEMBLY"), ("-O2", "-mno-unaligned-access")]
)
def test_layers_that_are_assembly_alone_are_the_same_in_every_build(
    core: str, shape: str, flags: tuple[str, ...], tmp_path: Path
) -> None:
    model = draw_model(SHAPES[shape], 35)
    chip = EmulatedModel(model, generate(model), core, tmp_path, flags)
    codes = draw_codes(len(model.channels))[::3].astype(model.code_type)
    for settled in (True, False):
        expected = Reference(model).run(codes[None], settled=settled)
        drift, flagged = chip.run(codes, settled=settled)
        np.testing.assert_array_equal(drift, expected.drift[0])
        np.testing.assert_array_equal(flagged, expected.flags[0])


@pytest.mark.parametrize(
    ("hidden", "inputs"),
    [
        (1, 1),
        (2, 3),
        (3, 2),
        (17, 8),
        *(
            pytest.param(h, i, marks=pytest.mark.slow)
            for h, i in ((4, 1), (8, 4), (16, 32), (31, 2), (32, 6), (64, 5), (127, 3), (128, 32))
        ),
    ],
)
@pytest.mark.spread(2, "flags", [("-O2",), ("-Os",)])
def test_an_lstm_of_8_bits_is_the_same_at_any_size_by_any_compiler(
    hidden: int, inputs: int, flags: tuple[str, ...], tmp_path: Path
) -> None:
    check_lstm("int8", "cortex-m4", (hidden, inputs), flags, tmp_path)


@pytest.mark.parametrize(
    ("hidden", "inputs"),
    [
        (1, 1),
        (2, 3),
        (17, 8),
        *(pytest.param(h, i, marks=pytest.mark.slow) for h, i in ((64, 5), (127, 3), (128, 32))),
    ],
)
@pytest.mark.spread(1, "flags", [("-O2",), ("-Os",)])
def test_an_lstm_on_the_smallest_cores_is_the_same_at_any_size_by_any_compiler(
    hidden: int, inputs: int, flags: tuple[str, ...], tmp_path: Path
) -> None:
    check_lstm("int16", "cortex-m0plus", (hidden, inputs), flags, tmp_path)


def check_lstm(
    weights: str, core: str, sizes: tuple[int, int], flags: tuple[str, ...], tmp_path: Path
) -> None:
    """Hold an LSTM of so many units and inputs against the reference, by every compiler."""
    hidden, inputs = sizes
    layers = (("lstm", hidden, (0,)),)
    model = draw_model(
        Shape(weights=weights, inputs=inputs, layered=layers, gain=4.0, forget_bias=4.0), 31
    )
    codes = draw_codes(len(model.channels))[::6].astype(model.code_type)
    expected = {s: Reference(model).run(codes[None], settled=s) for s in (True, False)}
    code = generate(model)
    assert ("zd_lstm_bytes_t" if weights == "int8" else "zd_lstm_pairs_t") in code.source
    for compiler in find_cross_compilers(core):
        folder = tmp_path / compiler.name
        folder.mkdir()
        chip = EmulatedModel(model, code, core, folder, flags, compiler)
        for settled, answer in expected.items():
            drift, flagged = chip.run(codes, settled=settled)
            np.testing.assert_array_equal(drift, answer.drift[0])
            np.testing.assert_array_equal(flagged, answer.flags[0])


COUNTED = {
    "lstm, int8": Shape(
        weights="int8", inputs=2, layered=(("lstm", 6, (0,)),), outputs=1, gain=8.0
    ),
    "lstm": Shape(inputs=2, layered=(("lstm", 6, (0,)),), outputs=1, gain=8.0),
    "before": Shape(reset="before", hidden=6, inputs=2, outputs=1, gain=8.0),
    "int8": Shape(weights="int8", hidden=6, inputs=2, outputs=1, gain=8.0),
}


@pytest.mark.parametrize("flags", [("-O2",), ("-Os",)])
@pytest.mark.spread(
    2,
    ("core", "shape"),
    [*(("cortex-m4", s) for s in COUNTED), *(("cortex-m0plus", s) for s in ("before", "lstm"))],
)
def test_instruction_count_of_other_layers_does_not_depend_on_the_data(
    core: str, shape: str, flags: tuple[str, ...], tmp_path: Path
) -> None:
    model = draw_model(COUNTED[shape], 33)
    chip = EmulatedModel(model, generate(model), core, tmp_path, flags)
    draw = Draw(7)
    features = [np.full(2, x, dtype=np.int16) for x in (-32768, 0, 1, 32767)]
    features += [draw.codes(-32768, 32767, 2) for _ in range(8)]
    counts = {chip.count_layer(x) for x in features for _ in range(4)}  # states as they come
    assert len(counts) == 1, sorted(counts)


@pytest.mark.parametrize(
    "core", [pytest.param(c, marks=() if c == "cortex-m4" else pytest.mark.slow) for c in CORES]
)
def test_told_stack_is_enough_for_what_runs(core: str, tmp_path: Path) -> None:
    model = draw_model(SHAPES["everything"], 32)
    code = generate(model)
    stacks = measure_footprint(code, core).stacks
    told = max(size for name, size in stacks if name != "selftest")
    used = EmulatedModel(model, code, core, tmp_path, ("-Os",)).measure_stack(draw_codes(4)[:40])
    assert used - 32 <= told, "32: the call into the model from the emulator's own frame"
    assert told <= used + 64, "and not told far too high"


@pytest.mark.spread(
    1,
    ("core", "flags"),
    [
        ("cortex-m0plus", ("-O2",)),
        ("cortex-m0plus", ("-Os",)),
        ("cortex-m0plus", ("-O2", "-DZD_NO_ASSEMBLY")),
        ("cortex-m4", ("-O2",)),
        ("cortex-m4", ("-Os",)),
        ("cortex-m4", ("-O2", "-DZD_NO_ASSEMBLY")),
        ("rv32imc", ("-O2",)),
        ("rv32imc", ("-Os",)),
    ],
)
def test_instruction_count_does_not_depend_on_the_data(
    core: str, flags: tuple[str, ...], tmp_path: Path
) -> None:
    """One number for rails, zeros and noise, whether the gates saturate or not."""
    model = draw_model(Shape(hidden=6, inputs=2, outputs=1, gain=8.0), 33)
    chip = EmulatedModel(model, generate(model), core, tmp_path, flags)
    draw, limit = Draw(7), 2**30 - 2**15 + 1
    features = [np.full(2, x, dtype=np.int16) for x in (-32768, 0, 1, 32767)]
    features += [draw.codes(-32768, 32767, 2) for _ in range(8)]
    states = [np.full(6, x) for x in (-limit, 0, 1, limit)]
    states += [np.floor(draw.uniform(-limit, limit, 6)).astype(np.int64) for _ in range(4)]
    counts = {chip.count_layer(x, h.astype(np.int32)) for x in features for h in states}
    assert len(counts) == 1, sorted(counts)


@pytest.mark.parametrize("flags", [("-O2",), ("-Os",)])
@pytest.mark.spread(1, "core", ["cortex-m4", "cortex-m0plus", "rv32imc"])
def test_instruction_count_of_a_normalisation_does_not_depend_on_the_data(
    core: str, flags: tuple[str, ...], tmp_path: Path
) -> None:
    """One number for rails, equal numbers, nearly equal ones and noise, whatever the doublings."""
    shape = Shape(inputs=2, layered=(("gru", 6, (0,)), ("norm", 6, (1,))), outputs=1, gain=8.0)
    model, draw = draw_model(shape, 33), Draw(7)
    chip = EmulatedModel(model, generate(model), core, tmp_path, flags)
    rows = [np.full(6, x) for x in (-32768, 0, 1, 32767)]
    rows += [np.array([-32768, 32767] * 3), np.array([0, 0, 0, 0, 0, 1])]
    rows += [draw.codes(-(2**k), 2**k - 1, 6) for k in range(1, 16)]
    counts = {chip.count_norm(row.astype(np.int16)) for row in rows}
    assert len(counts) == 1, sorted(counts)


LARGE = {
    "lstm, int8": Shape(weights="int8", inputs=4, layered=(("lstm", 16, (0,)),), outputs=1),
    "lstm": Shape(inputs=4, layered=(("lstm", 16, (0,)),), outputs=1),
    "before": Shape(reset="before", hidden=16, inputs=4, outputs=1),
    "int8": Shape(weights="int8", hidden=16, inputs=4, outputs=1),
}


@pytest.mark.spread(
    1,
    ("core", "shape", "most"),
    [
        ("cortex-m4", "lstm", 1728),
        ("cortex-m4", "before", 1400),
        ("cortex-m0plus", "before", 7200),
        ("cortex-m0plus", "lstm", 8320),
        ("cortex-m4", "int8", 1900),
        ("cortex-m4", "lstm, int8", 2400),
    ],
)
def test_a_step_of_16_units_takes_no_more_instructions_than_its_mark(
    core: str, shape: str, most: int, tmp_path: Path
) -> None:
    model = draw_model(LARGE[shape], 36)
    assert EmulatedModel(model, generate(model), core, tmp_path).count_layer() <= most


def test_weights_of_8_bits_save_an_eighth_of_the_layer_s_flash() -> None:
    flash = [
        measure_footprint(
            generate(draw_model(Shape(weights=weights, hidden=16, inputs=4, outputs=1), 36))
        ).layer_flash_bytes
        for weights in ("int16", "int8")
    ]
    assert flash[1] <= 0.88 * flash[0]


def test_an_lstm_of_8_bits_takes_less_flash_than_one_of_16() -> None:
    flash = {
        weights: measure_footprint(
            generate(draw_model(replace(LARGE["lstm, int8"], weights=weights), 36))
        ).layer_flash_bytes
        for weights in ("int16", "int8")
    }
    assert flash["int8"] <= 0.9 * flash["int16"]


@pytest.mark.slow
def test_dual_multiplier_pays(tmp_path: Path) -> None:
    model = draw_model(Shape(hidden=16, inputs=4, outputs=1), 34)
    counts = {}
    for core in ("cortex-m3", "cortex-m4"):
        (tmp_path / core).mkdir()
        chip = EmulatedModel(model, generate(model), core, tmp_path / core)
        counts[core] = chip.count_layer()
    assert counts["cortex-m4"] < 0.5 * counts["cortex-m3"]
