"""Recurrent layers beside their marks: instructions of a step, flash, an LSTM over a long run."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray

from benchmarks.bench_kernels import (
    HIDDEN,
    INPUTS,
    LSB_DEGC,
    LSB_PER_UNIT,
    OUTPUTS,
    Compensator,
    draw_fast_float,
    draw_slow_compensator,
    draw_temperature,
)
from zerodrift.base.arrays import Array
from zerodrift.c_runtime.cores import CORES
from zerodrift.c_runtime.emulator import EmulatedModel
from zerodrift.c_runtime.footprint import measure_footprint
from zerodrift.c_runtime.host import HostModel
from zerodrift.c_runtime.qemu import QemuModel, is_available
from zerodrift.codegen.generate import generate
from zerodrift.export.float_model import FloatModel
from zerodrift.export.float_network import FloatNetwork
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.quantize import quantize
from zerodrift.operations.backend import evaluate
from zerodrift.operations.lstm.cell import FloatLstm

LSTM_MARK_PCT = 0.15
"""RMS of int16 against float over 1e5 steps, of the output's RMS about its mean."""


@dataclass(frozen=True)
class StepMark:
    """What a step of GRU or LSTM with 16 units on 4 inputs was to take on a core."""

    layer: str
    core: str
    flags: tuple[str, ...]
    most: int | None
    """Instructions, call and return included; None: told without a mark."""


MARKS = (
    StepMark("gru int16", "cortex-m4", ("-O2",), 1056),
    StepMark("gru int16", "cortex-m4", ("-Os",), 1152),
    StepMark("gru before", "cortex-m4", ("-O2",), 1400),
    StepMark("gru before", "cortex-m4", ("-Os",), None),
    StepMark("gru before", "cortex-m0plus", ("-O2",), 7200),
    StepMark("gru int8", "cortex-m4", ("-O2",), 1900),
    StepMark("gru int8", "cortex-m4", ("-Os",), None),
    StepMark("gru int8", "cortex-m0plus", ("-O2",), None),
    StepMark("lstm int16", "cortex-m4", ("-O2",), 1856),
    StepMark("lstm int16", "cortex-m4", ("-Os",), None),
    StepMark("lstm int16", "cortex-m0plus", ("-O2",), 8320),
    StepMark("lstm int8", "cortex-m4", ("-O2",), 2400),
    StepMark("lstm int8", "cortex-m4", ("-Os",), None),
    StepMark("gru int16", "cortex-m55", ("-O2",), 750),
    StepMark("gru before", "cortex-m55", ("-O2",), 800),
    StepMark("gru int8", "cortex-m55", ("-O2",), 1000),
    StepMark("gru before int8", "cortex-m55", ("-O2",), None),
    StepMark("lstm int16", "cortex-m55", ("-O2",), 1024),
    StepMark("lstm int8", "cortex-m55", ("-O2",), 1400),
)


def main(quick: bool) -> None:
    """Print every figure; `quick` shortens the runs."""
    print_steps()
    print_flash()
    print_lstm_errors(range(4 if quick else 12), steps=20_000 if quick else 100_000)


def draw_layer(layer: str) -> Compensator:
    """Return a fast model of one recurrent layer, such as "gru before", in float."""
    kind, form, *_ = layer.split()
    drawn = draw_fast_float()
    network = drawn.model.network
    assert network is not None
    if kind == "lstm":
        return replace(drawn, model=replace(drawn.model, network=_draw_lstm(OUTPUTS)))
    if form == "before":
        (gru,) = network.grus
        bias = gru.bias.copy()
        bias[3] = 0.0
        before = network.replace_grus([replace(gru, reset="before", bias=bias)])
        return replace(drawn, model=replace(drawn.model, network=before))
    return drawn


def _draw_lstm(outputs: int) -> FloatNetwork:
    rng = np.random.default_rng(1)
    lstm = FloatLstm(
        rng.normal(size=(4, HIDDEN, INPUTS)),
        rng.normal(size=(4, HIDDEN, HIDDEN)) / np.sqrt(HIDDEN),
        rng.normal(size=(4, HIDDEN)) * 0.5,
    )
    return FloatNetwork.stack((lstm,), rng.normal(size=(outputs, HIDDEN)), np.zeros(outputs))


def print_steps() -> None:
    """Print the instructions of a step of each layer."""
    print(
        f"instructions of a step of the recurrent layer alone, H = {HIDDEN}, {INPUTS} inputs, call"
        " and return included;"
    )
    print("clang of the ziglang wheel, counted by unicorn; the M55 by gcc and QEMU's clock")
    for mark in MARKS:
        drawn = draw_layer(mark.layer)
        weights = "int8" if mark.layer.endswith("int8") else "int16"
        model = quantize(drawn.model, drawn.calibration, weights)
        with tempfile.TemporaryDirectory() as scratch:
            count = count_step(model, mark, Path(scratch))
        if count is None:
            print(f"  {mark.layer:15} {mark.core}: not measured, `make setup-qemu`")
            continue
        gates = 4 if mark.layer.startswith("lstm") else 3
        per_mac = count / (gates * HIDDEN * (HIDDEN + INPUTS))
        verdict = ""
        if mark.most is not None:
            verdict = f"{'reached' if count <= mark.most else 'MISSED'}: {mark.most}"
        flags = " ".join(mark.flags)
        print(f"  {mark.layer:15} {mark.core:13} {flags:4} {count:6} {per_mac:6.3f} {verdict}")


def count_step(model: IntegerModel, mark: StepMark, folder: Path) -> int | None:
    """Return the instructions of a step of the layer; None where nothing here emulates the core."""
    code = generate(model)
    if mark.core in CORES:
        return EmulatedModel(model, code, mark.core, folder, mark.flags).count_layer()
    if not is_available(mark.core):
        return None
    still = np.zeros((1, model.columns), dtype=model.code_type)
    return round(
        QemuModel(model, code, mark.core, folder, mark.flags).run(still).layer_instructions
    )


def print_flash() -> None:
    """Print the flash of a GRU's and an LSTM's layer with weights of 8 bits beside 16."""
    for kind, mark in (("gru", 12.0), ("lstm", 0.0)):
        sizes = []
        for weights in ("int16", "int8"):
            drawn = draw_layer(f"{kind} {weights}")
            code = generate(quantize(drawn.model, drawn.calibration, weights))
            sizes.append(measure_footprint(code).layer_flash_bytes)
        saved = 100.0 * (1.0 - sizes[1] / sizes[0])
        verdict = "reached" if saved >= mark else "MISSED"
        layer = {"gru": "a GRU's layer", "lstm": "an LSTM's layer"}[kind]
        print(
            f"flash of {layer} on a Cortex-M4 at -Os: {sizes[0]} B, with 8 bits {sizes[1]} B,"
            f" {saved:.1f} % less ({verdict}: {mark:g} %)"
        )


def draw_slow_lstm(rng: np.random.Generator, codes: NDArray[np.int16]) -> Compensator:
    """Return an LSTM(16) with forget gates of 1 - 0.001 to 1 - 0.05, calibrated on `codes`.

    Inputs as `draw_slow_compensator`; its input gates let in as much as is forgotten, so that the
    cell state stays within some units, as that of a trained one does.
    """
    slow = draw_slow_compensator(rng, codes)
    moves = np.exp(rng.uniform(np.log(0.001), np.log(0.05), HIDDEN))
    w_x = rng.normal(size=(4, HIDDEN, INPUTS)) * 0.5
    w_h = rng.normal(size=(4, HIDDEN, HIDDEN)) / np.sqrt(HIDDEN)
    w_x[:2] *= 0.4
    w_h[:2] *= 0.4
    bias = rng.normal(size=(4, HIDDEN)) * 0.2
    bias[0], bias[1] = np.log(moves / (1.0 - moves)), np.log((1.0 - moves) / moves)
    head = rng.normal(size=(OUTPUTS, HIDDEN))
    network = FloatNetwork.stack((FloatLstm(w_x, w_h, bias),), head, np.zeros(OUTPUTS))
    return replace(slow, model=replace(slow.model, network=network))


def run_float_lstm(model: FloatModel, codes: NDArray[np.int16]) -> Array:
    """Return the float compensator's drift [T, K], from rest at the first code."""
    network = model.network
    assert network is not None
    assert model.tap_mean is not None and model.whitening is not None
    degc = codes[:, 0] * LSB_DEGC
    signals = np.stack(evaluate(model.taps, {"temperature_degC": degc}, 1.0), axis=1)
    features = (signals - model.tap_mean) @ model.whitening.T
    lstm = network.layers[0].cell
    assert isinstance(lstm, FloatLstm)
    outputs, _ = lstm.run(features[None], lstm.settle(features[:1]))
    return np.asarray(outputs[0] @ network.head.T + network.head_bias)


def measure_lstm(seed: int, steps: int, weights: str) -> list[float]:
    """Return the RMS error of each output over a long run, in % of its RMS about its mean."""
    rng = np.random.default_rng(seed)
    codes = draw_temperature(rng, steps)
    drawn = draw_slow_lstm(rng, codes)
    truth = run_float_lstm(drawn.model, codes)
    model = quantize(drawn.model, drawn.calibration, weights)
    with tempfile.TemporaryDirectory() as scratch:
        host = HostModel(model, generate(model), Path(scratch), observe=False)
        drift = host.run(codes).drift / LSB_PER_UNIT
    error = np.sqrt(((drift - truth) ** 2).mean(axis=0)) / truth.std(axis=0)
    return [float(x) for x in 100.0 * error]


def print_lstm_errors(seeds: Sequence[int], steps: int) -> None:
    """Print integer against float over a long run of LSTMs with slow memory."""
    print(
        f"integer against float, streaming LSTM({HIDDEN}) that forgets 0.001 to 0.05 a step,"
        f" {len(seeds)} networks, {steps} steps of simulated"
    )
    print("temperature, 1 s apart; RMS error in % of the output's RMS about its mean")
    for weights in ("int16", "int8"):
        found = [error for seed in seeds for error in measure_lstm(seed, steps, weights)]
        line = f"  {weights:5}: median {median(found):.3f} %, worst {max(found):.3f} %"
        line += f" of {len(found)} outputs"
        if weights == "int16":
            inside = sum(error <= LSTM_MARK_PCT for error in found)
            line += f" (mark {LSTM_MARK_PCT} %; {inside} within)"
        print(line)


if __name__ == "__main__":
    main(False)
