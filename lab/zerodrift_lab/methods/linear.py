"""Least squares on powers of the temperature: what the earlier literature does."""

import time
from collections.abc import Sequence

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift_lab.methods.interface import Fit, Fitted, FittedFunction, Options
from zerodrift_lab.methods.windows import fit_windows


def make_least_squares(degree: int) -> Fit:
    """Return the fit of a polynomial of the temperature."""

    def fit(runs: Sequence[Run], *, seed: int, options: Options) -> Fitted:
        begin = time.process_time()
        windows = fit_windows(runs, options.thermometers, 1, options.spacing_s)

        def design(run: Run) -> Array:
            x = windows.cut(run)[:, 0]
            powers = [x**p for p in range(1, degree + 1)]
            return np.concatenate([np.ones((len(x), 1)), *powers], axis=1)

        a = np.concatenate([design(run) for run in runs])
        y = np.concatenate([run.drift for run in runs])
        coefficients = np.linalg.lstsq(a, y, rcond=None)[0]
        return FittedFunction(
            function=lambda run: np.asarray(design(run) @ coefficients),
            parameters=int(coefficients.size),
            macs_per_step=int(coefficients.size) + (degree - 1) * len(windows.sources),
            fit_cpu_s=time.process_time() - begin,
            exportable=True,
        )

    return fit
