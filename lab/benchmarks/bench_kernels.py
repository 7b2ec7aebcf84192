"""The fixed-point core: speed against float C, reference against C, table and model errors."""

import ctypes
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.c_runtime.compilers import Compiler, find_compilers
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.export.float_model import Calibration, FloatModel
from zerodrift.export.float_network import FloatNetwork
from zerodrift.export.integer_model import Channel, IntegerModel, OutputFormat
from zerodrift.export.quantize import quantize
from zerodrift.export.reference import Reference
from zerodrift.operations.backend import GraphOperations, evaluate
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.tables import T_MAX, T_MIN, sigmoid_q31, tanh_nodes, tanh_q30

INPUTS, HIDDEN, OUTPUTS = 4, 16, 6
LSB_DEGC = 2.0**-7
LSB_PER_UNIT = 10**6
FLOAT_C = Path(__file__).with_name("float_gru.c")


def main(quick: bool) -> None:
    """Print every figure; `quick` shortens the runs, which makes the times less certain."""
    time_kernels(rounds=5 if quick else 21)
    time_reference(rounds=3 if quick else 9)
    print_table_errors()
    print_model_errors(steps=20_000 if quick else 100_000, networks=4 if quick else 12)


@dataclass(frozen=True)
class Compensator:
    """A float model, what it was calibrated on, and the raw codes [T, 1] of that."""

    model: FloatModel
    calibration: Calibration


def draw_temperature(rng: np.random.Generator, steps: int) -> NDArray[np.int16]:
    """Return a simulated temperature in codes [T, 1], 1 s apart: a walk that is drawn to 25 degC.

    Its changes are slow against a second, as those of a body of 45 g are.
    """
    temperature, slope = np.empty(steps), 0.0
    now_degc = 25.0
    pushes = rng.normal(scale=0.002, size=steps)
    for t in range(steps):
        slope = 0.99 * slope + pushes[t]
        now_degc += slope - 2e-4 * (now_degc - 25.0)
        temperature[t] = now_degc
    return np.round(np.clip(temperature, -20.0, 60.0) / LSB_DEGC).astype(np.int16)[:, None]


def draw_slow_compensator(rng: np.random.Generator, codes: NDArray[np.int16]) -> Compensator:
    """Return a GRU(16) as training on thermal logs leaves it, calibrated on `codes`.

    Its inputs are temperature, two lags and their difference, whitened. The update gates move a
    unit by 0.001 to 0.05 of its distance per step, log-uniform over the units.
    """
    ops = GraphOperations(1.0)
    degc = ops.input("temperature_degC")
    lags = [ops.lowpass(degc, tau_s) for tau_s in (30.0, 400.0)]
    taps = (degc, *lags, ops.difference(degc, lags[1]))
    signals = np.stack(evaluate(taps, {"temperature_degC": codes[:, 0] * LSB_DEGC}, 1.0), axis=1)
    mean, scale = signals.mean(axis=0), signals.std(axis=0)
    moves = np.exp(rng.uniform(np.log(0.001), np.log(0.05), HIDDEN))
    w_x = rng.normal(size=(3, HIDDEN, INPUTS)) * 0.5
    w_h = rng.normal(size=(3, HIDDEN, HIDDEN)) / np.sqrt(HIDDEN)
    w_x[1] *= 0.4
    w_h[1] *= 0.4
    bias = rng.normal(size=(4, HIDDEN)) * 0.2
    bias[1] = np.log(moves / (1.0 - moves))
    gru, head = FloatGru(w_x, w_h, bias, "after"), rng.normal(size=(OUTPUTS, HIDDEN))
    network = FloatNetwork.stack((gru,), head, np.zeros(OUTPUTS))
    model = FloatModel(
        name="bench",
        sample_period_s=1.0,
        channels=(Channel("temperature", "degC", LSB_DEGC),),
        sources={"temperature_degC": 0},
        outputs=tuple(OutputFormat(f"out{k}", "N", LSB_PER_UNIT, 10.0) for k in range(OUTPUTS)),
        features=(),
        coefficients=np.zeros((0, OUTPUTS)),
        offset=np.zeros(OUTPUTS),
        taps=taps,
        tap_mean=mean,
        whitening=np.diag(1.0 / scale),
        network=network,
    )
    calibration = Calibration(
        code_limits=((int(codes.min()), int(codes.max())),),
        feature_max=np.abs((signals - mean) / scale).max(axis=0),
        drift_low=np.full(OUTPUTS, -100.0),
        drift_high=np.full(OUTPUTS, 100.0),
        rate_max=1000,
        warm_up_steps=0,
    )
    return Compensator(model, calibration)


def draw_fast_model(weights: str, hidden: int = HIDDEN) -> IntegerModel:
    """Return a GRU(16) on four raw inputs: the shape whose speed is told everywhere."""
    drawn = draw_fast_float(hidden)
    return quantize(drawn.model, drawn.calibration, weights)


def draw_fast_float(hidden: int = HIDDEN) -> Compensator:
    """Return the same in float, and ranges as if it had been calibrated."""
    rng = np.random.default_rng(1)
    ops = GraphOperations(1.0)
    names = [f"in{i}" for i in range(INPUTS)]
    gru = FloatGru(
        rng.normal(size=(3, hidden, INPUTS)),
        rng.normal(size=(3, hidden, hidden)) / np.sqrt(hidden),
        rng.normal(size=(4, hidden)) * 0.5,
        "after",
    )
    model = FloatModel(
        name="bench",
        sample_period_s=1.0,
        channels=tuple(Channel(name, "", 1.0) for name in names),
        sources={name: i for i, name in enumerate(names)},
        outputs=tuple(OutputFormat(f"out{k}", "N", 1000, 100.0) for k in range(OUTPUTS)),
        features=(),
        coefficients=np.zeros((0, OUTPUTS)),
        offset=np.zeros(OUTPUTS),
        taps=tuple(ops.input(name) for name in names),
        tap_mean=np.zeros(INPUTS),
        whitening=np.eye(INPUTS) / 8000.0,
        network=FloatNetwork.stack((gru,), rng.normal(size=(OUTPUTS, hidden)), np.zeros(OUTPUTS)),
    )
    calibration = Calibration(
        code_limits=((-32768, 32767),) * INPUTS,
        feature_max=np.full(INPUTS, 4.0),
        drift_low=np.full(OUTPUTS, -1e6),
        drift_high=np.full(OUTPUTS, 1e6),
        rate_max=1000,
        warm_up_steps=0,
    )
    return Compensator(model, calibration)


def time_kernels(rounds: int) -> None:
    """Print the time of a step against plain float C, by the same compiler and flags, in turns."""
    steps = 20_000
    codes = np.random.default_rng(2).integers(-20_000, 20_000, size=(steps, INPUTS))
    codes = codes.astype(np.int16)
    print(f"step of GRU({HIDDEN}), {INPUTS} inputs, {OUTPUTS} outputs, -O3, host; checks and flags")
    print("included; median of turns; target: 3 times as fast as plain float C with libm")
    for compiler in find_compilers():
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch)
            run_float = build_float(compiler, folder, codes)
            hosts = {}
            for weights in ("int16", "int8"):
                model = draw_fast_model(weights)
                host = HostModel(
                    model, generate(model), folder / weights, compiler, ("-O3",), observe=False
                )
                hosts[weights] = host
            seconds = alternate(
                {
                    "float": run_float,
                    **{name: lambda h=host: h.run(codes) for name, host in hosts.items()},
                },
                rounds,
            )
        ns = {name: median(values) / steps * 1e9 for name, values in seconds.items()}
        for weights in hosts:
            pairs = zip(seconds["float"], seconds[weights], strict=True)
            ratio = median(a / b for a, b in pairs)
            print(
                f"  {compiler.name:5} {weights:5}: {ns[weights]:5.0f} ns, float"
                f" {ns['float']:5.0f} ns: {ratio:.1f} times as fast"
            )


def build_float(
    compiler: Compiler,
    folder: Path,
    codes: NDArray[np.int16],
    flags: tuple[str, ...] = ("-O3",),
) -> Callable[[], object]:
    """Return a call that runs the float GRU over the codes."""
    library = folder / "float_gru.so"
    shape = [f"-DINPUTS={INPUTS}", f"-DHIDDEN={HIDDEN}", f"-DOUTPUTS={OUTPUTS}"]
    compiler.run(
        ["-std=c99", *flags, *shape, "-shared", "-fPIC", str(FLOAT_C), "-o", str(library), "-lm"]
    )
    function = ctypes.CDLL(str(library)).float_gru_run
    rng = np.random.default_rng(1)
    arrays = [
        rng.normal(size=(HIDDEN, 3, INPUTS + HIDDEN)) / 4.0,
        rng.normal(size=(HIDDEN, 4)) / 2.0,
        rng.normal(size=(OUTPUTS, HIDDEN)),
        np.full(INPUTS, 1.0 / 8000.0),
    ]
    constants = [np.ascontiguousarray(a, dtype=np.float32) for a in arrays]
    state = np.zeros(HIDDEN, dtype=np.float32)
    drift = np.empty((len(codes), OUTPUTS), dtype=np.float32)
    buffers = [*constants, codes, state, drift]

    def run() -> None:
        pointers = [ctypes.c_void_p(a.ctypes.data) for a in buffers]
        function(*pointers, ctypes.c_uint32(len(codes)))

    return run


def alternate(calls: dict[str, Callable[[], object]], rounds: int) -> dict[str, list[float]]:
    """Return the CPU seconds of each call, in turns so that a busy machine hits all alike."""
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for call in calls.values():
        call()
    for _ in range(rounds):
        for name, call in calls.items():
            start = time.thread_time()
            call()
            seconds[name].append(time.thread_time() - start)
    return seconds


def time_reference(rounds: int) -> None:
    """Print how much slower the NumPy reference is than host C, over a batch of 256 sequences."""
    batch, steps = 256, 100
    model = draw_fast_model("int16")
    codes = np.random.default_rng(3).integers(-20_000, 20_000, size=(batch, steps, INPUTS))
    codes = codes.astype(np.int16)
    one_by_one = codes.reshape(batch * steps, INPUTS)
    reference = Reference(model)
    with tempfile.TemporaryDirectory() as scratch:
        host = HostModel(model, generate(model), Path(scratch), flags=("-O3",), observe=False)
        seconds = alternate(
            {"reference": lambda: reference.run(codes), "host": lambda: host.run(one_by_one)},
            rounds,
        )
    ns = {name: median(values) / (batch * steps) * 1e9 for name, values in seconds.items()}
    pairs = zip(seconds["reference"], seconds["host"], strict=True)
    ratio = median(a / b for a, b in pairs)
    print(
        f"NumPy reference, batch of {batch}: {ns['reference']:.0f} ns per step of one sequence,"
        f" host C {ns['host']:.0f} ns: {ratio:.1f} times slower (target 20)"
    )


def print_table_errors() -> None:
    """Print the worst error of the activations over every input."""
    t = np.arange(T_MIN, T_MAX + 1)
    x = t / 2.0**16
    tanh_lsb = np.abs(tanh_q30(t) / 2.0**30 - np.tanh(x)).max() * 2.0**15
    sigmoid_lsb = np.abs(sigmoid_q31(t) / 2.0**31 - 1.0 / (1.0 + np.exp(-2.0 * x))).max() * 2.0**15
    print(
        f"activation table, {tanh_nodes().nbytes} bytes, all {t.size} inputs: worst error of tanh"
        f" {tanh_lsb:.2f} LSB of Q0.15, of the sigmoid {sigmoid_lsb:.2f}"
    )


def print_model_errors(steps: int, networks: int) -> None:
    """Print integer against float over a long run of slow-memory networks."""
    print(
        f"integer against float, streaming GRU({HIDDEN}) with update gates of 0.001 to 0.05,"
        f" {networks} networks, {steps} steps of simulated temperature, 1 s apart;"
    )
    print("RMS error in % of the output's RMS about its mean")
    errors: dict[str, list[float]] = {"int16": [], "int8": []}
    for seed in range(networks):
        rng = np.random.default_rng(seed)
        codes = draw_temperature(rng, steps)
        compensator = draw_slow_compensator(rng, codes)
        truth = run_float_model(compensator.model, codes)
        for weights, found in errors.items():
            model = quantize(compensator.model, compensator.calibration, weights)
            with tempfile.TemporaryDirectory() as scratch:
                host = HostModel(model, generate(model), Path(scratch), observe=False)
                drift = host.run(codes).drift / LSB_PER_UNIT
            error = np.sqrt(((drift - truth) ** 2).mean(axis=0)) / truth.std(axis=0)
            found.extend((100.0 * error).tolist())
    for weights, limit in (("int16", 0.12), ("int8", 1.5)):
        found = errors[weights]
        inside = sum(error <= limit for error in found)
        print(
            f"  {weights:5}: median {median(found):.3f} %, worst {max(found):.3f} % of"
            f" {len(found)} outputs (target {limit} %; {inside} within)"
        )


def run_float_model(model: FloatModel, codes: NDArray[np.int16]) -> Array:
    """Return the float compensator's drift [T, K], from rest at the first code."""
    assert model.network is not None and model.whitening is not None
    assert model.tap_mean is not None
    degc = codes[:, 0] * LSB_DEGC
    signals = np.stack(evaluate(model.taps, {"temperature_degC": degc}, 1.0), axis=1)
    features = (signals - model.tap_mean) @ model.whitening.T
    (gru,) = model.network.grus
    states = gru.run(features[None], gru.settle(features[:1]))[0]
    return np.asarray(states @ model.network.head.T + model.network.head_bias)


if __name__ == "__main__":
    main(False)
