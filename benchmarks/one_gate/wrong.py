"""Twenty-six kinds of wrong data, one training run of five spoilt, and whether they are told.

Each drawn case at least doubles the error that a plain model has on unseen runs (`harm`); one that
does not is drawn again with a larger fault, then with another sensor. Times in minutes and a part
cut out harm only where the model has a memory, and seldom; those that do are drawn.
"""

import re
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import polars as pl

from benchmarks.one_gate.draw import SIMULATORS, Wanted, draw_sensor
from benchmarks.one_gate.drive import Answer, Entry, ask
from benchmarks.one_gate.harm import DOUBLE, fit_plainly, weigh_harm
from benchmarks.one_gate.results import Row, scratch, tell_rate
from benchmarks.one_gate.sensor import TEMPERATURE, TIME, Array, Log, Sensor, write_csv

TRAIN = 5
SEEDS = 5
SIZES = (1.0, 2.0, 4.0)
DRAWS = 100
"""Sensors of one simulator that are tried before the next simulator is."""


@dataclass
class Scene:
    """A training run that is being spoilt.

    Attributes:
        sensor: as it is without the fault.
        columns: of the run, changed in place.
        rng: draws.
        size: of the fault; 1 at first.
        touched: columns that are wrong, or that look wrong as well as the wrong one does.
        shown: text that names the fault as well as the kind's words do.
    """

    sensor: Sensor
    columns: dict[str, Array]
    rng: np.random.Generator
    size: float
    touched: list[str] = field(default_factory=list)
    shown: list[str] = field(default_factory=list)

    def take_output(self, *, loaded: bool = False) -> int:
        """Return an output to spoil, with a load that moves where that is asked for.

        Raises:
            UnfitError: there is none.
        """
        able = [k for k in range(len(self.sensor.outputs)) if not loaded or self._moves(k)]
        if not able:
            raise UnfitError("no output with a load")
        return int(self.rng.choice(able))

    def _moves(self, output: int) -> bool:
        name = self.sensor.outputs[output].reference
        return name is not None and float(np.ptp(self.columns[name])) > 0.02 * (
            self.sensor.outputs[output].full_scale
        )

    def measured(self, output: int) -> str:
        """Return the measured column of an output, and note that it is touched."""
        self.touched.append(self.sensor.outputs[output].measured)
        return self.touched[-1]

    def reference(self, output: int) -> str:
        """Return the reference column of an output; with it the measured one may be blamed.

        Of the two columns a log tells only how they stand to each other.
        """
        told = self.sensor.outputs[output]
        assert told.reference is not None
        self.touched += [told.measured, told.reference]
        return told.reference

    def row(self) -> int:
        """Return a row in the middle of the run."""
        return int(self.rng.uniform(0.3, 0.7) * self.columns[TEMPERATURE].size)


MEMORY = ("thermal_lag", "thermal_gradient", "thermal_hysteresis", "creep", "warm_up", "humidity")
"""Effects whose columns follow from what was before, so that times matter."""


class UnfitError(Exception):
    """This sensor cannot have the fault."""


def _scale(*factors: float) -> Callable[[Scene], None]:
    def spoil(scene: Scene) -> None:
        k = scene.take_output()
        scene.columns[scene.measured(k)] *= float(scene.rng.choice(factors))

    return spoil


def _convert(change: Callable[[Array], Array], *, midway: bool = False) -> Callable[[Scene], None]:
    def spoil(scene: Scene) -> None:
        warm = scene.columns[TEMPERATURE]
        first = scene.row() if midway else 0
        warm[first:] = change(warm[first:])
        scene.touched.append(TEMPERATURE)

    return spoil


def _swap_outputs(scene: Scene) -> None:
    if len(scene.sensor.outputs) < 2:
        raise UnfitError("one output")
    one, two = scene.rng.permutation(len(scene.sensor.outputs))[:2].tolist()
    _exchange(scene, scene.measured(one), scene.measured(two))
    for k in (one, two):  # or the references are
        if scene.sensor.outputs[k].reference:
            scene.reference(k)


def _swap_references(scene: Scene) -> None:
    with_load = [k for k, output in enumerate(scene.sensor.outputs) if output.reference]
    if len(with_load) < 2:
        raise UnfitError("fewer than two references")
    one, two = scene.rng.permutation(with_load)[:2].tolist()
    _exchange(scene, scene.reference(one), scene.reference(two))


def _swap_thermometer(scene: Scene) -> None:
    others = [c for name, c in scene.sensor.inputs.items() if name != "clock"]
    if not others:
        raise UnfitError("no other channel")
    other = str(scene.rng.choice(others))
    scene.touched += [TEMPERATURE, other]
    _exchange(scene, TEMPERATURE, other)


def _exchange(scene: Scene, one: str, two: str) -> None:
    scene.columns[one], scene.columns[two] = scene.columns[two], scene.columns[one]


def _foreign_column(scene: Scene) -> None:
    k = scene.take_output()
    others = [o.measured for n, o in enumerate(scene.sensor.outputs) if n != k]
    others += [*scene.sensor.inputs.values(), TEMPERATURE]
    scene.columns[scene.measured(k)] = scene.columns[str(scene.rng.choice(others))].copy()


def _another_unit(scene: Scene) -> None:
    for k, output in enumerate(scene.sensor.outputs):
        terms = scene.sensor.basis(scene.columns, k)
        own = fit_plainly(scene.sensor, k)[: terms.shape[1]]
        other = own * scene.rng.normal(0.0, 0.5 * scene.size, own.size)
        added = terms @ other
        rows = scene.sensor.tare_rows
        scene.columns[output.measured] += added - (added[:rows].mean() if rows else 0.0)
        scene.measured(k)


def _stick(scene: Scene) -> None:
    values = scene.columns[scene.measured(scene.take_output())]
    first = scene.row()
    last = min(values.size, first + int(0.2 * scene.size * values.size))
    values[first:last] = values[first]


def _freeze(scene: Scene) -> None:
    warm = scene.columns[TEMPERATURE]
    first = int(scene.rng.uniform(0.1, 0.6) * warm.size)
    warm[first : first + warm.size // 3] = warm[first]
    scene.touched.append(TEMPERATURE)


def _clip_output(scene: Scene) -> None:
    values = scene.columns[scene.measured(scene.take_output())]
    share = 0.1 * scene.size
    if scene.rng.random() < 0.5:
        values[:] = np.minimum(values, np.quantile(values, 1.0 - share))
    else:
        values[:] = np.maximum(values, np.quantile(values, share))


def _clip_thermometer(scene: Scene) -> None:
    warm = scene.columns[TEMPERATURE]
    if not 0.2 < float(np.mean(warm > 25.0)) < 0.8:
        raise UnfitError("not on both sides of 25 degC")
    warm[:] = np.minimum(warm, 25.0)
    scene.touched.append(TEMPERATURE)


def _wrap(scene: Scene) -> None:
    values = scene.columns[scene.measured(scene.take_output())]
    span = float(scene.rng.uniform(0.5, 0.8) * np.ptp(values)) / scene.size**0.5
    low = float(np.quantile(values, 0.05))
    values[:] = low + np.mod(values - low, span)


def _zero_again(scene: Scene) -> None:
    k = scene.take_output()
    row = scene.row()
    values = scene.columns[scene.measured(k)]
    values[row:] -= values[row : row + 5].mean()


def _mark(*, stretches: bool) -> Callable[[Scene], None]:
    def spoil(scene: Scene) -> None:
        rng, thermometer = scene.rng, scene.rng.random() < 0.5
        if thermometer:
            column, markers = TEMPERATURE, [-127.0, 85.0, -200.0]
            scene.touched.append(column)
        else:
            column, markers = scene.measured(scene.take_output()), [9999.0, -200.0, -9999.0]
        values = scene.columns[column]
        beyond = [m for m in markers if not values.min() <= m <= values.max()]
        if not beyond:
            raise UnfitError("every marker is a value")
        marker = float(rng.choice(beyond))
        share = 0.02 * scene.size
        hit = rng.random(values.size) < share
        if stretches:
            hit[:] = False
            for _ in range(3):
                first = int(rng.integers(values.size))
                hit[first : first + max(5, int(share * values.size))] = True
        values[hit] = marker
        scene.shown.append(rf"(?<![\d.]){marker:.0f}(?!\d)")

    return spoil


def _reverse_reference(scene: Scene) -> None:
    scene.columns[scene.reference(scene.take_output(loaded=True))] *= -1.0


def _delay_reference(scene: Scene) -> None:
    values = scene.columns[scene.reference(scene.take_output(loaded=True))]
    rows = int(scene.rng.uniform(60.0, 300.0) * scene.size / scene.sensor.period_s)
    if not 3 <= rows <= values.size // 4:
        raise UnfitError("minutes are too short or too long here")
    values[rows:] = values[:-rows].copy()
    values[:rows] = values[0]


def _miss_reference(scene: Scene) -> None:
    scene.columns[scene.reference(scene.take_output(loaded=True))][:] = 0.0


def _spike(scene: Scene) -> None:
    values = scene.columns[scene.measured(scene.take_output())]
    hit = scene.rng.random(values.size) < 0.005 * scene.size
    size = float(np.ptp(values)) * scene.rng.uniform(0.5, 2.0, values.size) * scene.size
    values[hit] += (size * scene.rng.choice([-1.0, 1.0], values.size))[hit]


def _need_memory(scene: Scene) -> None:
    if not any(effect["kind"] in MEMORY for effect in scene.sensor.effects):
        raise UnfitError("nothing follows time")


def _tell_minutes(scene: Scene) -> None:
    _need_memory(scene)
    for column in {TIME, scene.sensor.inputs.get("clock", TIME)}:
        scene.columns[column] /= 60.0
        scene.touched.append(column)


def _cut_out(scene: Scene) -> None:
    _need_memory(scene)
    time = scene.columns[TIME]
    first = int(scene.rng.uniform(0.2, 0.5) * time.size)
    last = int(np.searchsorted(time, time[first] + 1000.0 * scene.size))
    if not first + 5 <= last <= 0.8 * time.size:
        raise UnfitError("the run is too short, or its rows are too far apart")
    lost_s = time[last] - time[first]
    time[last:] -= lost_s
    scene.columns = {name: np.delete(v, slice(first, last)) for name, v in scene.columns.items()}
    scene.touched += scene.columns


GAIN = r"gain|factor|scale|unit\b|units\b|times (as|too)"
SWAP = r"swap|exchang|interchang|permut"
STUCK = r"stuck|frozen|froze|constant|repeat|stands still|does not move|one value|same value"
MARK = r"sentinel|marker|missing|no value|placeholder|no reading|error code|stands for"
SIGN = r"\bsign|revers|invert|opposite|negat"
CLIP = r"satur|clip|\brail|cut off|limit"
KINDS: dict[str, tuple[Callable[[Scene], None], str]] = {
    "sign reversed": (_scale(-1.0), SIGN),
    "gain 2": (_scale(2.0), GAIN),
    "gain 0.5": (_scale(0.5), GAIN),
    "output in another unit": (_scale(9.80665, 1 / 9.80665, 1000.0, 0.001, 4.44822), GAIN),
    "degF read as degC": (
        _convert(lambda t: 1.8 * t + 32.0),
        r"fahrenheit|degF|°F|temperature.unit|another unit|gain|offset",
    ),
    "kelvin read as degC": (
        _convert(lambda t: t + 273.15),
        r"kelvin|273|temperature.unit|another unit|offset",
    ),
    "degC becomes degF": (
        _convert(lambda t: 1.8 * t + 32.0, midway=True),
        r"fahrenheit|degF|°F|temperature.unit|another unit",
    ),
    "swapped outputs": (_swap_outputs, SWAP),
    "foreign column": (
        _foreign_column,
        r"foreign|another (column|channel|signal|quantity)|same as|copy of|holds|" + SWAP,
    ),
    "thermometer and a channel exchanged": (_swap_thermometer, r"foreign|" + SWAP),
    "another unit's run": (
        _another_unit,
        r"(another|other|different|not this).(sensor|unit|specimen|device)",
    ),
    "stuck output": (_stick, STUCK),
    "frozen thermometer": (_freeze, STUCK),
    "clipped output": (_clip_output, CLIP),
    "clipped thermometer": (_clip_thermometer, CLIP + "|" + STUCK),
    "counter that wraps": (_wrap, r"wrap|overflow|roll|modulo"),
    "zeroed again in mid-run": (_zero_again, r"zero|tare|offset|jump|\bstep"),
    "markers, scattered": (_mark(stretches=False), MARK),
    "markers, in stretches": (_mark(stretches=True), MARK + "|" + STUCK),
    "references exchanged": (_swap_references, SWAP),
    "reference reversed": (_reverse_reference, SIGN),
    "reference late": (
        _delay_reference,
        r"\blate\b|delay|\blag|behind|ahead|shifted in time|\bearly",
    ),
    "reference missing": (
        _miss_reference,
        r"missing|no reference|does not (move|follow)|unloaded|all zero|is zero|are zero|" + STUCK,
    ),
    "spikes": (_spike, r"spike|outlier|glitch|impuls|lone|isolated"),
    "minutes read as seconds": (
        _tell_minutes,
        r"minute|time.unit|unit of (the )?time|too (fast|slow)|faster|slower|times as (fast|slow)",
    ),
    "1000 s cut out": (
        _cut_out,
        r"cut out|stitch|\bgap|left out|splice|joined|jump|discontinu|lost|rows? (is|are) missing",
    ),
}
"""Kind -> what is done to a run, and words, one of which must stand in an entry's kind or text."""


OF_TIME = ("minutes read as seconds", "1000 s cut out")
"""Kinds that harm only a model with a memory."""


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


RIGHT, OTHER, GATE, READ, WRITTEN, CRASH = (
    *("right", "another kind, run or column", "by the gate alone"),
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
        if row["message"] and row["outcome"] in (READ, CRASH):
            print(f"    {row['message'][:200]}")
    for outcome in (RIGHT, OTHER, GATE, READ, WRITTEN, CRASH):
        count = sum(row["outcome"] == outcome for row in rows)
        print(f"{outcome:38s} {tell_rate(count, len(rows), upper=outcome != RIGHT)}")
    stopped = sum(row["outcome"] != WRITTEN for row in rows)
    print(f"{'stopped at all':38s} {tell_rate(stopped, len(rows), upper=False)}")
    print(f"{sum(row['cpu_s'] for row in rows):.0f} s of processor time")


def _of_data(entry: Mapping[str, str]) -> bool:
    return bool(entry["run"] or entry["column"])
