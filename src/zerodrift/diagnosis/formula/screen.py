"""Every form at every starting value, judged at once on runs left out: which are worth a fit.

All is reduced to block means and octaves, and freed from what the model as it is explains (its
columns and their slopes). Then a form is two sums per run and output - its squares, and its product
with what is left - and from these follow its gain in each run left out, and the gain that it would
have had if the signs of whole runs were others, which is what chance can do. The largest chance
gain over all forms is what the best form has to beat: so everything that was tried counts.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.diagnosis.examination import predict
from zerodrift.diagnosis.formula.expression import OWN_LOAD, Driver, Expression, is_by_load
from zerodrift.diagnosis.formula.grammar import Form, Spans
from zerodrift.diagnosis.noise import Noise
from zerodrift.operations.backend import NumpyOperations
from zerodrift.physics.campaign import Campaign
from zerodrift.physics.effect import Feature, Signals
from zerodrift.physics.reduction import Reduction, plan_reduction, select_means
from zerodrift.physics.search import Found, get_coordinates, list_coordinates, set_coordinates
from zerodrift.physics.signals import lay_tracks
from zerodrift.physics.terms import Term, build_features

MOST_ROWS = 4_000
"""Block means in all runs together."""
BATCH = 600
"""Columns that are worked on together."""
FLIPS = 128
"""Patterns of signs by which chance is told; all there are for up to eight runs."""
LEAST_LEFT = 0.05
"""A column of which the model imitates all but this share cannot be told from it."""
SLOPE_STEP = 1e-3
NOWHERE = 1e-9
REFINED = 60
"""Forms whose numbers are searched for more closely, ..."""
ROUNDS = 6
"""... in so many rounds, with steps that become smaller from each to the next ..."""
SHRINK = 0.6
"""... by this factor."""
FIRST_STEP = 0.5
"""The first step: this share of a number, or of a fifth of its typical range."""


@dataclass(frozen=True)
class Screened:
    """A form at its best starting values."""

    form: Form
    values: tuple[float, ...]
    gain: float
    """On runs left out, noise units."""


@dataclass(frozen=True)
class Search:
    """What the search over all forms found, and what chance finds."""

    forms: tuple[Screened, ...]
    """Best first."""
    tried: int
    """Columns that were judged: forms times starting values."""
    chance: Array
    """[P] largest gain over all columns when signs of whole runs are flipped; the first pattern
    flips nothing."""

    @property
    def p_value(self) -> float:
        """How often the best of everything tried does as well by chance."""
        best = float(self.chance[0])
        return float(np.mean(self.chance >= best - 1e-9 * abs(best)))


def list_sources(campaign: Campaign) -> list[Driver]:
    """Return the signals that a formula may begin from: those that move in the runs."""
    plan = campaign.plan
    tracks = lay_tracks(campaign.runs, plan)

    def measure(kind: str, name: str, unit: str, values: Sequence[Array]) -> Driver:
        low, middle, high = np.quantile(np.concatenate(list(values)), (0.02, 0.5, 0.98)).tolist()
        return Driver(kind, name, unit, low, middle, high)

    found = [
        measure("temperature", "T", "degC", [track.signals.temperature_degC for track in tracks])
    ]
    loads = {name: [track.signals.load[name] for track in tracks] for name in plan.loaded}
    if len(loads) > 1 and len(loads) == len(plan.outputs):
        every = [x for values in loads.values() for x in values]
        found.append(measure("load", OWN_LOAD, "load", every))
    found += [measure("load", name, "load", values) for name, values in loads.items()]
    found += [
        measure("input", name, _guess_unit(name), [t.signals.channels[name] for t in tracks])
        for name in plan.channels
        if name != "clock"
    ]
    found.append(measure("time", "elapsed", "s", [t.signals.elapsed_s for t in tracks]))
    if "clock" in plan.channels:
        found.append(measure("time", "clock", "s", [t.signals.clock_s for t in tracks]))
    return [source for source in found if source.span > 0.0]


UNITS = {
    "supply": "V",
    "humidity": "%RH",
    "ambient_light": "lux",
    "body_temperature": "degC",
}


def _guess_unit(name: str) -> str:
    """Return the unit that an input of this name is in."""
    if name.startswith("acceleration"):
        return "m/s^2"
    return "degC" if name.endswith("temperature") else UNITS.get(name, name)


class Screen:
    """The runs made ready for columns by the thousand.

    Args:
        campaign: the runs.
        base: the model as it is, fitted.
        noise: its noise.
    """

    def __init__(self, campaign: Campaign, base: Found, noise: Noise) -> None:
        runs, plan = campaign.runs, campaign.plan
        lengths = [len(run) for run in runs]
        block = max(1, sum(lengths) // MOST_ROWS, campaign.block)
        block = min(block, max(1, min(lengths) // 8))
        self._reduction = plan_reduction(
            lengths, [run.group for run in runs], block, 1, campaign.pieces_per_run
        )
        self._block = block
        self._period_s = plan.sample_period_s
        tracks = lay_tracks(runs, plan, block)
        self._places = [track.places for track in tracks]
        self._signals = _average([track.signals for track in tracks], self._reduction)
        self._outputs = plan.outputs
        owners = campaign.unit_of_piece
        piece = self._reduction.octaves.piece
        order = np.argsort(owners[piece], kind="stable")
        self._edges = np.searchsorted(owners[piece][order], np.unique(owners))
        self._order = order
        self._scale = _whiten(self._reduction, noise, lengths)[order]
        keep = ~select_means(self._reduction.octaves.octave)[order]
        self._scale *= keep[:, None]
        columns = _list_columns(campaign, base, self._build_arrays)
        self._bases = [self._span(columns, k) for k in range(len(self._outputs))]
        rests = [run.steady_drift - predict(base, run, plan, campaign.order) for run in runs]
        self._rests = []
        for k, basis in enumerate(self._bases):
            left = self._reduction.reduce_means([self._reduction.average(r[:, k]) for r in rests])
            rest = left.octaves[order] * self._scale[:, k]
            self._rests.append(rest - basis @ (basis.T @ rest))

    @property
    def spans(self) -> Spans:
        """The times that the runs can show."""
        longest = max(rows for rows in self._reduction.rows) * self._block * self._period_s
        return Spans(self._period_s, self._block * self._period_s, longest)

    def search(self, forms: Sequence[Form]) -> Search:
        """Return every form at its best starting values, best first, and what chance finds."""
        units = len(self._edges)
        signs = draw_signs(units)
        chance = np.full(len(signs), -np.inf)
        best: dict[int, tuple[float, tuple[float, ...]]] = {}
        tried = 0
        for batch in _cut(forms):
            columns = self._build_all([(form.expression, values) for _, form, values in batch])
            products, squares = self._reduce(
                columns, [is_by_load(f.expression) for _, f, _ in batch]
            )
            gains, by_chance = judge(products, squares, signs)
            tried += len(batch)
            chance = np.maximum(chance, by_chance)
            for (number, _, values), gain in zip(batch, gains.tolist(), strict=True):
                if gain > best.get(number, (-np.inf, ()))[0]:
                    best[number] = (gain, values)
        found = [Screened(forms[n], values, gain) for n, (gain, values) in best.items()]
        found.sort(key=lambda one: -one.gain)
        refined = self._refine(found[:REFINED]) + found[REFINED:]
        return Search(tuple(sorted(refined, key=lambda one: -one.gain)), tried, chance)

    def _refine(self, found: list[Screened]) -> list[Screened]:
        """Return forms with values around which no neighbour gains more."""
        step = FIRST_STEP
        for _ in range(ROUNDS):
            tried = [Form(one.form.expression, _surround(one, step)) for one in found]
            best = list(found)
            for batch in _cut(tried):
                columns = self._build_all([(form.expression, values) for _, form, values in batch])
                own = [is_by_load(form.expression) for _, form, _ in batch]
                products, squares = self._reduce(columns, own)
                gains, _ = judge(products, squares, np.ones((1, len(self._edges))))
                for (number, _, values), gain in zip(batch, gains.tolist(), strict=True):
                    if gain > best[number].gain:
                        best[number] = replace(best[number], values=values, gain=gain)
            found, step = best, step * SHRINK
        return found

    def _build_arrays(self) -> tuple[NumpyOperations, Signals[Array]]:
        shape = self._signals.temperature_degC.shape
        return NumpyOperations(self._block * self._period_s, shape), self._signals

    def _build_all(self, wanted: Sequence[tuple[Expression, tuple[float, ...]]]) -> list[Array]:
        """Return the coefficients [F, M] of the columns, once per output where they differ."""
        ops, signals = self._build_arrays()
        memory: dict[tuple[str, str | None], Array] = {}
        laid: list[list[Array]] = []
        for own in self._outputs if any(is_by_load(e) for e, _ in wanted) else [None]:
            rows = []
            for expression, numbers in wanted:
                values = {p.name: v for p, v in zip(expression.parameters, numbers, strict=True)}
                mine = own if is_by_load(expression) else None
                if mine is not None and mine not in signals.load:
                    rows.append(np.zeros(signals.temperature_degC.shape))
                    continue
                with np.errstate(all="ignore"):
                    rows.append(_evaluate(expression, ops, signals, values, mine, memory))
            laid.append(rows)
        return [self._transform(np.stack(rows)) for rows in laid]

    def _transform(self, values: Array) -> Array:
        """Return the octaves' coefficients [F, M] of signals [F, tracks, n]."""
        parts: list[Array | None] = [None] * len(self._reduction.rows)
        for track, places in enumerate(self._places):
            for stretch, start in places:
                first = start // self._block
                parts[stretch] = values[:, track, first : first + self._reduction.rows[stretch]]
        x = np.concatenate(
            [part for i in self._reduction.sequence if (part := parts[i]) is not None], axis=1
        )
        x = np.where(np.isfinite(x), x, 0.0) * np.sqrt(self._block)
        x = x - x.mean(axis=1, keepdims=True)
        running = np.concatenate([np.zeros((x.shape[0], 1)), np.cumsum(x, axis=1)], axis=1)
        o = self._reduction.octaves
        middle = running[:, o.middle]
        found = (middle - running[:, o.start]) * o.left - (running[:, o.stop] - middle) * o.right
        return np.asarray(found[:, self._order])

    def _reduce(self, columns: Sequence[Array], own: Sequence[bool]) -> tuple[Array, Array]:
        """Return each column's products with the rest, and squares, [F, U, K]."""
        shape = (columns[0].shape[0], len(self._edges), len(self._outputs))
        products, squares = np.zeros(shape), np.zeros(shape)
        by_load = np.array(own)
        for k, (basis, rest) in enumerate(zip(self._bases, self._rests, strict=True)):
            x = columns[0]
            if len(columns) > 1 and by_load.any():
                x = np.where(by_load[:, None], columns[k], columns[0])
            x = x * self._scale[:, k]
            whole = np.einsum("fm,fm->f", x, x)
            x = x - (x @ basis) @ basis.T
            left = np.einsum("fm,fm->f", x, x)
            x[left <= LEAST_LEFT**2 * whole + NOWHERE] = 0.0
            products[:, :, k] = np.add.reduceat(x * rest, self._edges, axis=1)
            squares[:, :, k] = np.add.reduceat(x * x, self._edges, axis=1)
        return products, squares

    def _span(self, columns: Sequence[tuple[str | None, Array]], k: int) -> Array:
        """Return an orthonormal basis [M, B] of what the model spans for one output."""
        mine = [x for output, x in columns if output in (None, self._outputs[k])]
        if not mine:
            return np.zeros((self._scale.shape[0], 0))
        table = self._transform(np.stack(mine)) * self._scale[:, k]
        norms = np.linalg.norm(table, axis=1, keepdims=True)
        table = table / np.where(norms > 0.0, norms, 1.0)
        u, sizes, _ = np.linalg.svd(table.T, full_matrices=False)
        return np.asarray(u[:, sizes > 1e-6 * max(float(sizes.max()), 1e-300)])


def _surround(one: Screened, step: float) -> tuple[tuple[float, ...], ...]:
    """Return values a step away from a form's own, one number at a time."""
    around = []
    for place, parameter in enumerate(one.form.expression.parameters):
        for sign in (-1.0, 1.0):
            values = list(one.values)
            if parameter.scale == "log":
                values[place] *= (1.0 + step) ** sign
            else:
                low, high = parameter.typical
                values[place] += sign * step * 0.2 * (high - low)
            values[place] = min(max(values[place], parameter.lower), parameter.upper)
            around.append(tuple(values))
    return tuple(around)


def judge(products: Array, squares: Array, signs: Array) -> tuple[Array, Array]:
    """Return each column's gain [F] on units left out, and the best by each pattern of signs [P].

    A column's coefficient is fitted to all units but one, per output, and tried on that one.

    Args:
        products: [F, U, K] of a column with what is left.
        squares: [F, U, K] of the column.
        signs: [P, U] of whole units; the first pattern is all ones.
    """
    others = squares.sum(axis=1, keepdims=True) - squares
    useful = others > 1e-6 * np.maximum(squares.sum(axis=1, keepdims=True), NOWHERE)
    inverse = np.where(useful, 1.0 / np.where(useful, others, 1.0), 0.0)
    best = np.full(len(signs), -np.inf)
    gains = np.zeros(products.shape[0])
    for p, sign in enumerate(signs):
        flipped = products * sign[:, None]
        coefficient = (flipped.sum(axis=1, keepdims=True) - flipped) * inverse
        gain = (coefficient * (2.0 * flipped - coefficient * squares)).sum(axis=(1, 2))
        best[p] = float(gain.max())
        if p == 0:
            gains = gain
    return gains, best


def draw_signs(units: int) -> Array:
    """Return patterns of signs [P, U], all ones first; a pattern and its opposite are one."""
    if 2 ** (units - 1) <= FLIPS:
        rows = [(1.0, *rest) for rest in itertools.product((1.0, -1.0), repeat=units - 1)]
        return np.array(rows)
    signs = np.random.default_rng(0).choice((1.0, -1.0), size=(FLIPS, units))
    signs[0] = 1.0
    return signs


def _evaluate(
    expression: Expression,
    ops: NumpyOperations,
    signals: Signals[Array],
    values: dict[str, float],
    own: str | None,
    memory: dict[tuple[str, str | None], Array],
) -> Array:
    """Return a column's values; low-passes and the like of plain signals are computed once."""
    one = expression
    simple = len(one.inputs) == 1 and one.inputs[0].op == "source"
    key = (one.write(values) if simple else "", own)
    if simple and key in memory:
        return memory[key]
    if one.op == "source" or simple:
        found = one.build(ops, signals, values, own)
    else:
        below = [_evaluate(x, ops, signals, values, own, memory) for x in one.inputs]
        found = one.apply(ops, below, values)
    if simple:
        memory[key] = found
    return found


def _cut(forms: Sequence[Form]) -> list[list[tuple[int, Form, tuple[float, ...]]]]:
    """Return forms with their starting values in batches: those by load apart."""
    plain = [
        (n, f, v) for n, f in enumerate(forms) for v in f.starts if not is_by_load(f.expression)
    ]
    own = [(n, f, v) for n, f in enumerate(forms) for v in f.starts if is_by_load(f.expression)]
    return [
        rows[start : start + BATCH] for rows in (plain, own) for start in range(0, len(rows), BATCH)
    ]


def _average(tracks: Sequence[Signals[Array]], reduction: Reduction) -> Signals[Array]:
    """Return the signals' block means [tracks, n], the last value repeated behind the shorter."""

    def lay(stretches: Sequence[Array]) -> Array:
        means = [reduction.average(x) for x in stretches]
        laid = np.empty((len(means), max(x.size for x in means)))
        for row, x in zip(laid, means, strict=True):
            row[: x.size], row[x.size :] = x, x[-1]
        return laid

    first = tracks[0]
    return Signals(
        temperature_degC=lay([t.temperature_degC for t in tracks]),
        elapsed_s=lay([t.elapsed_s for t in tracks]),
        clock_s=lay([t.clock_s for t in tracks]),
        load={name: lay([t.load[name] for t in tracks]) for name in first.load},
        saturated={name: lay([t.saturated[name] for t in tracks]) for name in first.saturated},
        channels={name: lay([t.channels[name] for t in tracks]) for name in first.channels},
        outputs=first.outputs,
        full_scale=first.full_scale,
        reference_temperature_degC=first.reference_temperature_degC,
    )


def _whiten(reduction: Reduction, noise: Noise, lengths: Sequence[int]) -> Array:
    """Return the factor [M, K] of each coefficient that makes the noise one."""
    octave = reduction.octaves.octave
    present, place = np.unique(octave, return_inverse=True)
    variance = noise.variance(present, int(np.median(lengths)), reduction.block)
    return np.asarray(1.0 / np.sqrt(np.maximum(variance, 1e-30)))[place]


def _list_columns(
    campaign: Campaign,
    base: Found,
    build_arrays: Callable[[], tuple[NumpyOperations, Signals[Array]]],
) -> list[tuple[str | None, Array]]:
    """Return the model's columns and their slopes, with the output that sees each."""
    ops, signals = build_arrays()

    def build(terms: Sequence[Term]) -> list[Feature[Array]]:
        return build_features(ops, signals, terms, campaign.order)[1:]

    features = build(base.terms)
    columns = [(f.output, f.signal) for f in features]
    coordinates = list_coordinates(base.terms)
    position = get_coordinates(base.terms, coordinates)
    for p in range(len(coordinates)):
        there = position.copy()
        there[p] += SLOPE_STEP
        moved = build(set_coordinates(base.terms, coordinates, there))
        columns += [
            (f.output, (m.signal - f.signal) / SLOPE_STEP)
            for f, m in zip(features, moved, strict=True)
            if not np.array_equal(f.signal, m.signal)
        ]
    return columns
