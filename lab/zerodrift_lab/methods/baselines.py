"""Other baselines of the field, from scikit-learn: none of them goes onto the chip."""

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import Run
from zerodrift_lab.methods.interface import Fit, Fitted, FittedFunction, Options
from zerodrift_lab.methods.networks import WINDOW
from zerodrift_lab.methods.windows import fit_windows

KERNEL_ROWS = 3000
"""Training rows of the kernel methods, evenly drawn: their cost grows with the square or cube."""

Make = Callable[[int], Any]
"""seed -> a scikit-learn regressor of several outputs."""


def make_kernel_ridge(_: int) -> Any:
    """Return kernel ridge regression with a Gaussian kernel: an RBF network with a unit per row."""
    from sklearn.kernel_ridge import KernelRidge

    return KernelRidge(kernel="rbf", alpha=1e-3, gamma=0.1)


def make_svr(_: int) -> Any:
    """Return one support-vector regression per output."""
    from sklearn.multioutput import MultiOutputRegressor
    from sklearn.svm import SVR

    return MultiOutputRegressor(SVR(kernel="rbf", C=100.0, epsilon=0.01, gamma=0.1))


def make_neighbours(_: int) -> Any:
    """Return the mean of the nearest windows."""
    from sklearn.neighbors import KNeighborsRegressor

    return KNeighborsRegressor(n_neighbors=10, weights="distance")


def make_forest(seed: int) -> Any:
    """Return a random forest."""
    from sklearn.ensemble import RandomForestRegressor

    return RandomForestRegressor(n_estimators=100, min_samples_leaf=5, random_state=seed)


def make_baseline(make: Make, most_rows: int = 0) -> Fit:
    """Return the fit of a scikit-learn regressor on the windows that the networks see.

    Args:
        make: makes the regressor.
        most_rows: training rows are thinned to as many; 0: all.
    """

    def fit(runs: Sequence[Run], *, seed: int, options: Options) -> Fitted:
        begin = time.process_time()
        try:
            model = make(seed)
        except ImportError as error:
            raise InputError(
                f"this method needs scikit-learn ({error}). Run: pip install scikit-learn"
            ) from error
        windows = fit_windows(runs, options.thermometers, WINDOW, options.spacing_s)

        def arrange(run: Run) -> Array:
            return windows.cut(run).reshape(len(run), -1)

        x = np.concatenate([arrange(run) for run in runs])
        drift = np.concatenate([run.drift for run in runs])
        centre, spread = drift.mean(axis=0), np.maximum(drift.std(axis=0), 1e-12)
        rows = np.arange(len(x))
        if most_rows and len(x) > most_rows:
            rows = np.linspace(0, len(x) - 1, most_rows).round().astype(int)
        model.fit(x[rows], ((drift - centre) / spread)[rows])

        def predict(run: Run) -> Array:
            answer = np.asarray(model.predict(arrange(run))).reshape(len(run), -1)
            return np.asarray(answer * spread + centre)

        return FittedFunction(
            function=predict,
            parameters=int(rows.size * (x.shape[1] + drift.shape[1])),
            macs_per_step=0,
            fit_cpu_s=time.process_time() - begin,
            exportable=False,
            notes=("parameters are the training rows that it keeps",),
        )

    return fit
