"""Which tanh units beside the lag bank, over which lags? On the six-axis twin.

    python -m benchmarks.study_units [--sensors 9 10 11 12 13 14] [--second]

Members of so many units each, from starts of their own, averaged, over the lags that the linear
bank found or lags spread evenly in the logarithm, with so many powers of each lag beside them. All
learn from the chamber and the varied logs of `bench_paper`; printed is the error on held-out runs
over their noise floor, and the number of parameters. The evidence of
`docs/decisions/104-many-units-over-spread-lags.md`. All data are simulated.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.study_heat import JUDGED, measure_heat
from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.physics.fit import fit as fit_effects
from zerodrift.train.front_end import TEMPERATURE
from zerodrift.train.lag_bank.data import DEGREE
from zerodrift.train.lag_bank.fit import assemble_fit, prepare
from zerodrift.train.lag_bank.search import choose_bank, pick, span_of
from zerodrift.train.lag_bank.units import Choice, Trial
from zerodrift_lab.methods.interface import Options, list_outputs
from zerodrift_lab.methods.physical import DEFAULT_EFFECTS
from zerodrift_lab.paper.world import BODY, CHAMBER_CYCLES, record_test, record_training

SHAPES = ((4, 1), (4, 3), (6, 2), (8, 2), (12, 1), (16, 1), (24, 1))
"""Units of a member, and members."""


@dataclass(frozen=True)
class Form:
    """What is fitted."""

    spread: int
    """Lags spread over what the logs can tell; 0: those that the linear bank found."""
    degree: int
    """Powers of each lag."""
    units: int
    members: int


def fit_forms(
    runs: Sequence[Run], second: bool, forms: Sequence[Form]
) -> list[tuple[Callable[[Run], Array], int]]:
    """Return what each form predicts of a run [n, K], and its number of parameters."""
    names, full_scale = list_outputs(runs, Options())
    units = ("",) * len(names)
    physics = fit_effects(DEFAULT_EFFECTS, runs, outputs=names, units=units, full_scale=full_scale)
    prepared = prepare(physics, runs, (TEMPERATURE, BODY) if second else (TEMPERATURE,))
    rows = prepared.rows
    bank = pick(choose_bank(rows))

    def fit_form(form: Form) -> tuple[Callable[[Run], Array], int]:
        taus_s = np.geomspace(*span_of(rows.data), max(form.spread, 2))
        lags = tuple((0, float(tau_s)) for tau_s in taus_s) if form.spread else bank.lags
        trial = Trial(rows, runs, lags, bank.ridge, form.degree, form.units)
        fits = []
        for member in range(form.members):
            fitted = trial.fit((0, member), rows.everything)
            choice = Choice(lags, bank.ridge, form.degree, fitted, trial.front_end, None)
            fits.append(assemble_fit(physics, runs, prepared, choice, (), ()))
        own = fits[0].weights.size + fits[0].bias.size + fits[0].head.size
        count = int(np.count_nonzero(physics.coefficients)) + fits[0].bank.parameters

        def predict(run: Run) -> Array:
            mean = np.mean([one.correct(run, physics) for one in fits], axis=0)
            return np.asarray(physics.predict(run) + mean)

        return predict, count + form.members * own

    return [fit_form(form) for form in forms]


def list_forms(second: bool) -> list[Form]:
    """Return the forms that are compared."""
    found = [Form(0, degree, *shape) for degree in (DEGREE, 1) for shape in SHAPES]
    if second:
        return found
    places = [(lags, degree) for lags in (3, 4, 5) for degree in (DEGREE, 1)]
    return found + [Form(*place, *shape) for place in places for shape in ((4, 3), (16, 1))]


def main(sensors: Sequence[int], second: bool) -> None:
    """Print the table, medians over the sensors."""
    forms, names = list_forms(second), (*JUDGED, "bench")
    rows: list[list[list[float]]] = [[] for _ in forms]
    for sensor in sensors:
        runs = record_training(sensor, "varied", second)
        tests = {test: record_test(sensor, test, second) for test in JUDGED}
        scale = np.concatenate([run.drift for run in runs[:CHAMBER_CYCLES]]).std(axis=0)
        for row, (predict, numbers) in zip(rows, fit_forms(runs, second, forms), strict=True):
            found = measure_heat(predict, tests, scale)
            row.append([*(found[name] for name in names), numbers])
    print(f"simulated six-axis sensors {list(sensors)}; error / noise floor, medians")
    print(f"{'lags':<8}{'powers':>7}{'units':>9}", *(f"{n[:10]:>10}" for n in names), "   numbers")
    for form, row in zip(forms, rows, strict=True):
        *errors, numbers = np.median(row, axis=0)
        lags, units = f"{form.spread or 'found'}", f"{form.members} x {form.units}"
        cells = " ".join(f"{x:10.2f}" for x in errors)
        print(f"{lags:<8}{form.degree:7d}{units:>9} {cells} {numbers:10.0f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Units beside the lag bank.")
    parser.add_argument("--sensors", type=int, nargs="+", default=list(range(9, 15)))
    parser.add_argument("--second", action="store_true", help="the second thermometer too")
    given = parser.parse_args()
    main(given.sensors, given.second)
