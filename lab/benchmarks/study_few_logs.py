"""How often an effect is named of one or two logs: `NAMED_OF_FEWEST` of `discovery/criterion.py`.

    python -m benchmarks.study_few_logs [--file FILE] [--minutes M] [--seed N]

Plans of one or two logs alone, on sensors whose effect is as large as the plan was told. The offset
is the likeliest on a grid, with the prior of `study_likely`; the slope is that of few runs. All
logs are simulated, and the verdicts are those that it is fitted to: a judgement needs other seeds.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import patch

import numpy as np

from benchmarks.bench_plan import PAIRS, Key, Trial, choose_truth, run_trials
from benchmarks.study_likely import expect
from zerodrift.discovery import criterion, plan
from zerodrift.discovery.limits import Limits
from zerodrift.discovery.search import choose_spaces

PLANS = ((1, 1.0, 0.6), (2, 2.0, 0.5), (2, 1.25, 0.8), (1, 1.75, 0.45))
"""Logs, hours and size."""
TOLD = 5
"""Pairs, the first ones: zero_tempco and dark_current are hardly told apart in so few hours."""
BUDGET_S = 2.0
OFFSETS = np.arange(-2.0, 4.01, 0.25)
PRIOR_SPREAD = 2.0


def list_trials(hours: float, size: float, seed: int) -> Iterator[Key]:
    """Give the trials of one kind of plan: both effects of each pair."""
    for n in range(2):
        for p, pair in enumerate(PAIRS[:TOLD]):
            yield "sized", pair, choose_truth(pair, n), hours, size, seed + 2000 * n + 1001 * p


def run(seed: int, file: Path | None, minutes: float) -> list[Trial]:
    """Return the verdicts, as many as there is time for."""
    found = []
    for number, (logs, hours, size) in enumerate(PLANS):

        def choose(
            limits: Limits, hours: float, runs: int, few: object, logs: int = logs
        ) -> object:
            found = choose_spaces(limits, hours, runs, few=(logs,))
            return [space for space in found if space.logs == logs]

        with patch.object(plan, "choose_spaces", choose):
            wanted = list_trials(hours, size, seed + TOLD * number)
            found += run_trials(wanted, file, minutes / len(PLANS), BUDGET_S)
    return found


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seed", type=int, default=955000)
    parser.add_argument("--file", type=Path)
    parser.add_argument("--minutes", type=float, default=1e9)
    options = parser.parse_args()
    trials = run(options.seed, options.file, options.minutes)
    expected = [t.expected for t in trials if t.expected is not None]
    right, runs = np.array([t.right for t in trials]), np.array([t.runs for t in trials])
    slope = criterion.NAMED_OF_FEW[1]
    numbers = np.array([criterion.APART, criterion.NAMED, criterion.NAMED_OF_FEW, criterion.WORTH])
    print(f"simulated sensors, {len(trials)} verdicts, {right.sum()} right; slope {slope:g}")
    best, most = 0.0, -np.inf
    for offset in OFFSETS.tolist():
        p = np.clip(expect(expected, runs, numbers, (offset, slope)), 1e-4, 1.0 - 1e-4)
        worth = float(np.where(right, np.log(p), np.log(1.0 - p)).sum())
        worth -= 0.5 * (offset / PRIOR_SPREAD) ** 2
        print(f"offset {offset:5.2f}: {p.sum():5.1f} right expected, worth {worth:.2f}")
        best, most = (offset, worth) if worth > most else (best, most)
    print(f"likeliest offset {best:g}")


if __name__ == "__main__":
    main()
