"""The catalogue's equations, integrated on the fine grid; linear in one coefficient per column."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from benchmarks.foreign.world import Array, Rng, Run, low_pass

Parameters = dict[str, float]
Model = dict[str, Parameters]
"""Effects by name with the values of their nonlinear parameters."""
CATALOGUE = (
    "zero_tempco", "dark_current", "span_tempco", "thermal_lag", "thermal_gradient", "warm_up",
    "thermal_hysteresis", "creep", "load_hysteresis", "load_nonlinearity", "crosstalk",
    "supply_sensitivity", "humidity", "ambient_light", "inertial_load", "ageing", "clock_delay",
    "adc_saturation",
)  # fmt: skip
THERMAL = ("zero_tempco", "dark_current", "span_tempco", "thermal_gradient")
"""Terms that see the temperature as the element does."""
BENDING = ("clock_delay", "thermal_lag", "thermal_hysteresis")
"""Effects that change what thermal terms see."""
LOADED = {"span_tempco", "creep", "load_hysteresis", "load_nonlinearity", "crosstalk"}
CHANNEL_OF = {
    "supply_sensitivity": "supply",
    "humidity": "humidity",
    "ambient_light": "ambient_light",
    "inertial_load": "acceleration_x",
    "ageing": "clock",
}
"""The input that each of these cannot be seen without."""
DISTURBANCES = ("ripple_in_temperature", "rectified_rate", "beat", "slips", "telegraph", "wander")
"""rectified_rate heats both ways alike; slips are jumps of a joint; telegraph is popcorn noise."""


def play(course: Array, half_width: float) -> Array:
    """Play operator on a course [m], relaxed at its start."""
    out, held = np.empty_like(course), float(course[0])
    for index, value in enumerate(course.tolist()):
        held = min(max(held, value - half_width), value + half_width)
        out[index] = held
    return out


@lru_cache(maxsize=64)
def _bent(run: Run, delay_s: float, tau_s: float, half_width_K: float) -> Array:
    seen = np.interp(run.time_s - delay_s, run.time_s, run.temperature_degC)
    seen = low_pass(seen, tau_s, float(run.time_s[1] - run.time_s[0])) if tau_s else seen
    return play(seen, half_width_K) if half_width_K else seen


def element_temperature(run: Run, model: Model) -> Array:
    """Temperature that the thermal terms see [m], degC."""
    return _bent(run, *(next(iter(model.get(name, {}).values()), 0.0) for name in BENDING))


@lru_cache(maxsize=64)
def _load_play(run: Run, output: int, half_width: float) -> Array:
    return play(run.loads[:, output], half_width) - run.loads[:, output]


def columns(run: Run, model: Model, output: int, full_scale: float) -> dict[str, Array]:
    """Columns [m, c] of each additive effect of the model for one output."""
    seen, own = element_temperature(run, model), run.loads[:, output]
    warm, step = seen - 21.7, float(run.time_s[1] - run.time_s[0])
    age_days = np.maximum(run.start_s + run.time_s, 0) / 86400
    axes = [f"acceleration_{axis}" for axis in "xyz"]
    build: dict[str, Callable[[Parameters], list[Array]]] = {
        "zero_tempco": lambda p: [(warm / 20) ** (power + 1) for power in range(int(p["order"]))],
        "dark_current": lambda p: [2 ** (warm / p["doubling_K"])],
        "span_tempco": lambda p: [(seen - p["calibrated_degC"]) * own],
        "thermal_gradient": lambda p: [np.gradient(seen, step)],
        "warm_up": lambda p: [-np.expm1(-np.maximum(run.time_s, 0) / p["tau_s"])],
        "creep": lambda p: [low_pass(own, p["tau_s"], step)],
        "load_hysteresis": lambda p: [
            _load_play(run, output, p["half_width_pct"] / 100 * full_scale)
        ],
        "load_nonlinearity": lambda p: [own**2 / full_scale, own**3 / full_scale**2],
        "crosstalk": lambda p: list(run.loads.T),
        "supply_sensitivity": lambda p: [run.channels["supply"] - 12],
        "humidity": lambda p: [low_pass(run.channels["humidity"] - 40, p["tau_s"], step)],
        "ambient_light": lambda p: [run.channels["ambient_light"]],
        "inertial_load": lambda p: [run.channels[axis] for axis in axes],
        "ageing": lambda p: [age_days ** p["exponent"]],
        **{name: lambda p: [run.channels["disturbance"]] for name in DISTURBANCES},
    }
    additive = [name for name in model if name in build]
    return {name: np.stack(build[name](model[name]), axis=1) for name in additive}


def draw_parameters(rng: Rng, name: str, period_s: float, length_s: float) -> Parameters:
    """Values of an effect's nonlinear parameters that logs of this period and length can show."""

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(max(high, 1.3 * low)))))

    slow = between(max(4 * period_s, 5), length_s / 6)
    ranges: dict[str, Parameters] = {
        "zero_tempco": {"order": float(rng.integers(1, 4))},
        "dark_current": {"doubling_K": between(7.5, 12.5)},
        "span_tempco": {"calibrated_degC": float(rng.uniform(15, 33))},
        "thermal_lag": {"tau_s": between(max(3 * period_s, 5), min(length_s / 10, 900))},
        "thermal_hysteresis": {"half_width_K": between(0.4, 4)},
        "clock_delay": {"delay_s": float(rng.choice([-1, 1])) * between(0.4, 3)},
        "warm_up": {"tau_s": slow},
        "creep": {"tau_s": slow},
        "humidity": {"tau_s": between(max(10 * period_s, 60), length_s / 4)},
        "load_hysteresis": {"half_width_pct": between(0.7, 9)},
        "ageing": {"exponent": float(rng.choice([1, rng.uniform(0.4, 0.9)]))},
    }
    return ranges.get(name, {})


def disturbance(
    rng: Rng, kind: str, time: Array, heat: Array, length_s: float, reach_K: float
) -> Array:
    """Course [m] of one of DISTURBANCES; temperatures reach +-reach, runs are of a length."""
    if kind == "ripple_in_temperature":
        course = np.sin(2 * np.pi * heat / (0.37 * reach_K))
    elif kind == "rectified_rate":
        course = np.abs(np.gradient(heat, time))
    elif kind == "beat":
        course = np.sin(2 * np.pi * (time / (length_s * 0.137) + rng.uniform()))
    elif kind == "slips":
        edges = np.sort(rng.uniform(0, length_s, 4))
        course = np.cumsum(rng.standard_normal(5))[np.searchsorted(edges, time)]
    elif kind == "telegraph":
        course = np.searchsorted(np.cumsum(rng.exponential(length_s / 12, 60)), time) % 2.0
    else:
        course = np.cumsum(rng.standard_normal(len(time)))
    return np.asarray(course)
