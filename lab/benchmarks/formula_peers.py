"""The methods that `propose` is compared with: what each sees of a run, and how it learns."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.operations.lowpass import lowpass

Predict = Callable[[Array], Array]
"""Columns [n, J] -> [n, K]."""
Levels = Mapping[str, Array]
"""Signal -> three levels of it."""
View = Callable[[Run, Levels], Array]
MOST_ROWS = 2_000
TAUS_S = (20.0, 60.0, 200.0, 600.0)
DELAYS_S = (40.0, 80.0, 160.0, 240.0)
MOST_TERMS = 8
SEARCH_S = 6
"""Seconds of pyoperon, for each output."""


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
