"""Clean sets of each simulator: none may be stopped as wrong data, few by the gate.

A set has 1 to 12 training runs, any number of outputs and inputs, a dwell or none, was tared or
not, has a fine or a coarse thermometer, and its model may lack an effect. A stop by the gate is
looked at again with four times the test runs of the same sensor.
"""

import numpy as np

from benchmarks.one_gate.draw import COARSE_K, SIMULATORS, SPARE, Wanted, draw_sensor, replace_tests
from benchmarks.one_gate.drive import Answer, ask
from benchmarks.one_gate.results import Row, scratch, tell_rate
from benchmarks.one_gate.sensor import Sensor

COUNT = 100
"""Sets of each simulator."""
MOST_TESTS = 2
AGAIN = SPARE // MOST_TESTS
"""Times the test runs by which a stop of the gate is looked at again."""
REFEREE, GATE, UNSAID, READ, PASSES, CRASH = (
    *("stopped as wrong data", "stopped by the gate", "stopped without an entry"),
    *("when read (exit code 2)", "written", "crashed"),
)


def draw_wanted(simulator: str, seed: int, attempt: int = 0) -> Wanted:
    """Return what a set is drawn for."""
    rng = np.random.default_rng([seed, SIMULATORS.index(simulator), attempt])
    return Wanted(
        seed=int(rng.integers(2**31)),
        train=int(rng.integers(1, 13)),
        tests=int(rng.integers(0, MOST_TESTS + 1)),
        dwell=bool(rng.random() < 0.5),
        lacks=bool(rng.random() < 0.4),
        coarse_K=float(rng.choice(COARSE_K)) if rng.random() < 0.25 else 0.0,
    )


def draw_clean(simulator: str, seed: int) -> Sensor:
    """Return a set without a fault."""
    for attempt in range(100):
        sensor = draw_sensor(simulator, draw_wanted(simulator, seed, attempt))
        if sensor is not None:
            return sensor
    raise RuntimeError(f"{simulator}: no sensor for seed {seed}")


def judge(answer: Answer) -> str:
    """Return what became of a clean set."""
    if answer.code in (0, 2):
        return PASSES if answer.code == 0 else READ
    if answer.code != 1:
        return CRASH
    entries = answer.list_entries("refused")
    if not entries:
        return UNSAID
    return REFEREE if any(entry.of_data for entry in entries) else GATE


def examine(simulator: str, seed: int) -> Row:
    """Draw a set, run `firmware` on it, and return what became of it."""
    sensor = draw_clean(simulator, seed)
    tests = len(sensor.select("test"))
    with scratch() as folder:
        sensor.write(folder)
        answer = ask(folder, "firmware")
    row: Row = {
        "outcome": judge(answer),
        "runs": len(sensor.select("train")),
        "tests": tests,
        "lacks": sensor.lacks,
        "tared": sensor.tare_rows > 0,
        "entries": [vars(entry) for entry in answer.list_entries("refused")],
        "message": answer.message[:300],
    }
    if row["outcome"] == GATE:
        more = replace_tests(sensor, AGAIN * max(1, tests))
        with scratch() as folder:
            more.write(folder)
            row["again"] = judge(ask(folder, "firmware"))
    return row


def tell(rows: list[Row]) -> None:
    """Print each set that was stopped, and the rates with their bounds."""
    for row in rows:
        if row["outcome"] == PASSES:
            continue
        lacks = f", lacks {row['lacks']}" if row["lacks"] else ""
        print(
            f"{row['kind']} {row['seed']} ({row['runs']} runs, {row['tests']} tests,"
            f" {'tared' if row['tared'] else 'not tared'}{lacks}): {row['outcome']}"
        )
        for entry in row["entries"][:3]:
            print(f"    {entry['run']} {entry['column']} {entry['kind']}: {entry['text'][:150]}")
        if row["outcome"] in (READ, CRASH, UNSAID):
            print(f"    {row['message'][:200]}")
        if "again" in row:
            print(f"    with {AGAIN} times the test runs: {row['again']}")
    for simulator in (*SIMULATORS, ""):
        mine = [row for row in rows if simulator in ("", row["kind"])]
        print(f"clean sets, {simulator or 'all three'} (simulated)")
        for outcome in (REFEREE, GATE, UNSAID, READ, CRASH):
            count = sum(row["outcome"] == outcome for row in mine)
            print(f"    {outcome:26s} {tell_rate(count, len(mine), upper=True)}")
        stays = sum(row.get("again") in (GATE, REFEREE) for row in mine)
        print(f"    {'of them again':26s} {tell_rate(stays, len(mine), upper=True)}")
    print(f"{sum(row['cpu_s'] for row in rows):.0f} s of processor time")
