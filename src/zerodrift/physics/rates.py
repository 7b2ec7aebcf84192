"""Chooses the rate at which a signal is computed: block means where it is slow, else all samples.

Temperature moves over minutes, logs have up to hundreds of samples per second. Columns of signals
that are nearly straight within a block are computed on block means, stretch by stretch; columns of
a fast signal are computed on all samples and then averaged.
"""

from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.operations.backend import NumpyOperations, evaluate
from zerodrift.operations.graph import Node, list_nodes
from zerodrift.operations.registry import OPERATIONS
from zerodrift.physics.reduction import Column, Reduction

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
