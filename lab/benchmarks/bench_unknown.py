"""How long a verdict takes where nothing fits: 11 runs of 35,000 rows and six outputs.

Simulated logs of the six-axis sensor with something hidden that the catalogue lacks, and with an
effect that it knows. CPU seconds are those of `diagnose` alone, in one process with one thread.

    python -m benchmarks.bench_unknown [--hidden NAME] [--size X] [--seed N] [--rows N]
                                       [--no-dwell] [--profile]
"""

import argparse
import cProfile
import pstats
import sys
import time
from collections.abc import Sequence
from dataclasses import replace

from benchmarks.hidden.cases import OUTSIDE, read_simulation
from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.diagnose import diagnose
from zerodrift.diagnosis.diagnosis import Diagnosis
from zerodrift.diagnosis.plain_errors import tell_plain_errors
from zerodrift.physics.catalogue import load_catalogue
from zerodrift_lab.twin.recipe import EffectChoice, Recipe
from zerodrift_lab.twin.simulate import simulate

RUNS = 11
ROWS = 35_000
MARK_S = 15.0
HIDDEN = (*OUTSIDE, "creep")


def simulate_logs(hidden: str, size: float, seed: int, rows: int) -> tuple[Recipe, Dataset]:
    """Return the recipe and the logs."""
    recipe = Recipe(
        seed=seed,
        train=("chamber",) * RUNS,
        hidden=(EffectChoice(hidden),),
        size=size,
        duration_s=float(rows),
    )
    return recipe, read_simulation(simulate(recipe))


def measure(
    recipe: Recipe, dataset: Dataset, profiler: cProfile.Profile | None
) -> tuple[Diagnosis, float]:
    """Return the verdict and the CPU seconds that it took."""
    effects = [EffectConfig(choice.name) for choice in recipe.told]
    begin = time.process_time()
    found = profiler.runcall(judge, effects, dataset) if profiler else judge(effects, dataset)
    return found, time.process_time() - begin


def judge(effects: Sequence[EffectConfig], dataset: Dataset) -> Diagnosis:
    """Return the verdict with the errors that the command tells."""
    catalogue = load_catalogue()
    found = diagnose(effects, dataset, catalogue)
    return tell_plain_errors(found, effects, dataset, catalogue)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a line for each hidden effect."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hidden", action="append", choices=HIDDEN)
    parser.add_argument("--size", type=float, default=3.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rows", type=int, default=ROWS)
    parser.add_argument("--no-dwell", action="store_true")
    parser.add_argument("--profile", action="store_true")
    options = parser.parse_args(arguments)
    slowest = 0.0
    for hidden in options.hidden or HIDDEN:
        recipe, dataset = simulate_logs(hidden, options.size, options.seed, options.rows)
        if options.no_dwell:
            dataset = replace(dataset, dwell=())
        rows = min(len(run) for run in dataset.train)
        profiler = cProfile.Profile() if options.profile else None
        found, seconds = measure(recipe, dataset, profiler)
        print(
            f"{hidden:12s} {len(dataset.train)} runs x {rows} rows x {len(dataset.outputs)} "
            f"outputs: {found.verdict} {found.effect or found.nearest or ''}, "
            f"{seconds:.1f} CPU s",
            flush=True,
        )
        if profiler:
            pstats.Stats(profiler).sort_stats("cumulative").print_stats(45)
        if found.verdict == "unknown":
            slowest = max(slowest, seconds)
    verdict = "reached" if slowest <= MARK_S else "not reached"
    print(f"slowest unknown verdict {slowest:.1f} CPU s; mark {MARK_S:.0f}: {verdict} (simulated)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
