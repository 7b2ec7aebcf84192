"""The forms of drift that generator and oracle share: equations, values, and what they need.

Written from the catalogue's equations in plain NumPy; nothing of the product is imported. The
generator computes a form at fine steps, the oracle at the rows of the log and for many values at
once. Arrays are runs side by side, shape (runs, rows), shorter runs held at their last value.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
DAY_S = 86400.0
CHIP = "temperature"
BODIES = ("body_1", "body_2")
MOST_EFFECTS = 3


@dataclass(frozen=True)
class Signals:
    """What the effects see.

    Attributes:
        series: name -> shape (runs, rows): thermometers in degC, `load`, the inputs by the
            names that the catalogue uses, `elapsed` in s since power-on, `clock` in s since the
            first run began.
        step_s: between rows.
        full_scale: of the output, in the load's unit.
    """

    series: Mapping[str, Array]
    step_s: float
    full_scale: float


def relax(x: Array, tau_s: Array, step_s: float) -> Array:
    """Return the solution of tau y' + y = x, at rest at the first row; x is straight between rows.

    Args:
        x: shape (runs, rows).
        tau_s: shape (values,).
        step_s: between rows.

    Returns:
        shape (values, runs, rows).
    """
    ratio = (step_s / tau_s)[:, None]
    decay, mean = np.exp(-ratio), -np.expm1(-ratio) / ratio
    before, now = mean - decay, 1.0 - mean
    found = np.empty((x.shape[1], tau_s.size, x.shape[0]))
    found[0] = state = np.repeat(x[None, :, 0], tau_s.size, axis=0)
    series = np.ascontiguousarray(x.T)
    for n in range(1, len(series)):
        state = decay * state + (before * series[n - 1] + now * series[n])
        found[n] = state
    return np.moveaxis(found, 0, 2)


def play(x: Array, half_width: Array) -> Array:
    """Return the play of x, without slack at the first row, shape (values, runs, rows).

    Args:
        x: shape (runs, rows).
        half_width: shape (values,), in the unit of x.
    """
    width = half_width[:, None]
    found = np.empty((x.shape[1], half_width.size, x.shape[0]))
    found[0] = state = np.repeat(x[None, :, 0], half_width.size, axis=0)
    series = np.ascontiguousarray(x.T)
    for n in range(1, len(series)):
        state = np.minimum(np.maximum(state, series[n] - width), series[n] + width)
        found[n] = state
    return np.moveaxis(found, 0, 2)


def shift(x: Array, delay_s: Array, step_s: float) -> Array:
    """Return x(t - d), held before the first and after the last row, (values, runs, rows)."""
    rows = np.arange(x.shape[1], dtype=float)
    return np.stack(
        [[np.interp(rows - d / step_s, rows, run) for run in x] for d in delay_s], axis=0
    )


def slope(x: Array, step_s: float) -> Array:
    """Return dx/dt by differences about each row, shape (runs, rows)."""
    found: Array = np.gradient(x, step_s, axis=1)
    return found


Columns = list[Array]
"""One array for each coefficient, each of shape (values, runs, rows)."""


@dataclass(frozen=True)
class Form:
    """One form of an effect of the catalogue.

    Attributes:
        kind: the catalogue's name of the effect.
        name: of the form, unique.
        build: (signals, thermometer, values) -> columns.
        value: the catalogue's name of the one nonlinear value; empty without one.
        low, high: bounds of the value, the catalogue's typical ones.
        log: whether the value is drawn evenly in its logarithm.
        points: of the oracle's grid over the value.
        needs: inputs beside the thermometer.
        thermal: whether it may follow any thermometer.
        rewrites: whether it acts on the temperature that the polynomial sees.
        options: of the form in an [[effect]] table.
    """

    kind: str
    name: str
    build: Callable[[Signals, str, Array], Columns]
    value: str = ""
    low: float = 0.0
    high: float = 0.0
    log: bool = True
    points: int = 1
    needs: tuple[str, ...] = ()
    thermal: bool = False
    rewrites: bool = False
    options: tuple[tuple[str, float], ...] = ()

    def grid(self) -> Array:
        """Return the values of the oracle's grid, shape (points,), even in the prior."""
        if not self.value:
            return np.zeros(1)
        if self.log:
            return np.geomspace(self.low, self.high, self.points)
        return np.linspace(self.low, self.high, self.points)

    def draw(self, rng: np.random.Generator) -> float:
        """Return a value from the prior."""
        if not self.value:
            return 0.0
        if self.log:
            return math.exp(rng.uniform(math.log(self.low), math.log(self.high)))
        return float(rng.uniform(self.low, self.high))


def _same(name: str) -> Callable[[Signals, str, Array], Columns]:
    return lambda s, _, values: [s.series[name][None]]


def _relaxed(name: str, power: int = 1) -> Callable[[Signals, str, Array], Columns]:
    return lambda s, _, values: [relax(s.series[name] ** power, values, s.step_s)]


def _rise(s: Signals, values: Array) -> Array:
    found: Array = -np.expm1(-s.series["elapsed"][None] / values[:, None, None])
    return found


FORMS: tuple[Form, ...] = (
    Form(
        "dark_current",
        "dark_current",
        lambda s, place, v: [2.0 ** ((s.series[place] - 25.0)[None] / v[:, None, None])],
        value="doubling_K",
        low=8.0,
        high=12.0,
        points=8,
        thermal=True,
    ),
    Form(
        "zero_tempco",
        "zero_tempco",
        lambda s, place, v: [s.series[place][None]],
        thermal=True,
    ),
    Form(
        "thermal_gradient",
        "thermal_gradient",
        lambda s, place, v: [slope(s.series[place], s.step_s)[None]],
        thermal=True,
    ),
    Form(
        "thermal_lag",
        "thermal_lag, rewriting",
        lambda s, place, v: [relax(s.series[place], v, s.step_s)],
        value="tau_s",
        low=5.0,
        high=600.0,
        points=20,
        rewrites=True,
        options=(("own_terms", 0), ("time_constants", 1)),
    ),
    Form(
        "thermal_lag",
        "thermal_lag, own",
        lambda s, place, v: [relax(s.series[place], v, s.step_s)],
        value="tau_s",
        low=5.0,
        high=600.0,
        points=20,
        thermal=True,
        options=(("own_terms", 1), ("time_constants", 1)),
    ),
    Form(
        "thermal_hysteresis",
        "thermal_hysteresis, rewriting",
        lambda s, place, v: [play(s.series[place], v)],
        value="half_width_K",
        low=0.2,
        high=10.0,
        points=64,
        rewrites=True,
        options=(("own_terms", 0),),
    ),
    Form(
        "thermal_hysteresis",
        "thermal_hysteresis, own",
        lambda s, place, v: [play(s.series[place], v) - s.series[place]],
        value="half_width_K",
        low=0.2,
        high=10.0,
        points=64,
        thermal=True,
        options=(("own_terms", 1),),
    ),
    Form(
        "clock_delay",
        "clock_delay",
        lambda s, place, v: [shift(s.series[place], v, s.step_s)],
        value="delay_s",
        low=1.0,
        high=10.0,
        points=24,
        rewrites=True,
    ),
    Form(
        "span_tempco",
        "span_tempco",
        lambda s, place, v: [(s.series[place] - v[:, None, None]) * s.series["load"]],
        value="calibrated_degC",
        low=15.0,
        high=35.0,
        log=False,
        points=6,
        needs=("load",),
        options=(("cross_axes", 0),),
    ),
    Form(
        "creep",
        "creep",
        _relaxed("load"),
        value="tau_s",
        low=60.0,
        high=1800.0,
        points=20,
        needs=("load",),
        options=(("time_constants", 1), ("settled", 0)),
    ),
    Form(
        "creep",
        "creep, settled",
        lambda s, _, v: [relax(s.series["load"], v, s.step_s) - s.series["load"]],
        value="tau_s",
        low=60.0,
        high=1800.0,
        points=20,
        needs=("load",),
        options=(("time_constants", 1), ("settled", 1)),
    ),
    Form(
        "load_hysteresis",
        "load_hysteresis",
        lambda s, _, v: [play(s.series["load"], v * s.full_scale / 100.0) - s.series["load"]],
        value="half_width_pct",
        low=0.3,
        high=15.0,
        points=64,
        needs=("load",),
        options=(("plays", 1),),
    ),
    Form(
        "load_nonlinearity",
        "load_nonlinearity",
        lambda s, _, v: [
            ((s.series["load"] / s.full_scale) ** power)[None] * s.full_scale for power in (2, 3)
        ],
        needs=("load",),
    ),
    Form("crosstalk", "crosstalk", _same("load"), needs=("load",)),
    Form("supply_sensitivity", "supply_sensitivity", _same("supply"), needs=("supply",)),
    Form(
        "excitation_heating",
        "excitation_heating",
        _relaxed("supply", 2),
        value="tau_s",
        low=30.0,
        high=1800.0,
        points=20,
        needs=("supply",),
    ),
    Form(
        "humidity",
        "humidity",
        _relaxed("humidity"),
        value="tau_s",
        low=600.0,
        high=20000.0,
        points=20,
        needs=("humidity",),
        options=(("of_rate", 0),),
    ),
    Form(
        "humidity",
        "humidity, of its rate",
        lambda s, _, v: [s.series["humidity"] - relax(s.series["humidity"], v, s.step_s)],
        value="tau_s",
        low=600.0,
        high=20000.0,
        points=20,
        needs=("humidity",),
        options=(("of_rate", 1),),
    ),
    Form("ambient_light", "ambient_light", _same("ambient_light"), needs=("ambient_light",)),
    Form("barometric_pressure", "barometric_pressure", _same("pressure"), needs=("pressure",)),
    Form("inertial_load", "inertial_load", _same("acceleration_z"), needs=("acceleration_z",)),
    Form(
        "warm_up",
        "warm_up",
        lambda s, _, v: [_rise(s, v)],
        value="tau_s",
        low=60.0,
        high=1200.0,
        points=20,
    ),
    Form(
        "turn_on_bias",
        "turn_on_bias",
        _same("turn_on"),
        needs=("turn_on",),
        options=(("decays", 0),),
    ),
    Form(
        "turn_on_bias",
        "turn_on_bias, decaying",
        lambda s, _, v: [
            np.repeat(s.series["turn_on"][None], v.size, axis=0),
            s.series["turn_on"] * (1.0 - _rise(s, v)),
        ],
        value="tau_s",
        low=60.0,
        high=1200.0,
        points=20,
        needs=("turn_on",),
        options=(("decays", 1),),
    ),
    Form(
        "ageing",
        "ageing",
        lambda s, _, v: [s.series["clock"][None] / DAY_S],
        needs=("clock",),
        options=(("power_law", 0),),
    ),
    Form(
        "ageing",
        "ageing, power law",
        lambda s, _, v: [(s.series["clock"] / DAY_S)[None] ** v[:, None, None]],
        value="exponent",
        low=0.3,
        high=0.9,
        log=False,
        points=16,
        needs=("clock",),
        options=(("power_law", 1),),
    ),
)
"""Left out: `adc_saturation`, whose rows are set aside; forms of two time constants or three plays,
of the span's humidity, ageing and supply; cross-talk of several outputs, as there is one output; a
clock ahead of the converter's, for which a chip knows the slope alone."""


@dataclass(frozen=True)
class Candidate:
    """A form on a thermometer; `signal` is CHIP where there is no choice."""

    form: Form
    signal: str

    @property
    def key(self) -> tuple[str, str]:
        """The form's name and the thermometer."""
        return self.form.name, self.signal

    @property
    def of_chip(self) -> bool:
        """Whether it follows the chip's temperature, which a rewriting form changes."""
        return self.signal == CHIP and (self.form.thermal or self.form.kind == "span_tempco")


def list_candidates(signals: Signals) -> list[Candidate]:
    """Return the forms that these signals can feed; a polynomial of the chip is always there."""
    places = [CHIP, *(name for name in BODIES if name in signals.series)]
    return [
        Candidate(form, place)
        for form in FORMS
        if all(name in signals.series for name in form.needs)
        for place in (places if form.thermal else [CHIP])
        if (form.kind, place) != ("zero_tempco", CHIP)
    ]


def go_together(chosen: Sequence[Candidate]) -> bool:
    """Return whether a sensor may have these: kinds apart; what is rewritten, for the polynomial.

    At most one form rewrites the chip's temperature, and then nothing else but the polynomial
    follows the chip: the drift is so a sum of columns of one value each.
    """
    kinds = {one.form.kind for one in chosen}
    rewriting = [one for one in chosen if one.form.rewrites]
    if len(kinds) < len(chosen) or len(rewriting) > 1:
        return False
    return not rewriting or not any(one.of_chip for one in chosen if one not in rewriting)


class SetPrior:
    """The prior over sets: how many effects, evenly; which kinds, evenly; which form, evenly.

    Sets that do not go together are drawn again with the same number of effects.
    """

    def __init__(self, candidates: Sequence[Candidate]) -> None:
        """Keep the candidates that the prior chooses from."""
        self.candidates = list(candidates)
        self.by_kind: dict[str, list[Candidate]] = {}
        for one in candidates:
            self.by_kind.setdefault(one.form.kind, []).append(one)
        self.most = min(MOST_EFFECTS, len(self.by_kind))
        self._allowed = lru_cache(maxsize=None)(self._sum_allowed)

    def draw(self, rng: np.random.Generator, count: int) -> list[Candidate]:
        """Return a set of `count` effects."""
        kinds = sorted(self.by_kind)
        while True:
            names = rng.choice(len(kinds), count, replace=False)
            forms = [self.by_kind[kinds[n]] for n in names]
            chosen = [options[int(rng.integers(len(options)))] for options in forms]
            if go_together(chosen):
                return chosen

    def log_probability(self, chosen: Sequence[Candidate]) -> float:
        """Return the logarithm of the probability of one set of forms."""
        if not go_together(chosen) or len(chosen) > self.most:
            return -math.inf
        weight = sum(math.log(len(self.by_kind[one.form.kind])) for one in chosen)
        return -math.log(self.most + 1) - weight - math.log(self._allowed(len(chosen)))

    def _sum_allowed(self, count: int) -> float:
        """Return the weight of all sets of `count` that go together."""
        total = 0.0
        for kinds in itertools.combinations(sorted(self.by_kind), count):
            for chosen in itertools.product(*(self._classes(kind) for kind in kinds)):
                if go_together([one for one, _ in chosen]):
                    total += math.prod(share for _, share in chosen)
        return total

    def _classes(self, kind: str) -> list[tuple[Candidate, float]]:
        """Return a kind's forms by what decides whether they go with others, with their shares."""
        found: dict[tuple[bool, bool], list[Candidate]] = {}
        for one in self.by_kind[kind]:
            found.setdefault((one.form.rewrites, one.of_chip), []).append(one)
        return [(same[0], len(same) / len(self.by_kind[kind])) for same in found.values()]


# What makes a drift as large as asked: the root mean square that a polynomial of the chip leaves.

LEAST_SHARE = 0.05
"""Of a column that a polynomial of second order in the logged temperature must leave."""
LEAST_REWRITTEN = 0.02
"""Of the temperature, that rewriting must move it by beyond such a polynomial."""
SLOW_S = 300.0
"""Correlation time of the slow part of the noise and of a thermometer's error."""
RESOLUTION_K = 0.0078125
"""Of every thermometer."""
LINE = (10.0, 60.0)
"""Sizes of the polynomial's first order, in noise levels, where nothing rewrites it."""
BEND = 20.0
"""Standard deviation of the size of its second order."""


def leave_polynomial(columns: Array, temperature: Array) -> Array:
    """Return the columns less their fit of second order in the temperature.

    Args:
        columns: shape (..., rows), all runs end to end.
        temperature: shape (rows,), as logged.
    """
    x = (temperature - temperature.mean()) / (temperature.std() + 1e-12)
    basis, _ = np.linalg.qr(np.stack([np.ones_like(x), x, x**2], axis=1))
    found: Array = columns - (columns @ basis) @ basis.T
    return found


def rms(x: Array) -> Array:
    """Return the root mean square along the last axis."""
    found: Array = np.sqrt(np.mean(x**2, axis=-1))
    return found


def measure_scale(candidate: Candidate, columns: Sequence[Array], temperature: Array) -> Array:
    """Return what a coefficient of 1 leaves of each column, NaN where too little.

    Args:
        candidate: whose columns these are; a rewriting form's is the rewritten temperature.
        columns: each of shape (values, rows), all runs end to end.
        temperature: shape (rows,), as logged.

    Returns:
        shape (columns, values).
    """
    scales = []
    for column in columns:
        moved = column - temperature if candidate.form.rewrites else column
        left = rms(leave_polynomial(moved, temperature))
        whole = temperature if candidate.form.rewrites else column
        least = LEAST_REWRITTEN if candidate.form.rewrites else LEAST_SHARE
        enough = left >= least * rms(whole - whole.mean(axis=-1, keepdims=True)) + 1e-12
        scales.append(np.where(enough, left, np.nan))
    found = np.stack(scales)
    # A form of several columns is there or not as a whole.
    return np.where(np.isnan(found).any(axis=0), np.nan, found)


BLOCK = 16
"""Rows whose mean is one datum of the oracle."""


def take_means(columns: Array, lengths: Sequence[int]) -> Array:
    """Return the means of whole blocks of rows, runs end to end, shape (values, blocks).

    Args:
        columns: shape (values, runs, rows).
        lengths: rows of each run.
    """
    parts = []
    for run, length in enumerate(lengths):
        whole = length // BLOCK * BLOCK
        kept = columns[:, run, :whole]
        parts.append(kept.reshape(len(kept), -1, BLOCK).mean(axis=2))
    return np.concatenate(parts, axis=1)


@dataclass(frozen=True)
class Entry:
    """A candidate's columns over its grid of values.

    Attributes:
        candidate: the form and its thermometer.
        grid: its values, shape (values,).
        columns: each of shape (values, blocks); a rewriting form has first and second order.
        scale: of `measure_scale`, shape (coefficients, values), NaN where the value is not drawn.
    """

    candidate: Candidate
    grid: Array
    columns: tuple[Array, ...]
    scale: Array

    @property
    def allowed(self) -> NDArray[np.bool_]:
        """Which values of the grid leave enough to be drawn, shape (values,)."""
        found: NDArray[np.bool_] = ~np.isnan(self.scale[0])
        return found


def tabulate(signals: Signals, lengths: Sequence[int]) -> list[Entry]:
    """Return the entries of all candidates that the logged signals can show.

    Args:
        signals: as logged.
        lengths: rows of each run.
    """
    middle = float(signals.series[CHIP].mean())
    chip = take_means(signals.series[CHIP][None], lengths)[0]
    entries = []
    for one in list_candidates(signals):
        grid = one.form.grid()
        built = one.form.build(signals, one.signal, grid)
        columns = [take_means(column, lengths) for column in built]
        scale = measure_scale(one, columns, chip)
        if np.isnan(scale).all():
            continue
        if one.form.rewrites:
            columns.append(take_means((built[0] - middle) ** 2, lengths))
        entries.append(Entry(one, grid, tuple(columns), scale))
    return entries
