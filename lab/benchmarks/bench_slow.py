"""One long run, no dwell: is a slow memory named, and nothing thermal where none is?

Simulated records of 20 to 100 h with four thermal events and a model of `zero_tempco` alone. What
is hidden is RMS 5 times the white noise beyond what a line in the temperature takes:

- memory: the element follows the thermometer, time constant a 60th to a sixth of the record;
- random_walk, flicker, ageing: a wandering, noise of variance 1/f, and a power of time, none of
  which has to do with the temperature; naming a thermal effect for them is wrong;
- complete: nothing but the white noise.

    python -m benchmarks.bench_slow KIND [--count N] [--seed N] [--size X] [--json FILE]
    python -m benchmarks.bench_slow --table FILE

Rates stand beside their one-sided 95 % Clopper-Pearson bound. The simulator shares no code with the
diagnosis.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from benchmarks import open_pool
from benchmarks.bench_conditions import bound
from zerodrift.base.arrays import Array
from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.diagnose import diagnose

KINDS = ("memory", "random_walk", "flicker", "ageing", "complete")
THERMAL = {
    "thermal_lag",
    "thermal_gradient",
    "thermal_hysteresis",
    "zero_tempco",
    "dark_current",
    "clock_delay",
}
"""Effects that follow the temperature."""
EVENTS = 4
STEPS = 8
"""Integration steps per sample."""


@dataclass(frozen=True)
class SlowOutcome:
    """What the diagnosis said of one record."""

    kind: str
    seed: int
    tau_s: float
    length_s: float
    verdict: str
    effect: str | None
    lookalikes: list[str]
    nearest: str | None
    told_tau_s: float
    p_value: float
    """Of the effect named or nearest."""
    seconds: float


def draw_temperature(rng: np.random.Generator, count: int) -> Array:
    """Return a course [count] of four ramps between levels, each held, with a slow ripple."""
    share = np.arange(count) / count
    begins = (np.arange(EVENTS) + rng.uniform(0.15, 0.85, EVENTS)) / EVENTS
    levels = [0.0]
    for _ in range(EVENTS):
        step = rng.uniform(4.0, 15.0) * rng.choice([-1.0, 1.0])
        levels.append(levels[-1] + (step if abs(levels[-1] + step) < 20.0 else -step))
    course = np.zeros(count)
    for number, begin in enumerate(begins):
        rise = np.clip((share - begin) / rng.uniform(0.005, 0.05), 0.0, 1.0)
        course += (levels[number + 1] - levels[number]) * rise
    ripple = 0.2 * np.sin(2.0 * np.pi * (share * rng.uniform(3.0, 12.0) + rng.uniform()))
    return np.asarray(rng.uniform(20.0, 30.0) + course + ripple)


def draw_record(kind: str, seed: int, size: float) -> tuple[Dataset, float, float]:
    """Return the record as a data set, its time constant (0: none), and its length, s."""
    rng = np.random.default_rng([KINDS.index(kind), seed])
    count = int(rng.integers(1500, 4000))
    length_s = 3600.0 * float(np.exp(rng.uniform(np.log(20.0), np.log(100.0))))
    period_s = round(length_s / count, 1)
    fine = draw_temperature(rng, count * STEPS)
    temperature = fine[::STEPS]
    # Lags of a 60th to a sixth.
    tau_s = length_s * float(np.exp(rng.uniform(np.log(1.0 / 60.0), np.log(1.0 / 6.0))))
    if kind == "memory":
        a = np.exp(-period_s / STEPS / tau_s)
        hidden = fine[0] + lfilter([1.0 - a], [1.0, -a], fine - fine[0])
        hidden = hidden[::STEPS]
    elif kind == "random_walk":
        hidden = np.cumsum(rng.standard_normal(count))
    elif kind == "flicker":
        half = np.append(0.0, np.arange(1, 4 * count // 2 + 1) ** -0.5)
        hidden = np.fft.irfft(np.fft.rfft(rng.standard_normal(4 * count))[: half.size] * half)
        hidden = hidden[:count]
    elif kind == "ageing":
        hidden = (np.arange(count) / count) ** rng.uniform(0.4, 1.2)
    else:
        hidden = np.zeros(count)
    base = np.stack([np.ones(count), temperature], axis=1)
    rest = hidden - base @ np.linalg.lstsq(base, hidden, rcond=None)[0]
    rms = float(np.sqrt(np.mean(rest**2)))
    drift = hidden * (size / rms if rms else 0.0) + rng.standard_normal(count)
    if kind != "memory":
        drift += rng.uniform(2.0, 20.0) * (temperature - temperature[0]) * rng.choice([-1.0, 1.0])
    time_s = period_s * np.arange(count)
    run = Run(
        name="record",
        group="record",
        part=0,
        source=Path("record.csv"),
        sample_period_s=period_s,
        time_s=time_s,
        temperature_degC=np.round(temperature / 0.0078125) * 0.0078125,
        measured=drift[:, None],
        reference=np.zeros((count, 1)),
        inputs={},
    )
    scale = (float(10.0 * np.ptp(drift)),)
    dataset = Dataset(
        train=(run,), test=(), dwell=(), outputs=("U",), units=("uV",), full_scale=scale
    )
    return dataset, tau_s if kind == "memory" else 0.0, length_s


def measure(task: tuple[str, int, float]) -> SlowOutcome:
    """Return what the diagnosis says of one record."""
    kind, seed, size = task
    dataset, tau_s, length_s = draw_record(kind, seed, size)
    begin = time.process_time()
    found = diagnose([EffectConfig("zero_tempco")], dataset)
    told = next((c for c in found.candidates if c.effect == (found.effect or found.nearest)), None)
    return SlowOutcome(
        kind,
        seed,
        tau_s,
        length_s,
        found.verdict,
        found.effect,
        list(found.lookalikes),
        found.nearest,
        float(found.parameters.get("tau_s", 0.0)),
        told.p_value if told else 1.0,
        time.process_time() - begin,
    )


def print_table(outcomes: Sequence[SlowOutcome]) -> None:
    """Print a line for each kind."""
    for kind in KINDS:
        mine = [o for o in outcomes if o.kind == kind]
        if not mine:
            continue
        line = f"{kind:12s} {len(mine):4d} records"
        if kind == "memory":
            right = sum(o.effect == "thermal_lag" for o in mine)
            alike = sum("thermal_lag" in o.lookalikes for o in mine)
            apart = [abs(np.log(o.told_tau_s / o.tau_s)) for o in mine if o.told_tau_s > 0.0]
            line += (
                f"  named {right} ({100 * right / len(mine):.1f} %, at least "
                f"{100 * bound(right, len(mine), upper=False):.1f} %), look-alike {alike}"
            )
            if apart:
                line += f", time constant off by {100 * np.expm1(np.median(apart)):.1f} % (median)"
        else:
            wrong = sum(bool({o.effect, *o.lookalikes} & THERMAL) for o in mine)
            named = sum(o.effect is not None for o in mine)
            line += (
                f"  thermal named {wrong} (at most "
                f"{100 * bound(wrong, len(mine), upper=True):.1f} %), any effect {named}"
            )
        line += f", unknown {sum(o.verdict == 'unknown' for o in mine)}"
        line += f", complete {sum(o.verdict == 'complete' for o in mine)}"
        print(f"{line}, median {np.median([o.seconds for o in mine]):.1f} CPU s")


def read_outcomes(path: Path | None) -> list[SlowOutcome]:
    """Return the outcomes that a file holds."""
    if path is None or not path.exists():
        return []
    return [SlowOutcome(**json.loads(line)) for line in path.read_text("utf-8").splitlines()]


def run_tasks(
    tasks: Sequence[tuple[str, int, float]], processes: int
) -> Iterator[SlowOutcome] | Iterable[SlowOutcome]:
    """Give the outcomes in order."""
    if processes == 1:
        yield from map(measure, tasks)
        return
    with open_pool(processes) as pool:
        yield from pool.map(measure, tasks, chunksize=2)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the records of one kind, or print the table of a file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", nargs="?", choices=KINDS)
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--size", type=float, default=5.0)
    parser.add_argument("--processes", type=int, default=1, choices=(1, 2))
    parser.add_argument("--json", type=Path, help="append outcomes here, and go on from them")
    parser.add_argument("--table", type=Path, help="print the table of a file of outcomes")
    options = parser.parse_args(arguments)
    if options.table:
        print_table(read_outcomes(options.table))
        return 0
    if options.kind is None:
        parser.error("expected KIND, or --table FILE")
    outcomes = read_outcomes(options.json)
    known = {(o.kind, o.seed) for o in outcomes}
    seeds = [1000 * options.seed + number for number in range(options.count)]
    tasks = [(options.kind, s, options.size) for s in seeds if (options.kind, s) not in known]
    for outcome in run_tasks(tasks, options.processes):
        outcomes.append(outcome)
        print(f"\r{len(outcomes)} done", end="", file=sys.stderr, flush=True)
        if options.json:
            with options.json.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(outcome)) + "\n")
    print(file=sys.stderr)
    print_table([o for o in outcomes if o.seed in seeds])
    return 0


if __name__ == "__main__":
    sys.exit(main())
