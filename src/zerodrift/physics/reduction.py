"""From long signals to few coefficients: block means in Haar octaves, and a sample of the rows."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from zerodrift.base.arrays import Array, IntArray, Mask

# Haar octaves: a run is cut in halves repeatedly, which separates slow from fast parts.


MEANS = -1
"""The octave's number of a piece's mean."""
WITHIN_BLOCKS = -2
"""The octave's number of deviations within blocks of samples."""
MOST_KEPT = 1 << 14
"""Rows of a change of basis that is kept for the next runs of these lengths: 1 MB at most."""


@dataclass(frozen=True)
class Octaves:
    """The change of basis for several pieces of time laid end to end.

    Rows of the result are sorted by piece, then by octave, from fine to coarse; each piece's last
    row is its mean times the square root of its length.
    """

    start: IntArray
    """[M] where the left half begins, in the running sum."""
    middle: IntArray
    stop: IntArray
    left: Array
    """[M] factor of the left half's sum; the right half has minus `right`."""
    right: Array
    octave: IntArray
    """[M] log2 of the halves' length in samples, rounded; MEANS for a piece's mean."""
    piece: IntArray
    """[M] index of the piece."""

    def transform(self, x: Array) -> Array:
        """Return the coefficients [M] of a column [n] over all pieces."""
        running = np.empty(x.size + 1)
        running[0] = 0.0
        np.cumsum(x, out=running[1:])
        at_middle = running.take(self.middle)
        left, right = running.take(self.start), running.take(self.stop)
        np.subtract(at_middle, left, out=left)
        np.subtract(right, at_middle, out=right)
        left *= self.left
        right *= self.right
        left -= right
        return left


def cut_octaves(lengths: IntArray, samples_per_row: int) -> Octaves:
    """Return the change of basis for pieces of these lengths.

    Args:
        lengths: [G] rows of each piece.
        samples_per_row: samples that each row is the mean of.
    """
    sizes = tuple(int(n) for n in lengths)
    return (_cut if sum(sizes) > MOST_KEPT else _cut_once)(sizes, samples_per_row)


def _cut(lengths: tuple[int, ...], samples_per_row: int) -> Octaves:
    parts: list[tuple[IntArray, IntArray, IntArray, IntArray, int]] = []
    offset = 0
    for index, length in enumerate(lengths):
        levels = []
        depth = 0
        while (1 << depth) < length:
            edges = np.round(np.linspace(0, length, 2 ** (depth + 1) + 1)).astype(np.int64)
            start, middle, stop = edges[0:-2:2], edges[1:-1:2], edges[2::2]
            whole = (middle > start) & (stop > middle)
            start, middle, stop = start[whole], middle[whole], stop[whole]
            half = 0.5 * (stop - start) * samples_per_row
            levels.append((start, middle, stop, np.round(np.log2(half)).astype(np.int64)))
            depth += 1
        for start, middle, stop, octave in reversed(levels):
            parts.append((start + offset, middle + offset, stop + offset, octave, index))
        mean = np.array([offset], dtype=np.int64)
        parts.append((mean, mean + length, mean + length, np.array([MEANS], dtype=np.int64), index))
        offset += length
    start = np.concatenate([p[0] for p in parts])
    middle = np.concatenate([p[1] for p in parts])
    stop = np.concatenate([p[2] for p in parts])
    octave = np.concatenate([p[3] for p in parts])
    piece = np.concatenate([np.full(p[0].size, p[4], dtype=np.int64) for p in parts])
    one, two = (middle - start).astype(np.float64), (stop - middle).astype(np.float64)
    is_mean = octave == MEANS
    safe = np.where(is_mean, 1.0, two)
    factor = np.sqrt(one * safe / (one + safe))
    left = np.where(is_mean, 1.0 / np.sqrt(one), factor / one)
    right = np.where(is_mean, 0.0, factor / safe)
    # Within a piece the octaves of different depths may share a number; sort to make slices.
    rank = np.where(is_mean, np.int64(1 << 30), octave)
    order = np.lexsort((rank, piece))
    found = Octaves(
        start[order],
        middle[order],
        stop[order],
        left[order],
        right[order],
        octave[order],
        piece[order],
    )
    for array in (found.start, found.middle, found.stop, found.octave, found.piece):
        array.flags.writeable = False  # several may have it
    found.left.flags.writeable = found.right.flags.writeable = False
    return found


_cut_once = lru_cache(maxsize=8)(_cut)


# From long signals to few coefficients: block means cut into octaves, and a sample of the rest.


@dataclass(frozen=True)
class Column:
    """The coefficients of one signal over all runs."""

    octaves: Array
    """[M] of the block means, sorted by piece and octave."""
    fast: Array | None = None
    """[F] deviations within blocks, by piece; None for a slow signal, where they are nothing."""

    def __sub__(self, other: "Column") -> "Column":
        if self.fast is None and other.fast is None:
            return Column(self.octaves - other.octaves)
        mine = 0.0 if self.fast is None else self.fast
        theirs = 0.0 if other.fast is None else other.fast
        return Column(self.octaves - other.octaves, np.asarray(mine - theirs))

    def scale(self, factor: float) -> "Column":
        """Return the column times a factor."""
        fast = None if self.fast is None else factor * self.fast
        return Column(factor * self.octaves, fast)


def combine(columns: Sequence[Column], factors: Sequence[float]) -> Column:
    """Return the sum of the columns, each times its factor."""
    total = columns[0].scale(factors[0])
    for column, factor in zip(columns[1:], factors[1:], strict=True):
        total = total - column.scale(-factor)
    return total


@dataclass(frozen=True)
class Reduction:
    """How the stretches of all runs become blocks, pieces and octaves.

    Blocks are averages over `block` samples. The stretches of a run are laid end to end and cut
    into one or more pieces; each piece is taken apart into octaves. Deviations within blocks are
    kept for every `stride`-th block.
    """

    block: int
    stride: int
    rows: tuple[int, ...]
    """Blocks of each stretch; samples behind the last whole block are not used."""
    sequence: tuple[int, ...]
    """The stretches in the order in which they are laid end to end, run by run."""
    octaves: Octaves
    levels: IntArray
    """[L] octaves present: MEANS, log2 of the half-length in samples; WITHIN_BLOCKS at the end."""
    slices: tuple[tuple[int, int, slice], ...]
    """(piece, level, coefficients) of a column's octaves."""
    fast_slices: tuple[slice, ...]
    """Per piece, its deviations within blocks; none where blocks are single samples."""
    counts: Array
    """[G, L] free coefficients of each piece and level."""

    def average(self, x: Array) -> Array:
        """Return the block means of one stretch's signal [n]."""
        if self.block == 1:
            return x
        rows = x.size // self.block
        return np.asarray(x[: rows * self.block].reshape(rows, self.block).mean(axis=1))

    def reduce(self, signals: Sequence[Array]) -> Column:
        """Return the coefficients of a signal at the full rate, given per stretch."""
        return self.assemble([self.take_apart(x) for x in signals])

    def take_apart(self, x: Array) -> tuple[Array, Array | None]:
        """Return one stretch's block means, and the deviations from them that are kept."""
        means = self.average(x)
        if self.block == 1:
            return means, None
        kept = slice(None, None, self.stride)
        blocks = x[: means.size * self.block].reshape(-1, self.block)[kept]
        return means, (blocks - means[kept, None]).reshape(-1)

    def draw_lines(self, means: Array) -> tuple[Array, Array | None]:
        """Return block means, and the deviations of straight lines through them."""
        if self.block == 1:
            return means, None
        rise = _rise(means, self.stride)
        return means, (rise[:, None] * self._places).reshape(-1)

    def assemble(self, parts: Sequence[tuple[Array, Array | None]]) -> Column:
        """Return the coefficients of a signal taken apart, given per stretch."""
        octaves = self.reduce_means([means for means, _ in parts])
        fast = [parts[i][1] for i in self.sequence]
        moving = [part for part in fast if part is not None]
        return Column(octaves.octaves, np.concatenate(moving) if moving else None)

    @cached_property
    def _alike(self) -> tuple[tuple[slice, int, slice, int], ...]:
        """(pieces, level, coefficients of the first, step to the next) of neighbours cut alike."""
        found: list[tuple[slice, int, slice, int]] = []
        for piece, level, rows in sorted(self.slices, key=lambda each: (each[1], each[0])):
            if found and found[-1][1] == level and found[-1][0].stop == piece:
                pieces, _, first, step = found[-1]
                count = piece - pieces.start
                step = step or rows.start - first.start
                length = first.stop - first.start
                if (rows.start, rows.stop - rows.start) == (first.start + count * step, length):
                    found[-1] = (slice(pieces.start, piece + 1), level, first, step)
                    continue
            found.append((slice(piece, piece + 1), level, rows, 0))
        return tuple(found)

    @cached_property
    def _places(self) -> Array:
        """Where in a block its samples lie, in blocks from its middle."""
        return (np.arange(self.block) + 0.5) / self.block - 0.5

    def measure_curvature(self, x: Array) -> tuple[float, float]:
        """Return a stretch's squares that straight lines within blocks leave, and all of them."""
        means = self.average(x)
        blocks = x[: means.size * self.block].reshape(-1, self.block)
        lines = means[:, None] + _rise(means, 1)[:, None] * self._places
        left = float(((blocks - lines) ** 2).sum())
        return left, float(((blocks - means.mean()) ** 2).sum())

    def reduce_means(self, means: Sequence[Array], *, centre: bool = True) -> Column:
        """Return the coefficients of block means, given per stretch, and none within blocks."""
        laid = np.concatenate([means[i] for i in self.sequence])
        if self.block > 1:
            laid *= np.sqrt(self.block)
        # The offsets take any constant; without it the running sums keep their precision.
        return Column(self.octaves.transform(laid - laid.mean() if centre else laid))

    def sum_products(self, octaves: Array, fast: Sequence[Array | None]) -> Array:
        """Return the sums of products [G, L, C, C] of columns, per piece and level.

        Args:
            octaves: [C, M] of the columns.
            fast: of each the deviations within blocks, if it has any.
        """
        products = np.zeros((*self.counts.shape, len(octaves), len(octaves)))
        for pieces, level, rows, step in self._alike:
            # One call for all pieces that are cut alike, each the product that it would be alone.
            across, along = octaves.strides
            part = np.ndarray(
                (pieces.stop - pieces.start, len(octaves), rows.stop - rows.start),
                buffer=octaves,
                offset=rows.start * along,
                strides=(step * along, across, along),
            )
            np.matmul(part, part.swapaxes(1, 2), out=products[pieces, level])
        moving = [(c, each) for c, each in enumerate(fast) if each is not None]
        if moving:
            places = np.array([c for c, _ in moving])
            stacked = np.stack([each for _, each in moving])
            for piece, rows in enumerate(self.fast_slices):
                part = stacked[:, rows]
                products[piece, -1, places[:, None], places] = self.stride * (part @ part.T)
        return products


def _rise(means: Array, stride: int) -> Array:
    """Return by how much a signal rises across every stride-th block, from its neighbours."""
    at = np.arange(0, means.size, stride)
    after, before = np.minimum(at + 1, means.size - 1), np.maximum(at - 1, 0)
    return np.asarray((means[after] - means[before]) / np.maximum(after - before, 1))


def plan_reduction(
    lengths: Sequence[int], groups: Sequence[str], block: int, stride: int, pieces_per_run: int
) -> Reduction:
    """Return the reduction of stretches of these lengths.

    Args:
        lengths: samples of each stretch.
        groups: the run that each stretch belongs to.
        block: samples in a block.
        stride: deviations within blocks are kept for every `stride`-th block.
        pieces_per_run: pieces that each run is cut into.
    """
    return _plan(tuple(lengths), tuple(groups), block, stride, pieces_per_run)


@lru_cache(maxsize=8)
def _plan(
    lengths: tuple[int, ...], groups: tuple[str, ...], block: int, stride: int, pieces_per_run: int
) -> Reduction:
    """Return the reduction, kept for the next runs that are as long."""
    rows = tuple(length // block for length in lengths)
    names = list(dict.fromkeys(groups))
    sequence = tuple(i for name in names for i, group in enumerate(groups) if group == name)
    sizes: list[int] = []
    for name in names:
        total = sum(rows[i] for i, group in enumerate(groups) if group == name)
        edges = np.round(np.linspace(0, total, pieces_per_run + 1)).astype(int)
        sizes += np.diff(edges).tolist()
    octaves = cut_octaves(np.array(sizes), block)
    present = np.unique(octaves.octave)
    levels = np.append(present, WITHIN_BLOCKS) if block > 1 else present
    counts = np.zeros((len(sizes), levels.size))
    slices = []
    for piece in range(len(sizes)):
        for j, level in enumerate(present):
            at = np.flatnonzero((octaves.piece == piece) & (octaves.octave == level))
            if at.size:
                slices.append((piece, j, slice(int(at[0]), int(at[-1]) + 1)))
                counts[piece, j] = at.size
    fast_slices: list[slice] = []
    if block > 1:
        owner = np.repeat(np.arange(len(sizes)), sizes)
        ends = np.cumsum([rows[i] for i in sequence])
        kept = np.concatenate(
            [
                owner[end - rows[i] : end][::stride]
                for i, end in zip(sequence, ends.tolist(), strict=True)
            ]
        )
        for piece in range(len(sizes)):
            first, last = np.searchsorted(kept, [piece, piece + 1])
            fast_slices.append(slice(int(first) * block, int(last) * block))
            # Of a block's deviations from its mean all but one are free.
            counts[piece, -1] = (last - first) * (block - 1) * stride
    counts.flags.writeable = False  # several campaigns may have it
    return Reduction(
        block,
        stride,
        rows,
        sequence,
        octaves,
        levels,
        tuple(slices),
        tuple(fast_slices),
        counts,
    )


def select_means(levels: IntArray) -> Mask:
    """Return which levels are the pieces' means."""
    return np.asarray(levels == MEANS)
