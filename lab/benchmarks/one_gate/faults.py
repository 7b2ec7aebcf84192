"""Twenty-six kinds of wrong data: what each does to a training run, and the words that name it."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from benchmarks.one_gate.harm import fit_plainly
from benchmarks.one_gate.sensor import TEMPERATURE, TIME, Array, Sensor


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
