"""The fitted lag bank: what it adds to the physical model, as arrays and as a graph."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.operations.backend import GraphOperations, NumpyOperations, Operations
from zerodrift.operations.operation import Node
from zerodrift.train.front_end import read_source
from zerodrift.train.lag_bank.data import DEGREE, Lag, Scale

S = TypeVar("S")

LOAD = "load:"
"""What names of loads begin with in graphs."""
LoadTerm = tuple[tuple[str, ...], int]
"""Product of one or two loads and a power of the chip's temperature u."""
POWERS = ((0, 0), (2, 0), (2, 1), (3, 1), (3, 2))
"""By order of the load terms: how many powers of u, from u^0 on, a load is seen times, and how many
a product of two loads or a square: nothing; gain by temperature; curvature; both richer."""


@dataclass(frozen=True)
class LagBank:
    """drift = correction of the physical features + powers of thermometers and their lags + loads.

    Per output sum_j coefficients[j, k] basis_j; the tanh units beside it are an ordinary network.
    """

    sources: tuple[str, ...]
    """Thermometers, the chip's own first."""
    scales: tuple[Scale, ...]
    """Of each thermometer."""
    lags: tuple[Lag, ...]
    loads: tuple[LoadTerm, ...]
    """What the bank sees of the outputs' loads."""
    correction: Array
    """[J, K] added to the physical model's coefficients."""
    coefficients: Array
    """[B, K] of the basis, in output units."""
    degree: int = DEGREE
    """Powers of each lag; a thermometer itself has `DEGREE`."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the basis, for reports."""
        loads = [f"{' '.join(names)} u^{p}" for names, p in self.loads]
        levels = [f"({s})^{p}" for s in self.sources for p in range(1, DEGREE + 1)]
        lags = [
            f"lowpass({self.sources[s]}, {tau_s:g} s)^{p}"
            for s, tau_s in self.lags
            for p in range(1, self.degree + 1)
        ]
        return (*loads, *levels, *lags)

    def build(self, ops: Operations[S], read: Callable[[str], S]) -> tuple[S, ...]:
        """Return the basis, computed or recorded; `read` gives a thermometer or "load:NAME"."""
        levels = []
        for source, scale in zip(self.sources, self.scales, strict=True):
            gain = 1.0 / scale.half_span
            levels.append(ops.affine(read(source), gain, -scale.centre * gain))
        columns = build_loads(ops, read, levels[0], self.loads)
        for level in levels:
            columns += raise_up(ops, level, DEGREE)
        for place, tau_s in self.lags:
            scale = self.scales[place]
            lagged = ops.lowpass(read(self.sources[place]), tau_s)
            gain = 1.0 / scale.half_span
            columns += raise_up(ops, ops.affine(lagged, gain, -scale.centre * gain), self.degree)
        return tuple(columns)

    def compute(self, run: Run, outputs: tuple[str, ...]) -> Array:
        """Return the basis [n, B] of a run.

        Args:
            run: its references are the loads.
            outputs: names of the run's outputs.

        Raises:
            InputError: the run lacks a thermometer.
        """

        def read(source: str) -> Array:
            if source.startswith(LOAD):
                return run.reference[:, outputs.index(source.removeprefix(LOAD))]
            return read_source(run, source)

        ops: Operations[Array] = NumpyOperations(run.sample_period_s, (len(run),))
        columns: tuple[Array, ...] = self.build(ops, read)
        return np.stack(columns, axis=1)

    def graph(self, ops: GraphOperations) -> tuple[Node, ...]:
        """Return the basis as graph nodes."""
        return self.build(ops, ops.input)

    @property
    def parameters(self) -> int:
        """Numbers that were fitted: coefficients and time constants."""
        return int(np.count_nonzero(self.coefficients)) + len(self.lags)

    @property
    def macs(self) -> int:
        """Multiplications in a step: powers, products with loads, lags, and the sum."""
        powers = (DEGREE - 1) * len(self.sources) + (self.degree - 1) * len(self.lags)
        loads = sum(len(names) - 1 + (p > 0) for names, p in self.loads)
        return powers + loads + 2 * len(self.lags) + int(self.coefficients.size)

    def to_record(self) -> "LagBankRecord":
        """Return the bank as compensator.json holds it."""
        return LagBankRecord(
            sources=self.sources,
            scales=tuple((s.centre, s.half_span) for s in self.scales),
            lags=self.lags,
            loads=self.loads,
            degree=self.degree,
            correction=self.correction,
            coefficients=self.coefficients,
        )


@dataclass(frozen=True, kw_only=True)
class LagBankRecord:
    """A lag bank as compensator.json holds it; see `LagBank`."""

    sources: tuple[str, ...]
    scales: tuple[tuple[float, float], ...]
    """Centre and half span."""
    lags: tuple[tuple[int, float], ...]
    loads: tuple[tuple[tuple[str, ...], int], ...]
    degree: int = DEGREE
    correction: Array
    coefficients: Array

    def restore(self, outputs: int) -> LagBank:
        """Return the bank that `to_record` described."""
        return LagBank(
            sources=self.sources,
            scales=tuple(Scale(float(centre), float(half)) for centre, half in self.scales),
            lags=tuple((place, float(tau_s)) for place, tau_s in self.lags),
            loads=self.loads,
            correction=self.correction.reshape(-1, outputs),
            coefficients=self.coefficients.reshape(-1, outputs),
            degree=self.degree,
        )


def list_load_terms(
    loads: Sequence[str], order: int, pairs: Sequence[tuple[str, str]]
) -> tuple[LoadTerm, ...]:
    """Return the terms of an order, 0 to 4; see `POWERS`.

    Args:
        loads: names of the loads.
        order: how rich.
        pairs: products of two loads, or squares, that were seen.
    """
    own, both = POWERS[order]
    single: list[LoadTerm] = [((name,), p) for name in loads for p in range(own)]
    return (*single, *((pair, p) for pair in pairs for p in range(both)))


def build_loads(
    ops: Operations[S], read: Callable[[str], S], level: S, terms: Sequence[LoadTerm]
) -> list[S]:
    """Return the signals of load terms, for the chip's scaled temperature `level`."""
    columns = []
    for names, p in terms:
        first, *others = (read(LOAD + name) for name in names)
        term = first
        for other in others:
            term = ops.power(first, 2.0) if names[0] == names[1] else ops.product(first, other)
        if p:
            term = ops.product(term, level if p == 1 else ops.power(level, float(p)))
        columns.append(term)
    return columns


def raise_up(ops: Operations[S], x: S, degree: int) -> list[S]:
    """Return x, x^2, ..., x^degree."""
    return [x, *(ops.power(x, float(p)) for p in range(2, degree + 1))]
