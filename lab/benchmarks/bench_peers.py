"""Formulas of `propose` against other methods on the same simulated sensors, runs and test runs.

    python -m benchmarks.bench_peers [--seeds N] [--first-seed N] [--file FILE] [--minutes M]

The sensors are those of `formula_cases`. Every method learns from the training runs of a sensor
and is judged by its two test runs: RMS error there over that of the true drift, each run's own
offset taken off; 1 is perfect. All but `propose` are given what a straight line in temperature
leaves, as means of at most 2,000 blocks, and see the level and four low-passes of temperature,
load and the four inputs. *forward OLS*: forward selection by BIC among these, delays, squares,
cubes, roots, absolute values, exponentials, larger ones, products. *PySINDy*: its sparse regression
(STLSQ) over all products of two, threshold and ridge chosen by the last training run. *pyoperon*,
*gplearn*: symbolic regression, each output by itself. *GP*: a Gaussian process on 2,000 points,
a length for each signal. Each run has an offset of its own: the first two leave it open; from what
the others are given it is taken off as the forward selection finds it. A package that is not
installed (`make setup-peers`) is left out, and said to be. PySR needs Julia, and is not tried.
Outcomes are appended to FILE, and those that it has are not run again.
"""

import argparse
import json
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.bench_conditions import bound
from benchmarks.bench_propose import draw_case, take_model
from benchmarks.formula_cases import FORMS, Simulated
from benchmarks.formula_peers import (
    MOST_ROWS,
    Predict,
    TrainingRows,
    View,
    average,
    centre,
    choose_levels,
    learn_forward,
    learn_gplearn,
    learn_operon,
    learn_process,
    learn_sindy,
    list_library,
    list_views,
)
from zerodrift.base.arrays import Array
from zerodrift.base.extras import is_there
from zerodrift.dataset.runs import Run
from zerodrift.diagnosis.formula.proposal import propose_formula
from zerodrift.physics.catalogue import load_catalogue

WORSE = 1.05
"""An error above this multiple of the best one's is worse."""


@dataclass(frozen=True)
class Trial:
    """One method on one sensor."""

    method: str
    kind: str
    seed: int
    ratio: float
    """Error over the noise on test runs."""
    cpu_s: float


METHODS: dict[str, tuple[str, Callable[[TrainingRows], Predict], View]] = {
    "forward OLS": ("numpy", learn_forward, list_library),
    "PySINDy": ("pysindy", learn_sindy, list_views),
    "pyoperon": ("pyoperon", learn_operon, list_views),
    "gplearn": ("gplearn", learn_gplearn, list_views),
    "GP": ("sklearn", learn_process, list_views),
}
"""Name -> the package that it needs, how it learns, and what it sees."""


def try_peer(method: str, case: Simulated, seed: int) -> float:
    """Return a method's error over the noise on the test runs."""
    _, learn, view = METHODS[method]
    line = _fit_line(case.dataset.train)
    rows, show = gather(case, line, view, seed)
    if learn not in (learn_forward, learn_sindy):
        library, _ = gather(case, line, list_library, seed)
        left = library.y - learn_forward(library)(library.x)
        rows = replace(rows, y=rows.y - (left - centre(left, rows.run)))
    predict = learn(rows)
    found, noise = [], []
    for run in case.dataset.test:
        error = _leave(case, line, run) - predict(show(run))
        truth = (run.drift - case.truth[run.name]) / case.noise
        found.append((error - error.mean(axis=0)) ** 2)
        noise.append((truth - truth.mean(axis=0)) ** 2)
    return float(np.sqrt(np.concatenate(found).mean() / np.concatenate(noise).mean()))


def gather(
    case: Simulated, line: Array, view: View, seed: int
) -> tuple[TrainingRows, Callable[[Run], Array]]:
    """Return the training rows of a method, and what shows it any run at the same scale."""
    runs = case.dataset.train
    levels = choose_levels(runs)
    columns = [view(run, levels) for run in runs]
    together = np.concatenate(columns)
    mean, rms = together.mean(axis=0), together.std(axis=0) + 1e-12
    block = -(-len(together) // MOST_ROWS)
    y = [average(_leave(case, line, run), block) for run in runs]
    rows = TrainingRows(
        np.concatenate([average((x - mean) / rms, block) for x in columns]),
        np.concatenate(y),
        np.concatenate([np.full(len(one), n) for n, one in enumerate(y)]),
        seed,
    )
    return rows, lambda run: (view(run, levels) - mean) / rms


def _leave(case: Simulated, line: Array, run: Run) -> Array:
    """Return what a straight line in temperature leaves of a run [n, K], over the noise."""
    return np.asarray((run.drift - (run.temperature_degC[:, None] - 25.0) * line) / case.noise)


def _fit_line(runs: Sequence[Run]) -> Array:
    """Return the slope [K] in temperature over all runs, each without its means."""
    t = np.concatenate([run.temperature_degC - run.temperature_degC.mean() for run in runs])
    d = np.concatenate([run.drift - run.drift.mean(axis=0) for run in runs])
    return np.asarray((t @ d) / (t @ t))


def try_propose(case: Simulated) -> float:
    """Return the same of what `propose` answers."""
    found = propose_formula(case.config, case.dataset, load_catalogue())
    model = take_model(case, found)
    left, noise = [], []
    for run in case.dataset.test:
        for rows, told in ((left, model.predict(run)), (noise, case.truth[run.name])):
            error = (run.drift - told) / case.noise
            rows.append((error - error.mean(axis=0)) ** 2)
    return float(np.sqrt(np.concatenate(left).mean() / np.concatenate(noise).mean()))


def read_trials(file: Path | None) -> dict[tuple[str, str, int], Trial]:
    """Return the outcomes that a file has."""
    if file is None or not file.exists():
        return {}
    trials = [Trial(**json.loads(line)) for line in file.read_text(encoding="utf-8").splitlines()]
    return {(t.method, t.kind, t.seed): t for t in trials}


def run_trials(seeds: Sequence[int], file: Path | None, minutes: float) -> list[Trial]:
    """Run every method on every form, sensor by sensor, as long as there is time."""
    done = read_trials(file)
    methods = ["propose", *(name for name, (package, _, _) in METHODS.items() if is_there(package))]
    for name, (package, _, _) in METHODS.items():
        if name not in methods:
            print(f"{name} is left out: {package} is not installed (make setup-peers)")
    begin = time.time()
    for seed in seeds:
        for k, kind in enumerate(FORMS):
            if time.time() - begin > 60.0 * minutes:
                return list(done.values())
            case = draw_case(kind, seed + k)
            for method in methods:
                if (method, kind, seed + k) in done:
                    continue
                start = time.process_time()
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    ratio = (
                        try_propose(case)
                        if method == "propose"
                        else try_peer(method, case, seed + k)
                    )
                trial = Trial(method, kind, seed + k, ratio, time.process_time() - start)
                done[method, kind, seed + k] = trial
                print(
                    f"  {kind:26s} {method:12s} {ratio:6.3f} {trial.cpu_s:6.1f} s", file=sys.stderr
                )
                if file is not None:
                    with file.open("a", encoding="utf-8") as out:
                        out.write(json.dumps(asdict(trial)) + "\n")
    return list(done.values())


def tell(trials: Sequence[Trial]) -> None:
    """Print each method's errors, and how `propose` stands against the best other one."""
    by_case: dict[tuple[str, int], dict[str, Trial]] = {}
    for trial in trials:
        by_case.setdefault((trial.kind, trial.seed), {})[trial.method] = trial
    methods = list(dict.fromkeys(trial.method for trial in trials))
    cases = [found for found in by_case.values() if len(found) == len(methods)]
    if not cases:
        return
    print(f"simulated sensors, {len(cases)} cases; error over the noise on test runs")
    for method in methods:
        ratios = [found[method].ratio for found in cases]
        cpu_s = float(np.median([found[method].cpu_s for found in cases]))
        print(
            f"{method:12s} median {np.median(ratios):.3f}, 90 % below "
            f"{np.quantile(ratios, 0.9):.3f}, worst {max(ratios):.3f}; {cpu_s:.1f} CPU s"
        )
    others = [method for method in methods if method != "propose"]
    if not others or "propose" not in methods:
        return
    against = [
        found["propose"].ratio / min(found[method].ratio for method in others) for found in cases
    ]
    good = sum(ratio <= WORSE for ratio in against)
    least = bound(good, len(cases), upper=False)
    print(
        f"propose over the best other one: median {np.median(against):.3f}; at most "
        f"{100.0 * (WORSE - 1.0):.0f} % worse in {good} of {len(cases)} "
        f"({100.0 * good / len(cases):.0f} %; above {100.0 * least:.0f} %)"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seeds", type=int, default=1, help="of each form")
    parser.add_argument("--first-seed", type=int, default=5000)
    parser.add_argument("--file", type=Path)
    parser.add_argument("--minutes", type=float, default=1e9)
    options = parser.parse_args(arguments)
    seeds = [options.first_seed + 100 * n for n in range(options.seeds)]
    tell(run_trials(seeds, options.file, options.minutes))


if __name__ == "__main__":
    main()
