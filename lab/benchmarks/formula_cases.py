"""Simulated sensors whose drift follows a form outside the catalogue, by NumPy alone.

Low-pass, delay and slack are written here as loops over time, from their differential equations.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import Config, parse_config
from zerodrift.dataset.runs import Dataset, Run

Channels = Mapping[str, Array]

ROWS, PERIOD_S = 1500, 2.0
OUTPUTS, NOISE = ("Fz", "Mx"), np.array([0.05, 0.004])
SLOW_NOISE = 0.5
"""RMS of the noise with a memory, over that of the white noise."""
TOML = """\
[sensor]
name = "simulated"
time = "time_s"
temperature = "temperature_degC"
sample_period_s = 2.0

[outputs.Fz]
measured = "Fz_N"
reference = "ref_Fz_N"
unit = "N"
full_scale = 200

[outputs.Mx]
measured = "Mx_Nm"
unit = "Nm"
full_scale = 14

[inputs]
supply = "supply"
humidity = "humidity"
ambient_light = "ambient_light"
body_temperature = "body_temperature"

[logs]
train = ["logs/run_*.csv"]
test = ["logs/test_*.csv"]
dwell = ["logs/dwell.csv"]

[[effect]]
kind = "zero_tempco"

[network]
kind = "none"
"""


def follow(x: Array, tau_s: float) -> Array:
    """Return x through a first-order lag, by the trapezoid rule."""
    share = PERIOD_S / (2.0 * tau_s)
    y = np.empty_like(x)
    y[0] = x[0]
    for n in range(1, x.size):
        y[n] = ((1.0 - share) * y[n - 1] + share * (x[n] + x[n - 1])) / (1.0 + share)
    return y


def slip(x: Array, width: float) -> Array:
    """Return what is dragged by x with a slack of `width` to either side."""
    y = np.empty_like(x)
    y[0] = x[0]
    for n in range(1, x.size):
        y[n] = min(max(y[n - 1], x[n] - width), x[n] + width)
    return y


def come_late(x: Array, samples: int) -> Array:
    """Return x so many samples ago."""
    return np.concatenate([np.full(samples, x[0]), x[: x.size - samples]])


Law = Callable[[Channels, np.random.Generator], Callable[[Channels], Array]]


def _transient(_: Channels, rng: np.random.Generator) -> Callable[[Channels], Array]:
    tau = rng.uniform(60.0, 500.0)
    return lambda c: c["ambient_light"] - follow(c["ambient_light"], tau)


def _heat_flow(_: Channels, rng: np.random.Generator) -> Callable[[Channels], Array]:
    tau = rng.uniform(60.0, 400.0)
    return lambda c: np.abs(c["T"] - follow(c["T"], tau))


def _warm_and_wet(_: Channels, rng: np.random.Generator) -> Callable[[Channels], Array]:
    a, b = rng.uniform(15.0, 35.0), rng.uniform(30.0, 60.0)
    return lambda c: (c["T"] - a) * (c["humidity"] - b)


def _regulator(c: Channels, rng: np.random.Generator) -> Callable[[Channels], Array]:
    limit = float(np.quantile(c["supply"], rng.uniform(0.3, 0.7)))
    return lambda c: np.maximum(c["supply"], limit)


def _late_light(_: Channels, rng: np.random.Generator) -> Callable[[Channels], Array]:
    samples = int(rng.integers(20, 120))
    return lambda c: come_late(c["ambient_light"], samples)


def _sticky(_: Channels, rng: np.random.Generator) -> Callable[[Channels], Array]:
    width = rng.uniform(3.0, 10.0)
    return lambda c: slip(c["humidity"], width)


def _heater(_: Channels, rng: np.random.Generator) -> Callable[[Channels], Array]:
    tau = rng.uniform(60.0, 400.0)
    return lambda c: follow((c["supply"] - 4.0) ** 2, tau)


def _soft_when_wet(_: Channels, rng: np.random.Generator) -> Callable[[Channels], Array]:
    tau, dry = rng.uniform(60.0, 400.0), rng.uniform(20.0, 50.0)
    return lambda c: c["load"] * (follow(c["humidity"], tau) - dry)


def _leakage(_: Channels, rng: np.random.Generator) -> Callable[[Channels], Array]:
    double = rng.uniform(6.0, 20.0)
    return lambda c: 2.0 ** (c["humidity"] / double)


def _root(_: Channels, rng: np.random.Generator) -> Callable[[Channels], Array]:
    return lambda c: np.sqrt(c["ambient_light"])


def _hotter(_: Channels, rng: np.random.Generator) -> Callable[[Channels], Array]:
    return lambda c: np.maximum(c["T"], c["body_temperature"])


def _bowed(_: Channels, rng: np.random.Generator) -> Callable[[Channels], Array]:
    return lambda c: (c["body_temperature"] - c["T"]) ** 2


FORMS: dict[str, Law] = {
    "light - LP(light)": _transient,
    "|T - LP(T)|": _heat_flow,
    "(T - a) (humidity - b)": _warm_and_wet,
    "max(supply, c)": _regulator,
    "delay(ambient_light)": _late_light,
    "play(humidity)": _sticky,
    "LP((supply - 4 V)^2)": _heater,
    "load (LP(humidity) - b)": _soft_when_wet,
    "2^(humidity / d)": _leakage,
    "sqrt(ambient_light)": _root,
    "max(T, body_temperature)": _hotter,
    "(body_temperature - T)^2": _bowed,
}
"""Forms of one or two operations that no effect of the catalogue has."""
DISTURBANCES = ("random walk", "beat", "jumps", "private channel")


@dataclass(frozen=True)
class Simulated:
    """A simulated project, and what its drift really is in the test runs."""

    config: Config
    dataset: Dataset
    truth: Mapping[str, Array]
    """Test run -> [n, K] drift without noise."""
    noise: Array
    """[K] RMS of the noise."""


def simulate(kind: str, size: float, runs: int, seed: int) -> Simulated:
    """Return a project whose model has zero_tempco alone.

    Args:
        kind: one of FORMS or a sum of them ("A + B"), one of DISTURBANCES, or "complete".
        size: RMS of what is hidden beyond a straight line in temperature, over that of the noise.
        runs: training runs.
        seed: draws everything.
    """
    rng = np.random.default_rng(seed)
    names = [*(f"run_{n}" for n in range(runs)), "test_0", "test_1"]
    channels = {name: _draw_channels(rng) for name in names}
    channels["dwell"] = _rest(channels["run_0"])
    hidden: dict[str, Array] = {}
    laws = [FORMS[one](channels["run_0"], rng) for one in kind.split(" + ") if one in FORMS]
    for law in laws:
        found_by_law = {name: law(c) for name, c in channels.items()}
        size_of_it = _measure([found_by_law[n] for n in names], [channels[n]["T"] for n in names])
        hidden = {name: hidden.get(name, 0.0) + x / size_of_it for name, x in found_by_law.items()}
    if kind in DISTURBANCES:
        hidden = {name: _disturb(kind, rng) for name in channels}
        hidden["dwell"] = np.zeros(ROWS)
    scale = (
        size / _measure([hidden[n] for n in names], [channels[n]["T"] for n in names])
        if hidden
        else 0.0
    )
    share = rng.uniform(0.4, 1.0, 2) * rng.choice((-1.0, 1.0), 2)
    share /= np.sqrt(np.mean(share**2))
    slope = rng.uniform(-0.3, 0.3, 2) * NOISE / 0.05
    taus = rng.uniform(20.0, 200.0)
    found, truth = {}, {}
    for name, c in channels.items():
        drift = (c["T"] - 25.0)[:, None] * slope
        if hidden:
            drift = drift + (scale * hidden[name])[:, None] * share * _rms_of_noise()
        offset = rng.normal(0.0, 3.0, 2) * NOISE
        white = rng.standard_normal((ROWS, 2))
        slow = np.stack([_wander(rng, taus) for _ in OUTPUTS], axis=1)
        truth[name] = drift
        reference = np.stack([c["load"], np.zeros(ROWS)], axis=1)
        found[name] = Run(
            name=name,
            group=name,
            part=0,
            source=Path(f"{name}.csv"),
            sample_period_s=PERIOD_S,
            time_s=PERIOD_S * np.arange(ROWS),
            temperature_degC=c["T"] + 0.004 * rng.standard_normal(ROWS),
            measured=reference + drift + offset + NOISE * (white + SLOW_NOISE * slow),
            reference=reference,
            inputs={n: c[n] for n in ("supply", "humidity", "ambient_light", "body_temperature")},
        )
    dataset = Dataset(
        train=tuple(found[n] for n in names if n.startswith("run")),
        test=tuple(found[n] for n in names if n.startswith("test")),
        dwell=(found["dwell"],),
        outputs=OUTPUTS,
        units=("N", "Nm"),
        full_scale=(200.0, 14.0),
    )
    config = parse_config(TOML, Path("zerodrift.toml"))
    tests = {n: truth[n] for n in names if n.startswith("test")}
    return Simulated(config, dataset, tests, _rms_of_noise())


def _rms_of_noise() -> Array:
    return np.asarray(NOISE * np.sqrt(1.0 + SLOW_NOISE**2))


def _wander(rng: np.random.Generator, tau_s: float) -> Array:
    """Return first-order noise of RMS 1."""
    keep = np.exp(-PERIOD_S / tau_s)
    kicks = np.sqrt(1.0 - keep**2) * rng.standard_normal(ROWS)
    y = np.empty(ROWS)
    y[0] = rng.standard_normal()
    for n in range(1, ROWS):
        y[n] = keep * y[n - 1] + kicks[n]
    return y


def _draw_levels(rng: np.random.Generator, low: float, high: float, count: int) -> Array:
    """Return steps between levels at times of their own."""
    edges = np.sort(rng.integers(0, ROWS, count))
    return rng.uniform(low, high, count + 1)[np.searchsorted(edges, np.arange(ROWS), "right")]


def _draw_ramps(rng: np.random.Generator, low: float, high: float, count: int) -> Array:
    """Return straight lines between levels at times of their own."""
    at = np.concatenate([[0.0], np.sort(rng.uniform(0.0, ROWS, count)), [float(ROWS)]])
    return np.interp(np.arange(ROWS, dtype=np.float64), at, rng.uniform(low, high, count + 2))


def _draw_channels(rng: np.random.Generator) -> dict[str, Array]:
    temperature = follow(_draw_ramps(rng, 5.0, 45.0, 5), 40.0)
    own = follow(_draw_levels(rng, -6.0, 6.0, 6), 60.0)
    return {
        "T": temperature,
        "load": _draw_levels(rng, 0.0, 80.0, 10),
        "supply": follow(_draw_levels(rng, 4.5, 5.5, 8), 5.0) + 0.01 * _wander(rng, 20.0),
        "humidity": follow(_draw_levels(rng, 20.0, 80.0, 6), 20.0) + 0.5 * _wander(rng, 100.0),
        "ambient_light": np.abs(_draw_levels(rng, 20.0, 900.0, 8) + 5.0 * _wander(rng, 30.0)),
        "body_temperature": follow(temperature, 120.0) + own,
    }


def _rest(like: Channels) -> dict[str, Array]:
    return {n: np.full(ROWS, 0.0 if n == "load" else float(x.mean())) for n, x in like.items()}


def _disturb(kind: str, rng: np.random.Generator) -> Array:
    """Return what has nothing to do with any channel."""
    if kind == "random walk":
        return np.cumsum(rng.standard_normal(ROWS))
    if kind == "beat":
        period = rng.uniform(150.0, 900.0)
        return np.sin(2.0 * np.pi * (PERIOD_S * np.arange(ROWS) / period + rng.uniform()))
    if kind == "jumps":
        return _draw_levels(rng, -1.0, 1.0, int(rng.integers(1, 5)))
    return follow(_draw_ramps(rng, -1.0, 1.0, 6), 100.0)


def _measure(hidden: list[Array], temperature: list[Array]) -> float:
    """Return the RMS of what a straight line in temperature and an offset leave, over all runs."""
    x = np.concatenate([t - t.mean() for t in temperature])
    y = np.concatenate([h - h.mean() for h in hidden])
    rest = y - x * (x @ y) / (x @ x)
    return float(np.sqrt(np.mean(rest**2)))
