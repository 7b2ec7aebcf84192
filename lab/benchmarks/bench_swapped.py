"""Names that `monitor` gives to swapped units, simulated: right, false, none.

    python -m benchmarks.bench_swapped [--seed N] [--cases N] [--noise KIND] [--units N ...]
                                       [--days N] [--mounted KIND ...] [--trained]

A case is a unit of `bench_monitor` that is swapped for another on some day of its month; means over
blocks until the alarm's cause is told, and `--days` more. N other units are known, each by a model
that is as uncertain as its calibration leaves it, by temperature and its square; with `--trained`,
as a trained model, also by waves over temperature and by a part that lags. The mounted unit is one
of them, or one that nobody knows, drawn from the same spread (*stranger*), or a stranger of which
no known unit can be told apart in two of the four terms (*cousin*). *False*: a name that is not
the mounted unit's.
Also cases whose alarm told another cause are left out, and counted. Bounds are one-sided, 95 %,
Clopper-Pearson. All data here are simulated; they share no code with the test.
"""

import argparse
import time

import numpy as np

from benchmarks.bench_monitor import (
    BLOCK_S,
    DAY,
    LEARN_DAYS,
    MONTH_DAYS,
    NOISE,
    NOISES,
    SPREAD,
    UNCERTAINTY,
    UNLIKE,
    Array,
    bound,
    draw_noise,
    draw_temperature,
)
from zerodrift.field.swapped import Before, Foretold, find_unit
from zerodrift.field.watch import OTHER_UNIT, BlockMeans, Rules, follow, make_blocks

MOUNTED = KNOWN, STRANGER, COUSIN = ("known", "stranger", "cousin")
TRAINED = 0.2
"""RMS of what a trained model leaves beside that, by its calibration's uncertainty: two and a half
times the noise of a mean over a block."""
FIRST_UNUSED = 5_200_000
"""Seeds below were looked at while the naming was made."""


def draw_case(
    seed: int, noise: str, units: int, mounted: str, days: float, *, trained: bool = False
) -> str:
    """Return right | false | none | several, or the cause that was told instead."""
    rng = np.random.default_rng(seed)
    n = (LEARN_DAYS + MONTH_DAYS) * DAY
    warm, late = draw_temperature(rng, n)
    terms = np.stack([np.ones(n), warm, warm**2, late - warm])

    def draw_error() -> Array:
        """Return [n] what a calibration leaves."""
        wrong = rng.normal(size=4) * UNCERTAINTY * np.array([0.0, 1.0, 1.0, 0.0]) @ terms
        if not trained:
            return wrong
        waves = rng.uniform(2.0, 8.0, size=3)
        left = sum(np.sin(w * warm + rng.uniform(0, 7)) for w in waves)
        left = left / np.std(left) + rng.normal() * (late - warm) / np.std(late - warm)
        return wrong + TRAINED * UNCERTAINTY * left / np.std(left)

    read = NOISE * draw_noise(rng, noise, n)
    sound = read + draw_error()
    minute = np.arange(n)
    begin = int((LEARN_DAYS + rng.uniform(1.0, MONTH_DAYS - 12.0)) * DAY)
    other = SPREAD * rng.normal(size=4)
    while np.std(other @ terms) < UNLIKE * UNCERTAINTY:
        other = SPREAD * rng.normal(size=4)
    known = SPREAD * rng.normal(size=(units, 4))
    if mounted == KNOWN:
        known[0] = other
    elif mounted == COUSIN:
        known[0, 1:3] = other[1:3]
    models = [one @ terms + draw_error() for one in known]
    # a swapped unit's own zero is not that of its calibration: it was mounted anew
    moved = other @ terms + 5.0 * rng.normal()
    residual = sound + moved * (minute >= begin)
    time_s = 1.7e9 + 60.0 * minute
    blocks = make_blocks(time_s, residual, warm, BLOCK_S)
    rules = Rules(0.01, BLOCK_S, UNCERTAINTY)
    told = follow(blocks, rules, None)
    finding = told.finding
    if finding is None or finding.told is None or told.learned is None:
        return "no cause yet"
    if finding.cause != OTHER_UNIT:
        return finding.cause
    end = blocks.place[finding.told] + round(days * 86_400.0 / BLOCK_S)
    place = np.floor(time_s / BLOCK_S).astype(np.int64)
    here = (place > blocks.place[finding.since]) & (place <= end)
    left = [
        make_blocks(time_s[here], (read + moved - model)[here], warm[here], BLOCK_S).residual
        for model in models
    ]
    new = make_blocks(time_s[here], residual[here], warm[here], BLOCK_S)
    old: BlockMeans = blocks.first(told.learned.blocks)
    found = find_unit(
        {
            "y": (
                Foretold(
                    new,
                    np.stack(left),
                    np.full(units, UNCERTAINTY),
                    np.zeros((units, new.place.size)),
                ),
                Before(old, told.learned, rules),
            )
        },
        units,
    )
    if found is None:
        return "too early"
    if found.named is not None:
        return "right" if mounted == KNOWN and found.named == 0 else "false"
    return "several" if found.possible else "none"


def measure(
    seed: int,
    cases: int,
    noise: str,
    units: int,
    mounted: str,
    days: float,
    *,
    trained: bool = False,
) -> None:
    """Print how often a name was right, false, or not given."""
    start = time.perf_counter()
    told = [draw_case(seed + i, noise, units, mounted, days, trained=trained) for i in range(cases)]
    count = {name: told.count(name) for name in dict.fromkeys(told)}
    tried = sum(count.get(name, 0) for name in ("right", "false", "none", "several"))
    false = count.get("false", 0)
    shown = ", ".join(f"{name} {number}" for name, number in sorted(count.items()))
    print(
        f"{noise}{', trained' if trained else ''}, {units} units known, mounted {mounted}, {days:g}"
        f" days more: {shown}; of {tried}"
        f" false at most {bound(false, tried, upper=True) if tried else 1.0:.4f}"
        + (
            f", right at least {bound(count.get('right', 0), tried, upper=False):.3f}"
            if mounted == KNOWN and tried
            else ""
        )
        + f" ({time.perf_counter() - start:.0f} s)",
        flush=True,
    )


def main(quick: bool = False) -> None:
    """Print the figures; few cases where `quick`."""
    for number, units in enumerate((1, 20) if quick else (1, 20, 200)):
        for place, mounted in enumerate(MOUNTED):
            seed = FIRST_UNUSED + 30_000 * number + 10_000 * place
            measure(seed, 5 if quick else 100, "white", units, mounted, 1.0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=FIRST_UNUSED)
    parser.add_argument("--cases", type=int, default=100)
    parser.add_argument("--noise", choices=NOISES, default="white")
    parser.add_argument("--units", type=int, nargs="+", default=[1, 20, 200])
    parser.add_argument("--days", type=float, default=1.0)
    parser.add_argument("--mounted", nargs="+", choices=MOUNTED, default=list(MOUNTED))
    parser.add_argument("--trained", action="store_true")
    given = parser.parse_args()
    for number, units in enumerate(given.units):
        for place, mounted in enumerate(given.mounted):
            first = given.seed + 30_000 * number + 10_000 * place
            measure(
                first, given.cases, given.noise, units, mounted, given.days, trained=given.trained
            )
