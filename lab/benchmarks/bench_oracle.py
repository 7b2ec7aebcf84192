"""How well missing effects can be named at all: the oracle on sensors of its own generator.

The oracle knows the family that the simulated sensors are drawn from; exact probabilities would
have the highest mean log score on them that there is. The tables tell, for each number of effects,
how often it gives the true set 0.9 or more, whether its probabilities hold, and what the
thermometers' error costs. All logs are simulated.

    cd lab && python -m benchmarks.bench_oracle --cases N --seed S [--sizes LOW HIGH]
        [--processes N]
"""

import argparse
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks import open_pool
from zerodrift_lab.oracle.generator import SIZES, draw_case
from zerodrift_lab.oracle.oracle import Oracle

BANDS = ((0.0, 0.1), (0.1, 0.9), (0.9, 1.0))


@dataclass(frozen=True)
class Judged:
    """What the oracle said of one case.

    Attributes:
        count: effects that the sensor has.
        error_K: of its thermometers.
        of_truth: probability of the true set of kinds.
        log_score: its logarithm, nats.
        expected: log score that the oracle itself expects.
        claims: (probability that a kind is in, whether it is), of every kind that may be.
        seconds: of the oracle.
    """

    count: int
    error_K: float
    of_truth: float
    log_score: float
    expected: float
    claims: tuple[tuple[float, bool], ...]
    seconds: float


def judge_case(asked: tuple[int, tuple[float, float]]) -> Judged:
    """Draw the case of a seed and judge it."""
    seed, sizes = asked
    case = draw_case(seed, sizes=sizes)
    start = time.perf_counter()
    oracle = Oracle(case)
    found = oracle.judge()
    seconds = time.perf_counter() - start
    kinds = case.truth.kinds
    claims = tuple((found.probability_in(kind), kind in kinds) for kind in oracle.prior.by_kind)
    return Judged(
        count=len(kinds),
        error_K=case.truth.thermometer_error_K,
        of_truth=found.by_kinds.get(kinds, 0.0),
        log_score=found.log_score(kinds),
        expected=found.expected_log_score,
        claims=claims,
        seconds=seconds,
    )


def check_bands(claims: Sequence[tuple[float, bool]]) -> list[tuple[int, float, int, float]]:
    """Return, for each band of probability: claims, expected right, right, standard deviation.

    Args:
        claims: (probability that an effect is in, whether it is).
    """
    rows = []
    for low, high in BANDS:
        inside = [(p, is_in) for p, is_in in claims if low <= p < high or p == high == 1.0]
        rows.append(
            (
                len(inside),
                sum(p for p, _ in inside),
                sum(is_in for _, is_in in inside),
                math.sqrt(sum(p * (1.0 - p) for p, _ in inside)),
            )
        )
    return rows


def report(judged: Sequence[Judged]) -> None:
    """Print the tables."""
    print("\n| effects | cases | true set at 0.9 or more | log score | expected | s per case |")
    print("|---|---|---|---|---|---|")
    for count in sorted({one.count for one in judged}):
        _print_row(str(count), [one for one in judged if one.count == count])
    _print_row("all", judged)
    for error_K in sorted({one.error_K for one in judged}):
        _print_row(f"error {error_K:g} K", [one for one in judged if one.error_K == error_K])
    print("\n| P(effect is in) | claims | right, expected | right | standard deviation |")
    print("|---|---|---|---|---|")
    claims = [claim for one in judged for claim in one.claims]
    for (low, high), row in zip(BANDS, check_bands(claims), strict=True):
        print(f"| {low:g} to {high:g} | {row[0]} | {row[1]:.1f} | {row[2]} | {row[3]:.1f} |")


def _print_row(name: str, judged: Sequence[Judged]) -> None:
    sure = sum(one.of_truth >= 0.9 for one in judged)
    score, expected, seconds = (
        float(np.mean([getattr(one, field) for one in judged]))
        for field in ("log_score", "expected", "seconds")
    )
    print(f"| {name} | {len(judged)} | {sure} | {score:.3f} | {expected:.3f} | {seconds:.1f} |")


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge the cases and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1, help="draws all cases")
    parser.add_argument(
        "--sizes", type=float, nargs=2, default=SIZES, help="of effects, in noise levels"
    )
    parser.add_argument("--processes", type=int, default=1, choices=(1, 2))
    options = parser.parse_args(arguments)
    low, high = options.sizes
    asked = [(options.seed * 100_000 + n, (low, high)) for n in range(options.cases)]
    print(f"{len(asked)} simulated sensors, seed {options.seed}, sizes {low:g} to {high:g}")
    judged = []
    with open_pool(options.processes) as pool:
        for one in pool.map(judge_case, asked):
            judged.append(one)
            print(f"\r{len(judged)} done", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    report(judged)
    return 0


if __name__ == "__main__":
    sys.exit(main())
