"""Runs known by their content: stretches of rows that two runs share, by the noise on them.

Two recordings of one programme never have the same noise, so rows whose noise agrees are the same
rows, whatever the file is called, whatever its clock says, and with however many digits it was
written. Values that can agree without being a copy are no evidence: a constant, a smooth simulated
curve, the steps of a coarse converter. So each column counts by what an independent recording of
the same signal would leave to chance, and only a match that chance does not explain is reported.

Runs are marked as they are read: their rows, rounded to steps near the noise, in windows whose
increments are hashed; of these the locally least are kept. Sorting the marks of all runs finds the
alignments that two runs may share, and only these are looked at again row by row.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array, find_median
from zerodrift.dataset.read_runs import ReadRun, ReadRuns
from zerodrift.dataset.resolution import (
    DIGITS,
    list_blocks,
    measure_step,
)

Codes = NDArray[np.uint64]
Rows = NDArray[np.int64]

LEAST_ROWS = 30
"""Fewer rows that agree are told by nobody."""
CHANCE_BITS = 40.0
"""A match is told when chance explains it with a probability below 2 to the minus this, over all
alignments that two runs have."""
WINDOW = 12
"""Increments that one mark is made of."""
NEIGHBOURS = 12
"""Of so many windows one after the other, one at least becomes a mark."""
MARKED_COLUMNS = 3
"""Columns with noise that are marked, the first ones: a copy agrees in all of them."""
BLOCK = 1 << 17
"""Rows that are marked at once."""
LEAST_NOISE_STEPS = 0.45
"""Noise of fewer steps than this (RMS) is not told from rounding, whose own is 0.29 steps."""
FITTED_ROWS = 20
"""Rows that a parabola is laid through."""
MOST_ALIKE = 32
"""Marks that occur more often than this are patterns, not noise."""
MOST_ALIGNMENTS = 16
"""Alignments of two runs that are looked at row by row, the likeliest ones."""
BESIDE = (5, 7, 11, 13)
"""Rows by which runs are laid beside their place to see how often noise agrees by chance."""
MOST_BITS = 16.0
"""Most that one value is taken to leave to chance."""
_SAMPLED = 4096
_POSITION_BITS = np.uint64(18)


@dataclass(frozen=True)
class Marks:
    """The marks by which the rows of a run are recognised."""

    rows: int
    """How many rows the run has."""
    codes: Codes
    """[m] hashes of windows."""
    at: NDArray[np.uint32]
    """[m] each window's first row."""
    bits: NDArray[np.float32]
    """[m] bits that each row of the window leaves to chance."""


@dataclass(frozen=True)
class Alignment:
    """Two runs of which one may hold rows of the other."""

    one: int
    other: int
    offset: int
    """Row of `other` minus that of `one`."""
    row: int
    """A row of `one` at which they seemed to agree."""
    score: float


@dataclass(frozen=True)
class SharedRows:
    """A stretch of rows that two runs share."""

    one: int
    other: int
    row: int
    """First shared row, within the run `one`."""
    other_row: int
    """The same row within the run `other`."""
    rows: int


def mark_run(columns: Sequence[Array]) -> Marks:
    """Return the marks of a run.

    Args:
        columns: its measured columns, each [n], as logged; those without noise are passed over.
    """
    codes: list[Codes] = []
    at: list[Rows] = []
    bits: list[NDArray[np.float32]] = []
    marked = 0
    for number, values in enumerate(columns):
        levels = _choose_levels(values)
        marked += bool(levels)
        for level, noise in levels.items():
            step = 10.0**level
            found, rows = _mark_column(values, step, 64 * number + level % 64)
            codes.append(found)
            at.append(rows)
            bits.append(np.full(rows.size, count_bits(noise, step), dtype=np.float32))
        if marked == MARKED_COLUMNS:
            break
    size = int(columns[0].size) if columns else 0
    if not codes:
        return Marks(size, np.zeros(0, np.uint64), np.zeros(0, np.uint32), np.zeros(0, np.float32))
    return Marks(
        size, np.concatenate(codes), np.concatenate(at).astype(np.uint32), np.concatenate(bits)
    )


def measure_white_noise(values: Array) -> float:
    """Return the RMS of the noise on a signal, which a smooth curve or rare steps have none of.

    White noise is as large in fourth as in sixth differences, which take smooth curves away;
    medians pass over steps. A ramp that crosses a step of its converter every other row looks like
    noise to differences, so no more is told than what a parabola leaves of a few rows.
    """
    if values.size < WINDOW:
        return 0.0
    differences = np.diff(values, 4)
    fourth = find_median(np.abs(differences)) / (0.6745 * 70**0.5)
    sixth = find_median(np.abs(np.diff(differences, 2))) / (0.6745 * 924**0.5)
    if sixth <= 0.5 * fourth:
        return 0.0
    least: float = min(fourth, sixth, _measure_scatter(values))
    return least


def _measure_scatter(values: Array) -> float:
    """Return the RMS of what parabolas through a few rows at a time leave, the median of them."""
    rows = min(FITTED_ROWS, values.size)
    pieces = values[: values.size // rows * rows].reshape(-1, rows)
    basis = _span_parabolas(rows)
    left: Array = pieces - pieces @ basis @ basis.T
    return find_median(np.sqrt(np.sum(left**2, axis=1) / (rows - 3)))


@lru_cache(maxsize=FITTED_ROWS)
def _span_parabolas(rows: int) -> Array:
    """Return an orthonormal basis [rows, 3] of the parabolas over so many rows."""
    basis = np.linalg.qr(np.vander(np.linspace(-1, 1, rows), 3))[0]
    basis.flags.writeable = False  # others get the same
    return basis


def count_bits(noise: float, step: float) -> float:
    """Return how many bits one value leaves to chance: noise (RMS) that is rounded to a step."""
    if noise <= 0 or noise < LEAST_NOISE_STEPS * step:
        return 0.0
    if noise > 2.0**MOST_BITS * step:
        return MOST_BITS
    own = noise**2 - step**2 / 12
    return min(MOST_BITS, 0.5 * float(np.log2(1 + 4 * np.pi * own / step**2)))


def find_alignments(marks: Sequence[Marks], groups: Sequence[object]) -> list[Alignment]:
    """Return how runs may lie on each other, the likeliest first.

    Args:
        marks: of each run.
        groups: runs of the same group are not held against each other.
    """
    numbers = {group: number for number, group in enumerate(dict.fromkeys(groups))}
    group_of = np.array([numbers[group] for group in groups])
    run = np.repeat(np.arange(len(marks), dtype=np.uint32), [mark.codes.size for mark in marks])
    if len(numbers) < 2 or run.size == 0:
        return []
    codes = np.concatenate([mark.codes for mark in marks])
    order = np.argsort(codes)
    codes, run = codes[order], run[order]
    at = np.concatenate([mark.at for mark in marks])[order]
    bits = np.concatenate([mark.bits for mark in marks])[order]
    starts = np.flatnonzero(np.append(True, codes[1:] != codes[:-1]))
    sizes = np.diff(np.append(starts, codes.size))
    usable = np.repeat((sizes > 1) & (sizes <= MOST_ALIKE), sizes)
    codes, run, at, bits = codes[usable], run[usable], at[usable], bits[usable]
    found: list[tuple[Rows, ...]] = []
    for lag in range(1, MOST_ALIKE):
        same = np.flatnonzero(codes[lag:] == codes[:-lag])
        if same.size == 0:
            break
        same = same[group_of[run[same]] != group_of[run[same + lag]]]
        swap = run[same] > run[same + lag]
        one, other = np.where(swap, same + lag, same), np.where(swap, same, same + lag)
        found.append((one, other))
    ones = np.concatenate([one for one, _ in found]) if found else np.zeros(0, np.int64)
    others = np.concatenate([other for _, other in found]) if found else np.zeros(0, np.int64)
    if ones.size == 0:
        return []
    offset = at[others].astype(np.int64) - at[ones]
    order = np.lexsort((at[ones], offset, run[others], run[ones]))
    ones, others, offset = ones[order], others[order], offset[order]
    key = np.stack([run[ones].astype(np.int64), run[others].astype(np.int64), offset])
    starts = np.flatnonzero(np.append(True, np.any(key[:, 1:] != key[:, :-1], axis=0)))
    least = np.minimum(bits[ones], bits[others])
    # Windows overlap: each further one counts by the rows that it does not share on average.
    score = 4 * np.add.reduceat(least, starts) + 8 * np.maximum.reduceat(least, starts)
    length = np.array([float(max(mark.rows, 1)) for mark in marks])
    needed = np.log2(length[key[0, starts]] * length[key[1, starts]])
    likely = np.flatnonzero(score > needed)
    likely = likely[np.argsort(-score[likely], kind="stable")]
    found_at = []
    for i in likely:
        one, other, apart = (int(k) for k in key[:, starts[i]])
        found_at.append(Alignment(one, other, apart, int(at[ones[starts[i]]]), float(score[i])))
    return found_at


def confirm(
    alignments: Sequence[Alignment], read: Callable[[int], Sequence[Array]]
) -> dict[tuple[int, int], list[SharedRows]]:
    """Look at alignments row by row and return the stretches that no chance explains.

    Args:
        alignments: of any runs, the likeliest first.
        read: a run's number -> its columns again, all of them, the same in every run.

    Returns:
        The two runs -> the stretches that they share, the longest first.
    """
    shared: dict[tuple[int, int], list[SharedRows]] = {}
    by_pair: dict[tuple[int, int], list[Alignment]] = {}
    for alignment in alignments:
        by_pair.setdefault((alignment.one, alignment.other), []).append(alignment)
    runs = ReadRuns(read)
    for (one, other), alike in sorted(by_pair.items()):
        ours, theirs = runs.take(one), runs.take(other)
        found: list[SharedRows] = []
        for alignment in alike[:MOST_ALIGNMENTS]:
            found += _compare(alignment, ours, theirs)
        if found:
            shared[one, other] = sorted(found, key=lambda each: (-each.rows, each.row))
    return shared


def _choose_levels(values: Array) -> dict[int, float]:
    """Return decimal exponents of the steps at which a column is marked, with its noise there."""
    levels: dict[int, float] = {}
    blocks = range(0, values.size, max(_SAMPLED, values.size // 16))
    for start in blocks:
        block = values[start : start + _SAMPLED]
        noise = measure_white_noise(block)
        if noise <= DIGITS * float(np.abs(block).max()):
            continue
        if count_bits(noise, measure_step(block[:256])) == 0:
            continue
        coarse = int(np.floor(np.log10(noise / LEAST_NOISE_STEPS)))
        for level in (coarse, coarse - 1):
            levels[level] = max(noise, levels.get(level, 0.0))
    return levels


def _mark_column(values: Array, step: float, salt: int) -> tuple[Codes, Rows]:
    """Return the hashes of the windows that are kept and their first rows."""
    codes: list[Codes] = []
    rows: list[Rows] = []
    overlap = WINDOW + NEIGHBOURS
    for start in range(0, max(values.size - WINDOW, 0), BLOCK):
        block = values[start : start + BLOCK + overlap]
        with np.errstate(over="ignore", invalid="ignore"):
            hashes, usable = _hash_windows(np.rint(block / step).astype(np.int64), salt)
        if hashes.size < NEIGHBOURS:
            kept = np.flatnonzero(usable)
        else:
            # The lowest bits are the place, so that the least of neighbours tells where it is.
            places = np.arange(hashes.size, dtype=np.uint64)
            least = (hashes >> _POSITION_BITS << _POSITION_BITS) | places
            for width in (1, 2, 4):
                least = np.minimum(least[:-width], least[width:])
            least = np.minimum(least[:-4], least[4:])
            changed = np.append(True, least[1:] != least[:-1])
            mask = (np.uint64(1) << _POSITION_BITS) - np.uint64(1)
            kept = np.unique(least[changed] & mask).astype(np.int64)
            kept = kept[usable[kept]]
        codes.append(hashes[kept])
        rows.append(kept + start)
    if not codes:
        return np.zeros(0, np.uint64), np.zeros(0, np.int64)
    return np.concatenate(codes), np.concatenate(rows)


def _hash_windows(steps: Rows, salt: int) -> tuple[Codes, NDArray[np.bool_]]:
    """Return a hash of each window's increments, and whether enough of them move."""
    increments = np.diff(steps).astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    increments ^= increments >> np.uint64(29)
    pairs = increments[:-1] * np.uint64(0xBF58476D1CE4E5B9) + increments[1:]
    fours = pairs[:-2] * np.uint64(0x94D049BB133111EB) + pairs[2:]
    eights = fours[:-4] * np.uint64(0xD6E8FEB86659FD93) + fours[4:]
    hashes = eights[:-4] * np.uint64(0xA0761D6478BD642F) + fours[8:]
    hashes ^= np.uint64(salt) * np.uint64(0xE7037ED1A0B428DB)
    hashes ^= hashes >> np.uint64(32)
    hashes *= np.uint64(0xD6E8FEB86659FD93)
    hashes ^= hashes >> np.uint64(32)
    moves = np.cumsum(np.append(0, increments != 0))
    return hashes, moves[WINDOW:] - moves[:-WINDOW] >= WINDOW // 3


def _compare(alignment: Alignment, our_run: ReadRun, their_run: ReadRun) -> list[SharedRows]:
    """Return the stretches that agree in every column and that chance does not explain."""
    ours, theirs = our_run.columns, their_run.columns
    size, other_size = ours[0].size, theirs[0].size
    first = max(0, -alignment.offset)
    last = min(size, other_size - alignment.offset)
    if last - first < LEAST_ROWS:
        return []
    here, there = slice(first, last), slice(first + alignment.offset, last + alignment.offset)
    near = slice(alignment.row - first, alignment.row - first + WINDOW + 1)
    agree = np.ones(last - first, dtype=np.bool_)
    steps: list[float] = []
    limits: list[Array] = []
    for number, (one, other) in enumerate(zip(ours, theirs, strict=True)):
        apart = one[here] - other[there]
        blur = DIGITS * float(np.abs(one[here]).max())
        ends = [our_run.find_steps(number, here), their_run.find_steps(number, there)]
        steps.append(max(2 * blur, *(float(np.median(end)) for end in ends)))
        # The one was rounded from the other, so they differ by half of the coarser step at most.
        limit = 0.5001 * np.maximum(ends[0], ends[1]) + blur
        tare = float(np.median(apart[near]))
        if abs(tare) > float(np.broadcast_to(limit, apart.shape)[near].max()):
            # Zeroed anew before it was rounded: either end may be off by its own half step.
            apart -= tare
            limit = 2 * limit
        limits.append(np.broadcast_to(limit, apart.shape))
        agree &= np.abs(apart) <= limit
        stretches = _find_stretches(agree)
        if stretches.size == 0:  # most alignments by chance end with their first column
            return []
    shared = []
    for start, stop in stretches:
        rows = slice(first + int(start), first + int(stop))
        their_rows = slice(rows.start + alignment.offset, rows.stop + alignment.offset)
        bits = sum(
            min(
                count_bits(_find_noise(one[rows]), step),
                _count_chance(one[rows], other[their_rows], limit[start:stop]),
            )
            for one, other, step, limit in zip(ours, theirs, steps, limits, strict=True)
        )
        if bits * (stop - start) > CHANCE_BITS + np.log2(float(size) * other_size):
            shared.append(
                SharedRows(
                    alignment.one,
                    alignment.other,
                    rows.start,
                    their_rows.start,
                    int(stop - start),
                )
            )
    return shared


def _find_stretches(agree: NDArray[np.bool_]) -> Rows:
    """Return [m, 2] first row, and the one after the last, of stretches that are long enough."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], agree, [False]]))).reshape(-1, 2)
    return edges[edges[:, 1] - edges[:, 0] >= LEAST_ROWS]


def _count_chance(one: Array, other: Array, limit: Array) -> float:
    """Return how many bits a row's agreement is worth, by how many rows agree that do not belong.

    Laid some rows beside its place and levelled, the noise of the one has nothing to do with that
    of the other: a converter of two codes agrees there in every row, and proves nothing.

    Args:
        one: [n] of a column.
        other: [n] of the same column of the other run.
        limit: [n] by how much they may differ.
    """
    agreed = tried = 0
    for shift in BESIDE:
        for near, far in ((one[shift:], other[:-shift]), (one[:-shift], other[shift:])):
            apart = near - far
            apart -= np.median(apart)
            agreed += int(np.count_nonzero(np.abs(apart) <= limit[shift:]))
            tried += apart.size
    return float(np.log2((tried + 2) / (agreed + 1)))


def _find_noise(values: Array) -> float:
    """Return the usual noise of a column's parts."""
    return float(np.median([measure_white_noise(block) for block in list_blocks(values, _SAMPLED)]))
