"""Fits the methods, judges them on the tests, and keeps every result."""

import multiprocessing
import signal
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import EffectConfig
from zerodrift_lab.methods import METHODS, Options
from zerodrift_lab.methods.interface import Fitted
from zerodrift_lab.paper.store import Cell, Store
from zerodrift_lab.paper.world import (
    BODY,
    TESTS,
    Trial,
    pool_floor,
    record_test,
    record_training,
)
from zerodrift_lab.twin.sensor import FULL_SCALE, OUTPUTS

Say = Callable[[int, int, str], None]
"""(done, of how many, what was done)."""

COURSE_EPOCHS: tuple[int, ...] = (
    *(1, 2, 3, 5, 7, 10, 15, 20, 30, 40, 50, 70, 100, 150, 200, 300, 400, 500, 700, 1000),
    *(1200, 1400, 1600, 1800, 1900, 1950, 1990, 2000),
)
"""After which epochs the error is kept."""
EFFECTS = dict.fromkeys(
    ("physics", "physics_network"), ("zero_tempco", "dark_current", "thermal_lag")
)
"""The physical models of methods that need to be given one."""
TRACED, TRACE_POINTS = ("chamber", "heating"), 240
COURSE_TESTS = ("chamber", "heating")


@dataclass(frozen=True)
class Outcome:
    """A cell with its result."""

    cell: Cell
    result: Mapping[str, Any]

    def rmse(self, test: str) -> Array:
        """Return [K] RMSE on a test, runs pooled, in each output's unit."""
        return np.array(self.result["tests"][test]["rmse"])

    def none(self, test: str) -> Array:
        """Return [K] RMSE without compensation."""
        return np.array(self.result["tests"][test]["none"])

    def floor(self, test: str) -> Array:
        """Return [K] noise floor."""
        return np.array(self.result["tests"][test]["floor"])

    def scale(self) -> Array:
        """Return [K] RMS of the drift of the chamber's training runs about its mean."""
        return np.array(self.result["scale"])


def fit_cell(cell: Cell) -> dict[str, Any]:
    """Return the result of a fit as JSON values."""
    runs = record_training(cell.sensor, cell.logs, cell.body)
    course: list[dict[str, Any]] = []

    def follow(epoch: int, seconds: float, fitted: Fitted) -> None:
        errors = {t: judge(fitted, record_test(cell.sensor, t, cell.body)) for t in COURSE_TESTS}
        course.append({"epoch": epoch, "cpu_s": seconds, "tests": errors})

    effects = cell.effects or EFFECTS.get(cell.method, ())
    options = Options(
        spacing_s=cell.spacing_s,
        schedule=cell.schedule,
        epochs=cell.epochs,
        thermometers=(BODY,) if cell.body else (),
        effects=tuple(EffectConfig(kind) for kind in effects),
        outputs=OUTPUTS,
        full_scale=tuple(FULL_SCALE.tolist()),
        report=follow if cell.course else None,
        report_epochs=COURSE_EPOCHS,
    )
    fitted = METHODS[cell.method].fit(runs, seed=cell.seed, options=options)
    chamber = np.concatenate(
        [run.drift for run in runs if run.name.startswith("chamber_") and "loaded" not in run.name]
    )
    in_sample = np.concatenate([run.drift - fitted.predict(run) for run in runs])
    tests = {test: judge(fitted, record_test(cell.sensor, test, cell.body)) for test in TESTS}
    return {
        "parameters": fitted.parameters,
        "macs_per_step": fitted.macs_per_step,
        "fit_cpu_s": fitted.fit_cpu_s,
        "notes": list(fitted.notes),
        "scale": chamber.std(axis=0).tolist(),
        "in_sample": np.sqrt(np.mean(in_sample**2, axis=0)).tolist(),
        "tests": tests,
        "course": course,
        "traces": {
            test: trace(fitted, record_test(cell.sensor, test, cell.body)) for test in TRACED
        },
    }


def trace(fitted: Fitted, trials: Sequence[Trial]) -> dict[str, Any]:
    """Return the first run of a test at few points: time, temperature, drift and prediction."""
    run = trials[0].run
    step = max(1, len(run) // TRACE_POINTS)
    lists = {"drift": run.drift[::step], "prediction": fitted.predict(run)[::step]}
    return {
        "time_s": run.time_s[::step].tolist(),
        "temperature_degC": run.temperature_degC[::step].tolist(),
        **{name: np.round(values.T, 5).tolist() for name, values in lists.items()},
    }


def judge(fitted: Fitted, trials: Sequence[Trial]) -> dict[str, Any]:
    """Return errors with and without compensation, and the floor, [K] each, runs pooled."""
    drift = np.concatenate([trial.run.drift for trial in trials])
    errors = [trial.run.drift - fitted.predict(trial.run) for trial in trials]
    error = np.concatenate(errors)
    return {
        "rmse": np.sqrt(np.mean(error**2, axis=0)).tolist(),
        "none": np.sqrt(np.mean(drift**2, axis=0)).tolist(),
        "floor": pool_floor(trials).tolist(),
        "max": np.abs(error).max(axis=0).tolist(),
        "runs": {
            trial.run.name: {
                "rmse": np.sqrt(np.mean(e**2, axis=0)).tolist(),
                "none": np.sqrt(np.mean(trial.run.drift**2, axis=0)).tolist(),
                "floor": trial.floor.tolist(),
            }
            for trial, e in zip(trials, errors, strict=True)
        },
    }


def _fit_and_keep(cell: Cell, directory: Path) -> dict[str, Any]:
    result = fit_cell(cell)
    Store(directory).save(cell, METHODS[cell.method].family, result)
    return result


def _start_worker() -> None:
    """Leave Ctrl-C to the process that waits for this one."""
    import torch

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)


def run_study(
    cells: Sequence[Cell], store: Store, jobs: int = 1, say: Say = lambda *_: None
) -> list[Outcome]:
    """Return the outcome of every cell, in order; what is kept is not fitted again.

    Args:
        cells: what to fit.
        store: where each result is kept as soon as it is there.
        jobs: processes; 1 fits in this one.
        say: is told of every result.
    """
    found: dict[Cell, Mapping[str, Any]] = {}
    missing: list[Cell] = []
    for cell in dict.fromkeys(cells):
        kept = store.load(cell, METHODS[cell.method].family)
        if kept is None:
            missing.append(cell)
        else:
            found[cell] = kept
    total = len(found) + len(missing)

    def told(cell: Cell, result: Mapping[str, Any]) -> None:
        found[cell] = result
        say(len(found), total, f"{cell.method}, sensor {cell.sensor}, seed {cell.seed}")

    if missing:
        say(len(found), total, f"fitting {missing[0].method}, sensor {missing[0].sensor}")
    if jobs == 1:
        for cell in missing:
            told(cell, _fit_and_keep(cell, store.directory))
    elif missing:
        _run_in_pool(missing, store.directory, jobs, told)
    return [Outcome(cell, found[cell]) for cell in cells]


def _run_in_pool(
    cells: Sequence[Cell],
    directory: Path,
    jobs: int,
    told: Callable[[Cell, Mapping[str, Any]], None],
) -> None:
    """Fit in processes of their own; an interruption waits for none of them."""
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=_start_worker)
    try:
        waiting: dict[Future[dict[str, Any]], Cell] = {
            pool.submit(_fit_and_keep, cell, directory): cell for cell in cells
        }
        while waiting:
            done, _ = wait(waiting, return_when=FIRST_COMPLETED)
            for future in done:
                told(waiting.pop(future), future.result())
    except BaseException:
        for process in list((pool._processes or {}).values()):
            process.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
