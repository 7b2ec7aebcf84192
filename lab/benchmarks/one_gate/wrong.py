"""Twenty-six kinds of wrong data, one training run of five spoilt, and whether they are told.

Each drawn case at least doubles the error that a plain model has on unseen runs (`harm`); one that
does not is drawn again with a larger fault, then with another sensor. Times in minutes and a part
cut out harm only where the model has a memory, and seldom; those that do are drawn.
"""

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from benchmarks.one_gate.draw import SIMULATORS, Wanted, draw_sensor
from benchmarks.one_gate.drive import Answer, Entry, ask
from benchmarks.one_gate.faults import KINDS, OF_TIME, Scene, UnfitError
from benchmarks.one_gate.harm import DOUBLE, weigh_harm
from benchmarks.one_gate.results import Row, scratch, tell_rate
from benchmarks.one_gate.sensor import TEMPERATURE, TIME, Array, Log, Sensor, write_csv

TRAIN = 5
SEEDS = 5
SIZES = (1.0, 2.0, 4.0)
DRAWS = 100
"""Sensors of one simulator that are tried before the next simulator is."""


@dataclass(frozen=True, eq=False)
class Case:
    """One spoilt project: the sensor before and after, the run, what may be said of it."""

    kind: str
    sound: Sensor
    spoilt: Sensor
    run: str
    columns: tuple[str, ...]
    words: str
    harm: float

    def fits(self, entry: Entry) -> bool:
        """Whether an entry names run, column and fault."""
        return (
            entry.of_data
            and is_run(entry.run, self.run)
            and (not entry.column or any(name in entry.column for name in self.columns))
            and re.search(self.words, f"{entry.kind} {entry.text}".replace("_", " "), re.I)
            is not None
        )


def is_run(told: str, name: str) -> bool:
    """Whether a run that is told is the log of a name, or a part of it."""
    return told == name or told.startswith((f"{name}.", f"{name}#", f"{name}@", f"{name}["))


def draw_wrong(kind: str, seed: int) -> Case:
    """Return a case of a kind that at least doubles the error on unseen runs.

    Raises:
        RuntimeError: none was found; the kind is to be replaced.
    """
    start = list(KINDS).index(kind) + seed
    for turn in range(len(SIMULATORS)):
        simulator = SIMULATORS[(start + turn) % len(SIMULATORS)]
        for attempt in range(DRAWS):
            rng = np.random.default_rng([seed, start, turn, attempt])
            wanted = Wanted(
                seed=int(rng.integers(2**31)),
                train=TRAIN,
                tests=int(rng.choice([0, 2])),
                dwell=bool(rng.random() < 0.5),
                lacks=bool(rng.random() < 0.25),
                coarse_K=float(rng.choice([0.0, 0.0, 0.0, 0.0625, 0.5])),
                memory=kind in OF_TIME,
            )
            sensor = draw_sensor(simulator, wanted)
            if sensor is None:
                continue
            for size in SIZES:
                case = _spoil(kind, sensor, np.random.default_rng(wanted.seed), size)
                if case is not None and case.harm >= DOUBLE:
                    return case
    raise RuntimeError(f"{kind}: no case of seed {seed} doubles the error on unseen runs")


def _spoil(kind: str, sensor: Sensor, rng: np.random.Generator, size: float) -> Case | None:
    change, words = KINDS[kind]
    runs = sensor.select("train")
    log = runs[int(rng.integers(len(runs)))]
    copied = {name: values.copy() for name, values in log.columns.items()}
    scene = Scene(sensor, copied, rng, size)
    try:
        change(scene)
    except UnfitError:
        return None
    spoilt = sensor.with_log(Log(log.name, log.use, scene.columns))
    return Case(
        kind=kind,
        sound=sensor,
        spoilt=spoilt,
        run=log.name,
        columns=tuple(_list_names(sensor, scene.touched)),
        words="|".join([words, *scene.shown]),
        harm=weigh_harm(sensor, spoilt),
    )


def _list_names(sensor: Sensor, touched: list[str]) -> list[str]:
    """Return the names by which these columns may be told: their own, the output's, the role's."""
    names = list(touched)
    names += [o.name for o in sensor.outputs if {o.measured, o.reference} & {*touched}]
    names += [name for name, column in sensor.inputs.items() if column in touched]
    names += ["temperature", "thermometer"] * (TEMPERATURE in touched)
    names += ["time"] * (TIME in touched)
    return list(dict.fromkeys(names))


RIGHT, OTHER, GATE, UNSAID, READ, WRITTEN, CRASH = (
    *("right", "another kind, run or column", "by the gate alone", "stopped without an entry"),
    *("when read (exit code 2)", "not stopped", "crashed"),
)


def judge(case: Case, answer: Answer) -> str:
    """Return what became of a case."""
    entries = answer.list_entries("refused")
    if answer.code == 0:
        return WRITTEN
    if answer.code == 2:
        return READ
    if answer.code != 1:
        return CRASH
    if any(case.fits(entry) for entry in entries):
        return RIGHT
    if not entries:
        return UNSAID
    return OTHER if any(entry.of_data for entry in entries) else GATE


def examine(kind: str, seed: int) -> Row:
    """Draw a case, run `firmware` on it, and return what became of it."""
    case = draw_wrong(kind, seed)
    with scratch() as folder:
        case.spoilt.write(folder)
        answer = ask(folder, "firmware")
        entries = answer.list_entries("refused")
        row: Row = {
            "simulator": case.sound.simulator,
            "run": case.run,
            "columns": case.columns,
            "harm": case.harm,
            "outcome": judge(case, answer),
            "entries": [vars(entry) for entry in entries],
            "message": answer.message[:300],
        }
        if row["outcome"] == WRITTEN:
            row["left"] = measure_written(case.sound, folder)
        return row


def measure_written(sound: Sensor, folder: Path) -> float | None:
    """Return error of the written firmware over that of none, on unseen runs; the worst output.

    None where `apply` does not answer.
    """
    logs = sound.select("test", "spare")[:2]
    left: list[list[Array]] = [[] for _ in sound.outputs]
    none: list[list[Array]] = [[] for _ in sound.outputs]
    for log in logs:
        write_csv(log.columns, folder / "unseen.csv")
        told = folder / "applied.csv"
        if ask(folder, "apply", str(folder / "unseen.csv"), "--out", str(told)).code != 0:
            return None
        applied = pl.read_csv(told)
        for k, output in enumerate(sound.outputs):
            drift = sound.drift(log.columns, k)
            said = applied[f"{output.name}_drift"].to_numpy()
            if said.size != drift.size:
                return None
            rows = sound.tare_rows
            error = drift - said
            if rows:
                drift, error = drift - drift[:rows].mean(), error - error[:rows].mean()
            left[k].append(error)
            none[k].append(drift)
    return max(
        float(np.sqrt(np.mean(np.concatenate(a) ** 2) / np.mean(np.concatenate(b) ** 2)))
        for a, b in zip(left, none, strict=True)
    )


def tell(rows: list[Row]) -> None:
    """Print how each kind was judged, the names that were met, and every case that is not right."""
    print("one training run of five is wrong (simulated); right: run, column and fault are named")
    for kind in KINDS:
        mine = [row for row in rows if row["kind"] == kind]
        if not mine:
            continue
        met = Counter(entry["kind"] for row in mine for entry in row["entries"] if _of_data(entry))
        words = ", ".join(f"{name} {count}" for name, count in met.most_common())
        right = sum(row["outcome"] == RIGHT for row in mine)
        print(f"{kind:38s} right {right} of {len(mine)}   named: {words or '-'}")
    for row in rows:
        if row["outcome"] == RIGHT:
            continue
        where = f"{row['simulator']}, {row['run']}"
        print(f"{row['kind']}, seed {row['seed']} ({where}): {row['outcome']}")
        left = row.get("left")
        if left is not None:
            worse = "WORSE than none" if left > 1.0 else "better than none"
            print(f"    the firmware leaves {left:.2f} of what no compensation leaves: {worse}")
        for entry in row["entries"][:4]:
            where = f"{entry['run'] or 'gate'} {entry['column']}"
            print(f"    {where} {entry['kind']}: {entry['text'][:150]}")
        if row["message"] and row["outcome"] in (READ, CRASH, UNSAID):
            print(f"    {row['message'][:200]}")
    for outcome in (RIGHT, OTHER, GATE, UNSAID, READ, WRITTEN, CRASH):
        count = sum(row["outcome"] == outcome for row in rows)
        print(f"{outcome:38s} {tell_rate(count, len(rows), upper=outcome != RIGHT)}")
    stopped = sum(row["outcome"] != WRITTEN for row in rows)
    print(f"{'stopped at all':38s} {tell_rate(stopped, len(rows), upper=False)}")
    print(f"{sum(row['cpu_s'] for row in rows):.0f} s of processor time")


def _of_data(entry: Mapping[str, str]) -> bool:
    return bool(entry["run"] or entry["column"])
