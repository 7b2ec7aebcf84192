"""Five effects and a GRU on the chip: integer against float, a million steps, held out, time."""

import json
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray

from benchmarks.bench_kernels import draw_temperature
from zerodrift.base.arrays import Array
from zerodrift.base.config import EffectConfig
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.dataset.runs import Run
from zerodrift.export.float_model import Calibration, FloatModel, predict_fed_back
from zerodrift.export.float_network import FloatNetwork
from zerodrift.export.integer_model import Channel, OutputFormat
from zerodrift.export.quantize import quantize
from zerodrift.operations.backend import GraphOperations, evaluate
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.operation import list_nodes
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.signals import graph_inputs, name_signals, plan_signals, read_signals
from zerodrift.physics.terms import build_features, start_term

OUTPUTS, FULL_SCALE = ("Fz", "Mx"), (2000.0, 14.0)
LSB_PER_UNIT = (1000, 100_000)
LSB_DEGC = 2.0**-7
LAGS_S = (30.0, 400.0)
EFFECTS = (
    EffectConfig("zero_tempco", {"order": 3}),
    EffectConfig("dark_current", {"doubling_K": 10.0}),
    EffectConfig("thermal_lag", {"tau_s": 60.0}),
    EffectConfig("creep", {"tau_s": 600.0}),
    EffectConfig("span_tempco", {"calibrated_degC": 25.0}),
)
NETWORK_SHARE = 0.5
"""RMS of what the network adds, over that of the drift of the effects."""
TOLD = ("zero_tempco", "creep", "span_tempco", "crosstalk", "warm_up")
HIDDEN = ("dark_current=20", "thermal_lag=20,tau_s:47.3")
"""What the network has to learn in the held-out comparison."""


def main(quick: bool) -> None:
    """Print every figure; `quick` shortens the runs."""
    print_growth(steps=100_000 if quick else 1_000_000, seeds=1 if quick else 3)
    time_generation(rounds=3 if quick else 11)
    print_held_out()


@dataclass(frozen=True)
class Bench:
    """A float compensator on one long simulated run, and its answer."""

    model: FloatModel
    calibration: Calibration
    run: Run
    truth: Array
    """[n, K] drift with the load that the compensator leaves."""


def draw_run(rng: np.random.Generator, steps: int) -> Run:
    """Return a simulated run, 1 s a step: slow temperature, loads that change every few minutes."""
    temperature = draw_temperature(rng, steps)[:, 0] * LSB_DEGC
    edges = np.sort(rng.integers(0, steps, steps // 300))
    levels = rng.uniform(-0.6, 0.6, (edges.size + 1, 2)) * FULL_SCALE
    levels[0] = 0.0
    load = levels[np.searchsorted(edges, np.arange(steps), side="right")]
    return Run(
        name="bench",
        group="bench",
        part=0,
        source=Path("bench"),
        sample_period_s=1.0,
        time_s=np.arange(steps, dtype=np.float64),
        temperature_degC=temperature,
        measured=load,
        reference=load,
    )


def draw_bench(seed: int, steps: int, hidden: int) -> Bench:
    """Return five effects and a GRU with slow units on a run of that many steps."""
    rng = np.random.default_rng(seed)
    run = draw_run(rng, steps)
    plan = plan_signals([run], OUTPUTS, FULL_SCALE)
    catalogue = load_catalogue()
    terms = [start_term(catalogue, effect) for effect in EFFECTS]
    ops = GraphOperations(1.0)
    features = build_features(ops, name_signals(ops, plan), terms, tuple(catalogue))
    degc = ops.input("temperature_degC")
    lags = [ops.lowpass(degc, tau_s) for tau_s in LAGS_S]
    taps = (degc, *lags, ops.difference(degc, lags[1]))
    nodes = list_nodes([*(f.signal for f in features), *taps])
    values = dict(
        zip(nodes, evaluate(nodes, graph_inputs(read_signals(run, plan)), 1.0), strict=True)
    )
    seen = np.array([[f.output in (None, name) for name in OUTPUTS] for f in features])
    largest = np.array([np.abs(values[f.signal]).max() for f in features])
    coefficients = rng.uniform(-1.0, 1.0, seen.shape) * seen * 0.02 * np.array(FULL_SCALE)
    coefficients /= largest[:, None]
    signals = np.stack([values[tap] for tap in taps], axis=1)
    scale = signals.std(axis=0)
    gru = draw_slow_gru(rng, hidden)
    scaled = (signals - signals.mean(axis=0)) / scale
    states = gru.run(scaled[None], gru.settle(scaled[:1]))[0]
    model = FloatModel(
        name="bench",
        sample_period_s=1.0,
        channels=(
            Channel("temperature", "degC", LSB_DEGC),
            *(
                Channel(f"measured_{name}", "", 1.0 / lsb, bits=32)
                for name, lsb in zip(OUTPUTS, LSB_PER_UNIT, strict=True)
            ),
        ),
        sources={"temperature_degC": 0, **{f"load:{o}": k + 1 for k, o in enumerate(OUTPUTS)}},
        outputs=tuple(
            OutputFormat(name, "", lsb, full)
            for name, lsb, full in zip(OUTPUTS, LSB_PER_UNIT, FULL_SCALE, strict=True)
        ),
        features=tuple(f.signal for f in features),
        coefficients=coefficients,
        offset=np.zeros(len(OUTPUTS)),
        taps=taps,
        tap_mean=signals.mean(axis=0),
        whitening=np.diag(1.0 / scale),
    )
    columns = [f.signal for f in features]

    def predict_physics(run: Run) -> Array:
        found = evaluate(columns, graph_inputs(read_signals(run, plan)), 1.0)
        return np.asarray(np.stack(found, axis=1) @ coefficients)

    effects = predict_physics(run).std(axis=0)
    head = rng.normal(size=(len(OUTPUTS), hidden))
    head *= (NETWORK_SHARE * effects / (states @ head.T).std(axis=0))[:, None]
    added = states @ head.T
    measured = run.reference + predict_physics(run) + added
    truth = predict_fed_back(lambda r: predict_physics(r) + added, replace(run, measured=measured))
    limits = [(int(np.round(x.min() * lsb)), int(np.round(x.max() * lsb)))
              for x, lsb in zip(run.reference.T, LSB_PER_UNIT, strict=True)]  # fmt: skip
    codes = np.round(run.temperature_degC / LSB_DEGC)
    calibration = Calibration(
        code_limits=((int(codes.min()), int(codes.max())), *((2 * a, 2 * b) for a, b in limits)),
        feature_max=np.abs((signals - signals.mean(axis=0)) / scale).max(axis=0),
        drift_low=-2.0 * np.abs(truth).max(axis=0),
        drift_high=2.0 * np.abs(truth).max(axis=0),
        rate_max=1000,
        warm_up_steps=0,
        ranges={node: (float(v.min()), float(v.max())) for node, v in values.items()},
    )
    model = replace(model, network=FloatNetwork.stack((gru,), head, np.zeros(len(OUTPUTS))))
    return Bench(model, calibration, replace(run, measured=measured), truth)


def draw_slow_gru(rng: np.random.Generator, hidden: int) -> FloatGru:
    """Return a GRU whose units move by 0.001 to 0.05 of their distance per step."""
    moves = np.exp(rng.uniform(np.log(0.001), np.log(0.05), hidden))
    w_x = rng.normal(size=(3, hidden, 4)) * 0.5
    w_h = rng.normal(size=(3, hidden, hidden)) / np.sqrt(hidden)
    w_x[1] *= 0.4
    w_h[1] *= 0.4
    bias = rng.normal(size=(4, hidden)) * 0.2
    bias[1] = np.log(moves / (1.0 - moves))
    return FloatGru(w_x, w_h, bias, "after")


def encode(bench: Bench) -> NDArray[np.int32]:
    """Return the raw codes [n, C] of the run."""
    columns = [bench.run.temperature_degC, *bench.run.measured.T]
    scaled = [x / c.lsb for x, c in zip(columns, bench.model.channels, strict=True)]
    return np.round(np.stack(scaled, axis=1)).astype(np.int32)


def print_growth(steps: int, seeds: int) -> None:
    """Print the RMS error of integer against float over the first 100, 1000, ... steps."""
    print(
        f"integer against float: {', '.join(e.kind for e in EFFECTS)} and a streaming GRU(16) with"
        f" update gates of 0.001 to 0.05, which adds {100 * NETWORK_SHARE:.0f} % to the drift;"
        " simulated temperature and loads, 1 s apart, loads fed back;"
    )
    print(f"RMS error from the start in % of the whole run's drift RMS, worst of {seeds} networks"
          " and 2 outputs")  # fmt: skip
    marks = [10**n for n in range(2, 7) if 10**n <= steps]
    benches = [draw_bench(seed, steps, 16) for seed in range(seeds)]
    for weights, target in (("int16", 0.1), ("int8", None)):
        worst = np.zeros((3, len(marks)))
        for bench in benches:
            model = quantize(bench.model, bench.calibration, weights)
            with tempfile.TemporaryDirectory() as scratch:
                host = HostModel(model, generate(model), Path(scratch), observe=False)
                drift = host.run(encode(bench)).drift / np.array(LSB_PER_UNIT)
            error = (drift - bench.truth) / np.sqrt((bench.truth**2).mean(axis=0))
            for i, mark in enumerate(marks):
                decade = error[mark // 10 : mark] if mark > 100 else error[:mark]
                whole = 100.0 * np.sqrt((error[:mark] ** 2).mean(axis=0)).max()
                within = 100.0 * np.sqrt((decade**2).mean(axis=0)).max()
                bias = 100.0 * np.abs(decade.mean(axis=0)).max()
                worst[:, i] = np.maximum(worst[:, i], (whole, within, bias))
        goal = f" (target {target} %)" if target else ""
        print(f"  {weights}{goal}")
        for i, mark in enumerate(marks):
            whole, within, bias = worst[:, i]
            print(f"    {mark:8d} steps: {whole:.4f} %; of the last decade {within:.4f} %, its mean"
                  f" {bias:.4f} %")  # fmt: skip


def time_generation(rounds: int) -> None:
    """Print the time from a float model to C text."""
    bench = draw_bench(0, 2000, 32)
    seconds = []
    for _ in range(rounds):
        start = time.perf_counter()
        code = generate(quantize(bench.model, bench.calibration))
        seconds.append(time.perf_counter() - start)
    print(
        f"five effects and GRU(32), float model to {len(code.source)} characters of proven C:"
        f" median {median(seconds):.2f} s, worst {max(seconds):.2f} s (target 2 s)"
    )


def print_held_out() -> None:
    """Print held-out errors of float and integer after the whole road from simulated logs."""
    zerodrift = [sys.executable, "-m", "zerodrift"]
    with tempfile.TemporaryDirectory() as scratch:
        project = Path(scratch) / "bench"
        told = [word for name in TOLD for word in ("--told", name)]
        told += [word for name in HIDDEN for word in ("--hidden", name)]
        options = [*told, "--network", "gru", "--tare", "none", "--seed", "5"]
        twin = [*zerodrift, "twin", "-C", str(project), "--runs", "6", *options]
        subprocess.run(twin, check=True, capture_output=True)
        firmware = [*zerodrift, "firmware", "-C", str(project), "--json"]
        done = subprocess.run(firmware, check=True, capture_output=True, text=True)
        has_network = '"kind":"gru"' in (project / "build" / "model.json").read_text()
    result = json.loads(done.stdout)
    print(
        f"held-out runs of simulated logs: {', '.join(TOLD)} told, {' and '.join(HIDDEN)} hidden;"
        f" network kept: {has_network}; bit-exact {result['bit_exact']}"
    )
    for name, unit in result["units"].items():
        floats, integers = result["rmse"]["float"][name], result["rmse"]["integer"][name]
        change = 100.0 * (integers / floats - 1.0)
        print(
            f"  {name} [{unit}] RMSE float {floats:.4g}, integer {integers:.4g}: {change:+.2f} %"
            f" (target 1 %); integer - float {result['rmse_integer_to_float'][name]:.2g}"
        )


if __name__ == "__main__":
    main(False)
