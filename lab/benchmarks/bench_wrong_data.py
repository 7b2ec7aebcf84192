"""Wrong data in one run of simulated logs: how often it is told, with run and column.

    python -m benchmarks.bench_wrong_data [--seeds N] [--first SEED] [--clean N] [--only KIND]

Each kind is put into one run of a simulated sensor's logs (`benchmarks.hidden`, a complete model or
one effect short of it); clean sets, with and without a missing effect, must get no note.
"""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from benchmarks.bench_conditions import bound
from benchmarks.hidden.cases import Case, make_recipe, read_simulation
from zerodrift.base.arrays import Array
from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.referee import review
from zerodrift_lab.twin.simulate import simulate

Spoil = Callable[[Run, Dataset, np.random.Generator], Run]
HIDDEN = ("", "", "thermal_lag", "creep", "warm_up", "supply_sensitivity", "thermal_gradient")


def _set(run: Run, k: int, values: Array) -> Run:
    measured = run.measured.copy()
    measured[:, k] = values
    return replace(run, measured=measured)


def _scale(factor: float) -> Spoil:
    return lambda run, _, rng: _set(run, 2, factor * run.measured[:, 2])


def _swap(run: Run, _: Dataset, rng: np.random.Generator) -> Run:
    order = [1, 0, *range(2, run.measured.shape[1])]
    return replace(run, measured=run.measured[:, order])


def _foreign(run: Run, _: Dataset, rng: np.random.Generator) -> Run:
    return _set(run, 2, run.measured[:, 0])


def _temperature(change: Callable[[Array], Array]) -> Spoil:
    return lambda run, _, rng: replace(run, temperature_degC=change(run.temperature_degC))


def _swap_thermometer(run: Run, _: Dataset, rng: np.random.Generator) -> Run:
    inputs = {**run.inputs, "humidity": run.temperature_degC}
    return replace(run, temperature_degC=run.inputs["humidity"], inputs=inputs)


def _minutes(run: Run, _: Dataset, rng: np.random.Generator) -> Run:
    return replace(run.take(slice(0, None, 60)), time_s=run.time_s[: -(-len(run) // 60)])


def _shift(share: float) -> Spoil:
    def spoil(run: Run, dataset: Dataset, rng: np.random.Generator) -> Run:
        row = int(rng.uniform(0.3, 0.7) * len(run))
        size = share * max(float(np.std(run.drift[:, 2])), 20.0 * _noise(dataset)[2])
        return _set(run, 2, run.measured[:, 2] + size * (np.arange(len(run)) >= row))

    return spoil


def _noise(dataset: Dataset) -> Array:
    return np.asarray(np.std(np.concatenate([run.drift for run in dataset.dwell]), axis=0))


def _freeze(whole: bool) -> Spoil:
    def spoil(run: Run, _: Dataset, rng: np.random.Generator) -> Run:
        t = run.temperature_degC.copy()
        first = 0 if whole else int(rng.uniform(0.2, 0.5) * t.size)
        t[first : t.size if whole else first + t.size // 3] = t[first]
        return replace(run, temperature_degC=t)

    return spoil


def _stick(run: Run, _: Dataset, rng: np.random.Generator) -> Run:
    x = run.measured[:, 2].copy()
    x[int(rng.uniform(0.5, 0.8) * x.size) :] = x[int(0.5 * x.size)]
    return _set(run, 2, x)


def _saturate(run: Run, dataset: Dataset, rng: np.random.Generator) -> Run:
    x = run.measured[:, 2]
    return _set(run, 2, np.minimum(x, np.quantile(x, 0.8)))


def _wrap(run: Run, _: Dataset, rng: np.random.Generator) -> Run:
    x = run.measured[:, 2]
    middle, span = np.quantile(x, 0.9), 2.0 * float(np.ptp(x))
    return _set(run, 2, np.where(x > middle, x - span, x))


def _other_sensor(run: Run, dataset: Dataset, rng: np.random.Generator) -> Run:
    warm = (run.temperature_degC - 25.0)[:, None] / 30.0
    size = np.std(np.concatenate([r.drift for r in dataset.train]), axis=0) + 20.0 * _noise(dataset)
    other = warm * rng.uniform(1.0, 3.0, size.size) * rng.choice([-1, 1], size.size)
    other += warm**2 * rng.uniform(-1.0, 1.0, size.size)
    return replace(run, measured=run.measured + size * other)


KINDS: dict[str, tuple[Spoil, str, str]] = {
    "gain x1000": (_scale(1000.0), "Fz", "gain"),
    "gain /1000": (_scale(0.001), "Fz", "gain"),
    "gain x2": (_scale(2.0), "Fz", "gain"),
    "gain x10": (_scale(10.0), "Fz", "gain"),
    "sign": (_scale(-1.0), "Fz", "sign"),
    "swapped outputs": (_swap, "Fx Fy", "swapped"),
    "foreign column": (_foreign, "Fz", "foreign_column"),
    "swapped thermometer": (_swap_thermometer, "temperature", "swapped"),
    "fahrenheit": (_temperature(lambda t: 1.8 * t + 32.0), "temperature", "fahrenheit"),
    "kelvin": (_temperature(lambda t: t + 273.15), "temperature", "kelvin"),
    "time in minutes": (_minutes, "time", "time_unit"),
    "offset jump": (_shift(1.0), "Fz", "offset_jump"),
    "large offset jump": (_shift(4.0), "Fz", "offset_jump"),
    "frozen thermometer": (_freeze(False), "temperature", "frozen"),
    "constant thermometer": (_freeze(True), "temperature", "constant"),
    "stuck output": (_stick, "Fz", "stuck"),
    "saturated output": (_saturate, "Fz", "saturated"),
    "wrapped output": (_wrap, "Fz", "wrapped"),
    "another sensor": (_other_sensor, "", "another_sensor"),
}
"""Name -> what is done to a run, the columns one of which must be named, and the kind expected."""
TEST_KINDS = ("test reaches further", "test too short")


def simulate_set(seed: int, hidden: str) -> Dataset | None:
    """Return simulated logs; None where the simulator cannot make the case."""
    rng = np.random.default_rng(seed)
    size = float(rng.choice([3.0, 10.0])) if hidden else 0.0
    effects = (hidden,) if hidden else ()
    case = Case("one" if hidden else "complete", effects, size, int(rng.integers(4, 11)), seed)
    try:
        return read_simulation(simulate(make_recipe(case)))
    except InputError:
        return None


def _keep_cold(run: Run) -> Run:
    """Return the longest stretch of a run in the colder half of its temperatures."""
    warm = run.temperature_degC
    cold = warm <= 0.5 * (warm.min() + warm.max())
    edges = np.flatnonzero(np.diff(np.concatenate([[0], cold.astype(int), [0]])))
    first, last = max(zip(edges[::2], edges[1::2], strict=True), key=lambda e: e[1] - e[0])
    return run.take(slice(int(first), int(last)))


def spoil_test(dataset: Dataset, kind: str) -> tuple[Dataset, str]:
    """Return the set with its last run as a test run, made further or shorter, and its name."""
    *train, last = dataset.train
    if kind == TEST_KINDS[0]:
        last = max(dataset.train, key=lambda run: float(run.temperature_degC.max()))
        train = [_keep_cold(run) for run in dataset.train if run is not last]
    else:
        last = last.take(slice(0, 12))
    return replace(dataset, train=tuple(train), test=(last,)), last.group


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the kinds and the clean sets, and print the rates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--clean", type=int, default=30)
    parser.add_argument("--only", default="")
    options = parser.parse_args(arguments)
    seconds: list[float] = []

    def look(dataset: Dataset) -> list[tuple[str, str, str]]:
        begin = time.process_time()
        notes = review(dataset)
        seconds.append(time.process_time() - begin)
        return [(note.run, note.column, note.kind) for note in notes]

    good = cases = 0
    seeds = range(options.first, options.first + options.seeds)
    sets = {s: simulate_set(s, HIDDEN[s % len(HIDDEN)]) for s in seeds}
    for name in (*KINDS, *TEST_KINDS):
        if options.only not in name:
            continue
        hits, missed = 0, []
        for seed, dataset in sets.items():
            if dataset is None:
                continue
            rng = np.random.default_rng(seed)
            columns, kind = "time temperature", ""
            if name in KINDS:
                spoil, columns, kind = KINDS[name]
                place = int(rng.integers(len(dataset.train)))
                train = list(dataset.train)
                run = train[place].group
                train[place] = spoil(train[place], dataset, rng)
                wrong = replace(dataset, train=tuple(train))
            else:
                wrong, run = spoil_test(dataset, name)
            found = look(wrong)
            told = [
                c for r, c, _ in found if r == run and (not columns or c.split()[-1] in columns)
            ]
            cases += 1
            hits += bool(told)
            if not told or (kind and kind not in {k for _, _, k in found}):
                missed.append((seed, run, found[:3]))
        good += hits
        print(f"{name:22s} {hits} of {len(sets)}  {missed or ''}", flush=True)
    if cases:
        print(
            f"told with run and column: {good} of {cases} ({100.0 * good / cases:.1f} %, at least "
            f"{100.0 * bound(good, cases, upper=False):.1f} %)"
        )
    false = clean = 0
    for seed in range(10 * options.first, 10 * options.first + options.clean):
        dataset = simulate_set(seed, HIDDEN[seed % len(HIDDEN)])
        if dataset is None:
            continue
        clean += 1
        found = look(dataset)
        false += bool(found)
        if found:
            print("clean set with a note:", seed, HIDDEN[seed % len(HIDDEN)], found[:3])
    if clean:
        print(
            f"clean sets with a note: {false} of {clean} (at most "
            f"{100.0 * bound(false, clean, upper=True):.1f} %)"
        )
    print(f"median {np.median(seconds):.2f} CPU s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
