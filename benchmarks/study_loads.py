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
from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np

from zerodrift.config import EffectConfig
from zerodrift.dataset.runs import Run
from zerodrift.physics.fit import fit
from zerodrift.physics.model import PhysicalModel
from zerodrift.physics.twin.sensor import FULL_SCALE, OUTPUTS, UNITS
from zerodrift.physics.twin.six_axis import (
    Recording,
    draw_sensor,
    load_protocol,
    parse_protocol,
    record,
    to_run,
)
from zerodrift.report.paper.world import PERIOD_S, TEST_SEED, TRAIN_SEED, record_training
from zerodrift.train.front_end import TEMPERATURE
from zerodrift.train.lag_bank.fit import prepare
from zerodrift.train.lag_bank.loads import LoadPart, fit_loads, see_loads
from zerodrift.train.lag_bank.model import POWERS
from zerodrift.train.lag_bank.search import Rows, choose_bank, pick

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
    main(parser.parse_args().sensors)
