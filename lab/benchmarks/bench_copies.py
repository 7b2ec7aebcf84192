"""Copies of runs found, and runs that are no copies let through, with the bounds of both rates.

Copies: a run among others of its kind, and a second one made of it in one of five ways, for so many
seeds. Clean sets: runs of one sensor that share much and no noise: one chamber programme repeated,
converters so coarse that little but steps is left, channels that do not move, logs zeroed one by
one, simulations without noise, and logs by `zerodrift twin`. An alarm is any stretch of rows told
as shared; a copy is found if the rows that it was made of are told, all of them within a tenth.
"""

import time
from collections.abc import Callable

import numpy as np
from scipy.stats import beta

from zerodrift.base.arrays import Array
from zerodrift.dataset.shared_rows import LEAST_ROWS, SharedRows, confirm, find_alignments, mark_run
from zerodrift_lab.twin import Recipe, simulate

SEEDS = 20
CLEAN_SETS = 300
TWIN_SETS = 60
ROWS = 1500
TIMED_ROWS = 10_000_000
Log = list[Array]
"""Measured columns of one run, two outputs and the thermometer, as they are written."""
CLEAN_KINDS = ("programme", "coarse", "still", "tared", "noiseless")


def main(quick: bool) -> None:
    """Print what was found of each kind, what alarmed, and what marking and sorting take."""
    seeds, sets = (4, 30) if quick else (SEEDS, CLEAN_SETS)
    print(f"{'copy':<22}{'found':>10}   (a run among 4 of {ROWS} rows, simulated)")
    found = tried = 0
    for kind, make in COPIES.items():
        hits = sum(try_copy(seed, make) for seed in range(seeds))
        print(f"{kind:<22}{f'{hits} of {seeds}':>10}")
        found, tried = found + hits, tried + seeds
    print(
        f"{'all':<22}{f'{found} of {tried}':>10}: missed, with 95 % confidence, fewer than "
        f"{100 * bound(tried - found, tried):.2g} %"
    )
    kinds = (*CLEAN_KINDS, "twin")
    twins = sets * TWIN_SETS // CLEAN_SETS
    alarms = 0
    for number, kind in enumerate(kinds):
        of_kind = twins if kind == "twin" else (sets - twins) // len(CLEAN_KINDS)
        told = sum(bool(find(make_clean(kind, 1000 * number + k))) for k in range(of_kind))
        print(f"clean: {kind:<15}{f'{told} of {of_kind}':>10} alarms")
        alarms += told
    print(
        f"{'clean sets':<22}{f'{alarms} of {sets}':>10}: false alarms, with 95 % confidence, in "
        f"fewer than {100 * bound(alarms, sets):.2g} %"
    )
    print_cost(TIMED_ROWS // 20 if quick else TIMED_ROWS)


def bound(events: int, trials: int) -> float:
    """Return the one-sided 95 % Clopper-Pearson upper bound of a rate."""
    return 1.0 if events == trials else float(beta.ppf(0.95, events + 1, trials - events))


def find(logs: list[Log]) -> dict[tuple[int, int], list[SharedRows]]:
    """Return what the logs of one project are told to share."""
    alignments = find_alignments([mark_run(log) for log in logs], range(len(logs)))
    return confirm(alignments, lambda number: logs[number])


def make_log(programme: int, noise: int, rows: int = ROWS) -> Log:
    """Return a log of a chamber programme, of which a sensor has noise of its own."""
    drawn, rng = np.random.default_rng([1, programme]), np.random.default_rng([2, noise])
    at = np.arange(rows)
    temperature = 25 + 15 * np.sin(at / drawn.uniform(80, 400)) + drawn.uniform(-5, 5)
    load = np.repeat(drawn.normal(0, 20, rows // 50 + 1), 50)[:rows]
    fine = drawn.uniform(0.5, 2)
    force = load + 0.4 * temperature + np.cumsum(rng.normal(0, 0.01, rows))
    return [
        (force + rng.normal(0, 0.2 * fine, rows)).round(4),
        (0.01 * temperature**2 + rng.normal(0, 0.05 * fine, rows)).round(5),
        ((temperature + rng.normal(0, 0.015, rows)) * 128).round() / 128,
    ]


def try_copy(seed: int, make: Callable[[Log, np.random.Generator], tuple[Log, int]]) -> bool:
    """Return whether one copy, of all rows that it has, is told, and nothing else is."""
    rng = np.random.default_rng([3, seed])
    logs = [make_log(10 * seed + k, 10 * seed + k) for k in range(4)]
    copied, rows = make(logs[2], rng)
    told = find([*logs, copied])
    shared = sum(stretch.rows for stretch in told.get((2, 4), []))
    return set(told) == {(2, 4)} and 0.9 * rows <= shared <= rows


def copy_whole(log: Log, rng: np.random.Generator) -> tuple[Log, int]:
    """Return the same rows, as a copy or a hard link of the file holds them."""
    return [column.copy() for column in log], log[0].size


def copy_shifted(log: Log, rng: np.random.Generator) -> tuple[Log, int]:
    """Return the rows from some row on: another clock, and another first row."""
    start = int(rng.integers(1, 200))
    return [column[start:] for column in log], log[0].size - start


def copy_excerpt(log: Log, rng: np.random.Generator) -> tuple[Log, int]:
    """Return the fewest rows that are told, amid rows of another run."""
    start, place = (int(k) for k in rng.integers(0, log[0].size - LEAST_ROWS, 2))
    other = make_log(int(rng.integers(10**6, 10**7)), int(rng.integers(10**6, 10**7)))
    for column, into in zip(log, other, strict=True):
        into[place : place + LEAST_ROWS] = column[start : start + LEAST_ROWS]
    return other, LEAST_ROWS


def copy_rounded(log: Log, rng: np.random.Generator) -> tuple[Log, int]:
    """Return all rows with fewer digits, down to steps of the size of the noise."""
    digits = int(rng.integers(1, 4))
    return [column.round(min(digits + k, 3)) for k, column in enumerate(log)], log[0].size


def copy_rounded_excerpt(log: Log, rng: np.random.Generator) -> tuple[Log, int]:
    """Return 120 rows in single precision or with four digits in all."""
    start = int(rng.integers(0, log[0].size - 120))
    rows = [column[start : start + 120] for column in log]
    if rng.integers(2):
        return [column.astype(np.float32).astype(float) for column in rows], 120
    return [np.array([float(f"{value:.4g}") for value in column]) for column in rows], 120


COPIES = {
    "copy or hard link": copy_whole,
    "time shifted": copy_shifted,
    f"excerpt of {LEAST_ROWS} rows": copy_excerpt,
    "rounded digits": copy_rounded,
    "rounded excerpt": copy_rounded_excerpt,
}


def make_clean(kind: str, seed: int) -> list[Log]:
    """Return four logs of one project, none of them a copy."""
    rng = np.random.default_rng([4, seed])
    if kind == "twin":
        recipe = Recipe(seed=seed, train=("chamber",) * 3, test=("chamber",), duration_s=900.0)
        runs = simulate(recipe).runs
        return [[*np.asarray(run.measured).T, run.temperature_degC] for run in runs]
    logs = [make_log(seed, 10 * seed + k) for k in range(4)]
    steps = [
        10.0 ** rng.uniform(-2, 1.5),
        10.0 ** rng.uniform(-2.5, 0.5),
        2.0 ** rng.integers(-7, 2),
    ]
    for log in logs:
        if kind == "coarse":
            log[:] = [np.rint(c / step) * step for c, step in zip(log, steps, strict=True)]
        elif kind == "still":
            start = int(rng.integers(0, ROWS // 2))
            for column in log[int(rng.integers(3)) :]:
                column[start : start + int(rng.integers(100, ROWS // 2))] = column[start]
        elif kind == "tared":
            log[:] = [(c - c[:10].mean()).round(4) for c in log[:2]] + log[2:]
    if kind == "noiseless":
        quiet = [np.asarray(c) for c in make_log(seed, seed)]
        at = np.arange(ROWS)
        smooth = 25 + 15 * np.sin(at / 170) * np.exp(-at / 900)
        digits = int(rng.integers(1, 16))
        logs = [
            [(3 * smooth).round(digits), (0.01 * smooth**2).round(digits), smooth.round(digits)]
            for _ in range(3)
        ] + [quiet]
    return logs


def print_cost(rows: int) -> None:
    """Print the seconds that two runs of half of the rows each, of three columns, take."""
    rng = np.random.default_rng(0)
    logs = [make_log(k, k, 1000) for k in range(2)]
    repeats = rows // 2 // 1000
    logs = [[np.tile(c, repeats) + rng.normal(0, 0.1, 1000 * repeats) for c in log] for log in logs]
    start = time.perf_counter()
    marks = [mark_run(log) for log in logs]
    marked = time.perf_counter()
    alignments = find_alignments(marks, range(2))
    told = confirm(alignments, lambda number: logs[number])
    done = time.perf_counter()
    size = sum(m.codes.nbytes + m.at.nbytes + m.bits.nbytes for m in marks)
    print(
        f"{rows} rows of 3 columns: {marked - start:.1f} s to mark, {done - marked:.1f} s to sort "
        f"and compare, {size / rows:.0f} bytes of marks per row; told: {len(told)}"
    )


if __name__ == "__main__":
    import sys

    main("--quick" in sys.argv[1:])
