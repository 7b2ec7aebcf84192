"""What would help against one-sided heat: other terms, or a larger model? On the six-axis twin.

    python -m benchmarks.study_heat [--sensors 1 2 3] [--second]

The default's parts with lags that are given rather than searched, so that forms can be told apart
without the chance of a search: powers of the temperature, lags' distances from it times its powers,
products of two distances, the same times the temperature, tanh units; and with six lags a model too
large for the chip. All learn from the chamber and the varied logs of `bench_paper`. Printed is the
error on held-out runs over their noise floor. The evidence of
`docs/decisions/100-heat-is-learnt-from-logs-of-it.md`. All data are simulated.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.operations.lowpass import lowpass
from zerodrift.train.front_end import TEMPERATURE, Tap, fit_front_end, read_source
from zerodrift.train.lag_bank.data import BankData, Lag
from zerodrift.train.lag_bank.search import Rows
from zerodrift.train.lag_bank.units import fit_linear, fit_member
from zerodrift_lab.paper.world import (
    BODY,
    CHAMBER_CYCLES,
    Trial,
    pool_floor,
    record_test,
    record_training,
)

JUDGED = ("chamber", "heating", "cooling", "walking_still")
BENCH = JUDGED[1:]
LAGS: tuple[Lag, ...] = ((0, 5.0), (0, 60.0), (0, 1200.0))
MANY_LAGS: tuple[Lag, ...] = tuple((0, tau_s) for tau_s in (4.0, 10.0, 30.0, 100.0, 300.0, 1000.0))
BODY_LAGS: tuple[Lag, ...] = ((1, 8.0), (1, 60.0))
DOUBLING_K = (9.0, 11.0)
"""Of the dark current; two of them stand for all between."""
CENTRE, HALF_SPAN = 20.0, 40.0
RIDGE = 1e-8


@dataclass(frozen=True)
class Form:
    """Columns of a model."""

    lags: tuple[Lag, ...]
    second: bool
    products: int
    """0: none; 1: of two distances; 2: those times u too."""
    units: int
    powers: int = 4
    """u^0, u^1, ... that a distance is seen times."""

    def distances(self, run: Run) -> list[Array]:
        """Return how far lags, and the second thermometer, are from what they follow."""
        levels = [(read_source(run, s) - CENTRE) / HALF_SPAN for s in list_sources(self.second)]
        away = [levels[1] - levels[0]] if self.second else []
        return away + [
            lowpass(levels[s], run.sample_period_s, tau_s) - levels[s] for s, tau_s in self.lags
        ]

    def compute(self, run: Run) -> Array:
        """Return the columns [n, J] of a run."""
        chip = run.temperature_degC
        u, away = (chip - CENTRE) / HALF_SPAN, self.distances(run)
        columns = [np.exp2((chip - CENTRE) / k - 4.0) for k in DOUBLING_K]
        columns += [u**p for p in range(1, 5)]
        columns += [w * u**p for w in away for p in range(self.powers)]
        for a, b in combinations_with_replacement(away, 2):
            columns += [a * b * u**p for p in range(self.products)]
        return np.stack(columns, axis=1)


def list_sources(second: bool) -> tuple[str, ...]:
    """Return the thermometers."""
    return (TEMPERATURE, BODY) if second else (TEMPERATURE,)


def judge(form: Form, runs: Sequence[Run], tests: dict[str, tuple[Trial, ...]]) -> dict[str, float]:
    """Return the error over the noise floor of each test, and of the bench together."""
    none = [np.zeros((len(run), 0)) for run in runs]
    unloaded = [np.zeros(len(run), dtype=bool) for run in runs]
    drifts = [run.drift for run in runs]
    data = BankData(runs, list_sources(form.second), none, drifts, unloaded)
    scale = np.concatenate(drifts[:CHAMBER_CYCLES]).std(axis=0)
    rows = Rows(data, data.counts, False, scale)

    def see(run: Run) -> Array:
        return np.concatenate([np.ones((len(run), 1)), form.compute(run)], axis=1)

    columns = data.average(np.concatenate([see(run) for run in runs]))
    if form.units:
        sources = list_sources(form.second)
        taps = [Tap("level", source=s) for s in sources]
        taps += [Tap("lag", source=sources[s], tau_s=tau_s) for s, tau_s in form.lags]
        front_end = fit_front_end(taps, runs)
        features = data.average(np.concatenate([front_end.compute(run) for run in runs]))
        member = fit_member(rows, columns, features, RIDGE, form.units, (0, 0), rows.everything)
    else:
        member = fit_linear(rows, columns, RIDGE, rows.everything)

    def predict(run: Run) -> Array:
        features = front_end.compute(run) if form.units else np.zeros((len(run), 0))
        return np.asarray(member.predict(see(run), features) * scale)

    return measure_heat(predict, tests, scale)


def measure_heat(
    predict: Callable[[Run], Array], tests: dict[str, tuple[Trial, ...]], scale: Array
) -> dict[str, float]:
    """Return the error over the noise floor of each test, and of the bench together.

    Args:
        predict: drift [n, K] of a run.
        tests: the runs of each test, the bench's among them.
        scale: [K] what errors are shares of.
    """
    squares, floors = {}, {}
    for test, trials in tests.items():
        error = np.concatenate([(t.run.drift - predict(t.run)) / scale for t in trials])
        squares[test] = float(np.mean(error**2))
        floors[test] = float(np.mean((pool_floor(trials) / scale) ** 2))
    found = {test: float(np.sqrt(squares[test] / floors[test])) for test in tests}
    together = sum(squares[t] for t in BENCH) / sum(floors[t] for t in BENCH)
    return {**found, "bench": float(np.sqrt(together))}


def list_forms(second: bool) -> list[Form]:
    """Return the forms that are compared, the large one last."""
    body = BODY_LAGS if second else ()
    few = (*(LAGS[:2] if second else LAGS), *body)
    many = (*(MANY_LAGS[::2] if second else MANY_LAGS), *body)
    return [
        *(Form(few, second, products, units) for products in range(3) for units in (0, 4)),
        Form(many, second, 0, 12, powers=1),
        Form(many, second, 2, 16),
    ]


def main(sensors: Sequence[int], second: bool) -> None:
    """Print the table, medians over the sensors."""
    names = (*JUDGED, "bench")
    print(f"simulated six-axis sensors {list(sensors)}; error / noise floor, medians")
    print(f"{'lags, powers, products, units, numbers':<40}", *(f"{n[:10]:>10}" for n in names))
    logs = {s: record_training(s, "varied", True) for s in sensors}
    tests = {s: {t: record_test(s, t, True) for t in JUDGED} for s in sensors}
    for form in list_forms(second):
        found = [judge(form, logs[s], tests[s]) for s in sensors]
        outputs = logs[sensors[0]][0].drift.shape[1]
        width = form.compute(logs[sensors[0]][0]).shape[1] + 1
        inputs = 1 + form.second + len(form.lags)
        numbers = width * outputs + form.units * (inputs + 1 + outputs) + len(form.lags)
        shape = (len(form.lags), form.powers, form.products, form.units, numbers)
        figures = (float(np.median([one[n] for one in found])) for n in names)
        what = ", ".join(str(x) for x in shape)
        print(f"{what:<40}", *(f"{x:10.2f}" for x in figures), flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Terms against one-sided heat.")
    parser.add_argument("--sensors", type=int, nargs="+", default=[1, 2, 3], help="specimens")
    parser.add_argument("--second", action="store_true", help="the second thermometer too")
    given = parser.parse_args()
    main(given.sensors, given.second)
