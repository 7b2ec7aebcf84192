"""What an effect gains by chance where few runs speak: the evidence of `rules.SURE_NATS`.

Models that lack nothing but slow noise, in one run (`bench_slow`: random_walk, flicker, complete)
or in two to five (`bench_conditions`: runs_2 to runs_5 and without a dwell), and beside them models
that do lack an effect (memory, and PURPOSE one). Of each the best effect is told that `diagnose`
would name but for the size of its gain: sound values, a worthwhile error, a small p-value, next to
no loss.

    python -m benchmarks.study_evidence KIND [--count N] [--seed N]

KIND is one of `bench_slow`, or CONDITION:PURPOSE of `bench_conditions`. All logs are simulated.
"""

import argparse
from collections.abc import Iterator
from itertools import islice

import numpy as np

from benchmarks import bench_conditions, bench_slow
from benchmarks.hidden.cases import make_recipe, read_simulation
from zerodrift.base.config import EffectConfig
from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.case import open_case
from zerodrift.diagnosis.diagnose import look
from zerodrift.diagnosis.examination import Judged
from zerodrift.diagnosis.rules import SIGNIFICANT, SURE_SHARE, WORTHWHILE, WORTHWHILE_ON_ONE
from zerodrift.physics.catalogue import load_catalogue
from zerodrift_lab.twin.simulate import simulate

TOLD = 5


def list_models(kind: str, count: int, seed: int) -> Iterator[tuple[Dataset, list[EffectConfig]]]:
    """Give data sets with the model that is judged on them."""
    if ":" not in kind:
        for number in range(count):
            dataset = bench_slow.draw_record(kind, 1000 * seed + number, 5.0)[0]
            yield dataset, [EffectConfig("zero_tempco")]
        return
    name, purpose = kind.split(":")
    condition = bench_conditions.CONDITIONS[name]
    for case in islice(bench_conditions.list_cases(condition, purpose, seed), count):
        recipe = make_recipe(case)
        try:
            simulation = simulate(recipe)
        except InputError:
            continue
        dataset = bench_conditions.change(read_simulation(simulation), condition, case.seed)
        yield dataset, [EffectConfig(choice.name) for choice in recipe.told]


def list_passing(dataset: Dataset, effects: list[EffectConfig]) -> list[Judged]:
    """Return the effects that only the size of their gain keeps from being named."""
    case = open_case(dataset, load_catalogue(), effects)
    found = look(case, case.terms)
    return [
        j
        for j in found.judged
        if j.sound
        and j.gain > 0.0
        and (j.rmse_ratio <= WORTHWHILE or j.best_output_ratio <= WORTHWHILE_ON_ONE)
        and j.p_value <= max(SIGNIFICANT, 2.0 ** -float(j.gains.size))
        and j.positive_share >= SURE_SHARE
    ]


def main() -> None:
    """Print the largest gains in likelihood and in noise units."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind")
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    signal, alone, count = [], [], 0
    for dataset, effects in list_models(options.kind, options.count, options.seed):
        count += 1
        passing = list_passing(dataset, effects)
        signal += [max((j.nats for j in passing if j.follows_signal), default=0.0)]
        alone += [max((j.gain for j in passing if not j.follows_signal), default=0.0)]
    print(f"{options.kind}: {count} simulated models; the best effect of each that else passes")
    for name, values in (("nats, following a signal", signal), ("units, time alone", alone)):
        most = ", ".join(f"{x:.1f}" for x in sorted(values, reverse=True)[:TOLD])
        print(f"  {name}: largest {most}; median {np.median(values):.1f}, least {min(values):.1f}")


if __name__ == "__main__":
    main()
