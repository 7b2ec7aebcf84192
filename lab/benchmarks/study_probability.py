"""The probabilities of `diagnose`: cases are drawn, the maps fitted on some and judged on others.

    python -m benchmarks.study_probability collect WORLD --file FILE [--count N] [--seed N]
    python -m benchmarks.study_probability fit --file FILE [--file FILE ...] [--write]
    python -m benchmarks.study_probability measure --file FILE [--file FILE ...]

WORLD is `own` (the twin: one effect hidden in 45 % of the cases, two in 15 %, none in 20 %, a
disturbance outside the catalogue in 20 %; 6 to 12 runs or 4, with and without a dwell), `slow`
(single runs of `bench_slow`), `both` (slow memory, half of them with a beat or a walk besides) or
`drawn` (simulators 1 and 2 in turn, all factors drawn as by `benchmarks.evidence drawn`).
`fit --write` writes `diagnosis/probability.txt`. All logs are simulated; a seed that maps are
fitted on is never one that they are judged by. Printed are the expected calibration error over ten
bands (mean absolute difference of probability and frequency, by entries) and each band with 20.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from pathlib import Path
from typing import cast

import numpy as np
from scipy.optimize import minimize

from benchmarks import bench_conditions, bench_slow
from benchmarks.evidence.conditions import draw_asks
from benchmarks.evidence.sources import CannotDrawError, draw
from benchmarks.hidden.cases import LISTED, OUTSIDE, Case, make_recipe, read_simulation
from zerodrift.base.arrays import Array
from zerodrift.base.config import EffectConfig
from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.diagnose import diagnose
from zerodrift.diagnosis.diagnosis_report import (
    CANDIDATE,
    ELSE,
    MAPS,
    NOTHING,
    ProbabilityMap,
    list_candidate_figures,
    list_case_figures,
    load_maps,
)
from zerodrift_lab.twin.simulate import simulate

PURPOSES, SHARES = ("one", "pair", "complete", "outside"), (0.45, 0.15, 0.2, 0.2)
CONDITIONS = ("clean", "runs_4", "no_dwell")
OTHER = "something outside the catalogue"
RIDGE = 1.0
BANDS = 10
FEWEST = 20


@dataclass(frozen=True)
class Entry:
    """One thing that was given a probability."""

    map: str
    figures: tuple[float, ...]
    true: bool


def draw_own(seed: int) -> Iterator[tuple[Dataset, list[EffectConfig], list[str]]]:
    """Give cases of the twin without end, with what is missing."""
    rng = np.random.default_rng([seed, 77])
    while True:
        purpose = str(rng.choice(PURPOSES, p=SHARES))
        condition = bench_conditions.CONDITIONS[str(rng.choice(CONDITIONS))]
        count = {"one": 1, "pair": 2, "complete": 0, "outside": 1}[purpose]
        known = OUTSIDE if purpose == "outside" else LISTED
        hidden = tuple(str(name) for name in rng.choice(known, count, replace=False))
        runs = int(rng.integers(condition.fewest_runs, condition.most_runs + 1))
        size = float(rng.choice([1.0, 3.0, 10.0])) if count else 0.0
        case = Case(purpose, hidden, size, runs, int(rng.integers(2**31)))
        recipe = make_recipe(case)
        try:
            simulation = simulate(recipe)
        except InputError:
            continue
        dataset = bench_conditions.change(read_simulation(simulation), condition, case.seed)
        told = [EffectConfig(choice.name) for choice in recipe.told]
        yield dataset, told, [OTHER] if purpose == "outside" else list(hidden)


def draw_slow(seed: int) -> Iterator[tuple[Dataset, list[EffectConfig], list[str]]]:
    """Give single runs without end, with what is missing."""
    truths = {"memory": ["thermal_lag"], "ageing": ["ageing"], "complete": [], "flicker": []}
    rng = np.random.default_rng([seed, 78])
    for number in iter(lambda: int(rng.integers(2**31)), None):
        kind = str(rng.choice(bench_slow.KINDS))
        dataset = bench_slow.draw_record(kind, number, float(rng.choice([1.0, 3.0, 5.0])))[0]
        yield dataset, [EffectConfig("zero_tempco")], truths.get(kind, [OTHER])


def draw_logs(seed: int) -> Iterator[tuple[Dataset, list[EffectConfig], list[str]]]:
    """Give cases of simulators 1 and 2 in turn without end, with what is missing."""
    for ask in chain.from_iterable(zip(draw_asks(1, seed), draw_asks(2, seed), strict=True)):
        try:
            drawn = draw(ask)
        except (CannotDrawError, InputError):
            continue
        missing = [OTHER] if ask.purpose == "outside" else list(ask.hidden)
        yield drawn.dataset, list(drawn.config.effects), missing


def draw_both(seed: int) -> Iterator[tuple[Dataset, list[EffectConfig], list[str]]]:
    """Give single runs with slow memory without end, half of them with a disturbance besides."""
    rng = np.random.default_rng([seed, 79])
    for number in iter(lambda: int(rng.integers(2**31)), None):
        dataset = bench_slow.draw_record("memory", number, float(rng.choice([3.0, 10.0, 30.0])))[0]
        (run,) = dataset.train
        missing = ["thermal_lag"]
        if rng.uniform() < 0.5:
            share = np.linspace(0.0, 1.0, len(run))
            beat = np.sin(2.0 * np.pi * (rng.uniform(5.0, 40.0) * share + rng.uniform()))
            walk = np.cumsum(rng.standard_normal(len(run)))
            more = beat if rng.uniform() < 0.5 else (walk - walk.mean()) / walk.std()
            more = more * float(rng.choice([1.0, 2.0, 4.0]))
            run = replace(run, measured=run.measured + more[:, None])
            missing.append(OTHER)
        yield replace(dataset, train=(run,)), [EffectConfig("zero_tempco")], missing


WORLDS = {"own": draw_own, "slow": draw_slow, "both": draw_both, "drawn": draw_logs}


def collect(world: str, count: int, seed: int, path: Path) -> None:
    """Append the figures of cases to a file, one case a line."""
    done = len(read_lines([path])) if path.exists() else 0
    for dataset, effects, missing in islice(WORLDS[world](seed), done, count):
        found = diagnose(effects, dataset)
        entries = [
            (
                CANDIDATE,
                list_candidate_figures(found, candidate),
                candidate.effect in missing,
            )
            for candidate in found.candidates
        ]
        figures = list_case_figures(found)
        entries.append((NOTHING, figures, not missing))
        if found.effect is not None:
            entries.append((ELSE, figures, bool(set(missing) - {found.effect})))
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entries) + "\n")


def read_lines(paths: Sequence[Path]) -> list[list[Entry]]:
    """Return the entries of each case."""
    cases = []
    for path in paths:
        for line in path.read_text(encoding="utf-8").splitlines():
            told = cast("list[tuple[str, list[float], bool]]", json.loads(line))
            cases.append([Entry(name, tuple(figures), true) for name, figures, true in told])
    return cases


def fit_map(name: str, entries: Sequence[Entry]) -> ProbabilityMap:
    """Return the logistic map of largest likelihood, its weights held together by a ridge."""
    figures = np.array([entry.figures for entry in entries])
    sign = np.where([entry.true for entry in entries], 1.0, -1.0)

    def cost(weights: Array) -> tuple[float, Array]:
        margin = sign * (figures @ weights)
        slope = -sign / (1.0 + np.exp(np.clip(margin, -500.0, 500.0)))
        held = weights.copy()
        held[0] = 0.0
        total = np.logaddexp(0.0, -margin).sum() + 0.5 * RIDGE * held @ held
        return float(total), figures.T @ slope + RIDGE * held

    found = minimize(cost, np.zeros(figures.shape[1]), jac=True, method="L-BFGS-B")
    return ProbabilityMap(name, tuple(float(w) for w in found.x))


def print_calibration(maps: dict[str, ProbabilityMap], entries: Sequence[Entry]) -> None:
    """Print expected calibration error and bands of each map."""
    for name, one in maps.items():
        mine = [entry for entry in entries if entry.map == name]
        if not mine:
            continue
        told = np.array([one.apply(entry.figures) for entry in mine])
        true = np.array([float(entry.true) for entry in mine])
        band = np.minimum((told * BANDS).astype(int), BANDS - 1)
        off, bands = 0.0, []
        for number in range(BANDS):
            here = band == number
            if here.any():
                apart = float(true[here].mean() - told[here].mean())
                off += abs(apart) * float(here.mean())
                if here.sum() >= FEWEST:
                    bands.append(
                        f"{100 * told[here].mean():.0f}->{100 * true[here].mean():.0f} "
                        f"({int(here.sum())})"
                    )
        brier = float(np.mean((told - true) ** 2))
        print(
            f"{name:16s} {len(mine):5d} entries, base rate {100 * true.mean():.1f} %, expected "
            f"calibration error {100 * off:.1f} points, Brier {brier:.3f}; told->true % "
            f"(entries): {', '.join(bands)}"
        )


def main() -> None:
    """Collect, fit or measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("action", choices=("collect", "fit", "measure"))
    parser.add_argument("world", nargs="?", choices=tuple(WORLDS))
    parser.add_argument("--file", type=Path, action="append", required=True)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    if options.action == "collect":
        if options.world is None:
            parser.error("collect needs a WORLD")
        collect(options.world, options.count, options.seed, options.file[0])
        return
    cases = read_lines(options.file)
    entries = [entry for case in cases for entry in case]
    maps = load_maps()
    if options.action == "fit":
        maps = {
            name: fit_map(name, [entry for entry in entries if entry.map == name])
            for name in (CANDIDATE, NOTHING, ELSE)
        }
        if options.write:
            lines = [
                "# Written by `python -m benchmarks.study_probability fit --write`; the figures'",
                "# order stands in diagnosis/diagnosis_report.py. Fitted on "
                f"{len(cases)} simulated cases.",
            ]
            lines += [
                " ".join([name, *(f"{w:.4f}" for w in one.weights)]) for name, one in maps.items()
            ]
            MAPS.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(f"{len(cases)} simulated cases")
    print_calibration(maps, entries)


if __name__ == "__main__":
    main()
