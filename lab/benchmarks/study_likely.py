"""The numbers of `discovery/criterion.py`: what fits verdicts on simulated sensors best.

    python -m benchmarks.study_likely [--file FILE] [--minutes M] [--seed N] [--plans N] [--draws N]

The trials are those of `bench_plan probability` with these seeds, 1, 2 and 910000 unless given, 60
plans for each and a budget of 2 s, as many as there is time for. Maximum likelihood, with a wide
Gaussian prior that a number keeps to where no verdict depends on it. Prints offsets and slopes in
their order there, then predicted and observed rates in four bands, on the trials that they were
fitted to: a judgement needs other seeds. With few logs two curves hold: one below ENOUGH_RUNS, and
NAMED_OF_FEWEST, which `study_few_logs` fits and which stays as it is, below MANY_RUNS.
"""

import argparse
import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from scipy.special import ndtr

from benchmarks.bench_plan import Expected, Trial, list_probability, run_trials
from zerodrift.base.arrays import Array
from zerodrift.diagnosis.judgement import MANY_RUNS
from zerodrift.diagnosis.rules import ENOUGH_RUNS
from zerodrift.discovery.criterion import MOST, NAMED_OF_FEWEST, logistic, tell_disguised

NAMES = ("APART", "NAMED", "NAMED_OF_FEW", "WORTH")
PRIOR = np.array([[-0.7, 1.5], [0.0, 4.0], [0.0, 4.0], [0.0, 4.0]])
SPREAD = np.array([[2.0, 1.0], [2.0, 2.0], [2.0, 2.0], [2.0, 2.0]])
BANDS = (0.0, 0.2, 0.5, 0.8, 1.0)
STARTS = 3


def expect(
    expected: Sequence[Expected],
    runs: Array,
    numbers: Array,
    fewest: tuple[float, float] = NAMED_OF_FEWEST,
) -> Array:
    """Return the probabilities [N] of the trials by these numbers [4, 2].

    Args:
        expected: what their plans expect.
        runs: [N] logs of each.
        numbers: offset and slope of NAMES.
        fewest: the same of what is named of fewer than MANY_RUNS.
    """

    def stack(name: str) -> Array:
        return np.array([getattr(one, name) for one in expected])

    def curve(name: str, x: Array) -> Array:
        offset, slope = numbers[NAMES.index(name)].tolist()
        return logistic(offset, slope, x)

    rise = stack("rise")
    few, least = (runs[:, None] < most for most in (ENOUGH_RUNS, MANY_RUNS))
    sure = np.where(few, curve("NAMED_OF_FEW", rise), curve("NAMED", rise))
    sure = np.where(least, logistic(*fewest, rise), sure)
    apart = curve("APART", stack("grow"))
    alone = tell_disguised(apart, stack("apart"), stack("disguised"))
    worth = curve("WORTH", stack("outgrow"))
    first = ndtr(0.5 * np.sqrt(stack("beside")))
    return np.asarray((MOST * alone * sure * worth * first).mean(axis=1))


def fit(trials: Sequence[Trial]) -> tuple[Array, Array]:
    """Return the numbers [4, 2], and the trials' probabilities [N] by them."""
    expected = [t.expected for t in trials if t.expected is not None]
    right = np.array([t.right for t in trials])
    runs = np.array([t.runs for t in trials])

    def cost(x: Array) -> float:
        numbers = x.reshape(PRIOR.shape)
        p = np.clip(expect(expected, runs, numbers), 1e-4, 1.0 - 1e-4)
        likelihood = np.where(right, np.log(p), np.log(1.0 - p)).sum()
        return float(0.5 * np.sum(((numbers - PRIOR) / SPREAD) ** 2) - likelihood)

    rng = np.random.default_rng(0)
    starts = [PRIOR.ravel() + 0.5 * rng.standard_normal(PRIOR.size) for _ in range(STARTS)]
    options = {"maxiter": 20_000, "maxfev": 20_000}
    found = [minimize(cost, x, method="Nelder-Mead", options=options) for x in starts]
    best = min(found, key=lambda one: float(one.fun))
    numbers = np.asarray(best.x).reshape(PRIOR.shape)
    return numbers, expect(expected, runs, numbers)


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seed", type=int, nargs="+", default=[1, 2, 910000])
    parser.add_argument("--plans", type=int, default=60)
    parser.add_argument("--draws", type=int, default=2)
    parser.add_argument("--file", type=Path)
    parser.add_argument("--minutes", type=float, default=1e9)
    options = parser.parse_args()
    seeds = [list_probability(seed, options.plans, options.draws) for seed in options.seed]
    wanted = itertools.chain.from_iterable(zip(*seeds, strict=True))
    trials = run_trials(wanted, options.file, options.minutes, 2.0)
    numbers, p = fit(trials)
    print(f"simulated sensors, {len(trials)} verdicts; offset and slope")
    for name, (offset, slope) in zip(NAMES, numbers.tolist(), strict=True):
        print(f"{name:14s} {offset:6.2f} {slope:6.2f}")
    right = np.array([t.right for t in trials])
    for low, high in itertools.pairwise(BANDS):
        here = (p >= low) & (p < high)
        if here.any():
            print(
                f"{low:.1f} .. {high:.1f}: {here.sum()} trials, predicted {p[here].mean():.3f}, "
                f"observed {right[here].mean():.3f}"
            )


if __name__ == "__main__":
    main()
