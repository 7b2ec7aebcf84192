"""The advice on simulated logs of which the answer is known: `python -m benchmarks.study_advice`.

Each line is one kind of log over several specimens: which time constants were found, what a window
of ten samples leaves, and how many ways of heating the advice saw. All data are simulated.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zerodrift.base.config import Config, NetworkConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.advice import Advice, advise
from zerodrift_lab.twin.project import to_config, to_dataset
from zerodrift_lab.twin.recipe import EffectChoice, Recipe
from zerodrift_lab.twin.simulate import simulate
from zerodrift_lab.twin.six_axis import draw_sensor, load_protocol, record
from zerodrift_lab.twin.six_axis import to_config as to_six_config
from zerodrift_lab.twin.six_axis import to_dataset as to_six_dataset

CHAMBER = ("chamber",) * 6
MIXED = ("chamber",) * 4 + ("heating", "cooling") * 3
SIX_MIXED = ("chamber",) * 4 + ("standing", "heating", "lamp_steps") * 2
BODY = ("body_temperature",)
WINDOW = NetworkConfig("gru", memory=10, lags_s=(3.0,))


def main(quick: bool) -> None:
    """Print the study; `quick` is one specimen of each kind."""
    seeds = range(200, 201 if quick else 208)
    print(f"{len(seeds)} simulated specimens each; medians\n")
    print(
        f"{'logs':<52}{'lags found, s':>16}{'without memory':>15}{'10 x 1 s':>10}"
        f"{'one path':>10}{'perhaps':>9}{'several':>9}{'worst ratio':>14}"
    )
    for tau_s in (None, 20.0, 60.0, 150.0, 300.0):
        hidden = () if tau_s is None else (EffectChoice("thermal_lag", None, {"tau_s": tau_s}),)
        label = "no lag" if tau_s is None else f"lag of {tau_s:g} s"
        show(f"chamber, {label}", [make(CHAMBER, hidden, seed) for seed in seeds])
    hidden = (EffectChoice("thermal_lag", None, {"tau_s": 100.0}),)
    show("chamber, lamp, ice, lag of 100 s", [make(MIXED, hidden, seed) for seed in seeds])
    hidden = (EffectChoice("heat_path"),)
    show("chamber, hidden heat path", [make(CHAMBER, hidden, seed) for seed in seeds])
    show("chamber, lamp, ice, hidden heat path", [make(MIXED, hidden, seed) for seed in seeds])
    show(
        "the same with a second thermometer",
        [make(MIXED, hidden, seed, BODY) for seed in seeds],
    )
    show("six-axis twin, chamber", [make_six(CHAMBER, seed) for seed in seeds])
    show("six-axis twin, chamber, plates, lamp", [make_six(SIX_MIXED, seed) for seed in seeds])
    show(
        "the same with a second thermometer",
        [make_six(SIX_MIXED, seed, BODY) for seed in seeds],
    )


def make(
    train: Sequence[str],
    hidden: Sequence[EffectChoice],
    seed: int,
    channels: Sequence[str] = (),
) -> tuple[Config, Dataset]:
    """Return a project of the first twin."""
    simulation = simulate(
        Recipe(
            seed=seed,
            train=tuple(train),
            hidden=tuple(hidden),
            dwell=False,
            exercise=(),
            channels=tuple(channels),
        )
    )
    return to_config(simulation), to_dataset(simulation)


def make_six(
    train: Sequence[str], seed: int, channels: Sequence[str] = ()
) -> tuple[Config, Dataset]:
    """Return a project of the six-axis twin."""
    sensor, runs = draw_sensor(seed), []
    for kind in train:
        number = 1 + sum(run.protocol == kind for run in runs)
        name = f"{kind}_{number}"
        runs.append(record(sensor, load_protocol(kind), name=name, seed=1, period_s=1.0))
    return to_six_config(runs, channels=channels), to_six_dataset(runs, channels=channels)


def show(label: str, projects: Sequence[tuple[Config, Dataset]]) -> None:
    """Print one line."""
    found: list[Advice] = []
    for config, dataset in projects:
        advice = advise(replace(config, network=WINDOW), dataset)
        if advice is not None:
            found.append(advice)
    slowest = [max((t.tau_s for t in a.time_constants), default=0.0) for a in found]
    windows = [a.memory.window_ratio or 1.0 for a in found]
    ratios = [a.paths[0].ratio if a.paths else 1.0 for a in found]
    lags = f"{min(slowest):.3g} to {max(slowest):.3g}" if max(slowest) else "none"
    print(
        f"{label:<52}{lags:>16}{np.median([a.without_memory for a in found]):15.2f}"
        f"{np.median(windows):10.2f}{sum(a.heat == 'one' for a in found):10d}"
        f"{sum(a.heat == 'perhaps' for a in found):9d}"
        f"{sum(a.heat == 'several' for a in found):9d}"
        f"{f'{min(ratios):.2f} to {max(ratios):.2f}':>14}",
        flush=True,
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="The advice where the answer is known.")
    parser.add_argument("--quick", action="store_true", help="one specimen of each kind")
    main(parser.parse_args().quick)
