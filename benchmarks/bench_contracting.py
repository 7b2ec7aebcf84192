"""GRUs and LSTMs trained freely and with `[network] contracting = true`: bounds, and their cost.

    python -m benchmarks bench_contracting [--quick]
    python -m benchmarks.bench_contracting --first 700 --seeds 20 [--kind lstm]

Specimens of the six-axis twin, all simulated: four chamber cycles to train on, a chamber cycle,
heating, cooling and a walk as tests, which training does not see; each specimen is one seed, for
every size. The error is pooled over tests and outputs in shares of full scale. The worst input of
each bound is searched for as in `bench_bound`. Rates stand beside their one-sided 95 %
Clopper-Pearson bound. Exit code 1 if any input exceeds its bound.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta
from tests.bound.cases import Case

from benchmarks.bench_bound import search
from zerodrift.base.config import Config
from zerodrift.dataset.runs import Dataset
from zerodrift.export.compose import calibrate, describe_compensator
from zerodrift.export.float_network import FloatNetwork
from zerodrift.export.layered_network import FloatLayeredNetwork
from zerodrift.lab.twin.six_axis import draw_sensor, load_protocol, record, to_config, to_dataset
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.train.scores import Trained
from zerodrift.train.training import train_together

Array = NDArray[np.float64]
SIZES = (8, 12, 16)
TESTS = ("chamber", "heating", "cooling", "walking")
CYCLES = 4
FIRST, SEEDS, ROUNDS = 700, 20, 30
MARK_PERCENT, MARK_SHARES, MARK_RATIO, MARK_COST = 0.5, (0.5, 0.95), 20.0, 1.05


@dataclass(frozen=True)
class Bounded:
    """A trained network."""

    error: float
    """On the tests, in shares of full scale."""
    percent: float
    """The largest bound of an output, % of full scale; infinite where none is proven."""
    ratios: tuple[float, ...]
    """Bound over worst found, output by output; empty where none is proven."""


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
        rounds: of the search.
        sizes: hidden units.
        kind: of the network, "gru" or "lstm".
    """
    free, kept, costs = list[Bounded](), list[Bounded](), list[float]()
    projects = [make_project(number) for number in range(first, first + seeds)]
    for hidden in sizes:
        pair = [
            train_all(projects, (kind, hidden), first, rounds, contracting=contracting)
            for contracting in (False, True)
        ]
        both = [(a, b) for a, b in zip(*pair, strict=True) if a is not None and b is not None]
        own = [b.error / a.error for a, b in both]
        free += [a for a, _ in both]
        kept += [b for _, b in both]
        costs += own
        ratios = [ratio for _, b in both for ratio in b.ratios]
        print(
            f"{hidden:3d} units, {len(both)} of {seeds}: bound at most"
            f" {MARK_PERCENT} % of full scale: free {count([a for a, _ in both])}, contracting"
            f" {count([b for _, b in both])}, the largest {max(b.percent for _, b in both):.2g} %;"
            f" bound / worst found: median {np.median(ratios):.1f}, {min(ratios):.1f} to"
            f" {max(ratios):.1f}; error, contracting / free: median {np.median(own):.3f},"
            f" {min(own):.3f} to {max(own):.3f}",
            flush=True,
        )
    for name, found, mark in zip(("free", "contracting"), (free, kept), MARK_SHARES, strict=True):
        print(
            f"{name}: {count(found)} of {len(found)} have a bound of at most {MARK_PERCENT} % of"
            f" full scale, {100.0 * least_rate(count(found), len(found)):.0f} % or more of all;"
            f" mark {100.0 * mark:.0f} %"
        )
    ratios = [ratio for b in kept for ratio in b.ratios]
    print(
        f"bound / worst found, {len(ratios)} outputs: median {np.median(ratios):.1f}, mark"
        f" {MARK_RATIO:g}; test error, contracting / free: median {np.median(costs):.3f}, mean"
        f" {np.mean(costs):.3f}, {min(costs):.3f} to {max(costs):.3f}, mark {MARK_COST}"
    )
    return min(ratios) >= 1.0


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
    *,
    contracting: bool,
) -> list[Bounded | None]:
    """Return every specimen's network of a kind and size; None where training left it out."""
    kind, hidden = network
    options = {"contracting": True} if contracting else {}
    given = []
    for k, (config, dataset) in enumerate(projects):
        own = replace(config.network, kind=kind, hidden=hidden, seed=seed + k, options=options)
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
    assert isinstance(described.network, FloatNetwork | FloatLayeredNetwork)
    case = Case.of(described, calibrate(described, dataset.train))
    proven = case.bound().outputs
    if not proven:
        return Bounded(error, float("inf"), ())
    limits = np.array([float(of_output.total) for of_output in proven])
    worst = search(case, limits, np.random.default_rng(seed), rounds)
    percent = float((100.0 * limits / full_scale).max())
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
