"""Steps that are told their time: bits, step response, what is collected, and what a step costs.

Models are low-passes of a thermometer, made as the tests' are; seeds are others. The step response
is compared with its closed form in double precision.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tests.blocks.units import describe_unit
from tests.variable_step.models import make_lowpass, make_model

from benchmarks.bench_conditions import bound
from zerodrift.base.arrays import Array
from zerodrift.c_runtime.compilers import SANITIZE, can_sanitize, find_compiler
from zerodrift.c_runtime.emulator import EmulatedModel
from zerodrift.c_runtime.footprint import measure_footprint
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.export.quantize import quantize
from zerodrift.verify.host_check import check_host
from zerodrift.verify.vectors import draw_sequences

TAUS_S = (1e-3, 1.0, 95.0, 36_000.0, 3.2e7)
STEPS, MODEL_STEPS, CHIP_STEPS = 1_000_000, 200_000, 4000
SEED = 77_000
CORES = ("cortex-m0plus", "cortex-m4", "rv32imc")
RATIOS = 10.0 ** np.arange(-6.0, 3.01, 0.25)
STEP_CODES = 20_000
LSB = 2.0**12
"""Counts of a low-pass's output in one code."""
LONGEST_RESPONSE = 3_000_000
WITHIN = 1e-3


def main(quick: bool) -> None:
    """Print every mark of a variable step with what was reached."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        compare_bits(folder, STEPS // (50 if quick else 1))
        compare_models(folder, MODEL_STEPS // (50 if quick else 1))
        compare_cores(folder, CHIP_STEPS // (10 if quick else 1))
        measure_response(folder, RATIOS[::6] if quick else RATIOS)
        measure_collected(folder, 20_000 if quick else 1_000_000)
        measure_cost(folder)


def draw_steps(seed: int, count: int, tau_s: float) -> NDArray[np.int64]:
    """Return random codes and times [count, 2], dt/tau log-uniform from 1e-6 to 1e3."""
    rng = np.random.default_rng(seed)
    times = 10 ** rng.uniform(-6.0, 3.0, count) * tau_s * 1e6
    codes = rng.integers(-32768, 32768, count)
    return np.stack([codes, np.maximum(np.round(times), 1).astype(np.int64)], axis=1)


def compare_bits(folder: Path, steps: int) -> None:
    """Print how many steps of how many differ, for single low-passes."""
    compiler = find_compiler()
    flags = SANITIZE if can_sanitize(compiler, folder) else ()
    told = "undefined behaviour ends the program" if flags else "without a sanitizer"
    differ = 0
    for number, tau_s in enumerate(TAUS_S):
        model = make_lowpass((tau_s,))
        host = HostModel(model, generate(model), folder / f"bits{number}", flags=("-O1", *flags))
        outcome = check_host(host, draw_steps(SEED + number, steps, tau_s))
        differ += outcome.mismatch is not None
        print(f"tau {tau_s:g} s, dt/tau 1e-6 to 1e3, {steps} random steps: "
              + ("0 LSB" if outcome.mismatch is None else str(outcome.mismatch)))  # fmt: skip
    total = steps * len(TAUS_S)
    most = bound(differ, len(TAUS_S) * steps, upper=True)
    print(f"  {differ} of {total} steps differ, nodes, states and flags compared at each ({told});"
          f" at most {most:.1e} of them")  # fmt: skip


def compare_models(folder: Path, steps: int) -> None:
    """Print the same of models with plays, loads, a clock and inputs without a reading."""
    for guarded in (False, True):
        model = make_model(seed=SEED, guarded=guarded)
        host = HostModel(model, generate(model), folder / f"model{guarded}")
        found = [check_host(host, c).mismatch for c in draw_sequences(model, steps).values()]
        wrong = [str(one) for one in found if one is not None]
        print(f"model of {len(model.nodes)} operations, {'guarded, ' * guarded}times from 0 to 2^61"
              f" us, {steps} steps: {wrong[0] if wrong else '0 LSB'}")  # fmt: skip


def compare_cores(folder: Path, steps: int) -> None:
    """Print the same of emulated cores, against the host."""
    model = make_lowpass(TAUS_S)
    code = generate(model)
    host = HostModel(model, code, folder / "cores")
    codes = np.concatenate([draw_steps(SEED + 10 + k, steps, tau) for k, tau in enumerate(TAUS_S)])
    expected = host.run(codes)
    for core in CORES:
        place = folder / core
        place.mkdir()
        drift, flags = EmulatedModel(model, code, core, place).run(codes)
        same = (drift == expected.drift).all() and (flags == expected.flags).all()
        print(f"{core}, emulated, {len(codes)} steps: {'0 LSB' if same else 'DIFFERS'}")


def measure_response(folder: Path, ratios: Array) -> None:
    """Print how far the answer to a step is from its closed form, in % of the step."""
    tau_s = 1000.0
    model = make_lowpass((tau_s,))
    host = HostModel(model, generate(model), folder / "response")
    worst = 0.0
    for ratio in ratios:
        count = min(max(int(8 / ratio), 4), LONGEST_RESPONSE)
        codes = np.full((count, 2), STEP_CODES // 2, dtype=np.int64)
        codes[:, 1] = round(ratio * tau_s * 1e6)
        codes[0] = (-STEP_CODES // 2, 0)
        found = (host.run(codes).nodes[:, 1] / LSB + STEP_CODES / 2) / STEP_CODES
        r = codes[1, 1] / (tau_s * 1e6)
        a = -np.expm1(-r)
        c = 1 - a / r if r > 1e-4 else r / 2 - r * r / 6
        expected = np.concatenate([[0.0], 1 - (1 - c) * np.exp(-r * np.arange(count - 1))])
        off = float(np.abs(found - expected).max())
        worst = max(worst, off)
        print(f"  dt/tau {ratio:8.2e}, {count:8d} steps, {count * r:8.3g} tau: {100 * off:.2e} %"
              " of the step")  # fmt: skip
    verdict = "reached" if worst <= WITHIN else "MISSED"
    print(f"step response, {len(ratios)} values of dt/tau: {100 * worst:.1e} % of the step at worst"
          f" (to reach 0.1 %: {verdict})")  # fmt: skip


def measure_collected(folder: Path, steps: int) -> None:
    """Print what becomes of steps that are too short to move anything by themselves."""
    tau_s = 36_000.0
    model = make_lowpass((tau_s,))
    host = HostModel(model, generate(model), folder / "collected")
    for time_us in (1, 100, 5000):
        codes = np.full((steps, 2), STEP_CODES // 2, dtype=np.int64)
        codes[:, 1] = time_us
        codes[0] = (-STEP_CODES // 2, 0)
        found = (host.run(codes).nodes[:, 1] / LSB + STEP_CODES / 2) / STEP_CODES
        expected = -np.expm1(-time_us / (tau_s * 1e6) * np.arange(steps))
        off = 100 * float(np.abs(found - expected).max())
        print(f"{steps} steps of {time_us} us at tau {tau_s:g} s (dt/tau"
              f" {time_us / tau_s / 1e6:.1e}): {off:.1e} % of the step")  # fmt: skip


def measure_cost(folder: Path) -> None:
    """Print instructions a step and flash, of a fixed and of a variable step."""
    floating, calibration = describe_unit(SEED)
    models = [
        quantize(replace(floating, variable_step=variable), calibration)
        for variable in (False, True)
    ]
    codes = np.zeros((6, 2), dtype=np.int64)
    codes[:, 0] = 1000 * np.arange(6)
    for core in CORES:
        counts, flash = [], []
        for variable, model in enumerate(models):
            place = folder / f"cost-{core}-{variable}"
            place.mkdir()
            chip = EmulatedModel(model, generate(model), core, place)
            given = codes[:, : model.columns]
            counts.append(max(chip.count_instructions(given)))
            flash.append(measure_footprint(generate(model), core).flash_bytes)
        print(f"{core}, one low-pass: {counts[0]} instructions a step fixed, {counts[1]} variable;"
              f" flash {flash[0]} and {flash[1]} B")  # fmt: skip
