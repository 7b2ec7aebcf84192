"""The logs of a case, from any of the three simulators, as the loader reads them."""

import json
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.evidence.conditions import Ask
from benchmarks.foreign import case as foreign_case
from benchmarks.foreign import files
from benchmarks.hidden.cases import Case, make_recipe, read_simulation
from benchmarks.third_simulator import Case as ThirdCase
from benchmarks.third_simulator import Log, draw_case
from benchmarks.third_simulator.noise import draw_noise
from zerodrift.base.arrays import Array
from zerodrift.base.config import Config, load_config, parse_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.runs import Dataset, Run
from zerodrift_lab.twin.simulate import simulate

TEST_RUNS = 2


class CannotDrawError(Exception):
    """The simulator cannot make such a case."""


@dataclass(frozen=True, eq=False)
class Drawn:
    """A case's logs and what is known of them.

    Attributes:
        config: zerodrift.toml.
        dataset: training runs and the dwell.
        test: runs that no command sees.
        truth: test run -> true drift, shape (n, outputs); empty where the simulator tells none.
        noise: RMS of the noise, shape (outputs,).
        tared: whether every run was zeroed by itself.
        sensor: what it is.
    """

    config: Config
    dataset: Dataset
    test: tuple[Run, ...]
    truth: dict[str, Array]
    noise: Array
    tared: bool
    sensor: str


def draw(ask: Ask) -> Drawn:
    """Return the logs of a case.

    Raises:
        CannotDrawError: the simulator cannot make it.
        InputError: the loader refuses logs that it made.
    """
    if ask.simulator == 3:
        return _draw_third(ask)
    return _change(_draw_twin(ask) if ask.simulator == 1 else _draw_foreign(ask), ask)


def _draw_third(ask: Ask) -> Drawn:
    try:
        case = draw_case(
            ask.seed,
            runs=ask.runs,
            effect=ask.hidden,
            size=ask.size or 1.0,
            noise=ask.logs.noise,
            outliers=ask.logs.outliers,
            dwell=ask.logs.dwell,
        )
    except ValueError as error:
        raise CannotDrawError(str(error)) from None
    clean = []
    for log in case.logs:  # judged without its wild rows
        keep = ~log.wild.any(axis=1) if log.use == "test" else np.ones(len(log.wild), dtype=bool)
        columns = {name: values[keep] for name, values in log.columns.items()}
        clean.append(replace(log, columns=columns, drift=log.drift[keep]))
    config, dataset = _load(replace(case, logs=tuple(clean)))
    # What the loader makes of the true drift: it averages rows, and gaps make stretches.
    bare = replace(case, logs=tuple(_take_noise_off(case, log) for log in clean))
    truth = {run.name: run.drift for run in _load(bare)[1].test}
    return Drawn(
        config=config,
        dataset=replace(dataset, test=()),
        test=dataset.test,
        truth=truth,
        noise=np.array(case.truth.noise_rms),
        tared=False,
        sensor=case.family.name,
    )


def _load(case: ThirdCase) -> tuple[Config, Dataset]:
    with tempfile.TemporaryDirectory() as folder:
        case.write(Path(folder))
        config = load_config(Path(folder))
        return config, load_dataset(config)


def _take_noise_off(case: ThirdCase, log: Log) -> Log:
    """Return a log whose outputs are reference and true drift alone."""
    columns = dict(log.columns)
    for k, name in enumerate(case.outputs):
        reference = columns.get(f"{name}_reference", np.zeros(len(log.drift)))
        columns[f"{name}_measured"] = reference + log.drift[:, k]
    return replace(log, columns=columns)


def _draw_twin(ask: Ask) -> Drawn:
    case = Case(ask.purpose, ask.hidden, ask.size, ask.runs + TEST_RUNS, ask.seed)
    recipe = make_recipe(case)
    try:
        simulation = simulate(recipe)
    except InputError as error:
        raise CannotDrawError(str(error)) from None
    dataset = read_simulation(simulation)
    drifts = {run.name: run.drift for run in simulation.runs}
    test = dataset.train[ask.runs :]
    noise = [(run.drift - drifts[run.name]) for run in test]
    lines = ['[sensor]\nname = "twin"\ntime = "t"\ntemperature = "T"\nsample_period_s = 1.0']
    for name, unit, scale in zip(dataset.outputs, dataset.units, dataset.full_scale, strict=True):
        lines.append(
            f'[outputs.{name}]\nmeasured = "{name}"\nunit = "{unit}"\nfull_scale = {scale}'
        )
    lines.append('[logs]\ntrain = ["*.csv"]')
    lines += [f'[[effect]]\nkind = "{choice.name}"' for choice in recipe.told]
    return Drawn(
        config=parse_config("\n".join(lines) + "\n", Path("zerodrift.toml")),
        dataset=replace(dataset, train=dataset.train[: ask.runs]),
        test=test,
        truth={run.name: drifts[run.name] for run in test},
        noise=np.sqrt(np.mean(np.concatenate(noise) ** 2, axis=0)),
        tared=True,
        sensor="six-axis",
    )


def _draw_foreign(ask: Ask) -> Drawn:
    kind = {"one": "effect", "outside": "disturbance"}.get(ask.purpose, ask.purpose)
    recipe = foreign_case.Recipe(kind, ask.hidden, ask.size, ask.runs + TEST_RUNS, ask.seed)
    try:
        case = foreign_case.draw(recipe)
    except RuntimeError as error:
        raise CannotDrawError(str(error)) from None
    with tempfile.TemporaryDirectory() as folder:
        config = load_config(files.write(case, Path(folder)))
        dataset = load_dataset(config)
        told = json.loads((Path(folder) / "truth.json").read_text(encoding="utf-8"))
    runs = (*dataset.train, *dataset.test)
    groups = list(dict.fromkeys(run.group for run in runs))
    train = tuple(run for run in runs if run.group in groups[: ask.runs])
    return Drawn(
        config=config,
        dataset=replace(dataset, train=train, test=()),
        test=tuple(run for run in runs if run.group in groups[ask.runs :]),
        truth={},
        noise=np.array(told["noise_rms"], dtype=np.float64),
        tared=bool(told["tared"]),
        sensor="foreign",
    )


def _change(drawn: Drawn, ask: Ask) -> Drawn:
    """Return the logs of simulator 1 or 2 as the condition has them.

    Their own noise stays; noise of another kind comes on top, of the same RMS.
    """
    rng = np.random.default_rng([ask.seed, 5])
    noise, logs = drawn.noise, ask.logs

    def spoil(run: Run, wild: bool) -> Run:
        measured = run.measured.copy()
        if logs.noise == "coarse":
            measured = np.round(measured / (3.0 * noise)) * 3.0 * noise
        elif logs.noise != "white":
            for k, sigma in enumerate(noise):
                measured[:, k] += sigma * draw_noise(rng, len(run), logs.noise)
        if wild and logs.outliers:
            hit = rng.random(len(run)) < logs.outliers
            size = (int(hit.sum()), noise.size)
            measured[hit] += rng.choice([-1, 1], size) * rng.uniform(15, 60, size) * noise
        return replace(run, measured=measured)

    dataset = replace(
        drawn.dataset,
        train=tuple(spoil(run, wild=True) for run in drawn.dataset.train),
        dwell=tuple(spoil(run, wild=True) for run in drawn.dataset.dwell if logs.dwell),
    )
    added = {"white": 0.0, "coarse": 3.0 / np.sqrt(12.0)}.get(logs.noise, 1.0)
    return replace(
        drawn,
        dataset=dataset,
        test=tuple(spoil(run, wild=False) for run in drawn.test),
        noise=noise * np.sqrt(1.0 + added**2),
    )
