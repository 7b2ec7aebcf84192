"""From a specimen's physics to logs: rows, thermometer, converter, and each effect at its size."""

import zlib
from dataclasses import dataclass

import numpy as np

from benchmarks.third_simulator.case import Case, Log, Size, Truth
from benchmarks.third_simulator.effects import Scene
from benchmarks.third_simulator.families import INPUTS, Family
from benchmarks.third_simulator.heat import Array, Flags
from benchmarks.third_simulator.noise import Recorder
from benchmarks.third_simulator.outside import OUTSIDE
from benchmarks.third_simulator.programme import ROOM_DEGC, Run

THERMOMETER_K = 0.004
THERMOMETER_LSB_K = 0.0078125
RESOLUTION = {
    "supply": (0.0005, 0.0002),
    "humidity": (0.05, 0.01),
    "pressure": (0.02, 0.01),
    "ambient_light": (1.0, 1.0),
    "acceleration_x": (0.01, 0.004),
    "acceleration_y": (0.01, 0.004),
    "acceleration_z": (0.01, 0.004),
    "body_temperature": (THERMOMETER_K, THERMOMETER_LSB_K),
    "clock": (0.0, 0.001),
}
"""Input -> RMS of its noise and its step, in the unit of its column."""


@dataclass(frozen=True)
class Asked:
    """What a case was asked to be."""

    seed: int
    family: Family
    effects: tuple[str, ...]
    size: float
    temperature_rows: int

    def stream(self, name: str) -> np.random.Generator:
        """Return the random numbers of one part, the same whatever the others draw."""
        return np.random.default_rng([self.seed, zlib.crc32(name.encode())])


@dataclass(frozen=True)
class Model:
    """The model that a user begins with.

    Attributes:
        order: of the zero's polynomial.
        of_load: whether span and its tempco are in it.
        known: input channels whose influence is known.
        kind: name of that influence.
    """

    order: int
    of_load: bool
    known: tuple[str, ...]
    kind: str | None

    def list_effects(self) -> tuple[dict[str, str | int], ...]:
        """Return the [[effect]] tables."""
        found: list[dict[str, str | int]] = [{"kind": "zero_tempco", "order": self.order}]
        if self.of_load:
            found.append({"kind": "span_tempco"})
        if self.kind:
            found.append({"kind": self.kind})
        return tuple(found)

    def list_columns(self, rows: "Rows", output: int) -> Array:
        """Return what ordinary least squares may use, shape (rows, columns), wild rows too."""
        shifted = (rows.temperature - ROOM_DEGC) / 30.0
        columns = [shifted**power for power in range(self.order + 1)]
        if self.of_load:
            columns += [rows.load[:, output], rows.load[:, output] * shifted]
        columns += [rows.inputs[name] for name in self.known]
        return np.stack(columns, axis=1)


@dataclass(frozen=True, eq=False)
class Physics:
    """What truly happens: per run, at the fine step, shape (n, outputs).

    Attributes:
        scene: runs and temperatures.
        base: drift by what the base model has.
        hidden: effect -> its drift per run, not yet at its size.
        inputs: per run, name -> shape (n,).
    """

    scene: Scene
    base: tuple[Array, ...]
    hidden: dict[str, tuple[Array, ...]]
    inputs: tuple[dict[str, Array], ...]


@dataclass(frozen=True, eq=False)
class Rows:
    """A run's rows before the converter; temperature and inputs as they are logged."""

    run: Run
    time: Array
    keep: Flags
    temperature: Array
    load: Array
    base: Array
    hidden: dict[str, Array]
    inputs: dict[str, Array]


def _at(time: Array, run: Run, values: Array) -> Array:
    """Return `values` of the fine step at the rows' times, shape (rows, ...)."""
    if values.ndim == 1:
        found: Array = np.interp(time, run.time, values)
        return found
    return np.stack([np.interp(time, run.time, column) for column in values.T], axis=1)


def _read(rng: np.random.Generator, value: Array, noise: float, lsb: float) -> Array:
    found: Array = np.round((value + noise * rng.standard_normal(value.size)) / lsb) * lsb
    return np.round(found, 9)


def _take(asked: Asked, physics: Physics, recorder: Recorder, index: int) -> Rows:
    run = physics.scene.runs[index]
    rng = asked.stream(f"rows {run.name}")
    time, keep = recorder.take_rows(rng, float(run.time[-1]), run.period_s)
    place = _at(time, run, physics.scene.place[index])
    temperature = _read(rng, place, THERMOMETER_K, THERMOMETER_LSB_K)
    held = np.arange(time.size) // asked.temperature_rows * asked.temperature_rows
    return Rows(
        run=run,
        time=time,
        keep=keep,
        temperature=temperature[held],
        load=_at(time, run, run.load),
        base=_at(time, run, physics.base[index]),
        hidden={name: _at(time, run, arrays[index]) for name, arrays in physics.hidden.items()},
        inputs={
            name: _read(rng, _at(time, run, values), *RESOLUTION[name])
            for name, values in physics.inputs[index].items()
        },
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


@dataclass(frozen=True, eq=False)
class Fit:
    """The base model's least squares on training rows, for one output."""

    model: Model
    train: list[Rows]
    test: list[Rows]
    output: int

    def leave(self, train: list[Array], test: list[Array]) -> tuple[Array, Array]:
        """Return what is left of a drift, shape (rows,) per run, on training and test runs."""
        columns = np.concatenate([self._columns(rows) for rows in self.train])
        told = np.concatenate(train)
        found = np.linalg.lstsq(columns, told, rcond=None)[0]
        tests = np.concatenate([self._columns(rows) for rows in self.test])
        return told - columns @ found, np.concatenate(test) - tests @ found

    def leave_per_run(self, train: list[Array]) -> Array:
        """Return what is left where every training run has coefficients of its own."""
        left = []
        for rows, told in zip(self.train, train, strict=True):
            columns = self._columns(rows)
            left.append(told - columns @ np.linalg.lstsq(columns, told, rcond=None)[0])
        return np.concatenate(left)

    def _columns(self, rows: Rows) -> Array:
        return self.model.list_columns(rows, self.output)[rows.keep]


def measure(fit: Fit, train: list[Array], test: list[Array], noise: float) -> Size:
    """Return the size of a drift, shape (rows,) per run, over the RMS of the noise."""
    left, left_test = fit.leave(train, test)
    raw = float(np.std(np.concatenate(train))) / noise
    over = _rms(left) / noise
    return Size(
        raw=raw,
        train=over,
        test=_rms(left_test) / noise,
        per_run=_rms(fit.leave_per_run(train)) / noise,
        taken_up=1.0 - over / raw if raw else 0.0,
    )


def _scale(asked: Asked, fits: list[Fit], name: str, noise: float) -> tuple[float, Size]:
    """Return by what to multiply an effect, and its size then at the output that feels it most."""
    sizes = []
    for fit in fits:
        parts = [
            [rows.hidden[name][rows.keep, fit.output] for rows in some]
            for some in (fit.train, fit.test)
        ]
        sizes.append(measure(fit, parts[0], parts[1], noise))
    most = max(sizes, key=lambda size: size.train)
    if most.train <= 0.0:
        raise ValueError(f"seed {asked.seed}: nothing of {name!r} is in these runs")
    by = asked.size / most.train
    scaled = Size(
        raw=by * most.raw,
        train=by * most.train,
        test=by * most.test,
        per_run=by * most.per_run,
        taken_up=most.taken_up,
    )
    return by, scaled


def record(asked: Asked, physics: Physics, recorder: Recorder, model: Model) -> Case:
    """Return the case as it is logged, every hidden effect at the size asked for."""
    scene = physics.scene
    every = [_take(asked, physics, recorder, n) for n in range(len(scene.runs))]
    train = [rows for rows in every if rows.run.use == "train"]
    test = [rows for rows in every if rows.run.use == "test"]
    outputs = scene.zero.shape[1]
    fits = [Fit(model, train, test, output) for output in range(outputs)]
    noise = recorder.expected_rms
    factors, sizes = {}, {}
    for name in physics.hidden:
        factors[name], sizes[name] = _scale(asked, fits, name, noise)
    left = [
        _rms(
            fit.leave(
                [rows.base[rows.keep, fit.output] for rows in train],
                [rows.base[rows.keep, fit.output] for rows in test],
            )[0]
        )
        / noise
        for fit in fits
    ]
    names = asked.family.output[:outputs]
    logs = tuple(_log(asked, rows, recorder, (names, factors)) for rows in every)
    outside = [name for name in asked.effects if name in OUTSIDE]
    return Case(
        family=asked.family,
        outputs=names,
        full_scale=scene.full_scale,
        period_s=scene.runs[0].period_s,
        loaded=recorder.reference_sigma > 0.0,
        base=model.list_effects(),
        inputs=tuple(name for name in INPUTS if name in physics.inputs[0]),
        logs=logs,
        truth=Truth(
            seed=asked.seed,
            family=asked.family.name,
            effects=asked.effects,
            name="outside" if outside else (asked.effects[0] if asked.effects else None),
            sizes=sizes,
            noise_rms=_measure_noise(names, logs),
            noise_expected=noise,
            base_left=tuple(left),
            noise=recorder.kind,
            outliers=recorder.outliers,
        ),
    )


def _log(
    asked: Asked, rows: Rows, recorder: Recorder, told: tuple[tuple[str, ...], dict[str, float]]
) -> Log:
    names, factors = told
    drift = rows.base + sum(factors[name] * rows.hidden[name] for name in factors)
    columns = {"time_s": rows.time, "temperature_degC": rows.temperature}
    wild = np.zeros(drift.shape, dtype=bool)
    for output, name in enumerate(names):
        rng = asked.stream(f"converter {rows.run.name} {name}")
        value, wild[:, output] = recorder.spoil(rng, rows.load[:, output] + drift[:, output])
        columns[f"{name}_measured"] = value
        if recorder.reference_sigma > 0.0:
            told_by = recorder.reference_sigma * rng.standard_normal(value.size)
            columns[f"{name}_reference"] = rows.load[:, output] + told_by
    for name, values in rows.inputs.items():
        columns[INPUTS[name]] = values
    return Log(
        name=rows.run.name,
        use=rows.run.use,
        columns={name: values[rows.keep] for name, values in columns.items()},
        drift=drift[rows.keep],
        wild=wild[rows.keep],
    )


def _measure_noise(names: tuple[str, ...], logs: tuple[Log, ...]) -> tuple[float, ...]:
    """Return RMS of what is neither load nor drift on the test runs, wild rows apart."""
    found = []
    for output, name in enumerate(names):
        left = []
        for log in logs:
            if log.use == "test":
                load = log.columns.get(f"{name}_reference", np.zeros(len(log.drift)))
                noise = log.columns[f"{name}_measured"] - load - log.drift[:, output]
                left.append(noise[~log.wild[:, output]])
        found.append(_rms(np.concatenate(left)))
    return tuple(found)
