"""Everything that can add to the sensor's outputs, each as columns times coefficients.

The columns [n, 6, m] follow from what happened in the run and from the shape parameters (tau_s,
doubling_K, ...); the coefficients [6, m] are one sensor's and set how strong the disturbance is.
`CATALOGUE` are the effects that the catalogue names, `UNLISTED` those that it does not know.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift_lab.twin.conditions import Conditions
from zerodrift_lab.twin.elements import Elements
from zerodrift_lab.twin.hysteresis import play
from zerodrift_lab.twin.integrate import relax
from zerodrift_lab.twin.sensor import (
    FULL_SCALE,
    OUTPUTS,
    REFERENCE_TEMPERATURE,
    SUPPLY_NOMINAL,
    draw_signs,
    draw_stream,
)

Array = NDArray[np.float64]
Parameters = Mapping[str, float]
Columns = Callable[[Conditions, Elements, Parameters], Array]

DAY_S = 86400.0


@dataclass(frozen=True)
class Disturbance:
    """One thing that can add to the outputs."""

    columns: Columns
    """Gives the columns [n, 6, m]."""
    terms: tuple[str, ...]
    """[m] what each column is, with its unit: a coefficient is an output's unit per that."""
    draw: Callable[[np.random.Generator], dict[str, float]] = lambda rng: {}
    """Draws the shape parameters from continuous distributions."""
    coefficients: Callable[[np.random.Generator], Array] | None = None
    """Draws coefficients [6, m] of a special make; left out, like in noise units, any sign."""
    channel: str | None = None
    """The log's channel that is needed to see it."""
    thermal: bool = False
    """Follows the elements' temperature."""


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _same_for_all(*signals: Array) -> Array:
    """Return columns [n, 6, m] that are the same for every output, from signals [n]."""
    stacked = np.stack(signals, axis=1)[:, None, :]
    return np.broadcast_to(stacked, (stacked.shape[0], len(OUTPUTS), stacked.shape[2]))


# --- driven by the elements' temperature ---------------------------------------------------------


def zero_tempco(run: Conditions, elements: Elements, p: Parameters) -> Array:
    """Zero shift: powers of the distance from T0."""
    away = elements.temperature - REFERENCE_TEMPERATURE
    return _same_for_all(*(away**power for power in range(1, int(p["order"]) + 1)))


def dark_current(run: Conditions, elements: Elements, p: Parameters) -> Array:
    """Dark current of the photo-transistors: doubles every Td."""
    away = elements.temperature - REFERENCE_TEMPERATURE
    return _same_for_all(np.exp2(away / p["doubling_K"]))


def span_tempco(run: Conditions, elements: Elements, p: Parameters) -> Array:
    """Span shift: the LED shines less when warm, so the load reads less."""
    away = elements.temperature - REFERENCE_TEMPERATURE
    return (away[:, None] * run.load)[:, :, None]


def thermal_gradient(run: Conditions, elements: Elements, p: Parameters) -> Array:
    """Gradient across the body, in proportion to the heat that flows, hence to dT/dt."""
    return _same_for_all(elements.rate)


def threshold(run: Conditions, elements: Elements, p: Parameters) -> Array:
    """Abrupt: something gives way above a temperature, within a tenth of a kelvin."""
    away = np.clip((elements.temperature - p["threshold_degC"]) / 0.1, -40.0, 40.0)
    return _same_for_all(1.0 / (1.0 + np.exp(-away)))


# --- driven by the load --------------------------------------------------------------------------


def creep(run: Conditions, elements: Elements, p: Parameters) -> Array:
    """Creep: two Kelvin-Voigt elements, each a spring beside a damper, loaded by their own axis."""
    load = run.fine_load
    strain = (1.0 - p["slow_share"]) * relax(load, p["tau_s"], run.fine_step_s)
    strain = strain + p["slow_share"] * relax(load, p["slow_tau_s"], run.fine_step_s)
    return run.sample(strain)[:, :, None]


def load_hysteresis(run: Conditions, elements: Elements, p: Parameters) -> Array:
    """Hysteresis of the elastic body: load minus its play; the mean slope is calibrated away."""
    half_widths = p["half_width_pct"] / 100.0 * FULL_SCALE
    played = [
        play(run.fine_load[:, k], half_width, every=run.fine_per_sample)
        for k, half_width in enumerate(half_widths.tolist())
    ]
    return (run.load - np.stack(played, axis=1))[:, :, None]


def load_nonlinearity(run: Conditions, elements: Elements, p: Parameters) -> Array:
    """Non-linearity: square and cube of the load as a share of full scale."""
    share = run.load / FULL_SCALE
    return np.stack([share**2, share**3], axis=2)


def crosstalk(run: Conditions, elements: Elements, p: Parameters) -> Array:
    """Cross-talk: every output reads a little of every other axis."""
    return np.repeat(run.load[:, None, :], len(OUTPUTS), axis=1)


def load_rate(run: Conditions, elements: Elements, p: Parameters) -> Array:
    """Viscous: in proportion to how fast the load changes."""
    return run.load_rate[:, :, None]


# --- driven by other channels --------------------------------------------------------------------


def supply_sensitivity(run: Conditions, elements: Elements, p: Parameters) -> Array:
    """Supply influence: the LED current follows the supply."""
    return _same_for_all(run.supply - SUPPLY_NOMINAL)


def humidity(run: Conditions, elements: Elements, p: Parameters) -> Array:
    """Moisture that soaks into adhesive and board within hours."""
    return _same_for_all(run.sample(relax(run.fine_humidity, p["tau_s"], run.fine_step_s)))


def ambient_light(run: Conditions, elements: Elements, p: Parameters) -> Array:
    """Stray light that reaches the photo-transistors."""
    return _same_for_all(run.ambient_light)


def inertial_load(run: Conditions, elements: Elements, p: Parameters) -> Array:
    """The upper plate's own mass when the sensor is moved."""
    return np.repeat(run.acceleration[:, None, :], len(OUTPUTS), axis=1)


# --- driven by time ------------------------------------------------------------------------------


def warm_up(run: Conditions, elements: Elements, p: Parameters) -> Array:
    """Start-up: the LEDs heat their own neighbourhood, which the thermometer does not see."""
    return _same_for_all(-np.expm1(-run.powered_s / p["tau_s"]))


def ageing(run: Conditions, elements: Elements, p: Parameters) -> Array:
    """Long-term drift: a power of the age."""
    return _same_for_all(np.power(run.clock_s / DAY_S, p["exponent"], dtype=np.float64))


def beat(run: Conditions, elements: Elements, p: Parameters) -> Array:
    """Two sinusoids of absolute time that beat, such as two fans' hum folded down."""
    angle: Array = 2.0 * np.pi * run.clock_s
    first = np.sin(angle / p["period_s"] + p["phase_rad"])
    second = np.sin(angle / p["second_period_s"])
    return _same_for_all(first + second)


def jump(run: Conditions, elements: Elements, p: Parameters) -> Array:
    """One step in every run, at a random moment and of random size."""
    rng = draw_stream(run.seed, "jump", run.name)
    moment_s = float(rng.uniform(0.2, 0.8)) * float(run.time_s[-1])
    height = float(draw_signs(rng, 1)[0] * rng.uniform(0.5, 1.5))
    return _same_for_all(np.where(run.time_s > moment_s, height, 0.0))


def random_walk(run: Conditions, elements: Elements, p: Parameters) -> Array:
    """Every output wanders by itself."""
    rng = draw_stream(run.seed, "random walk", run.name)
    kicks = rng.standard_normal((run.time_s.size, len(OUTPUTS)))
    walk = np.cumsum(kicks, axis=0) * float(np.sqrt(run.sample_period_s / 3600.0))
    return np.asarray(walk[:, :, None])


# --- how they are drawn --------------------------------------------------------------------------


def _draw_crosstalk(rng: np.random.Generator) -> Array:
    """Draw C - I without a diagonal, in shares of full scale."""
    share = rng.normal(0.0, 0.02, (len(OUTPUTS), len(OUTPUTS)))
    np.fill_diagonal(share, 0.0)
    scaled: Array = share * FULL_SCALE[:, None] / FULL_SCALE[None, :]
    return scaled


def _draw_nonlinearity(rng: np.random.Generator) -> Array:
    """Draw square and cube, in shares of full scale."""
    share = rng.uniform(0.3, 1.0, (len(OUTPUTS), 2)) * draw_signs(rng, 2 * len(OUTPUTS)).reshape(
        -1, 2
    )
    scaled: Array = share * FULL_SCALE[:, None]
    return scaled


def _draw_own_load(rng: np.random.Generator) -> Array:
    """Draw coefficients of columns that are loads: the same order for every axis."""
    return (rng.uniform(0.5, 1.5, len(OUTPUTS)) * draw_signs(rng, len(OUTPUTS)))[:, None]


def _draw_plate(rng: np.random.Generator) -> Array:
    """Draw a plate's mass and centre; F = m a, M = r x F."""
    mass_kg = float(rng.uniform(0.015, 0.03))
    x, y, z = rng.uniform(-0.003, 0.003), rng.uniform(-0.003, 0.003), rng.uniform(0.005, 0.02)
    turn = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return mass_kg * np.concatenate([np.eye(3), turn])


CATALOGUE: dict[str, Disturbance] = {
    "zero_tempco": Disturbance(
        zero_tempco,
        terms=("T - T0 [K]", "(T - T0)^2 [K2]", "(T - T0)^3 [K3]"),
        draw=lambda rng: {"order": 1.0},
        thermal=True,
    ),
    "dark_current": Disturbance(
        dark_current,
        terms=("2^((T - T0)/Td) [1]",),
        draw=lambda rng: {"doubling_K": float(rng.uniform(8.0, 12.0))},
        thermal=True,
    ),
    "span_tempco": Disturbance(
        span_tempco, terms=("(T - T0) load [K x unit]",), coefficients=_draw_own_load, thermal=True
    ),
    "thermal_gradient": Disturbance(thermal_gradient, terms=("dT/dt [K/s]",), thermal=True),
    "warm_up": Disturbance(
        warm_up,
        terms=("1 - exp(-t/tau) [1]",),
        draw=lambda rng: {"tau_s": _log_uniform(rng, 90.0, 1000.0)},
    ),
    "creep": Disturbance(
        creep,
        terms=("load filtered by tau [unit]",),
        draw=lambda rng: {
            "tau_s": _log_uniform(rng, 80.0, 600.0),
            "slow_tau_s": _log_uniform(rng, 900.0, 2400.0),
            "slow_share": float(rng.uniform(0.1, 0.3)),
        },
        coefficients=_draw_own_load,
    ),
    "load_hysteresis": Disturbance(
        load_hysteresis,
        terms=("load - play(load) [unit]",),
        draw=lambda rng: {"half_width_pct": float(rng.uniform(1.0, 5.0))},
        coefficients=_draw_own_load,
    ),
    "load_nonlinearity": Disturbance(
        load_nonlinearity,
        terms=("(load/FS)^2 [1]", "(load/FS)^3 [1]"),
        coefficients=_draw_nonlinearity,
    ),
    "crosstalk": Disturbance(
        crosstalk,
        terms=tuple(f"load {name} [unit]" for name in OUTPUTS),
        coefficients=_draw_crosstalk,
    ),
    "supply_sensitivity": Disturbance(supply_sensitivity, terms=("V - V0 [V]",), channel="supply"),
    "humidity": Disturbance(
        humidity,
        terms=("RH filtered by tau [%]",),
        draw=lambda rng: {"tau_s": _log_uniform(rng, 1800.0, 9000.0)},
        channel="humidity",
    ),
    "ambient_light": Disturbance(
        ambient_light, terms=("illuminance [lux]",), channel="ambient_light"
    ),
    "inertial_load": Disturbance(
        inertial_load,
        terms=("ax [m/s2]", "ay [m/s2]", "az [m/s2]"),
        coefficients=_draw_plate,
        channel="acceleration",
    ),
    "ageing": Disturbance(
        ageing,
        terms=("(age/day)^p [1]",),
        draw=lambda rng: {"exponent": float(rng.uniform(0.6, 1.0))},
        channel="clock",
    ),
}

UNLISTED: dict[str, Disturbance] = {
    "beat": Disturbance(
        beat,
        terms=("sin + sin [1]",),
        draw=lambda rng: {
            "period_s": float(rng.uniform(300.0, 700.0)),
            "second_period_s": float(rng.uniform(700.0, 1100.0)),
            "phase_rad": float(rng.uniform(0.0, 2.0 * np.pi)),
        },
    ),
    "jump": Disturbance(jump, terms=("step [1]",)),
    "random_walk": Disturbance(random_walk, terms=("walk, RMS 1 after an hour [1]",)),
    "threshold": Disturbance(
        threshold,
        terms=("T above threshold [1]",),
        draw=lambda rng: {"threshold_degC": float(rng.uniform(28.0, 42.0))},
        thermal=True,
    ),
    "load_rate": Disturbance(load_rate, terms=("dload/dt [unit/s]",), coefficients=_draw_own_load),
}

DISTURBANCES: dict[str, Disturbance] = CATALOGUE | UNLISTED


def draw_coefficients(name: str, seed: int, noise_rms: Array, columns: int) -> Array:
    """Draw the coefficients [6, columns] of a disturbance, before they are scaled to a size."""
    rng = draw_stream(seed, "coefficients", name)
    make = DISTURBANCES[name].coefficients
    if make is not None:
        return make(rng)
    magnitude = rng.uniform(0.5, 1.5, (len(OUTPUTS), columns))
    signs = draw_signs(rng, len(OUTPUTS) * columns).reshape(-1, columns)
    # Higher powers of T - T0 come in at the range's end about as strong as the first.
    strong: Array = magnitude * signs * noise_rms[:, None] / 40.0 ** np.arange(columns)
    return strong
