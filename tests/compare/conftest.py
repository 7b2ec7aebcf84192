"""Runs whose errors are planted, so that what is found can be told in advance."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from zerodrift.dataset.runs import Run

Array = NDArray[np.float64]
MakeRun = Callable[..., Run]


@pytest.fixture
def make_run() -> MakeRun:
    """Return a function that makes a run of two ramps of the temperature, and two outputs."""

    def make(
        number: int,
        error: Callable[[Run], Array] | None = None,
        *,
        length: int = 1200,
        noise: float = 0.05,
        name: str = "",
        part: int = 0,
        **inputs: Array,
    ) -> Run:
        rng = np.random.default_rng(1000 + number)
        time_s = np.arange(length, dtype=np.float64)
        turn = 0.3 + 0.05 * (number % 4)
        knots = (0.0, 0.05 + 0.02 * (number % 3), turn, turn + 0.1, 0.85, 1.0)
        low, high = -5.0 - number % 7, 45.0 + number % 5
        levels = (20.0, 20.0, high, high, low, low)
        if number % 2:
            levels = (20.0, 20.0, low, low, high, high)
        temperature = np.interp(time_s / length, knots, levels)
        steps = 100.0 * rng.integers(-3, 4, size=-(-length // 150))
        load = np.stack([np.repeat(steps, 150)[:length], np.zeros(length)], axis=1)
        noise_part = noise * rng.standard_normal((length, 2))
        run = Run(
            name=name or f"run{number}" + (f"#{part + 1}" if part else ""),
            group=name or f"run{number}",
            part=part,
            source=Path(f"run{number}.csv"),
            sample_period_s=1.0,
            time_s=time_s,
            temperature_degC=temperature,
            measured=load + noise_part,
            reference=load,
            inputs=inputs,
        )
        if error is not None:
            run.measured[:] += error(run)
        return run

    return make
