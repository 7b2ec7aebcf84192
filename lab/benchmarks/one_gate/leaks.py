"""A test run that is a training run in disguise: is it told?

Told means: `compare` has a note, or `firmware` refuses, with the test run named and the training
run beside it, or with words for a copy. The same sets without the leak must get no such entry.
"""

import re
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.one_gate.draw import SIMULATORS, Wanted, draw_sensor
from benchmarks.one_gate.drive import Answer, ask
from benchmarks.one_gate.results import Row, scratch, tell_rate
from benchmarks.one_gate.sensor import TIME, Columns, Log, Sensor

SEEDS = 4
SHIFT_S = 0.37
"""By how much the rows of a resampled copy lie beside those of the original."""
KINDS = ("copied", "resampled", "noise added", "excerpt", "renamed, other times")
COPY = r"cop(y|ied|ies)|same|identical|duplicate|excerpt|part of|shared|contained|overlap|also in"


@dataclass(frozen=True, eq=False)
class Leak:
    """A set whose first test run was made from a training run."""

    sensor: Sensor
    test: str
    source: str


def draw_leak(kind: str, seed: int) -> tuple[Sensor, Leak]:
    """Return a sound set with two test runs, and the same with the first of them a copy."""
    place = KINDS.index(kind)
    for attempt in range(100):
        rng = np.random.default_rng([seed, place, attempt])
        simulator = SIMULATORS[(seed + place + attempt) % len(SIMULATORS)]
        wanted = Wanted(int(rng.integers(2**31)), train=4, tests=2, dwell=bool(rng.random() < 0.5))
        sensor = draw_sensor(simulator, wanted)
        if sensor is not None:
            test = sensor.select("test")[0]
            source = sensor.select("train")[int(rng.integers(4))]
            columns = disguise(kind, sensor, source.columns, rng)
            name = "walk_in_march" if kind == KINDS[4] else test.name
            logs = tuple(
                Log(name, "test", columns) if log.name == test.name else log for log in sensor.logs
            )
            return sensor, Leak(replace(sensor, logs=logs), name, source.name)
    raise RuntimeError(f"{kind}: no sensor for seed {seed}")


def disguise(
    kind: str, sensor: Sensor, columns: Columns, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Return a training run's columns as a leak of this kind has them."""
    made = {name: values.copy() for name, values in columns.items()}
    time = made[TIME]
    if kind == "resampled":
        grid = np.arange(time[0] + SHIFT_S, time[-1], sensor.period_s)
        made = {name: np.interp(grid, time, values) for name, values in made.items()}
        made[TIME] = grid
    elif kind == "noise added":
        for output in sensor.outputs:
            values = made[output.measured]
            noise = float(np.std(np.diff(values))) / np.sqrt(2.0)
            made[output.measured] = values + noise * rng.standard_normal(values.size)
    elif kind == "excerpt":
        first = int(rng.uniform(0.1, 0.4) * time.size)
        made = {name: v[first : first + time.size // 2] for name, v in made.items()}
        made[TIME] = made[TIME] - made[TIME][0]
    elif kind == "renamed, other times":
        made[TIME] = time + 86_400.0
        if "clock" in sensor.inputs:
            made[sensor.inputs["clock"]] = made[sensor.inputs["clock"]] + 86_400.0
    return made


def is_told(leak: Leak, compare: Answer, firmware: Answer) -> bool:
    """Whether an answer says that the test run is the training run, or a copy."""
    for entry in (*compare.list_entries("notes"), *firmware.list_entries("refused")):
        told = f"{entry.run} {entry.kind} {entry.text}".replace("_", " ")
        test, source = leak.test.replace("_", " "), leak.source.replace("_", " ")
        if test in told and (source in told or re.search(COPY, told, re.I)):
            return True
    message = "" if firmware.told else firmware.message
    return leak.test in message and leak.source in message


def examine(kind: str, seed: int) -> Row:
    """Draw a leak, run `compare` and `firmware`, and `compare` on the set without it."""
    sound, leak = draw_leak(kind, seed)
    with scratch() as folder:
        leak.sensor.write(folder)
        compare, firmware = ask(folder, "compare"), ask(folder, "firmware")
    with scratch() as folder:
        sound.write(folder)
        before = ask(folder, "compare")
    test = sound.select("test")[0].name
    control = Leak(sound, test, leak.source)
    return {
        "simulator": sound.simulator,
        "test": leak.test,
        "source": leak.source,
        "told": is_told(leak, compare, firmware),
        "stopped": firmware.stopped,
        "falsely": is_told(control, before, Answer(0)),
        "notes": [vars(entry) for entry in compare.list_entries("notes")],
        "refused": [vars(entry) for entry in firmware.list_entries("refused")],
        "messages": [compare.message[:200], firmware.message[:200]],
    }


def tell(rows: list[Row]) -> None:
    """Print how each kind of leak was told, and those that were not."""
    for kind in KINDS:
        mine = [row for row in rows if row["kind"] == kind]
        stopped = sum(row["stopped"] for row in mine)
        print(
            f"{kind:22s} told {sum(row['told'] for row in mine)} of {len(mine)},"
            f" firmware stopped {stopped}"
        )
    for row in rows:
        if not row["told"] or row["falsely"]:
            words = "NOT told" if not row["told"] else "told without a leak"
            print(f"{row['kind']}, seed {row['seed']} ({row['simulator']}): {words}")
            for entry in (*row["notes"], *row["refused"])[:4]:
                print(
                    f"    {entry['run']} {entry['column']} {entry['kind']}: {entry['text'][:150]}"
                )
    print("leaks told (simulated)", tell_rate(sum(r["told"] for r in rows), len(rows), upper=False))
    falsely = sum(row["falsely"] for row in rows)
    print("the same sets without the leak", tell_rate(falsely, len(rows), upper=True), "falsely")
    print(f"{sum(row['cpu_s'] for row in rows):.0f} s of processor time")
