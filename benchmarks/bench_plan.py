"""Planned against default programmes, and predicted against observed probability of the verdict.

    python -m benchmarks.bench_plan hours [--seed N] [--sensors N] [--pairs N] [--hours H,H]
                                           [--file FILE] [--minutes M]
    python -m benchmarks.bench_plan probability [--seed N] [--plans N] [--draws N] [--file FILE]
    python -m benchmarks.bench_plan time

The sensors are those of `lab/twin`, which shares no code with what plans. Each hides one effect of
a pair of look-alikes. *hours*: the twin's own chamber programme, an hour a run, against
programmes planned before the first log within the same temperatures, loads and inputs, rests
counted; right is that `diagnose` names the effect, and not the other one beside it. *probability*:
plans of several hours for pairs, on sensors drawn anew; what they predict against how often it
came. *time*: planning 8 hours with 6 open effects. Outcomes are appended to FILE, and those that
it has are not run again. All logs here are simulated; bounds are one-sided, 95 %, Clopper-Pearson.
"""

import argparse
import json
import re
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.bench_conditions import bound
from zerodrift.base.config import Config, EffectConfig, parse_config
from zerodrift.base.errors import InputError
from zerodrift.base.records import from_json, to_dict
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.diagnose import diagnose
from zerodrift.discovery.files import list_protocols
from zerodrift.discovery.likely import expect_verdicts
from zerodrift.discovery.plan import Planned, Question, plan_experiment
from zerodrift.lab.twin.played import play_protocols
from zerodrift.lab.twin.project import render_config, to_dataset, to_run
from zerodrift.lab.twin.recipe import EffectChoice, Recipe
from zerodrift.lab.twin.sensor import OUTPUTS, UNITS
from zerodrift.lab.twin.simulate import Simulation, simulate
from zerodrift.lab.twin.six_axis.protocol import parse_protocol
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
"""Of the hidden effect beyond the model in the default programme, in noise RMS."""
SIX = (
    *("creep", "load_hysteresis", "thermal_lag", "thermal_hysteresis"),
    *("thermal_gradient", "span_tempco"),
)
RIGHT_RATE = 0.8
PERIOD_S = 2.0
LOOKED_AT = ("Fz", "Mx")
"""Outputs of the six that are logged, which saves time."""
BUDGET_S = 20.0
TARGET = 0.0001
"""The twin's noise is about 0.01 % of full scale."""
LIMITS = """
[experiment]
temperature_degC = [-20, 60]
heating_K_per_min = 6
cooling_K_per_min = 6
start_degC = 23
log_min = 10
rest_min = 3
noise_pct = 0.012

[experiment.loads]
Fz = { range = [-400, 400], change_s = 3, hold_s = 100 }
Mx = { range = [-2.8, 2.8], change_s = 3, hold_s = 100 }

[experiment.inputs]
supply = { range = [4.75, 5.25], change_s = 2, hold_s = 150 }
ambient_light = { range = [0, 900], change_s = 2, hold_s = 100 }
humidity = { range = [15, 85], change_s = 90, hold_s = 400 }
"""


Key = tuple[str, tuple[str, ...], str, float, float, int]
"""Arm, pair, truth, hours, size and seed of a trial."""


@dataclass(frozen=True)
class Trial:
    """One sensor, one programme, one verdict."""

    arm: str
    """default | planned."""
    pair: tuple[str, ...]
    truth: str
    hours: float
    size: float
    seed: int
    right: bool
    verdict: str
    effect: str | None
    lookalikes: tuple[str, ...]
    predicted: float
    """NaN for the default; the mean over the plan's draws of this truth."""
    gain: float
    """Of the plan's truth and its nearest rival, means of logarithms, for the calibration."""
    apart: float
    runs: int


def make_sensor(
    pair: Sequence[str], truth: str, size: float, seed: int, hours: float
) -> Simulation:
    """Return a sensor that hides one effect, with so many hours of the default programme."""
    told = [name for name in ("zero_tempco", "dark_current") if name not in pair]
    if "zero_tempco" in pair:
        told = ["zero_tempco"]
    hidden = EffectChoice(truth)
    recipe = Recipe(
        seed=seed,
        train=("chamber",) * max(1, round(hours)),
        duration_s=3600.0 * min(1.0, hours),
        test=(),
        told=tuple(EffectChoice(name) for name in told if name != truth),
        hidden=(hidden,),
        size=size,
        sample_period_s=PERIOD_S,
    )
    return simulate(recipe)


def list_effects(pair: Sequence[str]) -> list[EffectConfig]:
    """Return the model: straight zero shift, and dark current unless that is asked for."""
    names = ["zero_tempco"] if "dark_current" in pair else ["zero_tempco", "dark_current"]
    return [EffectConfig(name) for name in names]


@cache
def make_config(pair: tuple[str, ...]) -> Config:
    """Return the project of a pair before its first log."""
    base = Recipe(seed=0, train=("chamber",), test=(), sample_period_s=PERIOD_S)
    text = render_config(simulate(replace(base, duration_s=300.0)))
    head = text.split("\n[[effect]]\n")[0] + "\n"
    for name in set(OUTPUTS) - set(LOOKED_AT):
        head = re.sub(rf"\[outputs\.{name}\]\n(.+\n)+", "", head)
    effects = "".join(f'[[effect]]\nkind = "{e.kind}"\n' for e in list_effects(pair))
    return parse_config(head + effects + LIMITS, Path("/bench/zerodrift.toml"))


@cache
def make_plan(pair: tuple[str, ...], hours: float, size: float, budget_s: float) -> Planned:
    """Return a plan before the first log."""
    question = Question(hours, pair, TARGET * size, budget_s)
    return plan_experiment(make_config(pair), None, load_catalogue(), question)


def record_plan(simulation: Simulation, planned: Planned) -> Dataset:
    """Return the logs of a sensor to which a plan is done, with the dwell."""
    units = dict(zip(OUTPUTS, UNITS, strict=True))
    texts = list_protocols(planned.programme, planned.limits, units)
    protocols = {
        f"planned_{end.removesuffix('.txt')}": parse_protocol(text, f"plan_{end}", "planned")
        for end, text in texts.items()
    }
    runs = play_protocols(simulation, protocols)
    dataset = to_dataset(simulation)
    return replace(dataset, train=tuple(to_run(run, simulation.recipe) for run in runs))


def keep_outputs(dataset: Dataset) -> Dataset:
    """Return the logs of those outputs alone that the bench looks at."""
    kept = [OUTPUTS.index(name) for name in LOOKED_AT]

    def take(runs: Sequence[Run]) -> tuple[Run, ...]:
        return tuple(
            replace(run, measured=run.measured[:, kept], reference=run.reference[:, kept])
            for run in runs
        )

    return replace(
        dataset,
        train=take(dataset.train),
        dwell=take(dataset.dwell),
        outputs=LOOKED_AT,
        units=tuple(dataset.units[k] for k in kept),
        full_scale=tuple(dataset.full_scale[k] for k in kept),
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
    try:
        told = hours if arm == "default" else 2.0
        simulation = make_sensor(pair, truth, size, seed, told)
    except InputError:
        return None
    predicted = gain = apart = float("nan")
    dataset = to_dataset(simulation)
    if arm == "planned":
        planned = make_plan(pair, hours, size, budget_s)
        dataset = record_plan(simulation, planned)
        m = planned.kinds.index(truth)
        predicted = float(expect_verdicts(planned.told)[m].mean())
        gain = float(np.exp(np.log(planned.told.gain[m] + 1e-9).mean()))
        apart = float(np.exp(np.log(planned.told.apart[m].min(axis=1) + 1e-9).mean()))
    found = diagnose(list_effects(pair), keep_outputs(dataset))
    rivals = set(pair) - {truth}
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
        predicted,
        gain,
        apart,
        len(dataset.train),
    )


MEASURED = ("predicted", "gain", "apart")
"""Fields of a trial that are null in the file where there is no plan."""


def read_trials(file: Path | None) -> list[Trial]:
    """Return the outcomes that a file has."""
    if file is None or not file.exists():
        return []
    lines = (json.loads(line) for line in file.read_text(encoding="utf-8").splitlines())
    nan = float("nan")
    return [
        from_json(
            Trial,
            {k: nan if v is None and k in MEASURED else v for k, v in line.items()},
            str(file),
        )
        for line in lines
    ]


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
            told = to_dict(trial)
            told |= {k: None for k in MEASURED if np.isnan(getattr(trial, k))}
            with file.open("a", encoding="utf-8") as out:
                out.write(json.dumps(told) + "\n")
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
            yield "planned", pair, choose_truth(pair, n), hours, size, place


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
        print(
            f"{name:14s} {len(band):4d} cases: predicted {predicted:.3f}, observed {observed:.3f} "
            f"({low:.3f} .. {high:.3f}), apart {100.0 * (predicted - observed):+.1f} points"
        )


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
    parser.add_argument("--seed", type=int, default=100)
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
        wanted = list_hours(options.seed, options.sensors, hours, options.pairs)
        tell_hours(run_trials(wanted, options.file, options.minutes, options.budget), hours)
    elif options.what == "probability":
        trials = list_probability(options.seed, options.plans, options.draws)
        tell_probability(run_trials(trials, options.file, options.minutes, options.budget))
    else:
        tell_time()


if __name__ == "__main__":
    main(sys.argv[1:])
