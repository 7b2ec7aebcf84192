"""Formulas outside the catalogue on simulated sensors: found, how good, and how often falsely.

    python -m benchmarks.bench_propose [--seeds N] [--without N] [--first-seed N]

The sensors are those of `formula_cases`, which shares no code with the search. Each has 4 to 8
training runs, an effect of one or two operations that the catalogue lacks, 2 to 10 times the noise,
and two test runs that nothing is chosen by. The marks: the right form, or predictions within a
tenth of the noise on the test runs, in 85 %; error over the floor after adding, median 1.10; a
formula for a complete model or a pure disturbance in at most 3 of 300; 60 CPU s for a search in 8
runs of 20,000 rows with 6 outputs and 5 channels.
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.bench_conditions import bound
from benchmarks.formula_cases import DISTURBANCES, FORMS, Simulated, simulate
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.formula.proposal import FormulaSearch, propose_formula
from zerodrift.physics.catalogue import load_catalogue

WITHIN = 0.1
"""Predictions this close, in units of the noise, are as good as the right form."""
RIGHT = {
    "humidity - LP(humidity)": {"(humidity - LP(humidity, tau_s))"},
    "|T - LP(T)|": {"|T - LP(T, tau_s)|"},
    "(T - a) (humidity - b)": {
        "(T - origin_a) * humidity",
        "T * (humidity - origin_b)",
        "(T - origin_a) * (humidity - origin_b)",
    },
    "max(supply, c)": {"max(supply, threshold)"},
    "delay(ambient_light)": {"delay(ambient_light, delay_s)"},
    "play(humidity)": {"play(humidity, half_width)"},
    "LP((supply - 4 V)^2)": {"LP((supply - origin)^2, tau_s)"},
    "load (LP(humidity) - b)": {"(LP(humidity, tau_s) - origin_a) * load_Fz"},
    "2^(humidity / d)": {"2^(humidity / doubling)"},
    "sqrt(ambient_light)": {"sqrt(ambient_light)"},
    "max(T, body_temperature)": {"max(T, body_temperature)"},
    "(body_temperature - T)^2": {"(T - body_temperature)^2"},
}
"""How `propose` writes each form, names for its numbers."""


@dataclass(frozen=True)
class Scored:
    """One case's end."""

    kind: str
    told: str
    """The formula, or why there is none."""
    right: bool
    apart: float
    """RMS difference from the truth on test runs, in units of the noise; NaN without a formula."""
    ratio: float
    """Error over the floor on test runs, with the formula if there is one."""
    found: bool
    cpu_s: float


def main(quick: bool) -> None:
    """Print every figure; `quick` takes one seed of each form."""
    run_cases(seeds=1 if quick else 3, without=8 if quick else 30)
    if not quick:
        time_large()


def run_cases(seeds: int, without: int, first_seed: int = 5000) -> None:
    """Run the forms, and the sensors for which there is no formula; print both."""
    print("simulated sensors; all logs here are simulated")
    scored = []
    for n in range(seeds):
        for k, kind in enumerate(FORMS):
            scored.append(score(kind, first_seed + 100 * n + k))
            one = scored[-1]
            mark = "form" if one.right else "as good" if one.apart < WITHIN else "MISSED"
            print(
                f"  {kind:28} {mark:8} {one.ratio:5.2f} {one.cpu_s:5.1f} s  {one.told}", flush=True
            )
    good = sum(one.right or one.apart < WITHIN for one in scored)
    print(f"right form or within {WITHIN:g} of the noise: {tell_least(good, len(scored))}")
    print(f"the right form: {tell_least(sum(one.right for one in scored), len(scored))}")
    ratios = [one.ratio for one in scored]
    print(f"error over floor on test runs: median {np.median(ratios):.3f}, worst {max(ratios):.2f}")
    print(f"CPU seconds of a search: median {np.median([one.cpu_s for one in scored]):.1f}")
    kinds = ("complete", *DISTURBANCES)
    false = []
    for n in range(without):
        one = score(kinds[n % len(kinds)], first_seed + 50_000 + n)
        if one.found:
            false.append(one)
            print(f"  FALSE {one.kind}: {one.told}", flush=True)
    most = bound(len(false), without, upper=True)
    print(
        f"a formula where there is none: {len(false)} of {without} "
        f"(at most {100.0 * most:.1f} % with 95 % confidence)"
    )


def score(kind: str, seed: int) -> Scored:
    """Return what `propose` makes of one simulated sensor."""
    rng = np.random.default_rng(seed)
    size, runs = float(np.exp(rng.uniform(np.log(2.0), np.log(10.0)))), int(rng.integers(4, 9))
    case = simulate(kind, size, runs, seed)
    start = time.process_time()
    found = propose_formula(case.config, case.dataset, load_catalogue())
    cpu_s = time.process_time() - start
    formula = found.formula
    if formula is None:
        return Scored(
            kind, found.reason, False, float("nan"), found.floor_ratio_before, False, cpu_s
        )
    apart, ratio = _compare(case, found)
    one = formula.expressions[0].write() if len(formula.expressions) == 1 else ""
    right = one in RIGHT.get(kind, set())
    return Scored(kind, formula.write(), right, apart, ratio, True, cpu_s)


def _compare(case: Simulated, found: FormulaSearch) -> tuple[float, float]:
    """Return how far predictions are from the truth, and errors over the noise, on test runs."""
    assert found.formula is not None
    model = found.formula.revision.after.model
    apart: list[NDArray[np.float64]] = []
    left: list[NDArray[np.float64]] = []
    noise: list[NDArray[np.float64]] = []
    for run in case.dataset.test:
        prediction, truth = model.predict(run), case.truth[run.name]
        for rows, difference in (
            (apart, prediction - truth),
            (left, run.drift - prediction),
            (noise, run.drift - truth),
        ):
            rows.append(((difference - difference.mean(axis=0)) / case.noise) ** 2)
    rms = [float(np.sqrt(np.concatenate(rows).mean())) for rows in (apart, left, noise)]
    return rms[0], rms[1] / rms[2]


def tell_least(good: int, of: int) -> str:
    """Return a rate with the bound that it exceeds with 95 % confidence (Clopper-Pearson)."""
    least = bound(good, of, upper=False)
    return f"{good} of {of} ({100.0 * good / of:.0f} %; above {100.0 * least:.0f} %)"


def time_large() -> None:
    """Time a search in 8 runs of 20,000 rows with 6 outputs and 5 channels."""
    case = simulate("humidity - LP(humidity)", 4.0, 8, 1)
    names = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
    rng = np.random.default_rng(1)

    def stretch(run: Run) -> Run:
        """Return the run with each sample held for 14, and six outputs with loads of their own."""
        rows = 20_000
        place = np.minimum(np.arange(rows) * len(run) // rows, len(run) - 1)
        load = np.repeat(rng.uniform(-50.0, 50.0, (40, 6)), rows // 40, axis=0)
        load *= float(np.ptp(run.reference)) > 0.0
        drift = run.drift[place][:, [0, 0, 0, 1, 1, 1]]
        drift = drift + 0.05 * rng.standard_normal((rows, 6))
        inputs = {name: x[place] for name, x in run.inputs.items()}
        inputs["acceleration_x"] = rng.standard_normal(rows)
        return replace(
            run,
            time_s=run.sample_period_s * np.arange(rows),
            temperature_degC=run.temperature_degC[place],
            measured=load + drift,
            reference=load,
            inputs=inputs,
        )

    data = case.dataset
    large = Dataset(
        train=tuple(stretch(run) for run in data.train),
        test=(),
        dwell=tuple(stretch(run) for run in data.dwell),
        outputs=names,
        units=("N",) * 3 + ("Nm",) * 3,
        full_scale=(200.0,) * 3 + (14.0,) * 3,
    )
    start = time.process_time()
    found = propose_formula(case.config, large, load_catalogue())
    cpu_s = time.process_time() - start
    print(
        f"8 runs x 20,000 rows x 6 outputs x 5 channels: {cpu_s:.0f} CPU s, {found.forms} formulas,"
        f" {found.tried} columns; {found.reason}"
    )


def parse(arguments: Sequence[str] | None = None) -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="of each form")
    parser.add_argument("--without", type=int, default=30, help="sensors without a formula")
    parser.add_argument("--first-seed", type=int, default=5000)
    parser.add_argument("--large", action="store_true", help="only the time of a large search")
    options = parser.parse_args(arguments)
    if options.large:
        time_large()
        return
    run_cases(options.seeds, options.without, options.first_seed)


if __name__ == "__main__":
    parse()
