"""How tight the proven error bound is: it over the worst input that a search finds.

    python -m benchmarks bench_bound [--quick]
    python -m benchmarks.bench_bound --seed 101 --rounds 40

Simulated sensors. Of each model the largest |chip - float model| is looked for by an evolutionary
search without gradients, started from rails, ramps at the largest rate, bang-bang at each time
constant, noise, steps and rests. Exit code 1 if any input exceeds its bound.
"""

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tests.bound.cases import Case, draw_case
from tests.bound.recurrent import Forgetful, make_recurrent
from tests.effects_on_chip.bench import (
    draw_runs,
    make_compensator,
    make_config,
    make_physics,
)
from tests.effects_on_chip.random_graphs import describe_graph, draw_codes
from tests.effects_on_chip.test_networks_on_chip import add_drift, train_network

from zerodrift.base.arrays import Array
from zerodrift.base.config import EffectConfig
from zerodrift.codegen.selftest import limits_of
from zerodrift.dataset.runs import Run
from zerodrift.export.compose import calibrate, describe_compensator
from zerodrift.export.float_model import FloatModel
from zerodrift.operations.backend import GraphOperations
from zerodrift.operations.operation import Node
from zerodrift.physics.catalogue import load_catalogue

Codes = NDArray[np.int64]
STEPS, PARENTS, CHILDREN = 400, 8, 24
MARK_PERCENT, MARK_RATIO, MARK_RECURRENT = 0.5, 3.0, 20.0
TAUS_S = (3.0, 30.0, 400.0)
PERIOD_S = 0.5
FINE = 10**9
"""Counts per unit of a filter's output, so that its own error is not below a count."""
RECURRENT = (
    Forgetful(hidden=1, seed=31),
    Forgetful(hidden=4, update=-4.0, of_update=0.3, seed=32),
    Forgetful(hidden=4, reset="before", seed=33),
    Forgetful(hidden=8, update=-2.0, of_update=0.5, seed=34),
    Forgetful(hidden=8, weights="int8", seed=35),
    Forgetful(hidden=16, update=-2.0, of_update=0.5, seed=36),
)
"""GRUs with drawn weights; `bench_contracting` searches trained ones."""


def main(quick: bool) -> None:
    """Search all models, or few of them for a short time."""
    if not measure(1, 4 if quick else 30, quick=quick):
        raise SystemExit(1)


def measure(seed: int, rounds: int, *, quick: bool) -> bool:
    """Print bound, worst found and their ratio for every model; return whether all bounds hold.

    Args:
        seed: of simulated sensors and of the search.
        rounds: of the search.
        quick: some models of each sort.
    """
    ratios: dict[str, list[float]] = {}
    percents: dict[str, list[float]] = {}
    exceeded, unproven = 0, list[str]()
    print("sort            model                     output   bound      worst      ratio   % FS")
    for sort, name, case in list_cases(seed, quick=quick):
        bound = case.bound()
        if not bound.outputs:
            unproven.append(f"{name}: {bound.why}")
            continue
        limits = np.array([float(error.total) for error in bound.outputs])
        worst = search(case, limits, np.random.default_rng(seed), rounds)
        for output, limit, found in zip(case.described.outputs, limits, worst, strict=True):
            ratio = limit / found if found > 0.0 else np.inf
            percent = 100.0 * limit / output.full_scale
            exceeded += bool(found > limit)
            ratios.setdefault(sort, []).append(ratio)
            percents.setdefault(sort, []).append(percent)
            line = f"{sort:15} {name:25} {output.name:8} {limit:.3e}  {found:.3e}"
            print(f"{line}  {ratio:6.2f}  {percent:.2g}", flush=True)
    for sort, found_ratios in ratios.items():
        median, largest = float(np.median(found_ratios)), max(percents[sort])
        print(
            f"{sort}: {len(found_ratios)} outputs, bound / worst found: median {median:.2f},"
            f" largest {max(found_ratios):.2f}; bound at most {largest:.2g} % of full scale"
        )
    for text in unproven:
        print(f"nothing proven: {text}")
    print(
        f"exceeded: {exceeded}. Marks: median at most {MARK_RATIO} (filters, lag bank),"
        f" {MARK_RECURRENT} (recurrent), bound at most {MARK_PERCENT} % of full scale (physics, lag"
        " bank)."
    )
    return exceeded == 0


def list_cases(seed: int, *, quick: bool) -> Iterator[tuple[str, str, Case]]:
    """Yield sort, name and case of every model that is searched."""
    for count, name, nodes in list_filters():
        if not quick or count % 4 == 0:
            yield "filters", name, make_filter(nodes, seed)
    for kind in list(load_catalogue())[:: 6 if quick else 1]:
        runs = draw_runs(2, 1500)
        compensator, drifting = make_compensator(make_physics([EffectConfig(kind)], runs), runs)
        described = describe_compensator(compensator, make_config(), drifting)
        yield "physics", kind, _compose(described, tuple(drifting))
    with tempfile.TemporaryDirectory() as folder:
        for kind in ("lag_bank",) if quick else ("lag_bank", "many units", "mlp", "mlp_seq", "tcn"):
            sort = "lag bank" if kind in ("lag_bank", "many units") else "windows"
            compensator, config = train_network(kind, Path(folder), epochs=40)
            runs = tuple(add_drift(run, loaded=False) for run in draw_runs(4, 1500))
            yield sort, kind, _compose(describe_compensator(compensator, config, runs), runs)
    for kind in RECURRENT[:: 3 if quick else 1]:
        yield "recurrent", f"{kind.hidden} units, {kind.weights}", make_recurrent(kind)
    for number in range(3 if quick else 20):
        yield "random", f"{seed}/{number}", draw_case(seed, number)


def list_filters() -> Iterator[tuple[int, str, list[Node]]]:
    """Yield low-passes and what is made of them."""
    for count, tau_s in enumerate((0.4, 2.0, 11.0, 75.0, 390.0, 5000.0)):
        ops = GraphOperations(PERIOD_S)
        x = ops.affine(ops.input("x0"), 1.0 / 64.0, 0.0)
        y = ops.lowpass(x, tau_s)
        twice = ops.lowpass(y, 2.0 * tau_s)
        yield count, f"low-pass {tau_s:g} s", [y, ops.difference(x, y), ops.difference(y, twice)]


def make_filter(nodes: list[Node], seed: int) -> Case:
    """Return filters with outputs fine enough that their own error shows."""
    described, calibration = describe_graph(nodes, draw_codes(seed))
    outputs = tuple(replace(output, lsb_per_unit=FINE) for output in described.outputs)
    ends = np.full(len(nodes), 2.0)
    described = replace(described, outputs=outputs)
    calibration = replace(calibration, drift_low=-ends, drift_high=ends)
    return Case.of(described, calibration)


def _compose(described: FloatModel, runs: tuple[Run, ...]) -> Case:
    return Case.of(described, calibrate(described, runs))


def search(case: Case, limits: Array, rng: np.random.Generator, rounds: int) -> Array:
    """Return the largest error [K] that is found.

    Args:
        case: the model.
        limits: [K] what is proven, which the outputs' errors are weighed by.
        rng: of the search.
        rounds: of mutation and choice; each round goes for one output.
    """
    low, high = (np.array(ends, dtype=np.int64) for ends in limits_of(case.quantized.model))
    parents = start(case, low, high, rng)
    errors = replace(case, codes=parents).measure().max(axis=1)
    worst = errors.max(axis=0)
    for number in range(rounds):
        output = number % len(limits)
        parents = parents[np.argsort(-errors[:, output])[:PARENTS]]
        children = np.stack([mutate(parents, low, high, rng) for _ in range(CHILDREN)])
        parents = np.concatenate([parents, children])
        errors = replace(case, codes=parents).measure().max(axis=1)
        worst = np.maximum(worst, errors.max(axis=0))
    return np.asarray(worst)


def start(case: Case, low: Codes, high: Codes, rng: np.random.Generator) -> Codes:
    """Return sequences [B, STEPS, C] that are likely to be bad."""
    steps = np.arange(STEPS)
    shapes = [np.zeros(STEPS), np.ones(STEPS), steps / STEPS, 1.0 - steps / STEPS]
    period_s, rate = case.quantized.model.sample_period_s, case.quantized.model.guards.rate_max
    span = max(int(high[0] - low[0]), 1)
    shapes.append(np.minimum(steps * rate / span, 1.0))  # a ramp at the largest rate
    shapes += [np.abs((steps * rate / span) % 2.0 - 1.0)]
    for tau_s in TAUS_S:  # bang-bang
        held = max(int(tau_s / period_s), 1)
        shapes += [(steps // held % 2).astype(float), (steps // held % 2 == 0).astype(float)]
    shapes += [rng.random(STEPS) for _ in range(4)]
    shapes += [np.repeat(rng.random(STEPS // 20), 20) for _ in range(4)]
    shapes += [np.clip(np.cumsum(rng.normal(size=STEPS)) / 20.0 + 0.5, 0.0, 1.0) for _ in range(4)]
    columns = []
    for channel in range(low.size):
        order = np.arange(len(shapes)) if channel == 0 else rng.permutation(len(shapes))
        scaled = low[channel] + np.stack(shapes)[order] * (high[channel] - low[channel])
        columns.append(np.round(scaled).astype(np.int64))
    return np.stack(columns, axis=2)


def mutate(parents: Codes, low: Codes, high: Codes, rng: np.random.Generator) -> Codes:
    """Return a child [STEPS, C]: a stretch changed, taken from another, held, or moved a little."""
    child = parents[rng.integers(len(parents))].copy()
    first = int(rng.integers(STEPS))
    last = min(first + int(2.0 ** rng.uniform(0.0, np.log2(STEPS))), STEPS)
    channel = int(rng.integers(low.size))
    part = child[first:last, channel]
    way = int(rng.integers(6))
    if way == 0:
        part[:] = rng.choice([low[channel], high[channel]])
    elif way == 1:
        part[:] = rng.integers(low[channel], high[channel] + 1)
    elif way == 2:
        part += rng.integers(-3, 4, part.size)
    elif way == 3:
        child[first:last] = parents[rng.integers(len(parents)), first:last]
    elif way == 4:
        part[:] = rng.integers(low[channel], high[channel] + 1, part.size)
    else:
        part += int(rng.normal() * 0.05 * (high[channel] - low[channel]))
    return np.asarray(np.clip(child, low, high))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    if not measure(given.seed, given.rounds, quick=given.quick):
        raise SystemExit(1)
