"""What loads do to the drift, and what it takes to learn it, on the six-axis twin.

All data are simulated. Training logs are those of the study's "loaded" set (six chamber cycles,
twelve bench logs) with loaded chamber cycles of one kind or another. What the load adds to the
drift is known in a simulation: codes with the load less codes without it, at the same temperatures.
The table shows by how much the model's load part misses that, in multiples of the noise floor, all
axes pooled, medians over specimens. One thermometer; lags found as in training.

- pairs: test runs of the protocol `chamber_loaded`, two directions loaded at a time, ten pairs
- oblique: all six directions loaded at once
"""

import argparse
import itertools
from collections.abc import Mapping, Sequence
from functools import cache, partial

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import EffectConfig
from zerodrift.dataset.runs import Run
from zerodrift.export.float_model import predict_fed_back
from zerodrift.physics.fit import fit
from zerodrift.physics.model import PhysicalModel
from zerodrift.train.front_end import TEMPERATURE
from zerodrift.train.lag_bank.fit import LoadPart, fit_loads, prepare, see_loads
from zerodrift.train.lag_bank.model import POWERS
from zerodrift.train.lag_bank.search import Rows, choose_bank, pick, solve_ridge
from zerodrift_lab.methods import METHODS, Options
from zerodrift_lab.paper.plan import DEFAULT
from zerodrift_lab.paper.world import (
    PERIOD_S,
    TEST_SEED,
    TRAIN_SEED,
    pool_floor,
    record_test,
    record_training,
)
from zerodrift_lab.twin.sensor import FULL_SCALE, OUTPUTS, UNITS
from zerodrift_lab.twin.six_axis import (
    Recording,
    draw_sensor,
    load_protocol,
    parse_protocol,
    record,
    to_run,
)

OBLIQUE = """\
title Thermal chamber, one cycle with weights that load all six directions at once
room 20..26 degC
airflow 25 W/m2K
wait 60..180 s
air 54..62 degC at 2..5 K/min
repeat 6
  wait 60..120 s
  {load}
  wait 120..240 s
  load none
end
air -22..-14 degC at 2..5 K/min
repeat 10
  wait 60..120 s
  {load}
  wait 120..240 s
  load none
end
wait 300 s
""".format(
    load="\n  ".join(
        f"load {axis} {size}"
        for axis, size in (
            ("Fz", "100..400 N"),
            ("Fx", "-100..100 N"),
            ("Fy", "-100..100 N"),
            ("Mx", "-2..2 Nm"),
            ("My", "-2..2 Nm"),
            ("Mz", "-3..3 Nm"),
        )
    )
)
"""As many holds as `chamber_loaded` has."""
TESTS = ("pairs", "oblique")
CHOSEN = "chosen on runs left out"
WAYS: Mapping[str, tuple[tuple[int, ...], float | None]] = {
    "no load terms": ((0,), None),
    "gain linear in T": ((1,), None),
    "the same and load products": ((2,), None),
    "the same, not differenced": ((2,), 0.0),
    "gain to T^2, products times T": ((4,), None),
    CHOSEN: (tuple(range(len(POWERS))), None),
}
BASES: Mapping[str, tuple[str, ...]] = {
    "gain by u, u^2": ("1", "u", "u2"),
    "gain by u, products": ("1", "u", "products"),
    "gain by u, u^2, products by u": ("1", "u", "u2", "products", "products u"),
    "gain by the body's temperature, products": ("1", "body", "products"),
    "gain by u, squares of the couplers' codes": ("1", "u", "squares of codes"),
    "gain by u, products, cubes": ("1", "u", "products", "cubes"),
}
"""Of the load's part; u is the chip's temperature."""
CODES, RIDGE = 3000.0, 1e-4


@cache
def record_one(sensor: int, kind: str, name: str, seed: int) -> Recording:
    """Return a loaded run of a specimen."""
    protocol = load_protocol("chamber_loaded")
    if kind == "oblique":
        protocol = parse_protocol(OBLIQUE, "oblique", "oblique")
    return record(draw_sensor(sensor), protocol, name=name, seed=seed, period_s=PERIOD_S)


def list_training(sensor: int, kind: str, count: int) -> list[Run]:
    """Return the unloaded training runs and so many loaded ones."""
    loaded = [record_one(sensor, kind, f"{kind}_{n + 1}", TRAIN_SEED) for n in range(count)]
    return [*record_training(sensor, "varied", False), *(to_run(one) for one in loaded)]


def measure(sensor: int, part: LoadPart, physics: PhysicalModel, rows: Rows) -> list[float]:
    """Return the load part's error over the floor of each of `TESTS`."""
    twin = draw_sensor(sensor)
    found = []
    for kind in TESTS:
        error = floor = 0.0
        for n in (1, 2):
            one = record_one(sensor, kind, f"test_{kind}_{n}", TEST_SEED)
            bare = twin.to_load(twin.sense(np.zeros_like(one.load), one.nodes))
            seen = see_loads(to_run(one), physics, rows.data.scales[0], part.terms)
            missed = seen @ part.coefficients - (one.drift - bare)
            error += float(np.sum(np.mean((missed / rows.unit) ** 2, axis=0)))
            floor += float(np.sum((one.floor / rows.unit) ** 2))
        found.append(float(np.sqrt(error / floor)))
    return found


def study(sensor: int, kind: str, count: int, ways: Sequence[str]) -> list[list[float]]:
    """Return the errors [way][test] with so many loaded runs of a kind among the training runs."""
    runs = list_training(sensor, kind, count)
    effects = (EffectConfig("dark_current"),)
    physics = fit(
        effects, runs, outputs=OUTPUTS, units=UNITS, full_scale=tuple(FULL_SCALE.tolist())
    )
    prepared = prepare(physics, runs, (TEMPERATURE,))
    lags = pick(choose_bank(prepared.rows)).lags
    found = []
    for way in ways:
        choice, alike = WAYS[way]
        part = fit_loads(physics, runs, prepared.raw, lags, choice=choice, alike=alike)
        found.append(measure(sensor, part, physics, prepared.raw))
    return found


def see_basis(sensor: int, one: Recording, basis: str) -> Array:
    """Return the columns [n, J] of one of `BASES`, the same for all outputs."""
    twin = draw_sensor(sensor)
    load = one.reference / FULL_SCALE
    codes = twin.to_codes(one.reference) / CODES
    u = (one.temperature_degC[:, None] - 20.0) / 40.0
    body = (one.body_temperature_degC[:, None] - 20.0) / 40.0
    pairs = itertools.combinations_with_replacement(range(len(OUTPUTS)), 2)
    products = np.stack([load[:, k] * load[:, m] for k, m in pairs], axis=1)
    parts = {
        "1": load,
        "u": load * u,
        "u2": load * u**2,
        "body": load * body,
        "products": products,
        "products u": products * u,
        "cubes": load**3,
        "squares of codes": codes**2,
    }
    return np.concatenate([parts[name] for name in BASES[basis]], axis=1)


def study_bases(sensor: int) -> list[list[float]]:
    """Return RMSE over floor [basis][test] where the drift without load is known exactly."""
    twin = draw_sensor(sensor)

    def left(one: Recording) -> Array:
        bare = twin.to_load(twin.sense(np.zeros_like(one.load), one.nodes))
        return np.asarray(one.measured - one.reference - bare)

    runs = record_training(sensor, "varied", False)
    unit = np.concatenate([r.drift for r in runs if r.name.startswith("chamber_")]).std(axis=0)
    train = [record_one(sensor, "pairs", f"pairs_{n}", TRAIN_SEED) for n in (1, 2, 3)]
    found = []
    for basis in BASES:
        x = np.concatenate([see_basis(sensor, one, basis) for one in train])
        y = np.concatenate([left(one) for one in train])
        normal = x.T @ x
        solved = solve_ridge(normal, x.T @ y, RIDGE * np.diag(normal))
        errors = []
        for kind in TESTS:
            error = floor = 0.0
            for n in (1, 2):
                one = record_one(sensor, kind, f"test_{kind}_{n}", TEST_SEED)
                missed = (left(one) - see_basis(sensor, one, basis) @ solved) / unit
                error += float(np.sum(np.mean(missed**2, axis=0)))
                floor += float(np.sum((one.floor / unit) ** 2))
            errors.append(float(np.sqrt(error / floor)))
        found.append(errors)
    return found


def print_bases(sensors: Sequence[int]) -> None:
    """Print what bases of the load's part can do at best."""
    print("the same with the drift without load known exactly: RMSE / floor, every specimen")
    errors = np.array([study_bases(s) for s in sensors])
    for place, basis in enumerate(BASES):
        figures = "".join(
            f"   {test} " + ", ".join(f"{figure:.2f}" for figure in errors[:, place, at])
            for at, test in enumerate(TESTS)
        )
        print(f"{basis:<44}{figures}", flush=True)


def print_fed_back(sensors: Sequence[int]) -> None:
    """Print what it costs that the chip takes its loads from its own last drift."""
    print("RMSE / floor of the default, by true loads and by those of the chip")
    for sensor in sensors:
        runs = record_training(sensor, "loaded", False)
        options = Options(outputs=OUTPUTS, full_scale=tuple(FULL_SCALE.tolist()))
        fitted = METHODS[DEFAULT].fit(runs, seed=0, options=options)
        for test in ("chamber_loaded", "walking"):
            trials = record_test(sensor, test, False)
            unit = np.concatenate([trial.run.drift for trial in trials]).std(axis=0)
            floor = np.sqrt(np.mean((pool_floor(trials) / unit) ** 2))
            figures = []
            for predict in (fitted.predict, partial(predict_fed_back, fitted.predict)):
                missed = [trial.run.drift - predict(trial.run) for trial in trials]
                error = np.sqrt(np.mean((np.concatenate(missed) / unit) ** 2))
                figures.append(float(error / floor))
            print(f"specimen {sensor}, {test}: {figures[0]:.3f}, {figures[1]:.3f}", flush=True)


def main(sensors: Sequence[int]) -> None:
    """Print the table."""
    print(f"simulated; specimens {', '.join(map(str, sensors))}; error of the load part / floor")
    print(f"{'loaded runs':<14}{'load terms':<34}" + "".join(f"{test:>10}" for test in TESTS))
    for kind, count, ways in (
        ("pairs", 3, tuple(WAYS)),
        *(("pairs", count, (CHOSEN,)) for count in (1, 2, 6)),
        *(("oblique", count, (CHOSEN,)) for count in (1, 2, 3)),
    ):
        errors = np.median([study(s, kind, count, ways) for s in sensors], axis=0)
        for way, own in zip(ways, errors, strict=True):
            figures = "".join(f"{figure:10.2f}" for figure in own)
            print(f"{f'{count} {kind}':<14}{way:<34}{figures}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="The loads' part of the drift, and its logs.")
    parser.add_argument("--sensors", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--bases", action="store_true", help="bases at their best, alone")
    parser.add_argument("--fed-back", action="store_true", help="loads as the chip has them")
    given = parser.parse_args()
    if given.bases:
        print_bases(given.sensors)
    elif given.fed_back:
        print_fed_back(given.sensors)
    else:
        main(given.sensors)
