"""Training runs prepared so that columns can be built for them many times, reduced to octaves.

Signals are averaged over blocks of samples; the blocks of each run are taken apart
into octaves, see `reduction`; deviations within blocks are kept for every few blocks, so that fast
parts are kept. All that follows is small algebra on sums of products.
"""

import itertools
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from zerodrift.base.arrays import Array, IntArray, Mask
from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import Run
from zerodrift.operations.backend import GraphOperations, NumpyOperations, evaluate
from zerodrift.operations.operation import Node, list_nodes
from zerodrift.operations.registry import OPERATIONS
from zerodrift.physics.effect import FEWEST_RUNS, Arrivals, Effect, Feature
from zerodrift.physics.rails import bridge
from zerodrift.physics.reduction import MEANS, Column, Reduction, plan_reduction, select_means
from zerodrift.physics.signals import (
    SignalPlan,
    build_stretches,
    graph_inputs,
    lay_tracks,
    name_signals,
    read_signals,
    tell_arrival,
)
from zerodrift.physics.terms import Term, build_features, name_feature

# Chooses the rate at which a signal is computed: block means where it is slow, else all samples.
#
# Temperature moves over minutes, logs have up to hundreds of samples per second. Columns of signals
# that are nearly straight within a block are computed on block means, stretch by stretch; columns
# of a fast signal are computed on all samples and then averaged.

STRAIGHT = 1e-5
"""A signal is slow in a stretch if straight lines within blocks leave less than this share of its
squares over all stretches."""
STRAIGHT_ENOUGH = 1e-2
"""The same where values are only searched for."""
MOST_FILTERED = 16
"""Filtered signals of block means that are kept."""


class Rates:
    """The signals of all tracks at both rates.

    Args:
        inputs: per track, signal name -> [n]; a track holds the stretches of one run.
        places: per track, (stretch, its first sample on the track), at multiples of the block.
        reduction: how stretches become blocks and octaves.
        sample_period_s: seconds between samples.
    """

    def __init__(
        self,
        inputs: Sequence[Mapping[str, Array]],
        places: Sequence[Sequence[tuple[int, int]]],
        reduction: Reduction,
        sample_period_s: float,
    ) -> None:
        self._inputs = inputs
        self._places = places
        self._reduction = reduction
        self._sample_period_s = sample_period_s
        self._slow = {
            name: _lay_side_by_side([reduction.average(x[name]) for x in inputs])
            for name in inputs[0]
        }
        self._full: dict[tuple[str, tuple[int, ...]], Array] = {}
        self._filtered: OrderedDict[int, tuple[Node, Array]] = OrderedDict()
        self._fast: dict[tuple[int, bool], tuple[int, ...]] = {}
        self._curvature = {name: self._measure_curvature(name) for name in inputs[0]}
        self.roughly = False
        """Whether values are only searched for, so that block means may stand for more."""

    def put_spikes(self, name: str, heights: Sequence[float]) -> None:
        """Add a signal that is zero but at each track's first sample, or first block."""
        if name in self._slow:
            return
        self._slow[name] = np.zeros_like(next(iter(self._slow.values())))
        self._slow[name][:, 0] = heights
        spikes = []
        for inputs, height in zip(self._inputs, heights, strict=True):
            spikes.append(np.zeros(next(iter(inputs.values())).size))
            spikes[-1][0] = height
        self._inputs = [{**x, name: spike} for x, spike in zip(self._inputs, spikes, strict=True)]
        self._curvature[name] = np.zeros(len(spikes))

    @contextmanager
    def search_roughly(self) -> Iterator[None]:
        """Within this context, block means replace all signals that are nearly straight within
        blocks."""
        before, self.roughly = self.roughly, True
        try:
            yield
        finally:
            self.roughly = before

    def find_fast(self, node: Node) -> tuple[int, ...]:
        """Return the tracks on which a node is computed sample by sample; what it is there and on
        the others depends on nothing else."""
        if self._reduction.block == 1:
            return ()
        key = (id(node), self.roughly)
        if key not in self._fast:
            sources = {n.source for n in list_nodes([node]) if n.op == "input"}
            self._fast[key] = self._find_fast(sources)
        return self._fast[key]

    def compute(self, node: Node) -> Column:
        """Return the coefficients of a node's values over all stretches."""
        fast = self.find_fast(node)
        block = self._reduction.block
        block_rows = self._reduction.rows
        parts: list[tuple[Array, Array | None] | None] = [None] * len(block_rows)
        if len(fast) < len(self._inputs):
            laid = self._compute_slow(node)
            for i, row in enumerate(laid):
                for stretch, start in self._places[i] if i not in fast else ():
                    first = start // block
                    means = row[first : first + block_rows[stretch]]
                    parts[stretch] = self._reduction.draw_lines(means)
        if fast:
            sources = {n.source for n in list_nodes([node]) if n.op == "input"}
            full = {name: self._lay_full(name, fast) for name in sources}
            laid = evaluate([node], full, self._sample_period_s)[0]
            for i, row in zip(fast, laid, strict=True):
                for stretch, start in self._places[i]:
                    samples = row[start : start + block * block_rows[stretch]]
                    parts[stretch] = self._reduction.take_apart(samples)
        return self._reduction.assemble([part for part in parts if part is not None])

    def lay(self, node: Node) -> Array:
        """Return the values [n] of a node that is fast nowhere, stretch by stretch as in columns.

        Those are the blocks' means; of blocks of one sample the samples.
        """
        laid, block, rows = self._compute_slow(node), self._reduction.block, self._reduction.rows
        parts: dict[int, Array] = {}
        for row, places in zip(laid, self._places, strict=True):
            for stretch, start in places:
                parts[stretch] = row[start // block : start // block + rows[stretch]]
        return np.concatenate([parts[i] for i in self._reduction.sequence])

    def _compute_slow(self, node: Node) -> Array:
        """Return a node's values [tracks, n] of block means; what is filtered is kept for others.

        Features of one time constant share a filter, and a search comes back to it.
        """
        ops = NumpyOperations(
            self._reduction.block * self._sample_period_s, next(iter(self._slow.values())).shape
        )
        values: dict[int, Array] = {}
        for each in list_nodes([node]):
            if each.op == "input":
                values[id(each)] = self._slow[each.source]
            elif id(each) in self._filtered:
                self._filtered.move_to_end(id(each))
                values[id(each)] = self._filtered[id(each)][1]
            else:
                found = ops.compute(each, [values[id(child)] for child in each.inputs])
                values[id(each)] = found
                if each.op != "constant" and OPERATIONS[each.op].timed:
                    self._filtered[id(each)] = each, found
        while len(self._filtered) > MOST_FILTERED:
            self._filtered.popitem(last=False)
        return values[id(node)]

    def _find_fast(self, sources: set[str]) -> tuple[int, ...]:
        """Return the tracks in which one of the signals is fast."""
        if not sources:
            return ()
        limit = STRAIGHT_ENOUGH if self.roughly else STRAIGHT
        bent = np.max([self._curvature[name] for name in sources], axis=0)
        return tuple(np.flatnonzero(bent > limit).tolist())

    def _measure_curvature(self, name: str) -> Array:
        """Return each track's share of the signal's squares that straight lines leave."""
        if self._reduction.block == 1:
            return np.zeros(len(self._inputs))
        measured = [self._reduction.measure_curvature(x[name]) for x in self._inputs]
        total = sum(all_of_it for _, all_of_it in measured)
        left = np.array([left for left, _ in measured])
        # Per track against the mean track, so that one still run does not count as fast.
        return left * len(measured) / total if total > 0.0 else left

    def _lay_full(self, name: str, tracks: tuple[int, ...]) -> Array:
        """Return a signal of some tracks at the full rate, side by side."""
        key = (name, tracks)
        if key not in self._full:
            self._full[key] = _lay_side_by_side([self._inputs[i][name] for i in tracks])
        return self._full[key]


def _lay_side_by_side(stretches: Sequence[Array]) -> Array:
    """Return stretches as rows of one array, the last value repeated behind the shorter."""
    laid = np.empty((len(stretches), max(x.size for x in stretches)))
    for row, x in zip(laid, stretches, strict=True):
        row[: x.size] = x
        row[x.size :] = x[-1]
    return laid


# Training runs prepared so that columns can be built for them many times, reduced to octaves.

MOST_ROWS = 6_000
"""Blocks in all runs together; more samples than that are averaged."""
FEWEST_ROWS = 8
"""Blocks of the shortest stretch."""
FAST_ROWS = 3_000
"""Samples for which deviations within blocks are kept."""
CACHED_COLUMNS = 1000
"""Columns that are kept: those of one look at a model come back when values are refined."""
SPARE_ROWS = 8
"""Room for more columns at the next sum."""
MOST_BUILT = 1000
"""Values of the terms whose features are kept."""
FEWEST_PIECES = 8
"""As many pieces there are then, at least."""


@dataclass(frozen=True)
class Sums:
    """Sums of products of columns, per piece of time and octave.

    Columns: J features, then slopes, then the offsets' columns, then the K drifts.
    """

    products: Array
    """[G, L, C, C]."""
    counts: Array
    """[G, L] number of free coefficients behind each sum."""
    features: tuple[Feature[Node], ...] | tuple[Feature[Array], ...]
    """Of the graph, or of the arrays that were summed; the algebra uses only their number."""
    slopes: tuple[tuple[int, int], ...]
    """(coordinate, feature) of each slope column."""
    offsets: int
    outputs: int
    mask: Mask
    """[J, K] which output sees which feature."""


class Campaign:
    """All training runs with their signals, reduced to octaves; see the module's first lines.

    Args:
        runs: the runs.
        plan: what their signals are.
        order: the catalogue's order, in which rewriting effects act.
        tared: whether each run has an offset of its own.
        set_aside: whether samples at a converter's rail are bridged.
        most_rows: blocks in all runs together.
    """

    def __init__(
        self,
        runs: Sequence[Run],
        plan: SignalPlan,
        order: Sequence[str],
        *,
        tared: bool = True,
        set_aside: bool = False,
        most_rows: int = MOST_ROWS,
    ) -> None:
        self.runs = tuple(runs)
        self.plan = plan
        self.order = tuple(order)
        self.tared = tared
        self.groups = tuple(dict.fromkeys(run.group for run in runs))
        count = len(self.groups)
        self.pieces_per_run = 1 if count >= FEWEST_RUNS else -(-FEWEST_PIECES // count)
        self.samples = sum(len(run) for run in runs)
        reach = max(1, self.samples // most_rows)
        block = max(1, min(reach, min(len(run) for run in runs) // FEWEST_ROWS))
        self.reduction = plan_reduction(
            [len(run) for run in runs],
            [run.group for run in runs],
            block,
            max(1, self.samples // FAST_ROWS),
            self.pieces_per_run,
        )
        self.run_of_piece = np.repeat(np.arange(count), self.pieces_per_run)
        """[G] the run that each piece belongs to."""
        self.ops = GraphOperations(plan.sample_period_s)
        tracks = lay_tracks(runs, plan, block)
        self.rates = Rates(
            [graph_inputs(track.signals) for track in tracks],
            [track.places for track in tracks],
            self.reduction,
            plan.sample_period_s,
        )
        firsts = [self.runs[track.places[0][0]] for track in tracks]
        arrive = partial(_arrive, self.rates, self.ops, firsts)
        self._signals = replace(name_signals(self.ops, plan), arrivals=arrive)
        self._cache: OrderedDict[tuple[int, tuple[int, ...]], Column] = OrderedDict()
        self._built: dict[tuple[object, ...], tuple[Feature[Node], ...]] = {}
        self._effects: dict[int, Effect] = {}
        """Kept, so that no other gets the number of one that is gone."""
        self.set_aside = set_aside
        self._rows: Array | None = None
        self._drifts = [self._reduce_drift(k, None) for k in range(len(plan.outputs))]
        self._offsets = self._make_offsets()

    def share(self, *, tared: bool) -> "Campaign":
        """Return a campaign of the same runs that shares all columns, with other offsets."""
        other = copy(self)
        other.tared = tared
        other._drifts = list(self._drifts)
        other._offsets = other._make_offsets()
        other._rows = None
        return other

    def average_runs(self, values: Array) -> Array:
        """Return the means [R, K] over each run's pieces of values [G, K]."""
        shape = (len(self.groups), self.pieces_per_run, values.shape[1])
        return np.asarray(values.reshape(shape).mean(axis=1))

    @property
    def block(self) -> int:
        """Samples in a block."""
        return self.reduction.block

    @property
    def levels(self) -> IntArray:
        """[L] the octaves."""
        return self.reduction.levels

    @property
    def counts(self) -> Array:
        """[G, L] free coefficients of each piece and octave."""
        return self.reduction.counts

    @property
    def means(self) -> Mask:
        """[L] which octaves are the pieces' means."""
        return select_means(self.reduction.levels)

    @property
    def unit_of_piece(self) -> IntArray:
        """[G] the unit of evidence of each piece: its run, or with few runs the piece itself."""
        if self.pieces_per_run == 1:
            return self.run_of_piece
        return np.arange(self.run_of_piece.size)

    @property
    def uses_means(self) -> bool:
        """Whether the pieces' means carry information, beside the offsets' columns."""
        return bool(self._offsets)

    def build(self, terms: Sequence[Term]) -> tuple[Feature[Node], ...]:
        """Return the features of the terms as nodes, without the constant.

        Raises:
            InputError: an effect fails, or returns something other than nodes.
        """
        key = tuple(
            (id(t.effect), t.signal, t.arrivals, tuple(sorted(t.values.items()))) for t in terms
        )
        if key in self._built:
            return self._built[key]
        features = build_features(self.ops, self._signals, terms, self.order)
        for feature in features:
            if not isinstance(feature.signal, Node):
                raise InputError(
                    f"{name_feature(feature, terms)} is a "
                    f"{type(feature.signal).__name__}; expected what an operation of `ops` returns."
                )
        if len(self._built) >= MOST_BUILT:
            self._built.clear()
        self._effects |= {id(term.effect): term.effect for term in terms}
        self._built[key] = tuple(features[1:])
        return self._built[key]

    def column(self, node: Node, label: str = "") -> Column:
        """Return the coefficients of a node's values over all runs, computed once.

        Args:
            node: what to compute.
            label: the column's name, for messages.

        Raises:
            InputError: it is NaN or infinite somewhere.
        """
        key = (id(node), self.rates.find_fast(node))
        if key in self._cache:
            self._cache.move_to_end(key)
            return self._cache[key]
        # Values that overflow or are undefined are refused below, with a name.
        with np.errstate(over="ignore", invalid="ignore"):
            column = self.rates.compute(node)
        if not np.isfinite(column.octaves).all():
            raise InputError(
                f"{label or repr(node)}: some values are NaN or infinite; keep the arguments of "
                "each operation where it is defined, or narrow the parameters' bounds."
            )
        self._cache[key] = column
        if len(self._cache) > CACHED_COLUMNS:
            self._cache.popitem(last=False)
        return column

    def sum(
        self,
        features: Sequence[Feature[Node]],
        terms: Sequence[Term],
        slopes: Sequence[tuple[int, int, Column]] = (),
    ) -> Sums:
        """Return the sums of products of features, slopes, offsets and drifts.

        Args:
            features: from `build`.
            terms: what they were built from, for messages.
            slopes: (coordinate, feature, column) of each slope.
        """
        columns = [self.column(f.signal, name_feature(f, terms)) for f in features]
        columns += [column for _, _, column in slopes]
        outputs = self.plan.outputs
        mask = np.array(
            [[f.output is None or f.output == output for output in outputs] for f in features],
            dtype=bool,
        ).reshape(len(features), len(outputs))
        return Sums(
            self._sum_products(columns),
            self.counts,
            tuple(features),
            tuple((p, j) for p, j, _ in slopes),
            len(self._offsets),
            len(outputs),
            mask,
        )

    def _sum_products(self, columns: Sequence[Column]) -> Array:
        """Return the sums of products of these columns, then the offsets and the drifts."""
        behind = [*self._offsets, *self._drifts]
        needed = len(columns) + len(behind)
        if self._rows is None or len(self._rows) < needed:
            # What is behind stays where it is from one sum to the next.
            self._rows = np.empty((needed + SPARE_ROWS, behind[-1].octaves.size))
            np.stack([column.octaves for column in behind], out=self._rows[-len(behind) :])
        rows = self._rows[-needed:]
        for row, column in zip(rows, columns, strict=False):
            row[:] = column.octaves
        return self.reduction.sum_products(rows, [c.fast for c in (*columns, *behind)])

    def lay_drift(self) -> Array | None:
        """Return the drift [K, n] of all samples, stretch by stretch as in `Rates.lay`.

        None where samples are averaged or bridged, or where only what lies between the pieces'
        means counts.
        """
        if self.block > 1 or not self.uses_means or (self.set_aside and self.plan.saturated):
            return None
        drift = np.concatenate([self.runs[i].steady_drift for i in self.reduction.sequence])
        return np.ascontiguousarray(drift.T)

    def level(self, laid: Array) -> Array:
        """Return laid values [..., n] without what the offsets take."""
        groups = [self.runs[i].group if self.tared else "" for i in self.reduction.sequence]
        sizes = [self.reduction.rows[i] for i in self.reduction.sequence]
        levelled, at = np.empty_like(laid), 0
        for _, own in itertools.groupby(zip(groups, sizes, strict=True), key=lambda each: each[0]):
            part = laid[..., at : (at := at + sum(size for _, size in own))]
            np.subtract(
                part,
                part.mean(axis=-1, keepdims=True),
                out=levelled[..., at - part.shape[-1] : at],
            )
        return levelled

    def mean_of(self, node: Node) -> Array:
        """Return the mean [G] of a node's values over each piece, but for a constant."""
        return self._list_means(self.column(node))

    def drift_means(self) -> Array:
        """Return the mean [G, K] of the drift over each piece, but for a constant."""
        return np.stack([self._list_means(column) for column in self._drifts], axis=1)

    def _list_means(self, column: Column) -> Array:
        """Return the means over the pieces from a column's coefficients."""
        octaves = self.reduction.octaves
        rows = np.flatnonzero(octaves.octave == MEANS)
        # The coefficient is the mean times the root of the piece's samples.
        return np.asarray(column.octaves[rows] * octaves.left[rows] / np.sqrt(self.block))

    def fill(self, terms: Sequence[Term], coefficients: Array) -> None:
        """Fill samples at a converter's rail again, with the prediction of a fitted model.

        A straight line across many of them misses the curvature of a fast ramp; the residual of the
        model is straight enough.

        Args:
            terms: the fitted model.
            coefficients: [K, J] of its features, without the constant.
        """
        if not self.set_aside or not self.plan.saturated:
            return
        predictions = []
        built = build_stretches(self.runs, self.plan, terms, self.order)
        for run, (_, *columns) in zip(self.runs, built, strict=True):
            prediction = np.zeros(run.drift.shape)
            for column, row in zip(columns, coefficients.T, strict=True):
                prediction += column.signal[:, None] * row
            predictions.append(prediction)
        for name in self.plan.saturated:
            k = self.plan.outputs.index(name)
            self._drifts[k] = self._reduce_drift(k, predictions)
        self._rows = None

    def _reduce_drift(self, k: int, predictions: Sequence[Array] | None) -> Column:
        """Return the coefficients of one output's drift."""
        drifts = []
        for i, run in enumerate(self.runs):
            drift = run.steady_drift[:, k]
            if self.plan.outputs[k] in self.plan.saturated and self.set_aside:
                flags = read_signals(run, self.plan).saturated[self.plan.outputs[k]]
                expected = predictions[i][:, k] if predictions else np.zeros_like(drift)
                drift = expected + bridge(drift - expected, flags)
            drifts.append(drift)
        return self.reduction.reduce(drifts)

    def _make_offsets(self) -> list[Column]:
        """Return the constant columns: none where each piece has an offset of its own."""
        if self.tared and self.pieces_per_run == 1:
            return []
        owners: list[str | None] = list(self.groups) if self.tared else [None]
        return [
            self.reduction.reduce_means(
                [
                    np.full(rows, float(owner is None or owner == run.group))
                    for run, rows in zip(self.runs, self.reduction.rows, strict=True)
                ],
                centre=False,
            )
            for owner in owners
        ]


def _arrive(rates: Rates, ops: GraphOperations, firsts: Sequence[Run], arrivals: Arrivals) -> Node:
    """Return the input that says from where each run came to its first temperature.

    No method of `Campaign`: one that holds itself would wait for the garbage collector, with all
    its columns.
    """
    name = f"arrival:{arrivals}"
    rates.put_spikes(name, [tell_arrival(arrivals, run) for run in firsts])
    return ops.input(name)
