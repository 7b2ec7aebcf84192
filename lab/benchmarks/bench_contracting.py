"""GRUs and LSTMs trained freely, `limited` and `contracting`: bounds, and what these cost.

    python -m benchmarks bench_contracting [--quick]
    python -m benchmarks.bench_contracting --first 700 --seeds 20 [--kind lstm]

Specimens of the six-axis twin, all simulated: four chamber cycles to train on, a chamber cycle,
heating, cooling and a walk as tests, which training does not see; each specimen is one seed, for
every size. The error is pooled over tests and outputs in shares of full scale. The worst input of
each bound is searched for as in `bench_bound`. Rates stand beside their one-sided 95 %
Clopper-Pearson bound. Where no more is known of the states than their range, nothing is searched
for. Exit code 1 if any input exceeds its bound.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import beta
from tests.bound.cases import Case

from benchmarks.bench_bound import search
from zerodrift.base.config import CONSTRAINTS, Config
from zerodrift.dataset.runs import Dataset
from zerodrift.export.compose import calibrate, describe_compensator
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.train.scores import Trained
from zerodrift.train.training import train_together
from zerodrift_lab.twin.six_axis import draw_sensor, load_protocol, record, to_config, to_dataset

SIZES = (8, 12, 16)
TESTS = ("chamber", "heating", "cooling", "walking")
CYCLES = 4
FIRST, SEEDS, ROUNDS = 700, 20, 30
MARK_PERCENT, MARK_RATIO, MARK_COST = 0.5, 20.0, 1.05
MARK_SHARES = {"free": 0.5, "contracting": 0.95}
TRAININGS = ("free", *CONSTRAINTS)


@dataclass(frozen=True)
class Bounded:
    """A trained network."""

    error: float
    """On the tests, in shares of full scale."""
    percent: float
    """The largest bound of an output, % of full scale; infinite where none is proven."""
    ratios: tuple[float, ...]
    """Bound over worst found, output by output; empty where none is proven, or only by range."""


def main(quick: bool) -> None:
    """Train and search; few and short ones if `quick`."""
    if not measure(
        FIRST, 2 if quick else SEEDS, 4 if quick else ROUNDS, SIZES[: 1 if quick else 3], "gru"
    ):
        raise SystemExit(1)


def measure(first: int, seeds: int, rounds: int, sizes: Sequence[int], kind: str) -> bool:
    """Print a line per size, and the marks; return whether all bounds hold.

    Args:
        first: number of the first specimen, and seed of the search.
        seeds: specimens.
        rounds: of the search; 0: none.
        sizes: hidden units.
        kind: of the network, "gru" or "lstm".
    """
    every: dict[str, list[Bounded]] = {name: [] for name in TRAININGS}
    costs: dict[str, list[float]] = {name: [] for name in TRAININGS}
    projects = [make_project(number) for number in range(first, first + seeds)]
    for hidden in sizes:
        found = [
            train_all(projects, (kind, hidden), first, rounds, {name: name in CONSTRAINTS})
            for name in TRAININGS
        ]
        alike = [all_of for all_of in zip(*found, strict=True) if None not in all_of]
        for k, name in enumerate(TRAININGS):
            own = [all_of[k] for all_of in alike]
            cost = [b.error / a.error for a, b in zip((x[0] for x in alike), own, strict=True)]
            every[name] += own
            costs[name] += cost
            print(
                f"{hidden:3d} units, {len(own)} of {seeds}, {name}: {_tell(own, cost)}", flush=True
            )
    for name in TRAININGS:
        good, total = count(every[name]), len(every[name])
        told = (
            f"{name}: {good} of {total} have a bound of at most {MARK_PERCENT} % of full scale,"
            f" {100.0 * least_rate(good, total):.1f} % or more of all"
        )
        if name in MARK_SHARES:
            told += f"; mark {100.0 * MARK_SHARES[name]:.0f} %"
        if name in CONSTRAINTS:
            told += (
                f"; test error over that of the free one: median {np.median(costs[name]):.3f}, mean"
                f" {np.mean(costs[name]):.3f}, {min(costs[name]):.3f} to {max(costs[name]):.3f},"
                f" mark {MARK_COST}"
            )
        print(told)
    ratios = [ratio for b in every["contracting"] for ratio in b.ratios]
    if not ratios:
        return True
    print(
        f"contracting: bound / worst found, {len(ratios)} outputs: median {np.median(ratios):.1f},"
        f" mark {MARK_RATIO:g}"
    )
    return min(ratios) >= 1.0


def _tell(found: Sequence[Bounded], costs: Sequence[float]) -> str:
    percents = np.array([b.percent for b in found])
    told = (
        f"bound at most {MARK_PERCENT} % of full scale: {count(found)}; bounds {percents.min():.2g}"
        f" to {percents.max():.2g} %; error over the free one's: median {np.median(costs):.3f},"
        f" {min(costs):.3f} to {max(costs):.3f}"
    )
    ratios = [ratio for b in found for ratio in b.ratios]
    if ratios:
        told += f"; bound / worst found: median {np.median(ratios):.1f}"
        told += f", {min(ratios):.1f} to {max(ratios):.1f}"
    return told


def count(found: Sequence[Bounded]) -> int:
    """Return how many have a bound as small as the mark."""
    return sum(b.percent <= MARK_PERCENT for b in found)


def least_rate(found: int, total: int) -> float:
    """Return the one-sided 95 % Clopper-Pearson lower bound of a rate."""
    return float(beta.ppf(0.05, found, total - found + 1)) if found else 0.0


def make_project(number: int) -> tuple[Config, Dataset]:
    """Return configuration and runs of a specimen."""
    sensor = draw_sensor(number)
    train = [
        record(sensor, load_protocol("chamber"), name=f"chamber_{k + 1}", seed=number)
        for k in range(CYCLES)
    ]
    tests = [
        record(sensor, load_protocol(name), name=f"test_{name}_1", seed=number + 1000)
        for name in TESTS
    ]
    return to_config(train, tests), to_dataset(train, tests)


def train_all(
    projects: Sequence[tuple[Config, Dataset]],
    network: tuple[str, int],
    seed: int,
    rounds: int,
    options: Mapping[str, bool],
) -> list[Bounded | None]:
    """Return every specimen's network of a kind and size; None where training left it out."""
    kind, hidden = network
    given = []
    for k, (config, dataset) in enumerate(projects):
        own = replace(
            config.network, kind=kind, hidden=hidden, seed=seed + k, options=dict(options)
        )
        given.append((replace(config, network=own), dataset))
    answers = train_together(given, load_catalogue())
    found: list[Bounded | None] = []
    for (config, dataset), answer in zip(given, answers, strict=True):
        if isinstance(answer, Exception):
            raise answer
        worth = answer.compensator.network is not None
        found.append(bound(config, dataset, answer, seed, rounds) if worth else None)
    return found


def bound(config: Config, dataset: Dataset, trained: Trained, seed: int, rounds: int) -> Bounded:
    """Return a network's error and bound, searched for the worst input."""
    full_scale = np.array(trained.scores.full_scale)
    error = float(np.sqrt(np.mean((trained.scores.held_out.compensated / full_scale) ** 2)))
    described = describe_compensator(trained.compensator, config, dataset.train)
    assert described.network is not None
    case = Case.of(described, calibrate(described, dataset.train))
    proven = case.bound().outputs
    if not proven:
        return Bounded(error, float("inf"), ())
    limits = np.array([float(of_output.total) for of_output in proven])
    percent = float((100.0 * limits / full_scale).max())
    if rounds == 0 or any(of_output.range for of_output in proven):
        return Bounded(error, percent, ())
    worst = search(case, limits, np.random.default_rng(seed), rounds)
    return Bounded(error, percent, tuple((limits / worst).tolist()))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=FIRST)
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--kind", choices=("gru", "lstm"), default="gru")
    given = parser.parse_args()
    if not measure(given.first, given.seeds, given.rounds, given.sizes, given.kind):
        raise SystemExit(1)
