"""Names of runs, and rows that two of them share: refused between uses, counted once within one."""

import itertools
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array, IntArray, Mask, find_median
from zerodrift.base.config import Config
from zerodrift.base.errors import InputError
from zerodrift.dataset.checks import locate_row
from zerodrift.dataset.resolution import (
    DIGITS,
    find_steps,
    list_blocks,
    measure_step,
)
from zerodrift.dataset.selectors import Selection
from zerodrift.dataset.tables import LogTable

# Names of runs: the shortest that are unique; and no row both learnt from and tested on.


@dataclass(frozen=True)
class RunKey:
    """What a run is: a file, a value of its `run` column, a part in time."""

    path: Path
    run: str
    """Value of the `run` column; empty for a file without one."""
    cut: str
    """As written after the '@'; empty for the whole run."""
    span_s: tuple[float, float]
    """The part in seconds since the run's first row, the second end not included."""
    where: str
    """Place in zerodrift.toml, for messages."""
    start_s: float = 0.0
    """The log's clock at the run's first row in s, before any cut."""
    place: int = 0
    """Position of the run among those of its file, in the order of appearance."""
    files: tuple[Path, ...] = ()
    """All files of the log, where `path` is a folder or the first of several."""

    def name(self, detail: int, directory: Path) -> str:
        """Return a name: by run or stem (0), by stem and run (1), by path and run (2)."""
        # What follows a point in a folder's name is part of it.
        file = self.path.name if self.path.is_dir() else self.path.stem
        if detail == 2:
            inside = self.path.is_relative_to(directory)
            path = self.path.relative_to(directory) if inside else self.path
            file = str(path)
        base = self.run if self.run and detail == 0 else f"{file}:{self.run}" if self.run else file
        return f"{base}@{self.cut}" if self.cut else base


def name_runs(keys: Sequence[RunKey], directory: Path) -> dict[RunKey, str]:
    """Return a unique name for every run, with more detail only where names would collide."""
    distinct = {(key.path, key.run, key.cut): key for key in keys}
    names: dict[tuple[Path, str, str], str] = {}
    left = dict(distinct)
    for detail in (0, 1, 2):
        candidates = {identity: key.name(detail, directory) for identity, key in left.items()}
        counts = Counter(candidates.values())
        for identity, name in candidates.items():
            if (counts[name] == 1 and name not in names.values()) or detail == 2:
                names[identity] = name
                del left[identity]
    return {key: names[key.path, key.run, key.cut] for key in keys}


def refuse_overlaps(keys: Sequence[RunKey]) -> None:
    """Raise InputError when two selectors of train and test share rows.

    Args:
        keys: one per selector and run.

    A row that is both learnt from and tested on makes the held-out error too small; one that is
    selected twice counts double.
    """
    by_run: dict[tuple[Path, str], list[RunKey]] = {}
    for key in keys:
        by_run.setdefault((key.path.resolve(), key.run), []).append(key)
    for same in by_run.values():
        for one, other in itertools.combinations(same, 2):
            if max(one.span_s[0], other.span_s[0]) < min(one.span_s[1], other.span_s[1]):
                run = f", run '{one.run}'" if one.run else ""
                raise InputError(
                    f"{other.where}: selects rows of {other.path.name}{run} that {one.where} "
                    "selects already; expected every row once, as a row both learnt from and "
                    "tested on makes the held-out error too small. Narrow one glob, or cut the "
                    "run: '@0%:60%' and '@60%:100%'."
                )


# Runs that are looked at row by row, kept while each is held against several others.

MOST_KEPT = 1 << 23
"""Values of columns and their steps that are kept, beside those of the two runs at hand."""


@dataclass(frozen=True)
class ReadRun:
    """A run that is looked at row by row."""

    columns: Sequence[Array]
    """[n] of each column."""
    _steps: dict[int, Array] = field(default_factory=dict)
    """Column -> its steps, once they were asked for."""

    @property
    def values(self) -> int:
        """How many values are kept of it: of its columns, and as many of their steps."""
        return 2 * sum(column.size for column in self.columns)

    def find_steps(self, column: int, rows: slice) -> Array:
        """Return the steps, [rows] or [1], in which rows of a column are written.

        How a column is written is the whole run's, not that of the rows that are asked for.
        """
        if column not in self._steps:
            self._steps[column] = find_steps(self.columns[column])
        steps = self._steps[column]
        return steps[rows] if steps.size > 1 else steps


class ReadRuns:
    """Runs by their numbers, read again only where there was no room to keep them."""

    def __init__(self, read: Callable[[int], Sequence[Array]], most: int = MOST_KEPT) -> None:
        """Keep nothing yet.

        Args:
            read: a run's number -> its columns.
            most: values that are kept.
        """
        self._read, self._most = read, most
        self._kept: dict[int, ReadRun] = {}

    def take(self, number: int) -> ReadRun:
        """Return a run; where there is no room the one read last goes.

        Runs are asked for in turns, so the one read last is the last to be asked for again.
        """
        if number not in self._kept:
            run = ReadRun(self._read(number))
            while self._kept and self._count() + run.values > self._most:
                self._kept.popitem()
            self._kept[number] = run
        return self._kept[number]

    def _count(self) -> int:
        return sum(run.values for run in self._kept.values())


# Runs known by their content: stretches of rows that two runs share, by the noise on them.
#
# Two recordings of one programme never have the same noise, so rows whose noise agrees are the same
# rows, whatever the file is called, whatever its clock says, and with however many digits it was
# written. Values that can agree without being a copy are no evidence: a constant, a smooth
# simulated curve, the steps of a coarse converter. So each column counts by what an independent
# recording of the same signal would leave to chance, and only a match that chance does not explain
# is reported.
#
# Runs are marked as they are read: their rows, rounded to steps near the noise, in windows whose
# increments are hashed; of these the locally least are kept. Sorting the marks of all runs finds
# the alignments that two runs may share, and only these are looked at again row by row.

Codes = NDArray[np.uint64]

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
    at: list[IntArray] = []
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
    found: list[tuple[IntArray, ...]] = []
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


def _mark_column(values: Array, step: float, salt: int) -> tuple[Codes, IntArray]:
    """Return the hashes of the windows that are kept and their first rows."""
    codes: list[Codes] = []
    rows: list[IntArray] = []
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


def _hash_windows(steps: IntArray, salt: int) -> tuple[Codes, Mask]:
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


def _find_stretches(agree: Mask) -> IntArray:
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


# Runs that share rows: refused between two uses, counted once within one.

WHOLLY = 0.95
"""A run is a copy if so many of its rows are another one's."""
_USES = {"train": "learnt from", "test": "tested on", "dwell": "taken for the noise"}


@dataclass(frozen=True)
class KnownRun:
    """A run as it is logged, known by its content."""

    use: str
    """train | test | dwell."""
    key: RunKey
    selection: Selection
    columns: tuple[str, ...]
    """What is measured: the outputs, then the thermometer."""
    rows: slice
    """Its rows in the log's table."""
    marks: Marks

    @staticmethod
    def mark(
        use: str, key: RunKey, selection: Selection, table: LogTable, rows: slice, config: Config
    ) -> "KnownRun":
        """Mark a run before its log is resampled."""
        columns = (*(each.measured for each in config.outputs), config.temperature_column)
        marks = mark_run([table.columns[column][rows] for column in columns])
        return KnownRun(use, key, selection, columns, rows, marks)

    def take(self, table: LogTable) -> tuple[Array, ...]:
        """Return the run's measured columns, each [n], of its log's table."""
        return tuple(table.columns[column][self.rows] for column in self.columns)

    def name_rows(self, table: LogTable, first: int, count: int) -> str:
        """Return `log.csv:2 to log.csv:61` for rows of the run."""
        start = self.rows.start + first
        ends = (start, start + count - 1)
        return " to ".join(locate_row(table.source, table.position(row)).text for row in ends)


@dataclass(frozen=True)
class Repeats:
    """The rows of a project's runs that occur twice within one use, and so are counted once."""

    left_out: Mapping[RunKey, str]
    """Run of which another holds all rows -> why."""
    ends_s: Mapping[RunKey, float]
    """Run whose last rows another run has too -> time of the first of them, in s by the log's own
    clock."""
    notes: tuple[str, ...]


def find_repeats(
    runs: Sequence[KnownRun], read: Callable[[Selection], LogTable], time_column: str
) -> Repeats:
    """Return the runs to leave out, and those to end early, as another of the same use continues.

    Of two runs that overlap, the one whose last rows are shared is cut short: cutting the other
    one's beginning would take away its power-on and its history.

    Args:
        runs: of a project, in the order in which they are fitted. Parts that selectors cut out of
            one run are not compared with each other.
        read: reads a log again, as it was read before.
        time_column: the column of times, which `read` has converted to seconds.

    Raises:
        InputError: runs of different use share rows, or the shared rows of one use end neither run.
    """
    groups = [(run.key.path.resolve(), run.key.run) for run in runs]
    alignments = find_alignments([run.marks for run in runs], groups)
    if not alignments:
        return Repeats({}, {}, ())
    kept: dict[Selection, LogTable] = {}

    def read_table(number: int) -> LogTable:
        selection = runs[number].selection
        if selection not in kept:
            while len(kept) > 1:
                del kept[next(iter(kept))]
            kept[selection] = read(selection)
        return kept[selection]

    shared = confirm(alignments, lambda number: runs[number].take(read_table(number)))
    left_out: dict[RunKey, str] = {}
    ends_s: dict[RunKey, float] = {}
    overlaps: dict[tuple[RunKey, RunKey], str] = {}
    for (one, other), found in shared.items():
        first, second = runs[one], runs[other]
        if first.use == second.use and {first.key, second.key} & left_out.keys():
            continue
        tables = read_table(one), read_table(other)
        same = f"{_name(first, second, found[0], tables)}"
        if first.use != second.use:
            raise InputError(_explain_leak(first, second, same))
        count = sum(stretch.rows for stretch in found)
        sizes = [run.rows.stop - run.rows.start for run in (first, second)]
        if count < WHOLLY * min(sizes):
            end_s, early, late = _find_end(first, second, found, tables, time_column, same)
            ends_s[early.key] = min(end_s, ends_s.get(early.key, end_s))
            overlaps[early.key, late.key] = (
                f"{_write(early)} and {_write(late)} overlap ({same}): counted once, "
                f"{_write(early)} ends there, as by '@:{end_s - early.key.start_s:.10g}'"
            )
            continue
        copy, other_name = (second, first) if sizes[1] <= sizes[0] else (first, second)
        left_out[copy.key] = (
            f"{_write(copy)} is a copy of rows of {_write(other_name)} ({same}): counted once, "
            f"{_write(copy)} is left out"
        )
    told = [note for keys, note in overlaps.items() if not left_out.keys() & set(keys)]
    return Repeats(left_out, ends_s, (*left_out.values(), *told))


def _find_end(
    first: KnownRun,
    second: KnownRun,
    found: Sequence[SharedRows],
    tables: tuple[LogTable, LogTable],
    time_column: str,
    same: str,
) -> tuple[float, KnownRun, KnownRun]:
    """Return the new end in s of the run whose last rows are shared, that run, and the other one.

    Raises:
        InputError: neither ends with what they share.
    """
    if len(found) == 1:
        (shared,) = found
        # Where both end with them, the later one in order is cut: of three alike one stays whole.
        for run, other, table, row in (
            (second, first, tables[1], shared.other_row),
            (first, second, tables[0], shared.row),
        ):
            if row + shared.rows == run.rows.stop - run.rows.start:
                time_s = table.columns[time_column]
                return float(time_s[run.rows.start + row]), run, other
    raise InputError(_explain_part(first, second, same))


def _write(run: KnownRun) -> str:
    name = run.key.path.name + (f" run '{run.key.run}'" if run.key.run else "")
    return f"{name}@{run.key.cut}" if run.key.cut else name


def _name(
    first: KnownRun, second: KnownRun, found: SharedRows, tables: tuple[LogTable, LogTable]
) -> str:
    there = second.name_rows(tables[1], found.other_row, found.rows)
    here = first.name_rows(tables[0], found.row, found.rows)
    return f"{there} are the rows of {here}, {found.rows} rows"


def _explain_leak(first: KnownRun, second: KnownRun, same: str) -> str:
    return (
        f"{second.key.where}: {_write(second)} and {_write(first)} hold the same measurements: "
        f"{same} with the same noise. They would be both {_USES[first.use]} and "
        f"{_USES[second.use]}; expected every row once, as the held-out error would be none. Take "
        "one of the two logs out of [logs], or select parts of one of them: '@0%:60%' and "
        "'@60%:100%'."
    )


def _explain_part(first: KnownRun, second: KnownRun, same: str) -> str:
    return (
        f"{second.key.where}: {_write(second)} and {_write(first)} overlap: {same} with the same "
        "noise, and neither ends with them; expected every row once, as one that is there twice "
        "counts double. Take one of the two out of [logs], or select what only it holds, by "
        "'@FROM:TO' in seconds since its first row."
    )
