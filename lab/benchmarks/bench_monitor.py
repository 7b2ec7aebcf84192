"""Alarms of `monitor` over simulated units: where nothing has changed, and of four faults.

    python -m benchmarks.bench_monitor [--seed N] [--sound N] [--faulty N] [--noise KIND] [--gaps]

A unit is sampled every 60 s for 14 days, which the test learns from, and 30 more. What is drawn
anew for each: temperature (day, weather, season), the sensor's drift (offset, slope, curvature, a
lag of some hours), the error of its calibration, whose standard uncertainty the test is told, the
fault's time, sign and size. Full scale is 2000 N, noise of a sample 0.5 N RMS: white; or, of its
variance, 0.3 in a first-order process of 3 hours; or 0.2 in flicker noise from the sampling rate
down to 1/350 days, shaped in the frequency domain. Faults: ageing of 0.1 % of full scale a month
from the first day; a step of 5 x noise; another unit in its place from some day on, and the model
of another unit from the first sample on. Two units whose drifts differ by less than 3 standard
uncertainties of the calibration, RMS over the temperatures, are drawn again.
With `--gaps` a unit is logged for 14 days and 3 to 15 more, then not for 7 to 90, then for 20.
Its zero steps, in half of the cases within the gap, or ages from the first day or from any time
on, by 3 to 30 standard uncertainties in all; a third of the units misfit as a trained model
does, by a wave over temperature and by a lag. *Right*: cause sure and true, and the true begin
in the interval.
The simulation shares no code with the test. *Right*: an alarm whose cause is sure and true.
Seeds below 4,100,000 were looked at while the test was made, with gaps those below 4,700,000. All
data here are simulated; bounds are one-sided, 95 %, Clopper-Pearson.
"""

import argparse
import time
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter
from scipy.stats import beta

from zerodrift.base.arrays import Array
from zerodrift.field.watch import Rules, follow, make_blocks

NOISES = ("white", "first order", "flicker")
FAULTS = ("ageing", "step", "other unit", "other model")
DAY = 1440
LEARN_DAYS, MONTH_DAYS = 14, 30
NOISE = 0.5
FULL_SCALE = 2000.0
UNCERTAINTY = 0.4
"""Of the calibration, over its range, N."""
SPREAD = np.array([20.0, 40.0, 10.0, 8.0])
"""Of offset, slope, curvature and lagged part between units, N over half the range."""
UNLIKE = 3.0
"""Least difference of two units, RMS over the temperatures, in standard uncertainties."""
BLOCK_S = 14_400.0
MOST_ALARMS, FEWEST_ALARMS = 17, 4
FIRST_UNUSED = 4_100_000


@dataclass(frozen=True)
class Outcome:
    """What became of one unit."""

    alarm_days: float | None
    """From the fault, or the end of learning, to the alarm."""
    told_days: float | None
    cause: str


def draw_noise(rng: np.random.Generator, kind: str, n: int) -> Array:
    """Return noise [n] of an RMS of 1."""
    white = rng.normal(size=n)
    if kind == "white":
        return white
    if kind == "first order":
        keep = np.exp(-1.0 / 180.0)
        drawn = rng.normal(size=n + 3000)
        slow = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], drawn)[3000:]
        return np.sqrt(0.7) * white + np.sqrt(0.3) * slow
    length = 1 << 19
    frequency = np.arange(length // 2 + 1)
    gain = np.zeros(frequency.size)
    gain[1:] = 1.0 / np.sqrt(frequency[1:])
    spectrum = gain * np.exp(2j * np.pi * rng.random(gain.size)) * rng.rayleigh(size=gain.size)
    slow = np.fft.irfft(spectrum, length)[:n] * length / (2.0 * np.sqrt(np.sum(gain**2)))
    return np.sqrt(0.8) * white + np.sqrt(0.2) * slow


def draw_temperature(rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    """Return temperature, and itself some hours late [n], as shares of the calibrated range."""
    day = np.arange(n) / DAY
    whole = np.zeros(n)
    for period, swing in ((1.0, 0.2), (4.7, 0.12), (11.0, 0.12), (90.0, 0.2)):
        whole += swing * rng.uniform(0.5, 1.0) * np.sin(2 * np.pi * (day / period + rng.random()))
    keep = np.exp(-1.0 / rng.uniform(60.0, 300.0))
    late, _ = lfilter([1.0 - keep], [1.0, -keep], whole, zi=[keep * whole[0]])
    return whole, late


def draw_unit(seed: int, noise: str, fault: str | None) -> Outcome:
    """Return what the test says of one unit."""
    rng = np.random.default_rng(seed)
    n = (LEARN_DAYS + MONTH_DAYS) * DAY
    warm, late = draw_temperature(rng, n)
    terms = np.stack([np.ones(n), warm, warm**2, late - warm])
    # what a calibration leaves follows temperature; its zero is taken off on mounting
    wrong = rng.normal(size=4) * UNCERTAINTY * np.array([0.0, 1.0, 1.0, 0.0])
    residual = NOISE * draw_noise(rng, noise, n) + wrong @ terms
    minute = np.arange(n)
    begin = int((LEARN_DAYS + rng.uniform(1.0, MONTH_DAYS - 8.0)) * DAY)
    sign = rng.choice([-1.0, 1.0])
    other = SPREAD * rng.normal(size=4) @ terms
    while np.std(other) < UNLIKE * UNCERTAINTY:
        other = SPREAD * rng.normal(size=4) @ terms
    if fault == "ageing":
        begin = 0
        residual += sign * 1e-3 * FULL_SCALE * minute / (MONTH_DAYS * DAY)
    elif fault == "step":
        residual += sign * 5.0 * NOISE * (minute >= begin)
    elif fault == "other unit":
        residual += other * (minute >= begin)
    elif fault == "other model":
        begin = 0
        residual += other
    blocks = make_blocks(1.7e9 + 60.0 * minute, residual, warm, BLOCK_S)
    found = follow(blocks, Rules(0.01, BLOCK_S, UNCERTAINTY), None).finding
    if found is None:
        return Outcome(None, None, "")

    def count_days(block: int) -> float:
        return float((blocks.place[block] + 1) * BLOCK_S - 1.7e9) / 86_400.0 - begin / DAY

    told = count_days(found.told) if found.told is not None else None
    return Outcome(count_days(found.alarm), told, found.cause if told is not None else "undecided")


@dataclass(frozen=True)
class Gapped:
    """What became of one unit that was not logged all the time."""

    cause: str
    """That was told; undecided, or "" without an alarm."""
    holds: bool
    """Whether the interval that was told holds the true begin."""
    days: float
    """Length of that interval."""
    off: float
    """Size told over true size, or rate over rate; 0 where none is told."""


def draw_gapped(seed: int, noise: str, fault: str | None) -> Gapped:
    """Return what the test says of one unit with a gap in its logs."""
    rng = np.random.default_rng(seed)
    before = LEARN_DAYS + rng.uniform(3.0, 15.0)
    gap = np.exp(rng.uniform(np.log(7.0), np.log(90.0)))
    whole = before + gap + 20.0
    n = int(whole * DAY)
    minute = np.arange(n)
    warm, late = draw_temperature(rng, n)
    terms = np.stack([np.ones(n), warm, warm**2, late - warm])
    wrong = rng.normal(size=4) * UNCERTAINTY * np.array([0.0, 1.0, 1.0, 0.0])
    residual = NOISE * draw_noise(rng, noise, n) + wrong @ terms
    if rng.random() < 1 / 3:
        misfit = np.sin(7.0 * warm + rng.uniform(0, 7)) + 3.0 * (late - warm)
        residual += 0.5 * UNCERTAINTY * misfit / np.std(misfit)
    size = rng.choice([-1.0, 1.0]) * UNCERTAINTY * np.exp(rng.uniform(np.log(3), np.log(30)))
    begin = rng.uniform(LEARN_DAYS + 1.0, before) if rng.random() < 0.5 else 0.0
    if fault == "step":
        begin = begin or rng.uniform(before, before + gap)
        residual += size * (minute >= begin * DAY)
    elif fault == "ageing":
        if rng.random() < 0.5:
            begin = rng.uniform(LEARN_DAYS, before + gap)
        size /= before + gap - min(begin, before)
        residual += size * np.maximum(minute / DAY - begin, 0.0)
    seen = (minute < before * DAY) | (minute >= (before + gap) * DAY)
    time_s = 1.7e9 + 60.0 * minute[seen]
    blocks = make_blocks(time_s, residual[seen], warm[seen], BLOCK_S)
    found = follow(blocks, Rules(0.01, BLOCK_S, UNCERTAINTY), None).finding
    if found is None or found.begun is None:
        return Gapped("", False, 0.0, 0.0)
    low, high = ((place * BLOCK_S - 1.7e9) / 86_400.0 for place in found.begun)
    told = found.per_day if found.cause == "ageing" else found.size
    return Gapped(
        found.cause if found.told is not None else "undecided",
        low <= begin <= high or (begin == 0.0 and low <= 0.0),
        high - low,
        told / size,
    )


def measure_gapped(seed: int, sound: int, faulty: int, noises: tuple[str, ...]) -> None:
    """Print alarms of sound units with a gap in their logs, then steps and ageing."""
    for noise in noises:
        base = seed + 100_000 * NOISES.index(noise)
        alarms = sum(bool(draw_gapped(base + i, noise, None).cause) for i in range(sound))
        if sound:
            low, high = (bound(alarms, sound, upper=upper) for upper in (False, True))
            print(f"{noise}, gap: {alarms} of {sound} sound units alarm ({low:.4f} .. {high:.4f})")
        for place, fault in enumerate(("step", "ageing") if faulty else ()):
            first = base + 20_000 * (place + 1)
            told = [draw_gapped(first + i, noise, fault) for i in range(faulty)]
            right = [one for one in told if one.cause == fault and one.holds]
            causes = {one.cause or "none": 0 for one in told}
            for one in told:
                causes[one.cause or "none"] += 1
            undecided = sum(one.cause == "undecided" and one.holds for one in told)
            days, off = (np.array([getattr(o, k) for o in right] or [0]) for k in ("days", "off"))
            print(
                f"{noise}, gap: {fault}: {len(right)} of {faulty} right with an interval that holds"
                f" it, at least {bound(len(right), faulty, upper=False):.3f}; told {causes}, of the"
                f" undecided {undecided} hold it; interval {np.median(days):.1f} days (largest"
                f" {days.max():.0f}), size told over true {np.median(off):.2f}"
                f" ({np.quantile(off, 0.05):.2f} .. {np.quantile(off, 0.95):.2f})",
                flush=True,
            )


def bound(count: int, n: int, *, upper: bool) -> float:
    """Return the one-sided 95 % bound of a share."""
    if upper:
        return 1.0 if count == n else float(beta.ppf(0.95, count + 1, n - count))
    return 0.0 if count == 0 else float(beta.ppf(0.05, count, n - count + 1))


def measure(seed: int, sound: int, faulty: int, noises: tuple[str, ...]) -> None:
    """Print alarms of sound units, then faults told right, for each kind of noise."""
    for noise in noises:
        base = seed + 100_000 * NOISES.index(noise)
        start = time.perf_counter()
        if sound:
            outcomes = [draw_unit(base + i, noise, None) for i in range(sound)]
            alarms = sum(o.alarm_days is not None for o in outcomes)
            low = bound(alarms, sound, upper=False)
            high = bound(alarms, sound, upper=True)
            print(
                f"{noise}: {alarms} of {sound} sound unit-months alarm ({low:.4f} .. {high:.4f});"
                f" stated 0.01 ({time.perf_counter() - start:.0f} s)",
                flush=True,
            )
        for place, fault in enumerate(FAULTS if faulty else ()):
            first = base + 20_000 * (place + 1)
            outcomes = [draw_unit(first + i, noise, fault) for i in range(faulty)]
            alarms = sum(o.alarm_days is not None for o in outcomes)
            right = [o for o in outcomes if o.cause == fault]
            wrong = sum(o.cause not in (fault, "", "undecided") for o in outcomes)
            told = np.array([o.told_days for o in right if o.told_days is not None])
            heard = np.array([o.alarm_days for o in right if o.alarm_days is not None])
            delays = ", ".join(
                f"{name} after {np.median(days):.1f} days (95 %: {np.quantile(days, 0.95):.1f})"
                for name, days in (("alarm", heard), ("cause", told))
                if days.size
            )
            print(
                f"{noise}: {fault}: {len(right)} of {faulty} right, at least"
                f" {bound(len(right), faulty, upper=False):.3f}; {alarms} alarms, {wrong} with"
                f" another cause; {delays}",
                flush=True,
            )


def main(quick: bool = False) -> None:
    """Print the figures; few units where `quick`."""
    measure(FIRST_UNUSED, 10 if quick else 1000, 3 if quick else 200, NOISES)
    measure_gapped(FIRST_UNUSED, 10 if quick else 1000, 3 if quick else 200, NOISES)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=FIRST_UNUSED)
    parser.add_argument("--sound", type=int, default=1000)
    parser.add_argument("--faulty", type=int, default=200)
    parser.add_argument("--noise", choices=NOISES, default=None)
    parser.add_argument("--gaps", action="store_true")
    given = parser.parse_args()
    run = measure_gapped if given.gaps else measure
    run(given.seed, given.sound, given.faulty, (given.noise,) if given.noise else NOISES)
