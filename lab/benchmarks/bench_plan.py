"""Planned against default programmes, and predicted against observed probability of the verdict.

    python -m benchmarks.bench_plan hours [--seed N] [--sensors N] [--pairs N] [--hours H,H]
                                           [--file FILE] [--minutes M]
    python -m benchmarks.bench_plan probability [--seed N [N ...]] [--plans N] [--draws N]
                                                [--file FILE] [--minutes M]
    python -m benchmarks.bench_plan time

The sensors are those of `zerodrift_lab.twin`, which shares no code with what plans. Each hides one
effect of a pair of look-alikes. *hours*: the first hours of the twin's own chamber programme, an
hour a run, against programmes planned before the first log within the same temperatures, loads and
inputs, for the same hours with the same rest after each log. Both are done to the same sensor,
whose numbers neither knows: its effect has its size over CAMPAIGN_H hours of the twin's programme,
whatever is recorded. The plan is told a target as large, by its own definition. Right is that
`diagnose` names the effect, and not the other one beside it. *probability*:
plans of several hours for pairs, on sensors drawn anew whose effect is as large as the plan was
told; what they predict against how often it came. Sensors of one plan share its prediction: many
plans with few draws say more than few with many. *time*: planning 8 hours with 6 open effects.
Outcomes are appended to FILE, and those that it has are not run again. All logs here are simulated;
bounds are one-sided, 95 %, Clopper-Pearson.
"""

import argparse
import itertools
import json
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.bench_conditions import bound
from benchmarks.planned_sensors import (
    keep_outputs,
    list_effects,
    make_as_large,
    make_config,
    make_plan,
    make_whole,
    record_default,
    record_plan,
)
from zerodrift.base.arrays import Array
from zerodrift.base.errors import InputError
from zerodrift.base.records import OPTIONAL, from_json, to_dict
from zerodrift.diagnosis.diagnose import diagnose
from zerodrift.discovery.criterion import expect_verdicts, grow, outgrow, rise
from zerodrift.discovery.plan import Planned, Question, plan_experiment
from zerodrift.physics.catalogue import load_catalogue

PAIRS = (
    ("creep", "load_hysteresis"),
    ("thermal_lag", "thermal_gradient"),
    ("thermal_lag", "thermal_hysteresis"),
    ("thermal_gradient", "clock_delay"),
    ("span_tempco", "load_nonlinearity"),
    ("zero_tempco", "dark_current"),
)
HOURS = (0.5, 1.0, 2.0, 4.0)
SIZE = 0.5
"""Of the hidden effect, in noise RMS: what a plan is told, and what it is beyond the model over the
whole default campaign."""
SIX = (
    *("creep", "load_hysteresis", "thermal_lag", "thermal_hysteresis"),
    *("thermal_gradient", "span_tempco"),
)
RIGHT_RATE = 0.8
BUDGET_S = 20.0
DRAWN_AGAIN = 4000
"""Bootstrap over plans (Efron and Tibshirani, An Introduction to the Bootstrap, 1993)."""


Key = tuple[str, tuple[str, ...], str, float, float, int]
"""Arm, pair, truth, hours, size and seed of a trial."""


@dataclass(frozen=True)
class Expected:
    """What a plan expects of one truth; all but the first are lists over its draws."""

    probability: float
    """Of the right verdict, the mean over the draws."""
    grow: tuple[float, ...]
    """What the probability is calculated from, see `discovery/criterion.py`."""
    rise: tuple[float, ...]
    outgrow: tuple[float, ...]
    beside: tuple[float, ...]
    apart: tuple[float, ...]
    disguised: tuple[float, ...]
    """Of the nearest rival."""


@dataclass(frozen=True)
class Measured:
    """What `diagnose` found of the hidden effect: by what it judges whether to name it."""

    rmse_ratio: float
    """On runs left out, with it over without."""
    p_value: float
    nats: float
    sound: bool


@dataclass(frozen=True)
class Trial:
    """One sensor, one programme, one verdict."""

    arm: str
    """default | planned | sized: planned, the sensor's effect as large as the plan was told."""
    pair: tuple[str, ...]
    truth: str
    hours: float
    size: float
    seed: int
    right: bool
    verdict: str
    effect: str | None
    lookalikes: tuple[str, ...]
    expected: Expected | None
    """None for the default."""
    runs: int
    measured: Measured | None = field(default=None, metadata=OPTIONAL)
    """None where `diagnose` did not try it."""

    @property
    def predicted(self) -> float:
        """The plan's probability of this truth; NaN for the default."""
        return float("nan") if self.expected is None else self.expected.probability


def expect(planned: Planned, truth: str) -> Expected:
    """Return what a plan expects of one truth."""
    told, m = planned.told, planned.kinds.index(truth)

    def list_draws(x: Array) -> tuple[float, ...]:
        return tuple(round(float(value), 4) for value in np.minimum(x[m], 1e6))

    apart = np.minimum(told.apart, 1e30)
    nearest = apart.argmin(axis=2)[:, :, None]
    distance = np.take_along_axis(apart, nearest, axis=2)[:, :, 0]
    disguised = np.take_along_axis(told.disguised, nearest, axis=2)[:, :, 0]
    return Expected(
        float(expect_verdicts(told)[m].mean()),
        list_draws(grow(distance, told.gain)),
        list_draws(rise(told.gain, told.nats)),
        list_draws(outgrow(told.excess)),
        list_draws(told.beside),
        list_draws(distance),
        list_draws(disguised),
    )


def try_one(
    arm: str,
    pair: tuple[str, ...],
    truth: str,
    hours: float,
    size: float,
    seed: int,
    budget_s: float,
) -> Trial | None:
    """Return what `diagnose` makes of one sensor after one programme; None: it cannot be made."""
    expected: Expected | None = None
    try:
        if arm == "default":
            dataset = record_default(make_whole(pair, truth, size, seed), hours)
        else:
            planned = make_plan(pair, hours, size, budget_s)
            if arm == "sized":
                simulation = make_as_large(pair, truth, size, seed, planned)
            else:
                simulation = make_whole(pair, truth, size, seed)
            dataset = record_plan(simulation, planned)
            expected = expect(planned, truth)
    except InputError:
        return None
    found = diagnose(list_effects(pair), keep_outputs(dataset))
    rivals = set(pair) - {truth}
    own = next((c for c in found.candidates if c.effect == truth), None)
    right = found.effect == truth and not rivals & set(found.lookalikes)
    return Trial(
        arm,
        pair,
        truth,
        hours,
        size,
        seed,
        right,
        found.verdict,
        found.effect,
        found.lookalikes,
        expected,
        len(dataset.train),
        None
        if own is None
        else Measured(own.rmse_left_out_ratio, own.p_value, own.nats, own.sound),
    )


def read_trials(file: Path | None) -> list[Trial]:
    """Return the outcomes that a file has."""
    if file is None or not file.exists():
        return []
    lines = file.read_text(encoding="utf-8").splitlines()
    return [from_json(Trial, json.loads(line), str(file)) for line in lines]


def run_trials(
    wanted: Iterator[Key], file: Path | None, minutes: float, budget_s: float
) -> list[Trial]:
    """Run what the file does not have yet, as long as there is time; return all."""
    done = {(t.arm, t.pair, t.truth, t.hours, t.size, t.seed): t for t in read_trials(file)}
    found = []
    begin = time.time()
    for key in wanted:
        if key in done:
            found.append(done[key])
            continue
        if time.time() - begin > 60.0 * minutes:
            continue
        trial = try_one(*key, budget_s)
        if trial is None:
            continue
        found.append(trial)
        if file is not None:
            with file.open("a", encoding="utf-8") as out:
                out.write(json.dumps(to_dict(trial)) + "\n")
        mark = "right" if trial.right else f"{trial.verdict} {trial.effect} {trial.lookalikes}"
        print(
            f"  {trial.arm} {trial.truth} of {trial.pair} {trial.hours:g} h, size {trial.size:g}: "
            f"{mark} (predicted {trial.predicted:.2f})",
            file=sys.stderr,
            flush=True,
        )
    return found


def choose_truth(pair: Sequence[str], number: int) -> str:
    """Return the effect that a sensor hides: one of the pair, in turn.

    A straight zero shift is in every model, so of it and dark current the second is hidden.
    """
    return "dark_current" if "dark_current" in pair else pair[number % 2]


def list_hours(seed: int, sensors: int, hours: Sequence[float], pairs: int) -> Iterator[Key]:
    """Give the trials of the comparison, sensor by sensor."""
    for n in range(sensors):
        for p, pair in enumerate(PAIRS[:pairs]):
            for arm in ("planned", "default"):
                for h in hours:
                    yield arm, pair, choose_truth(pair, n), h, SIZE, seed + 1000 * p + n


def list_probability(seed: int, plans: int, draws: int) -> Iterator[Key]:
    """Give the trials of the calibration: pairs, hours and sizes drawn, each on many sensors."""
    rng = np.random.default_rng(seed)
    drawn = []
    for number in range(plans):
        hours = float(rng.choice([0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0]))
        size = float(rng.choice([0.1, 0.2, 0.3, 0.5, 1.0, 2.0]))
        drawn.append((PAIRS[number % len(PAIRS)], hours, size))
    for n in range(draws):
        for number, (pair, hours, size) in enumerate(drawn):
            place = seed + 7000 + 1000 * number + n
            yield "sized", pair, choose_truth(pair, n), hours, size, place


def tell_hours(trials: Sequence[Trial], hours: Sequence[float]) -> None:
    """Print the rate of right names by hours, and the hours to the wanted rate."""
    ratios = []
    for pair in PAIRS:
        reached: dict[str, float] = {}
        for arm in ("default", "planned"):
            cells = []
            for h in hours:
                here = [t.right for t in trials if (t.arm, t.pair, t.hours) == (arm, pair, h)]
                cells.append(f"{h:g} h {sum(here)}/{len(here)}")
                if here and sum(here) >= RIGHT_RATE * len(here):
                    reached.setdefault(arm, h)
            print(f"{' / '.join(pair):34s} {arm:8s} " + "  ".join(cells))
        default, planned = reached.get("default"), reached.get("planned")
        print(f"{'':34s} hours to {RIGHT_RATE:.0%}: default {default}, planned {planned}")
        if planned is not None or default is not None:
            never = 2.0 * hours[-1]
            ratios.append((planned or never) / (default or never))
    if ratios:
        print(
            f"planned over default hours: median {np.median(ratios):.2f}, longest "
            f"{max(ratios):.2f}, {len(ratios)} of {len(PAIRS)} pairs that one of both arrives at "
            "(who never arrives counts with twice the longest)"
        )
    for arm in ("default", "planned"):
        here = [t.right for t in trials if t.arm == arm]
        if here:
            low = bound(sum(here), len(here), upper=False)
            print(f"{arm}: {sum(here)} of {len(here)} right over all hours (at least {low:.1%})")


def tell_probability(trials: Sequence[Trial]) -> None:
    """Print predicted against observed rates, over all and in three bands."""
    ordered = sorted(trials, key=lambda t: t.predicted)
    third = -(-len(ordered) // 3)
    bands = {
        "all": ordered,
        "lowest third": ordered[:third],
        "middle third": ordered[third : 2 * third],
        "highest third": ordered[2 * third :],
    }
    for name, band in bands.items():
        if not band:
            continue
        right = sum(t.right for t in band)
        predicted = float(np.mean([t.predicted for t in band]))
        low, high = (bound(right, len(band), upper=upper) for upper in (False, True))
        observed = right / len(band)
        plans, least, most = spread_over_plans(band)
        print(
            f"{name:14s} {len(band):4d} cases: predicted {predicted:.3f}, observed {observed:.3f} "
            f"({low:.3f} .. {high:.3f}), apart {100.0 * (predicted - observed):+.1f} points; "
            f"{plans} predictions, drawn anew {100.0 * least:+.1f} .. {100.0 * most:+.1f}"
        )


def spread_over_plans(band: Sequence[Trial]) -> tuple[int, float, float]:
    """Return the number of different predictions, and how far apart others would have been.

    All sensors of one plan and truth share one prediction, and a draw of its values: they say less
    than as many plans would. So whole plans are drawn again, with their truths.

    Returns:
        predictions; 5 % and 95 % quantile of predicted minus observed over DRAWN_AGAIN draws.
    """
    apart: dict[tuple[object, ...], list[float]] = {}
    for t in band:
        key = (t.pair, t.truth, t.hours, t.size)
        apart.setdefault(key, []).append(t.predicted - t.right)
    sums = np.array([[sum(one), len(one)] for one in apart.values()])
    rng = np.random.default_rng(0)
    drawn = sums[rng.integers(len(sums), size=(DRAWN_AGAIN, len(sums)))].sum(axis=1)
    least, most = np.quantile(drawn[:, 0] / drawn[:, 1], (0.05, 0.95)).tolist()
    return len(sums), least, most


def tell_time() -> None:
    """Print what planning 8 hours with 6 open effects takes."""
    begin = time.process_time()
    question = Question(8.0, SIX, 0.001, 240.0)
    planned = plan_experiment(make_config(PAIRS[0]), None, load_catalogue(), question)
    print(
        f"8 h, 6 open effects: first answer {planned.first_cpu_s:.1f} CPU s, whole planning "
        f"{time.process_time() - begin:.0f} CPU s, {planned.best.tried} programmes"
    )


def main(arguments: Sequence[str]) -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("what", choices=("hours", "probability", "time"))
    parser.add_argument("--seed", type=int, nargs="+", default=[100])
    parser.add_argument("--sensors", type=int, default=5)
    parser.add_argument("--pairs", type=int, default=len(PAIRS))
    parser.add_argument("--hours", default=",".join(f"{h:g}" for h in HOURS))
    parser.add_argument("--plans", type=int, default=20)
    parser.add_argument("--draws", type=int, default=30)
    parser.add_argument("--file", type=Path)
    parser.add_argument("--minutes", type=float, default=1e9)
    parser.add_argument("--budget", type=float, default=BUDGET_S)
    options = parser.parse_args(arguments)
    print("simulated sensors; all logs here are simulated")
    if options.what == "hours":
        hours = [float(h) for h in options.hours.split(",")]
        wanted = list_hours(options.seed[0], options.sensors, hours, options.pairs)
        tell_hours(run_trials(wanted, options.file, options.minutes, options.budget), hours)
    elif options.what == "probability":
        seeds = [list_probability(seed, options.plans, options.draws) for seed in options.seed]
        trials = itertools.chain.from_iterable(seeds)
        tell_probability(run_trials(trials, options.file, options.minutes, options.budget))
    else:
        tell_time()


if __name__ == "__main__":
    main(sys.argv[1:])
