"""What dropouts in the logs cost: lag bank and GRU, with and without them. On the twin.

    python -m benchmarks.study_gaps [--dropouts 0 50 150] [--kinds lag_bank gru]

Runs of an hour lose eight seconds at so many random places; stretches of fewer than ten samples are
left out, as the reader of logs does. The sensor lags by 60 s, which the effects that the model is
told do not say. Printed is the held-out error in Fz. All data are simulated.
"""

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from zerodrift.dataset.runs import Dataset, Run
from zerodrift.train.training import train
from zerodrift_lab.twin import EffectChoice, Recipe, simulate
from zerodrift_lab.twin.project import to_config, to_dataset

LOST, SHORTEST = 8, 10
"""Samples of a dropout; of a stretch that is kept, at least."""
OUTPUT = "Fz"


def make_recipe(kind: str) -> Recipe:
    """Return the simulated project."""
    return Recipe(
        seed=0,
        train=("chamber", "heating", "cooling") * 3,
        test=("chamber", "heating", "cooling", "walking"),
        told=(EffectChoice("zero_tempco"), EffectChoice("dark_current")),
        hidden=(EffectChoice("thermal_lag", None, {"tau_s": 60.0}),),
        channels=(),
        network=kind,
    )


def interrupt(run: Run, dropouts: int, rng: np.random.Generator) -> list[Run]:
    """Return the stretches that are left of a run."""
    there = np.ones(len(run), dtype=bool)
    for start in rng.integers(SHORTEST, len(run) - LOST, dropouts):
        there[start : start + LOST] = False
    edges = np.flatnonzero(np.diff(np.concatenate([[False], there, [False]]).astype(int)))
    stretches: list[Run] = []
    for begin, end in edges.reshape(-1, 2):
        if end - begin < SHORTEST:
            continue
        before = stretches[-1] if stretches else None
        own = run.take(slice(begin, end))
        stretches.append(replace(own, part=len(stretches), before=before))
    return stretches


def interrupt_all(dataset: Dataset, dropouts: int) -> Dataset:
    """Return the dataset with dropouts in training and test runs."""
    rng = np.random.default_rng(1)

    def cut(runs: Sequence[Run]) -> tuple[Run, ...]:
        return tuple(part for run in runs for part in interrupt(run, dropouts, rng))

    return replace(dataset, train=cut(dataset.train), test=cut(dataset.test))


def main(dropouts: Sequence[int], kinds: Sequence[str]) -> None:
    """Print the table."""
    print("simulated; held-out RMSE in Fz, N")
    print(f"{'network':<10}{'dropouts':>9}{'none':>9}{'physics':>9}{'whole':>9}")
    for kind in kinds:
        simulation = simulate(make_recipe(kind))
        for count in dropouts:
            dataset = interrupt_all(to_dataset(simulation), count)
            with tempfile.TemporaryDirectory() as folder:
                trained = train(to_config(simulation, Path(folder)), dataset)
            errors = trained.scores.held_out
            k = trained.scores.outputs.index(OUTPUT)
            figures = (errors.uncompensated[k], errors.physics[k], errors.compensated[k])
            print(f"{kind:<10}{count:9d}" + "".join(f"{x:9.3f}" for x in figures), flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="What dropouts in the logs cost.")
    parser.add_argument("--dropouts", type=int, nargs="+", default=[0, 50, 150], help="per run")
    parser.add_argument("--kinds", nargs="+", default=["lag_bank", "gru"], help="[network] kind")
    given = parser.parse_args()
    main(given.dropouts, given.kinds)
