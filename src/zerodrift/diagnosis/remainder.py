"""Describes the remainder: which signal it follows from run to run, if any."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.physics.signals import SignalPlan, read_signals

MOST_ROWS = 12_000
BINS = 16
"""Bins of a signal, each with about as many samples."""
LEAST_SHARE = 0.1
"""A signal is named if it tells this share of the remainder in runs left out."""
BELONGS_TO_RUNS = 0.8
"""Runs are named if they hold this share of the squared remainder beyond the noise, ..."""
FEW_RUNS = 0.4
"""... and are no more than this share of all runs."""
WITHOUT_MEMORY = 0.3
"""Correlation of neighbouring samples below which a remainder is noise."""
LINE_SHARE = 0.3
"""A period is named if it holds this share of the remainder's variance."""


@dataclass(frozen=True)
class RemainderPattern:
    """One signal that the remainder follows."""

    follows: str
    share: float
    """Share of the remainder's variance that the other runs predict."""


def describe_remainder(
    runs: Sequence[Run], rests: Sequence[Array], plan: SignalPlan, noise: Array
) -> list[RemainderPattern]:
    """Return what the remainder follows, most telling first.

    Each signal is cut into bins; the mean remainder per bin, taken from all other runs, predicts
    the run left out. What is predicted that way is a property of the sensor, not of the run.

    Args:
        runs: the runs.
        rests: what the model leaves, [n, K] per run.
        plan: the project's signals.
        noise: [K] RMS, to bring the outputs to one scale.
    """
    block = max(1, sum(len(run) for run in runs) // MOST_ROWS)
    targets = [_average(rest / noise, block) for rest in rests]
    targets = [target - target.mean(axis=0) for target in targets]
    groups = [run.group for run in runs]
    shares: dict[str, float] = {}
    for name in _describe(runs[0], plan, block):
        signals = [_describe(run, plan, block)[name] for run in runs]
        shares[name] = _predict_share(signals, targets, groups)
    patterns = [
        RemainderPattern(name, share) for name, share in shares.items() if share >= LEAST_SHARE
    ]
    period = _find_period(targets, block * plan.sample_period_s)
    if period is not None:
        patterns.append(period)
    return sorted(patterns, key=lambda pattern: -pattern.share)


def single_out_runs(runs: Sequence[Run], rests: Sequence[Array], noise: Array) -> str:
    """Return in words which few runs hold most of the remainder, or nothing if none do.

    Args:
        runs: the runs.
        rests: what the model leaves, [n, K] per run.
        noise: [K] RMS.
    """
    groups = list(dict.fromkeys(run.group for run in runs))
    excess = dict.fromkeys(groups, 0.0)
    memory: dict[str, list[float]] = {group: [] for group in groups}
    for run, rest in zip(runs, rests, strict=True):
        scaled = (rest - rest.mean(axis=0)) / noise
        excess[run.group] += float((scaled**2).sum()) - scaled.size
        squares = float((scaled**2).sum())
        memory[run.group].append(float((scaled[1:] * scaled[:-1]).sum()) / max(squares, 1e-300))
    total = sum(max(value, 0.0) for value in excess.values())
    worst = sorted(groups, key=lambda group: -excess[group])[: int(FEW_RUNS * len(groups))]
    named: list[str] = []
    for group in worst:
        named.append(group)
        share = sum(excess[name] for name in named) / max(total, 1e-300)
        if share >= BELONGS_TO_RUNS:
            who = f"run {named[0]}" if len(named) == 1 else f"runs {', '.join(named)}"
            if max(max(memory[name]) for name in named) < WITHOUT_MEMORY:
                return f"{who}: noisier than the dwell, without any memory"
            if len(named) == 1:
                # Told by `course`, with more about it.
                return ""
            return (
                f"{100.0 * share:.0f} % of what is left beyond the noise lies in {who}: "
                "look there first"
            )
    return ""


def _average(x: Array, block: int) -> Array:
    """Return block means along time of [n, ...]."""
    rows = x.shape[0] // block
    return np.asarray(x[: rows * block].reshape(rows, block, *x.shape[1:]).mean(axis=1))


def _describe(run: Run, plan: SignalPlan, block: int) -> dict[str, Array]:
    """Return the signals [n] that a remainder may follow, by the words for them."""
    signals = read_signals(run, plan)
    step_s = block * plan.sample_period_s
    temperature = _average(signals.temperature_degC, block)
    reach = max(1, round(60.0 / step_s))
    slope = np.zeros_like(temperature)
    if temperature.size > 2 * reach:
        slope[reach:-reach] = temperature[2 * reach :] - temperature[: -2 * reach]
    described = {
        "the temperature": temperature,
        "the rate of temperature": slope,
        "the time since the start of the run": _average(signals.elapsed_s, block),
    }
    for name, load in signals.load.items():
        averaged = _average(load, block)
        described[f"the load on {name}"] = averaged
        described[f"the change of the load on {name}"] = np.gradient(averaged)
    for name, channel in signals.channels.items():
        if name != "clock":
            described[f"the input {name}"] = _average(channel, block)
    return described


def _predict_share(
    signals: Sequence[Array], targets: Sequence[Array], groups: Sequence[str]
) -> float:
    """Return the share of the remainder that bins of a signal predict in runs left out."""
    everything = np.concatenate(list(signals))
    if float(np.ptp(everything)) == 0.0:
        return 0.0
    edges = np.unique(np.quantile(everything, np.linspace(0.0, 1.0, BINS + 1)[1:-1]))
    places = [np.searchsorted(edges, signal) for signal in signals]
    outputs = targets[0].shape[1]
    sums = np.zeros((len(signals), edges.size + 1, outputs))
    counts = np.zeros((len(signals), edges.size + 1))
    for i, (place, target) in enumerate(zip(places, targets, strict=True)):
        np.add.at(sums[i], place, target)
        np.add.at(counts[i], place, 1.0)
    before = after = 0.0
    for i, (place, target) in enumerate(zip(places, targets, strict=True)):
        others = [j for j, group in enumerate(groups) if group != groups[i]]
        if not others:
            return 0.0
        count = counts[others].sum(axis=0)[:, None]
        means = sums[others].sum(axis=0) / np.maximum(count, 1.0)
        guess = means[place]
        guess = guess - guess.mean(axis=0)
        before += float((target**2).sum())
        after += float(((target - guess) ** 2).sum())
    return 1.0 - after / before if before > 0.0 else 0.0


def _find_period(targets: Sequence[Array], step_s: float) -> RemainderPattern | None:
    """Return the period at which much of the remainder swings, if there is one."""
    length = min(target.shape[0] for target in targets)
    if length < 64:
        return None
    window = np.hanning(length)[:, None]
    power = np.zeros(length // 2 + 1)
    for target in targets:
        part = target[:length] - target[:length].mean(axis=0)
        power += (np.abs(np.fft.rfft(part * window, axis=0)) ** 2).sum(axis=1)
    # The slowest lines are drift, which any wandering has.
    power[:4] = 0.0
    peak = int(power.argmax())
    share = float(power[max(peak - 2, 0) : peak + 3].sum() / max(power.sum(), 1e-300))
    if share < LINE_SHARE or peak < 4:
        return None
    return RemainderPattern(f"a period of about {length * step_s / peak:.0f} s", share)
