"""The limits of an experiment: `[experiment]`, completed from the logs, checked for
contradictions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.base.experiment_config import ExperimentConfig, Reach
from zerodrift.dataset.runs import Run

FOLLOWS_S = 200.0
"""A body of tens of grams follows moving air within minutes."""
RAMP_K_PER_MIN = 2.0
"""Of a chamber of which nothing is said."""
LOG_MIN, REST_MIN = 20.0, 5.0
ROOM_DEGC = 23.0
FASTEST_SHARE = 0.99
"""Of the rates in the logs, so that single noisy rows do not count."""
RATE_OVER_S = 120.0
LEAST_SPAN_K = 1.0
"""A chamber that moves less than this within a log moves nothing."""


@dataclass(frozen=True)
class Limits:
    """What can be set, how far and how fast."""

    low_degC: float
    high_degC: float
    start_degC: float
    heating_K_per_s: float
    cooling_K_per_s: float
    follows_s: float
    log_s: float
    """Shortest log."""
    rest_s: float
    """Between two logs."""
    power: bool
    loads: Mapping[str, Reach]
    inputs: Mapping[str, Reach]
    nominal: Mapping[str, float]
    """Input -> its value where it is not moved."""
    units: int
    notes: tuple[str, ...] = ()
    """What was assumed."""


def resolve_limits(config: Config, runs: Sequence[Run], hours: float) -> Limits:
    """Return the limits of an experiment of so many hours.

    Args:
        config: the project.
        runs: its training runs, where what `[experiment]` leaves out is looked up; may be empty.
        hours: in all.

    Raises:
        InputError: something needed is neither stated nor in the logs, limits contradict each
            other, or no chamber can follow.
    """
    told = config.experiment
    notes: list[str] = []
    low, high = _find_temperatures(config, runs, notes)
    start = told.start_degC
    if start is None:
        start = min(max(ROOM_DEGC, low), high)
    elif not low <= start <= high:
        whence = "the logs' range" if told.temperature_degC is None else "temperature_degC"
        raise InputError(
            f"{told.locate('start_degC')} is {start:g} degC, outside {low:g} to {high:g} degC "
            f"({whence}); expected a temperature within it. Change it, or [experiment] "
            "temperature_degC."
        )
    heating, cooling = _find_rates(told, runs, notes)
    loads = dict(told.loads)
    if not loads and runs:
        loads = _find_loads(config, runs)
    inputs = dict(told.inputs)
    log_s = 60.0 * (LOG_MIN if told.log_min is None else told.log_min)
    rest_s = 60.0 * (REST_MIN if told.rest_min is None else told.rest_min)
    if told.log_min is None:
        log_s = min(log_s, 3600.0 * hours)
    if told.rest_min is None and log_s + rest_s > 3600.0 * hours:
        rest_s = max(0.0, 3600.0 * hours - log_s)
    if log_s + rest_s > 3600.0 * hours + 1e-6:
        raise InputError(
            f"--hours {hours:g}: one log of {log_s / 60.0:g} min with its rest takes "
            f"{(log_s + rest_s) / 60.0:g} min; expected room for at least one. Allow more hours, "
            "or shorten [experiment] log_min or rest_min."
        )
    reach = min(heating, cooling) * 0.5 * (3600.0 * hours - rest_s)
    if reach < LEAST_SPAN_K and high - low >= LEAST_SPAN_K:
        raise InputError(
            f"{told.locate('heating_K_per_min')}, cooling_K_per_min: at {60.0 * heating:g} and "
            f"{60.0 * cooling:g} K/min no chamber moves {LEAST_SPAN_K:g} K and back within "
            f"{hours:g} h; expected rates that do. Allow more hours or faster ramps."
        )
    return Limits(
        low_degC=low,
        high_degC=high,
        start_degC=start,
        heating_K_per_s=heating,
        cooling_K_per_s=cooling,
        follows_s=FOLLOWS_S if told.follows_s is None else told.follows_s,
        log_s=log_s,
        rest_s=rest_s,
        power=told.power,
        loads=loads,
        inputs=inputs,
        nominal={name: _choose_nominal(name, reach_, runs) for name, reach_ in inputs.items()},
        units=told.units,
        notes=tuple(notes),
    )


def _find_temperatures(
    config: Config, runs: Sequence[Run], notes: list[str]
) -> tuple[float, float]:
    told = config.experiment.temperature_degC
    if told is not None:
        return told
    if not runs:
        raise InputError(
            f"{config.path}: [experiment] temperature_degC is missing, and there are no logs that "
            "would show a range; expected [LOW, HIGH] in degC that the chamber reaches. Add the "
            "table [experiment], or --within 'temperature_degC = [0, 50]'."
        )
    low = min(float(run.temperature_degC.min()) for run in runs)
    high = max(float(run.temperature_degC.max()) for run in runs)
    low, high = float(np.round(low, 1)), float(np.round(high, 1))
    notes.append(
        f"temperatures from {low:g} to {high:g} degC, as in the logs; [experiment] "
        "temperature_degC says what the chamber reaches"
    )
    if high - low < LEAST_SPAN_K:
        high = low + LEAST_SPAN_K
    return low, high


def _find_rates(
    told: ExperimentConfig, runs: Sequence[Run], notes: list[str]
) -> tuple[float, float]:
    """Return the fastest ramps up and down, K/s."""
    heating, cooling = told.heating_K_per_min, told.cooling_K_per_min
    if heating is not None and cooling is not None:
        return heating / 60.0, cooling / 60.0
    seen = RAMP_K_PER_MIN
    if runs:
        rates = []
        for run in runs:
            step = max(1, round(RATE_OVER_S / run.sample_period_s))
            moved = np.abs(run.temperature_degC[step:] - run.temperature_degC[:-step])
            if moved.size:
                rate = np.quantile(moved, FASTEST_SHARE) / (step * run.sample_period_s)
                rates.append(60.0 * float(rate))
        seen = float(np.round(max(max(rates, default=seen), 0.1), 1))
    either = heating if heating is not None else cooling if cooling is not None else seen
    if heating is None and cooling is None:
        whence = "as the fastest in the logs" if runs else "assumed"
        notes.append(
            f"ramps of {seen:g} K/min up and down, {whence}; [experiment] heating_K_per_min and "
            "cooling_K_per_min say what the chamber does"
        )
    up = heating if heating is not None else either
    down = cooling if cooling is not None else either
    return up / 60.0, down / 60.0


def _find_loads(config: Config, runs: Sequence[Run]) -> dict[str, Reach]:
    """Return the loads that the logs have seen, where nothing is said of any."""
    found = {}
    for k, output in enumerate(config.outputs):
        low = min(float(run.reference[:, k].min()) for run in runs)
        high = max(float(run.reference[:, k].max()) for run in runs)
        if high - low > 0.0:
            found[output.name] = Reach(min(low, 0.0), max(high, 0.0))
    return found


def _choose_nominal(name: str, reach: Reach, runs: Sequence[Run]) -> float:
    """Return an input's value at rest: the logs' median, or zero, or the middle of its range."""
    seen = [run.inputs[name] for run in runs if name in run.inputs]
    if seen:
        return float(np.clip(np.median(np.concatenate(seen)), reach.low, reach.high))
    if reach.low <= 0.0 <= reach.high:
        return 0.0
    return 0.5 * (reach.low + reach.high)
