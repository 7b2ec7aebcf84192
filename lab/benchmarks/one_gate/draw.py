"""Sensors drawn from each of the three simulators, in one form."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from benchmarks.foreign import case as foreign_case
from benchmarks.foreign import effects as foreign_effects
from benchmarks.foreign.world import Run as ForeignRun
from benchmarks.one_gate.sensor import (
    TEMPERATURE,
    TIME,
    Array,
    Columns,
    Effect,
    Log,
    Output,
    Sensor,
)
from benchmarks.third_simulator import draw_case
from benchmarks.third_simulator.families import INPUTS as THIRD_INPUTS
from benchmarks.third_simulator.families import NEEDED
from zerodrift.base.errors import InputError
from zerodrift_lab.twin import EffectChoice, Recipe, simulate
from zerodrift_lab.twin.project import CHANNEL_COLUMNS
from zerodrift_lab.twin.sensor import FULL_SCALE, OUTPUTS, UNITS

SIMULATORS = ("twin", "foreign", "third")
SPARE = 8
"""Runs beyond training that are simulated: two tests, and four times as many to look again."""
COARSE_K = (0.0625, 0.1, 0.5)
"""Steps of thermometers: DS18B20 (12 bits), common climate loggers, LM35 on a slow converter."""
HIDDEN = {
    "twin": ("thermal_lag", "creep", "warm_up", "thermal_gradient", "supply_sensitivity"),
    "foreign": ("thermal_lag", "span_tempco", "creep", "thermal_gradient", "humidity"),
    "third": ("thermal_lag", "warm_up", "supply_sensitivity", "thermal_gradient", "humidity"),
}
"""Effects that the told model may lack."""


@dataclass(frozen=True)
class Wanted:
    """What a sensor is drawn for.

    Attributes:
        seed: decides all that is not asked for.
        train: training runs.
        tests: of the unseen runs, those that the project names; 0 = one run is left out.
        dwell: whether a dwell is logged.
        lacks: whether the told model lacks an effect.
        coarse_K: step of the thermometer; 0 = the simulator's own.
        memory: whether a twin's told model has a lag in any case.
    """

    seed: int
    train: int
    tests: int = 0
    dwell: bool = True
    lacks: bool = False
    coarse_K: float = 0.0
    memory: bool = False


def draw_sensor(simulator: str, wanted: Wanted) -> Sensor | None:
    """Return a sensor, or None where the simulator cannot make what was drawn."""
    make = {"twin": _draw_twin, "foreign": _draw_foreign, "third": _draw_third}[simulator]
    sensor = make(wanted, np.random.default_rng([wanted.seed, SIMULATORS.index(simulator)]))
    if sensor is not None and wanted.coarse_K:
        sensor = coarsen(sensor, wanted.coarse_K)
    return sensor


def coarsen(sensor: Sensor, step_K: float) -> Sensor:
    """Return the sensor with a thermometer that tells multiples of a step."""
    logs = []
    for log in sensor.logs:
        told = np.round(np.round(log.columns[TEMPERATURE] / step_K) * step_K, 6)
        logs.append(replace(log, columns={**log.columns, TEMPERATURE: told}))
    return replace(sensor, logs=tuple(logs))


def replace_tests(sensor: Sensor, count: int) -> Sensor:
    """Return the sensor with so many of the unseen runs told as test logs."""
    logs, unseen = [], 0
    for log in sensor.logs:
        if log.use in ("test", "spare"):
            use, unseen = ("test" if unseen < count else "spare"), unseen + 1
            logs.append(replace(log, use=use))
        else:
            logs.append(log)
    return replace(sensor, logs=tuple(logs))


def _use(number: int, wanted: Wanted) -> str:
    return "test" if number < wanted.tests else "spare"


def follow(values: Array, tau_s: float, step_s: float) -> Array:
    """Return a signal (rows,) behind by a time constant, at rest at its first row."""
    keep = float(np.exp(-step_s / tau_s))
    moved = lfilter([1.0 - keep], [1.0, -keep], values - values[0])
    return np.asarray(values[0] + moved)


def _draw_twin(wanted: Wanted, rng: np.random.Generator) -> Sensor | None:
    lagging = bool(rng.random() < 0.4) or wanted.memory
    hidden = [name for name in HIDDEN["twin"] if not (lagging and name == "thermal_lag")]
    lacks = str(rng.choice(hidden)) if wanted.lacks else ""
    told = ["zero_tempco", "dark_current"] + ["thermal_lag"] * lagging
    channels = [n for n in ("supply", "humidity", "body_temperature") if rng.random() < 0.5]
    if lacks == "supply_sensitivity" and "supply" not in channels:
        channels.append("supply")
    kinds = ["chamber"] * (wanted.train + SPARE)
    if wanted.train >= 6 and rng.random() < 0.5:
        kinds[wanted.train - 1] = str(rng.choice(["heating", "cooling", "cold_start"]))
    recipe = Recipe(
        seed=wanted.seed,
        train=tuple(kinds[: wanted.train]),
        test=tuple(kinds[wanted.train :]),
        dwell=wanted.dwell,
        told=tuple(EffectChoice(name) for name in told),
        hidden=(EffectChoice(lacks, size=float(rng.choice([1.0, 3.0, 10.0]))),) if lacks else (),
        sample_period_s=2.0,
        duration_s=float(rng.choice([1500.0, 2400.0, 3600.0])),
        tare=str(rng.choice(["start", "none"])),
        channels=tuple(channels),
    )
    try:
        made = simulate(recipe)
    except InputError:
        return None
    chosen = sorted(rng.permutation(6)[: int(rng.choice([1, 2, 3, 6]))].tolist())
    outputs = tuple(
        Output(
            OUTPUTS[k],
            f"{OUTPUTS[k]}_{UNITS[k]}",
            f"ref_{OUTPUTS[k]}_{UNITS[k]}",
            UNITS[k],
            float(FULL_SCALE[k]),
        )
        for k in chosen
    )
    logs, tests = [], 0
    for run in made.runs:
        columns = {TIME: run.time_s, TEMPERATURE: run.temperature_degC}
        for output, k in zip(outputs, chosen, strict=True):
            columns[output.measured] = run.measured[:, k]
            columns[str(output.reference)] = run.reference[:, k]
        columns |= {CHANNEL_COLUMNS[name]: values for name, values in run.channels.items()}
        use = _use(tests, wanted) if run.use == "test" else run.use
        tests += run.use == "test"
        logs.append(Log(run.name, use, columns))
    parameters = made.physics.parameters

    def basis(columns: Columns, output: int) -> Array:
        felt = columns[TEMPERATURE]
        if lagging:
            felt = follow(felt, float(parameters["thermal_lag"]["tau_s"]), 2.0)
        warm = felt - 25.0
        doubling_K = float(parameters["dark_current"]["doubling_K"])
        return np.stack([warm, 2.0 ** (warm / doubling_K)], axis=1)

    return Sensor(
        simulator="twin",
        outputs=outputs,
        inputs={name: CHANNEL_COLUMNS[name] for name in channels},
        period_s=2.0,
        effects=tuple({"kind": name} for name in told),
        logs=tuple(logs),
        tare_rows=5 if recipe.tare == "start" else 0,
        basis=basis,
        lacks=lacks,
    )


FOREIGN_COLUMNS = {
    "supply": "supply_V",
    "humidity": "humidity_pct",
    "ambient_light": "light_lux",
    "acceleration_x": "ax_mps2",
    "acceleration_y": "ay_mps2",
    "acceleration_z": "az_mps2",
    "clock": "clock_s",
}


def _draw_foreign(wanted: Wanted, rng: np.random.Generator) -> Sensor | None:
    lacks = str(rng.choice(HIDDEN["foreign"])) if wanted.lacks else ""
    recipe = foreign_case.Recipe(
        "effect" if lacks else "complete",
        (lacks,) if lacks else (),
        float(rng.choice([1.0, 3.0])),
        wanted.train + SPARE,
        wanted.seed,
    )
    try:
        case = foreign_case.draw(recipe)
    except RuntimeError:
        return None
    runs = case.runs[:-1]
    loaded = [k for k in range(len(case.units)) if any(np.any(run.loads[:, k]) for run in runs)]
    outputs = tuple(
        Output(f"q{k}", f"raw{k}", f"true{k}" if k in loaded else None, unit, case.full_scale[k])
        for k, unit in enumerate(case.units)
    )
    needed = {foreign_effects.CHANNEL_OF[n] for n in case.truth if n in foreign_effects.CHANNEL_OF}
    if "acceleration_x" in needed:
        needed |= {"acceleration_y", "acceleration_z"}
    usual = {n for n in ("supply", "humidity", "clock") if rng.random() < 0.3}
    channels = [name for name in FOREIGN_COLUMNS if name in needed | usual]
    logs = []
    for index, (run, measured) in enumerate(zip(case.runs, case.measured, strict=True)):
        seen = run.as_logged(foreign_case.LSB_DEGC)
        columns = {TIME: seen.time_s, TEMPERATURE: seen.temperature_degC}
        for k, output in enumerate(outputs):
            columns[output.measured] = measured[:, k]
            if output.reference:
                columns[output.reference] = seen.loads[:, k]
        courses = {**seen.channels, "clock": run.start_s + seen.time_s}
        columns |= {FOREIGN_COLUMNS[name]: courses[name] for name in channels}
        is_dwell = index == len(runs)
        if is_dwell and not wanted.dwell:
            continue
        use = "train" if index < wanted.train else _use(index - wanted.train, wanted)
        logs.append(Log(run.name, "dwell" if is_dwell else use, columns))
    told, full_scale = case.told, case.full_scale

    def basis(columns: Columns, output: int) -> Array:
        still = np.zeros(columns[TIME].size)
        loads = [columns[o.reference] if o.reference else still for o in outputs]
        seen = ForeignRun(
            "",
            columns[TIME],
            columns[TEMPERATURE],
            np.stack(loads, axis=1),
            {n: columns[FOREIGN_COLUMNS[n]] for n in channels},
            0.0,
            1,
        )
        return np.concatenate(
            list(foreign_effects.columns(seen, told, output, full_scale[output]).values()), axis=1
        )

    effects: list[Effect] = []
    for name, values in told.items():
        order = int(values.get("order", 1))
        effects.append({"kind": name, "order": order} if order > 1 else {"kind": name})
    return Sensor(
        simulator="foreign",
        outputs=outputs,
        inputs={name: FOREIGN_COLUMNS[name] for name in channels},
        period_s=case.period_s,
        effects=tuple(effects),
        logs=tuple(logs),
        tare_rows=5 if case.tared else 0,
        basis=basis,
        lacks=lacks,
    )


def _draw_third(wanted: Wanted, rng: np.random.Generator) -> Sensor | None:
    lacks = str(rng.choice(HIDDEN["third"])) if wanted.lacks else ""
    try:
        case = draw_case(
            wanted.seed,
            effect=lacks or None,
            runs=max(2, wanted.train),
            tests=SPARE,
            dwell=wanted.dwell,
            size=float(rng.choice([1.0, 3.0, 10.0])),
            noise=str(rng.choice(["white", "flicker", "mixed", "coarse"])),
            temperature_rows=int(rng.choice([1, 1, 1, 10])),
        )
    except ValueError:
        return None
    unit, full_scale = case.family.unit, case.full_scale
    outputs = tuple(
        Output(n, f"{n}_measured", f"{n}_reference" if case.loaded else None, unit, full_scale)
        for n in case.outputs
    )
    logs, trained, tested = [], 0, 0
    for log in case.logs:
        use = log.use
        if use == "train":
            use, trained = ("train" if trained < wanted.train else "spare"), trained + 1
        elif use == "test":
            use, tested = _use(tested, wanted), tested + 1
        logs.append(Log(log.name, use, log.columns))
    kinds = {str(table["kind"]): table for table in case.base}

    def basis(columns: Columns, output: int) -> Array:
        warm = (columns[TEMPERATURE] - 25.0) / 30.0
        terms = [warm**power for power in range(1, int(kinds["zero_tempco"]["order"]) + 1)]
        if "span_tempco" in kinds:
            load = columns[str(outputs[output].reference)]
            terms += [load, load * warm]
        for kind in kinds:
            if kind in NEEDED:
                terms += [columns[THIRD_INPUTS[name]] for name in NEEDED[kind]]
        return np.stack(terms, axis=1)

    return Sensor(
        simulator="third",
        outputs=outputs,
        inputs={name: THIRD_INPUTS[name] for name in case.inputs},
        period_s=case.period_s,
        effects=case.base,
        logs=tuple(logs),
        tare_rows=0,
        basis=basis,
        lacks=lacks,
    )
