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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.bench_conditions import bound
from benchmarks.bench_propose import draw_case, take_model
from benchmarks.formula_cases import FORMS, Simulated
from zerodrift.base.extras import is_there
from zerodrift.dataset.runs import Run
from zerodrift.diagnosis.formula.proposal import propose_formula
from zerodrift.operations.lowpass import lowpass
from zerodrift.physics.catalogue import load_catalogue

Array = NDArray[np.float64]
Predict = Callable[[Array], Array]
"""Columns [n, J] -> [n, K]."""
Levels = Mapping[str, Array]
"""Signal -> three levels of it."""
View = Callable[[Run, Levels], Array]

MOST_ROWS = 2_000
TAUS_S = (20.0, 60.0, 200.0, 600.0)
DELAYS_S = (40.0, 80.0, 160.0, 240.0)
WORSE = 1.05
"""An error above this multiple of the best one's is worse."""
MOST_TERMS = 8
SEARCH_S = 6
"""Seconds of pyoperon, for each output."""


@dataclass(frozen=True)
class Trial:
    """One method on one sensor."""

    method: str
    kind: str
    seed: int
    ratio: float
    """Error over the noise on test runs."""
    cpu_s: float


@dataclass(frozen=True)
class TrainingRows:
    """What a method is given: rows of the training runs."""

    x: Array
    """[m, J] columns at mean 0 and RMS 1."""
    y: Array
    """[m, K] what a straight line in temperature leaves, over the noise; each run has an offset of
    its own, or it was taken off."""
    run: NDArray[np.int64]
    """[m] number of the run."""
    seed: int


def list_signals(run: Run) -> dict[str, Array]:
    """Return the signals [n] of a run."""
    return {"T": run.temperature_degC, "load": run.reference[:, 0], **run.inputs}


def list_views(run: Run, levels: Levels) -> Array:
    """Return levels and low-passes [n, J] of a run's signals; `levels` plays no part."""
    columns = []
    for x in list_signals(run).values():
        columns += [x, *(lowpass(x, run.sample_period_s, tau) for tau in TAUS_S)]
    return np.stack(columns, axis=1)


def choose_levels(runs: Sequence[Run]) -> Levels:
    """Return three levels of each signal, its quartiles over all runs."""
    together = [list_signals(run) for run in runs]
    return {
        name: np.quantile(np.concatenate([x[name] for x in together]), (0.25, 0.5, 0.75))
        for name in together[0]
    }


def list_library(run: Run, levels: Levels) -> Array:
    """Return the candidates [n, J] of the forward selection.

    Args:
        run: with its signals.
        levels: of each signal, for what bends there.
    """
    signals = list_signals(run)
    columns: list[Array] = []
    for name, x in signals.items():
        low, middle, high = levels[name]
        views = [x, *(lowpass(x, run.sample_period_s, tau) for tau in TAUS_S)]
        late = [
            np.concatenate([np.full(steps, x[0]), x[: x.size - steps]])
            for steps in (round(delay / run.sample_period_s) for delay in DELAYS_S)
        ]
        apart = [x - view for view in views[1:]]
        columns += [*views, *late, *apart]
        columns += [v**2 for v in views] + [v**3 for v in views[:1]]
        columns += [np.abs(v) for v in apart] + [np.sqrt(np.abs(x))]
        columns += [
            np.exp2(np.clip((x - middle) / (share * max(high - low, 1e-9)), -30.0, 30.0))
            for share in (0.2, 0.4, 0.8)
        ]
        columns += [np.maximum(x, c) for c in (low, middle, high)]
    names = list(signals)
    for i, one in enumerate(names):
        for other in names[i + 1 :]:
            a, b = signals[one], signals[other]
            slow = [lowpass(v, run.sample_period_s, 200.0) for v in (a, b)]
            columns += [a * b, slow[0] * b, a * slow[1], np.maximum(a, b), (a - b) ** 2]
    return np.stack(columns, axis=1)


def average(x: Array, block: int) -> Array:
    """Return means of blocks of rows."""
    rows = len(x) // block
    return np.asarray(x[: rows * block].reshape(rows, block, -1).mean(axis=1))


def centre(values: Array, run: NDArray[np.int64]) -> Array:
    """Return rows without the mean of their run."""
    left = values.copy()
    for number in np.unique(run):
        left[run == number] -= values[run == number].mean(axis=0)
    return left


def learn_forward(rows: TrainingRows) -> Predict:
    """Return least squares on the columns that lower BIC most, one after the other."""
    coefficients = []
    m = len(rows.y)
    x = centre(rows.x, rows.run)
    for y in centre(rows.y, rows.run).T:
        chosen: list[int] = []
        basis = np.zeros((m, 0))
        left, columns = y.copy(), x.copy()
        best = m * np.log(np.mean(left**2))
        while len(chosen) < MOST_TERMS:
            squares = np.einsum("mj,mj->j", columns, columns)
            gains = np.where(squares > 1e-6 * m, (left @ columns) ** 2 / (squares + 1e-12), 0.0)
            j = int(np.argmax(gains))
            error = max(float(left @ left - gains[j]), 1e-12)
            score = m * np.log(error / m) + (len(chosen) + 1) * np.log(m)
            if gains[j] <= 0.0 or score >= best:
                break
            direction = columns[:, j] / np.sqrt(squares[j])
            basis = np.column_stack([basis, direction])
            left = left - direction * (direction @ left)
            columns = columns - np.outer(direction, direction @ columns)
            best = score
            chosen.append(j)
        weights = np.zeros(x.shape[1])
        if chosen:
            weights[chosen] = np.linalg.lstsq(x[:, chosen], y, rcond=None)[0]
        coefficients.append(weights)
    told = np.stack(coefficients, axis=1)
    return lambda x: x @ told


def learn_sindy(rows: TrainingRows) -> Predict:
    """Return PySINDy's sparse regression over all products of two."""
    import pysindy

    library = pysindy.PolynomialLibrary(degree=2, include_bias=False)
    table = np.asarray(library.fit_transform(rows.x))
    mean, rms = table.mean(axis=0), table.std(axis=0) + 1e-12
    table, y = centre((table - mean) / rms, rows.run), centre(rows.y, rows.run)
    judge = rows.run == rows.run.max()
    best: tuple[float, float, float] = (np.inf, 0.0, 0.0)
    for threshold in (0.03, 0.1, 0.3, 1.0):
        for alpha in (1.0, 30.0):
            found = _fit_sparse(table[~judge], y[~judge], threshold, alpha)
            error = float(np.mean((y[judge] - table[judge] @ found) ** 2))
            best = min(best, (error, threshold, alpha))
    told = _fit_sparse(table, y, best[1], best[2])
    return lambda x: ((np.asarray(library.transform(x)) - mean) / rms) @ told


def _fit_sparse(x: Array, y: Array, threshold: float, alpha: float) -> Array:
    import pysindy

    found = pysindy.STLSQ(threshold=threshold, alpha=alpha, max_iter=20).fit(x, y)
    return np.asarray(found.coef_).T


def learn_operon(rows: TrainingRows) -> Predict:
    """Return what pyoperon finds for each output."""
    from pyoperon.sklearn import SymbolicRegressor

    found = []
    for y in rows.y.T:
        search = SymbolicRegressor(
            allowed_symbols="add,sub,mul,div,sqrt,abs,exp,constant,variable",
            max_length=20,
            max_evaluations=10_000_000,
            max_time=SEARCH_S,
            n_threads=1,
            random_state=rows.seed,
        )
        search.fit(rows.x, y)
        found.append(search)
    return lambda x: np.stack([one.predict(x) for one in found], axis=1)


def learn_gplearn(rows: TrainingRows) -> Predict:
    """Return what gplearn finds for each output, scaled by least squares."""
    from gplearn.genetic import SymbolicRegressor

    found = []
    for y in rows.y.T:
        search = SymbolicRegressor(
            population_size=500,
            generations=10,
            function_set=("add", "sub", "mul", "div", "sqrt", "abs", "max", "min"),
            metric="pearson",
            stopping_criteria=1.0,
            parsimony_coefficient=0.001,
            n_jobs=1,
            random_state=rows.seed,
        )
        search.fit(rows.x, y)
        told = search.predict(rows.x)
        slope = float(np.polyfit(told, y, 1)[0]) if np.ptp(told) > 0.0 else 0.0
        found.append((search, slope))
    return lambda x: np.stack([slope * one.predict(x) for one, slope in found], axis=1)


def learn_process(rows: TrainingRows) -> Predict:
    """Return a Gaussian process, its lengths found on a quarter of the points."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    found = []
    picked = slice(None, None, 5)
    for y in rows.y.T:
        width = rows.x.shape[1]
        kernel = ConstantKernel(1.0, (1e-3, 1e3)) * RBF(
            np.full(width, 5.0), (0.3, 1e3)
        ) + WhiteKernel(0.1, (1e-3, 1e2))
        first = GaussianProcessRegressor(kernel, normalize_y=True, random_state=rows.seed)
        first.fit(rows.x[picked], y[picked])
        whole = GaussianProcessRegressor(first.kernel_, optimizer=None, normalize_y=True)
        found.append(whole.fit(rows.x, y))
    return lambda x: np.stack([one.predict(x) for one in found], axis=1)


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
