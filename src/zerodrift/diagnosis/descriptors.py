"""The operating conditions of a sensor at each moment, in quantities that a sentence can name.

Each descriptor is one number per block of samples, and knows how to say that it lies above or below
a threshold: "while cooling faster than 2 K/min", "first 8 min after power-on". Thresholds come from
lists of readable numbers over the range that the logs show, so that the one that is chosen needs no
rounding.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.physics.signals import LATEST_RELATIVE_TIME_S

MOST_BLOCKS = 10_000
"""Blocks of all runs together; more samples than that are averaged."""
SHORTEST_SPAN_S = 30.0
"""Slopes are taken over at least this time and ten samples, so that the thermometer's steps do not
show, and over 5 and 25 times as long."""
SPANS = (1, 5, 25)
BRANCH_SHARE = 0.05
"""A signal turns when it goes back by this share of its whole span."""
SLOW_K_PER_MIN = 0.1
"""Logs that hardly ever move faster are told in K/h."""
LINEAR_STEPS = 25
MANTISSAS = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
TIMES_S = (
    *(2.0, 5.0, 10.0, 20.0, 30.0, 45.0),
    *(60.0 * m for m in (1, 1.5, 2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 25, 30, 40, 50)),
    *(3600.0 * h for h in (1, 1.5, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 36, 48, 72, 96, 168)),
)


@dataclass(frozen=True)
class Descriptor:
    """One quantity: its values, the thresholds to try, and its words."""

    values: Array
    """[M] one value per block, all runs laid end to end."""
    thresholds: Array
    above: str = ""
    """Words for lying above a threshold `{}`; empty where nobody would ask."""
    below: str = ""
    between: str = ""
    """Words for lying between `{}` and `{}`."""
    is_time: bool = False
    output: int | None = None
    """The only output whose error it may explain; None: any."""
    liking: float = 1.0
    """Below 1 for what says less about the cause than others that go along with it."""

    def say(self, low: float | None, high: float | None) -> str:
        """Return the words for lying above `low` and below `high`; None leaves a side open."""
        if low is not None and high is not None and self.between:
            return self.between.format(self._write(low), self._write(high))
        said = [self.above.format(self._write(low))] if low is not None else []
        said += [self.below.format(self._write(high))] if high is not None else []
        return " and ".join(said)

    def _write(self, threshold: float) -> str:
        return format_time(threshold) if self.is_time else f"{threshold:g}"


@dataclass(frozen=True)
class Blocks:
    """Runs cut into blocks of equally many samples, laid end to end."""

    stretches: tuple[Run, ...]
    """All stretches of all runs, in order."""
    size: int
    """Samples in a block; what is left at the end of a stretch is dropped."""
    run: NDArray[np.int64]
    """[M] number of the run that a block belongs to."""
    stretch: NDArray[np.int64]
    """[M] number of its stretch."""
    row: NDArray[np.int64]
    """[M] its first row in the stretch."""

    @property
    def seconds(self) -> float:
        """Length of a block."""
        return self.size * self.stretches[0].sample_period_s

    def average(self, columns: Sequence[Array]) -> Array:
        """Return block means [M, ...] of a full-rate signal given per stretch."""
        means = []
        for x in columns:
            count = x.shape[0] // self.size
            rows = x[: count * self.size].reshape(count, self.size, *x.shape[1:])
            means.append(rows.mean(axis=1))
        return np.concatenate(means)


def cut_blocks(runs: Sequence[Sequence[Run]]) -> Blocks:
    """Return the blocks of these runs, each given by its stretches."""
    stretches = tuple(stretch for run in runs for stretch in run)
    samples = sum(len(stretch) for stretch in stretches)
    shortest = min(len(stretch) for stretch in stretches)
    size = max(1, min(-(-samples // MOST_BLOCKS), shortest))
    counts = [len(stretch) // size for stretch in stretches]
    owners = [number for number, run in enumerate(runs) for _ in run]
    return Blocks(
        stretches,
        size,
        np.repeat(np.array(owners, dtype=np.int64), counts),
        np.repeat(np.arange(len(stretches)), counts),
        np.concatenate([size * np.arange(count) for count in counts]),
    )


def describe(
    blocks: Blocks,
    errors: Sequence[Array],
    outputs: Sequence[str],
    units: Sequence[str],
    channel_units: Mapping[str, str] | None = None,
) -> tuple[Descriptor, ...]:
    """Return every descriptor that these runs have the signals for and that moves.

    Args:
        blocks: the runs.
        errors: [n, K] what the model leaves of each stretch.
        outputs: names of the K outputs.
        units: their units.
        channel_units: unit of each input channel, where it is known.
    """
    found = [
        *_describe_temperature(blocks),
        *_describe_time(blocks),
        *_describe_loads(blocks, outputs, units),
        *_describe_channels(blocks, channel_units or {}),
        *_describe_readings(blocks, errors, outputs, units),
    ]
    return tuple(d for d in found if d.thresholds.size)


def format_time(seconds: float) -> str:
    """Return a time in the unit that makes it readable."""
    for unit, length in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 1.5 * length or seconds == length:
            return f"{seconds / length:.3g} {unit}"
    return f"{seconds:.3g} s"


def list_thresholds(values: Array, *, positive: bool = False) -> Array:
    """Return readable numbers over the range of `values`, but for its thin ends.

    Args:
        values: what is to be divided.
        positive: list powers of ten and their parts too, and nothing at or below zero.
    """
    low, high = (float(q) for q in np.quantile(values, (0.005, 0.995)))
    if not high > low:
        return np.zeros(0)
    step = 10.0 ** np.floor(np.log10((high - low) / LINEAR_STEPS))
    step *= next(
        m for m in (1.0, 2.0, 5.0, 10.0) if m * step * LINEAR_STEPS >= 0.999 * (high - low)
    )
    numbers = step * np.arange(np.ceil(low / step), np.floor(high / step) + 1)
    if positive:
        decades = 10.0 ** np.arange(np.floor(np.log10(high)) - 2, np.floor(np.log10(high)) + 1)
        numbers = np.concatenate([numbers, np.outer(decades, MANTISSAS).ravel()])
        numbers = numbers[numbers > 0.0]
    numbers = np.unique([float(f"{number:.4g}") for number in numbers])
    return np.asarray(numbers[(numbers > low) & (numbers < high)])


def _describe_temperature(blocks: Blocks) -> list[Descriptor]:
    temperature = blocks.average([run.temperature_degC for run in blocks.stretches])
    found = [
        Descriptor(
            temperature,
            list_thresholds(temperature),
            "above {} degC",
            "below {} degC",
            "between {} and {} degC",
        )
    ]
    unit, per_minute = "K/min", 1.0
    for span in _list_spans(blocks):
        slopes = []
        for run in blocks.stretches:
            back = round(span / run.sample_period_s)
            then = np.maximum(np.arange(len(run)) - back, 0)
            slopes.append((run.temperature_degC - run.temperature_degC[then]) / span * 60.0)
        rate = blocks.average(slopes)
        if len(found) == 1 and np.quantile(np.abs(rate), 0.95) < SLOW_K_PER_MIN:
            unit, per_minute = "K/h", 60.0
        rate = rate * per_minute
        over = "" if len(found) == 1 else f" over the last {format_time(span)}"
        words = f"faster than {{}} {unit}{over}"
        size = np.abs(rate)
        found += [
            Descriptor(
                size,
                list_thresholds(size, positive=True),
                f"while the temperature changes {words}",
                f"while the temperature changes by less than {{}} {unit}{over}",
            ),
            Descriptor(rate, _positive(rate), f"while heating {words}"),
            Descriptor(-rate, _positive(-rate), f"while cooling {words}"),
        ]
    branch = _find_branches(blocks, temperature)
    found.append(
        Descriptor(branch, np.array([0.5]), "on the heating branch", "on the cooling branch")
    )
    return found


def _positive(values: Array) -> Array:
    """Return thresholds for the positive values alone."""
    above = values[values > 0.0]
    return list_thresholds(above, positive=True) if above.size > 1 else np.zeros(0)


def _list_spans(blocks: Blocks) -> list[float]:
    """Return the times over which changes are taken, none longer than a quarter of a run."""
    run = max(blocks.stretches, key=len)
    shortest = max(SHORTEST_SPAN_S, 10.0 * run.sample_period_s)
    spans = [
        round(shortest * factor / run.sample_period_s) * run.sample_period_s for factor in SPANS
    ]
    longest = 0.25 * len(run) * run.sample_period_s
    return [span for span in spans if span <= longest] or spans[:1]


def _find_branches(blocks: Blocks, signal: Array) -> Array:
    """Return 1 where a signal last turned upwards, 0 where it last turned downwards."""
    margin = max(BRANCH_SHARE * float(np.ptp(signal)), 1e-9)
    branch = np.empty_like(signal)
    for stretch in range(len(blocks.stretches)):
        here = np.flatnonzero(blocks.stretch == stretch)
        x = signal[here]
        # Before the first turn the run is on the branch that it is about to take.
        left = np.flatnonzero(np.abs(x - x[0]) >= margin)
        rising = bool(left.size == 0 or x[left[0]] > x[0])
        extreme = x[0]
        for i, value in zip(here.tolist(), x.tolist(), strict=True):
            if (value > extreme) == rising:
                extreme = value
            elif abs(value - extreme) >= margin:
                rising, extreme = not rising, value
            branch[i] = float(rising)
    return branch


def _describe_time(blocks: Blocks) -> list[Descriptor]:
    elapsed = []
    for run in blocks.stretches:
        relative = 0.0 <= run.time_s[0] < LATEST_RELATIVE_TIME_S
        elapsed.append(run.time_s if relative else run.time_s - run.time_s[0])
    values = blocks.average(elapsed)
    times = np.array([t for t in TIMES_S if values.min() < t < values.max()])
    return [
        Descriptor(
            values,
            times,
            "later than {} after power-on",
            "first {} after power-on",
            "from {} to {} after power-on",
            is_time=True,
        )
    ]


def _describe_loads(
    blocks: Blocks, outputs: Sequence[str], units: Sequence[str]
) -> list[Descriptor]:
    found = []
    for k, (name, unit) in enumerate(zip(outputs, units, strict=True)):
        load = blocks.average([run.reference[:, k] for run in blocks.stretches])
        if not np.ptp(load) > 0.0:
            continue
        found += [
            Descriptor(load, _positive(load), f"under load on {name} above {{}} {unit}"),
            Descriptor(-load, _positive(-load), f"under load on {name} below -{{}} {unit}"),
            Descriptor(
                np.abs(load),
                _positive(np.abs(load)),
                f"under load on {name} beyond ±{{}} {unit}",
                f"without load on {name} (within ±{{}} {unit})",
            ),
            Descriptor(
                _find_branches(blocks, load),
                np.array([0.5]),
                f"after the load on {name} rose",
                f"after the load on {name} fell",
                output=k,
            ),
        ]
        for span in _list_spans(blocks):
            change = _measure_change(blocks, load, span)
            words = f"within {format_time(span)} of a change of the load on {name} by more than"
            found.append(Descriptor(change, _positive(change), f"{words} {{}} {unit}"))
        mean = _trail_mean(blocks, load, span)
        words = f"with a mean load on {name} over the last {format_time(span)}"
        found.append(
            Descriptor(
                mean,
                list_thresholds(mean),
                f"{words} above {{}} {unit}",
                f"{words} below {{}} {unit}",
                output=k,
            )
        )
    return found


def _trail_mean(blocks: Blocks, load: Array, span_s: float) -> Array:
    """Return the mean [M] of a load over the last `span_s`, which began unloaded."""
    length = max(1, round(span_s / blocks.seconds))
    mean = np.empty_like(load)
    for stretch in range(len(blocks.stretches)):
        here = blocks.stretch == stretch
        sums = np.concatenate([np.zeros(length), np.cumsum(load[here])])
        mean[here] = (sums[length:] - sums[:-length]) / length
    return mean


def _measure_change(blocks: Blocks, load: Array, span_s: float) -> Array:
    """Return the range [M] of a load over the last `span_s`."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    half = max(1, round(0.5 * span_s / blocks.seconds))
    change = np.empty_like(load)
    for stretch in range(len(blocks.stretches)):
        here = blocks.stretch == stretch
        window = {"size": 2 * half + 1, "origin": half, "mode": "nearest"}
        x = load[here]
        change[here] = maximum_filter1d(x, **window) - minimum_filter1d(x, **window)
    return change


def _describe_channels(blocks: Blocks, channel_units: Mapping[str, str]) -> list[Descriptor]:
    first = blocks.stretches[0]
    shared = [name for name in first.inputs if all(name in r.inputs for r in blocks.stretches)]
    found = []
    for name in shared:
        unit = f" {channel_units[name]}" if channel_units.get(name) else ""
        signals = [run.inputs[name] for run in blocks.stretches]
        values = blocks.average(signals)
        if name.startswith("acceleration"):
            middle = float(np.median(values))
            size = np.sqrt(blocks.average([(x - middle) ** 2 for x in signals]))
            words = f"while {name} is more than {{}}{unit} away from its median"
            found.append(Descriptor(size, _positive(size), words))
        elif name == "clock":
            since = values - values.min()
            times = np.array([t for t in TIMES_S if t < since.max()])
            words = "from the start of the first run"
            found.append(
                Descriptor(
                    since, times, f"later than {{}} {words}", f"first {{}} {words}", is_time=True
                )
            )
        else:
            found.append(
                Descriptor(
                    values,
                    list_thresholds(values),
                    f"with {name} above {{}}{unit}",
                    f"with {name} below {{}}{unit}",
                    f"with {name} between {{}} and {{}}{unit}",
                )
            )
        if name.endswith("temperature"):
            ahead = blocks.average(
                [run.inputs[name] - run.temperature_degC for run in blocks.stretches]
            )
            words = f"while {name} is more than {{}} K"
            found += [
                Descriptor(ahead, _positive(ahead), f"{words} above the chip's"),
                Descriptor(-ahead, _positive(-ahead), f"{words} below the chip's"),
            ]
    return found


def _describe_readings(
    blocks: Blocks, errors: Sequence[Array], outputs: Sequence[str], units: Sequence[str]
) -> list[Descriptor]:
    """Describe what each output should have read: its own error must not explain itself."""
    found = []
    for k, (name, unit) in enumerate(zip(outputs, units, strict=True)):
        expected = [
            np.abs(run.measured[:, k] - error[:, k])
            for run, error in zip(blocks.stretches, errors, strict=True)
        ]
        size = blocks.average(expected)
        words = f"while {name} reads beyond ±{{}} {unit}"
        found.append(Descriptor(size, _positive(size), words, output=k, liking=0.9))
    return found
