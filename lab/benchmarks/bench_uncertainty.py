"""How often the expanded uncertainty covers the error on test runs: `python -m benchmarks NAME`.

Sensors of two simulators, each with its own training runs: the uncertainty comes from those alone,
and is held against runs that no model saw. Physics as it is told, half of them with a lag bank.
Then a few sensors of the first simulator whose model has one effect alone, so that a GRU learns the
rest: there the network is trained again without each run.
Then real sensors, each run left out in turn (`real_units`): one run is one observation, since the
errors along a run are alike, and the interval is Clopper and Pearson's, the share of a run that is
covered being its success.
"""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import beta

from benchmarks.foreign import case, files
from benchmarks.real_units import DATA, UNITS, UNSEEN, RealUnit, leave_out_each
from zerodrift.base.arrays import Array
from zerodrift.base.config import Config, NetworkConfig, load_config
from zerodrift.base.errors import CheckError
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.run_errors import collect_errors
from zerodrift.export.compose import (
    compose_integer_model,
    count_elapsed,
    describe_compensator,
    encode_inputs,
)
from zerodrift.tasks.apply import UNSTATED, Chip, measure_beyond
from zerodrift.train.prepare import Handling
from zerodrift.train.refits import Original
from zerodrift.train.training import train
from zerodrift.verify.left_out import LeftOut, leave_out_together
from zerodrift.verify.uncertainty import measure_uncertainty
from zerodrift_lab.twin import Recipe, simulate, write_logs

SENSORS = 100
"""Of each simulator; `quick`: 4."""
FIRST = 2000
"""Seed of the first sensor: those below were looked at while the model of uncertainty was made."""
NETWORKS = 20
"""Sensors whose rest a GRU learns; `quick`: 2."""
GRU = NetworkConfig(kind="gru", hidden=8)
RESAMPLES = 2000
HELD_OUT = 2
"""Runs of a foreign case that no model sees."""


def main(quick: bool, sensors: int = 0, first: int = FIRST, networks: int = 0) -> None:
    """Print the share of readings of test runs within the expanded uncertainty (k = 2).

    Args:
        quick: few sensors.
        sensors: as many of each simulator; 0 leaves it to `quick`.
        first: seed of the first sensor.
        networks: as many with a GRU; 0 leaves it to `quick`.
    """
    cover_networks(networks or (2 if quick else NETWORKS), first)
    sensors = sensors or (4 if quick else SENSORS)
    pooled: list[float] = []
    for name, draw in (("couplers", draw_twin), ("foreign", draw_foreign)):
        shares: list[float] = []
        refused = 0
        for seed in range(first, first + sensors):
            with tempfile.TemporaryDirectory() as scratch:
                config, dataset = draw(seed, Path(scratch))
                try:
                    kind = "lag_bank" if seed % 2 else "none"
                    shares += cover(config, dataset, NetworkConfig(kind=kind))
                except CheckError as error:
                    refused += 1
                    print(f"  {name} {seed}: no firmware, so nothing is stated: {error}")
        built = f"{sensors - refused} of {sensors} sensors"
        print(f"{name} (simulated), {built}: {describe(np.array(shares))}", flush=True)
        pooled += shares
    print(f"both: {describe(np.array(pooled))} (mark 93 to 97 %)")
    leave_out_real("real logs", UNITS[:1] if quick else UNITS)
    leave_out_real("real logs that nothing was chosen on", UNSEEN[:1] if quick else UNSEEN)


def leave_out_real(title: str, units: Sequence[RealUnit]) -> None:
    """Print the share of readings of real runs, each left out in turn, that is covered."""
    if not DATA.is_dir():
        print("real logs: skipped, shared/data is not beside the repository")
        return
    shares: list[float] = []
    for unit in units:
        with tempfile.TemporaryDirectory() as scratch:
            projects = leave_out_each(unit, Path(scratch))
            own = [s for c in projects for s in cover(c, load_dataset(c), NetworkConfig())]
        print(f"  {unit.name}: " + ", ".join(f"{share:.1%}" for share in own), flush=True)
        shares += own
    count, inside = len(shares), float(np.sum(shares))
    low = float(beta.ppf(0.025, inside, count - inside + 1.0))
    high = float(beta.ppf(0.975, inside + 1.0, count - inside)) if inside < count else 1.0
    print(
        f"{title}, {count} runs left out in turn: {inside / count:.1%} of their readings covered,"
        f" 95 % interval {low:.1%} to {high:.1%} (mark: it holds 95 %)"
    )


def draw_twin(seed: int, scratch: Path) -> tuple[Config, Dataset]:
    """Return a sensor of the project's own simulator."""
    recipe = Recipe(
        seed=41_000 + seed,
        train=("chamber",) * (4 + seed % 5),
        test=("chamber", "walking"),
        duration_s=1800.0,
    )
    write_logs(simulate(recipe), scratch)
    config = load_config(scratch)
    return config, load_dataset(config)


def draw_foreign(seed: int, scratch: Path) -> tuple[Config, Dataset]:
    """Return a sensor of the second simulator, its last runs kept for the test."""
    recipe = case.Recipe("complete", (), 1.0, 6 + seed % 5 + HELD_OUT, 52_000 + seed)
    config = load_config(files.write(case.draw(recipe), scratch))
    dataset = load_dataset(config)
    runs = [*dataset.train, *dataset.test]
    groups = list(dict.fromkeys(run.group for run in runs))
    kept = set(groups[-HELD_OUT:])
    return config, replace(
        dataset,
        train=tuple(run for run in runs if run.group not in kept),
        test=tuple(run for run in runs if run.group in kept),
    )


def cover_networks(sensors: int, first: int) -> None:
    """Print the coverage for sensors whose rest a GRU learns, a sensor being one observation."""
    shares: list[Array] = []
    for seed in range(first, first + sensors):
        with tempfile.TemporaryDirectory() as scratch:
            config, dataset = draw_twin(seed, Path(scratch))
            config = replace(config, effects=config.effects[:1])
            found = np.array(list(cover(config, dataset, GRU)))
        shares.append(found)
        print(f"  {seed}: {', '.join(f'{share:.1%}' for share in found)}", flush=True)
    rng = np.random.default_rng(0)
    means = np.array([own.mean() for own in shares if own.size])
    low, high = np.quantile(rng.choice(means, (RESAMPLES, means.size)).mean(axis=1), [0.025, 0.975])
    print(
        f"GRU({GRU.hidden}) beside one effect (simulated), {means.size} of {sensors} sensors:"
        f" {means.mean():.1%} of test readings covered, 95 % interval {low:.1%} to {high:.1%}"
        " over resampled sensors",
        flush=True,
    )


def cover(config: Config, dataset: Dataset, network: NetworkConfig) -> Iterator[float]:
    """Yield for each output the share of test readings within the expanded uncertainty."""
    config = replace(config, network=network)
    config.build_directory.mkdir(exist_ok=True)
    compensator = train(config, dataset).compensator
    described = describe_compensator(compensator, config, dataset.train)
    (left_out,) = leave_out_together([Original(config, dataset, compensator)], Handling())
    if not isinstance(left_out, LeftOut):
        return
    if network.kind == GRU.kind and compensator.network is None:
        return  # physics did as well
    model = compose_integer_model(described, config, dataset)
    scale = np.array([output.lsb_per_unit for output in model.outputs], dtype=np.float64)
    span = (np.array(model.drift.high) - np.array(model.drift.low)) / scale / 1.5
    none = [0.0] * len(scale)
    uncertainty = measure_uncertainty(
        described, dataset, left_out, model_hash=model.hash, rounding=none, span=span.tolist()
    )
    chip = Chip(model)
    predictions, beyond, stated = {}, {}, {}
    for run in dataset.test:
        codes = encode_inputs(model, run)
        drift, flags = chip.run(codes, count_elapsed(model, run))
        predictions[run.name] = drift / scale
        beyond[run.name] = measure_beyond(model, codes)
        stated[run.name] = flags & UNSTATED == 0
    errors = collect_errors(dataset.test, predictions, described.tared, described.find_usable)
    for k, known in enumerate(uncertainty.outputs.values()):
        inside, count = 0, 0
        for error in errors.values():
            expanded = known.expand(np.concatenate([beyond[run.name] for run in error.runs]))
            counts = error.usable[:, k] & np.concatenate([stated[run.name] for run in error.runs])
            inside += int(np.sum(np.abs(error.error[counts, k]) <= expanded[counts]))
            count += int(counts.sum())
        if count:
            yield inside / count


def describe(shares: Array) -> str:
    """Return the mean coverage with its interval over resampled outputs of sensors."""
    rng = np.random.default_rng(0)
    means = rng.choice(shares, (RESAMPLES, shares.size)).mean(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return (
        f"{shares.mean():.1%} of test readings covered, 95 % interval {low:.1%} to {high:.1%};"
        f" outputs below 90 %: {np.mean(shares < 0.9):.1%} of {shares.size}"
    )
