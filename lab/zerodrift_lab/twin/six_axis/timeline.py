"""A protocol drawn for one run: every quantity as a function of time."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from zerodrift.base.errors import InputError
from zerodrift_lab.twin.programmes import Gait, Programme, Ramps, Shaking, Sum
from zerodrift_lab.twin.sensor import FULL_SCALE, OUTPUTS, SUPPLY_NOMINAL, UNITS
from zerodrift_lab.twin.six_axis.heat import (
    Surroundings,
    ThermalNetwork,
    measure_rise,
    measure_touch,
)
from zerodrift_lab.twin.six_axis.protocol import Protocol, Statement
from zerodrift_lab.twin.six_axis.specimen import STILL_AIR
from zerodrift_lab.twin.six_axis.words import ABSOLUTE_ZERO, HOTTEST_DEGC, Quantity
from zerodrift_lab.twin.stimuli import SWINGS, Stimulus

Array = NDArray[np.float64]

TICK_S = 0.1
"""Every change begins and ends on a multiple of this, so that the integration meets it exactly."""
ROOM_HUMIDITY = 45.0
PLATE_RAMP_S, LAMP_RAMP_S = 4.0, 2.0
"""How long plate and lamp take where the thermometer's move is given."""
#: How much of a stance pushes first and pulls then, per output: shear does, pressure does not.
SKEW = dict(zip(OUTPUTS, (0.9, 0.4, 0.0, 0.3, 0.8, 0.7), strict=True))


@dataclass
class _Track:
    """A level over time while it is being written down."""

    knots: list[tuple[float, float]]

    def at(self, time_s: float) -> float:
        """Return the level at a time not before the last change was written."""
        times, levels = zip(*self.knots, strict=True)
        return float(np.interp(time_s, times, levels))

    def move(self, time_s: float, to: float, over_s: float) -> None:
        """Move to a level from where the track is then; an unfinished move is given up."""
        now = self.at(time_s)
        self.knots = [knot for knot in self.knots if knot[0] < time_s - 1e-9]
        self.knots += [(time_s, now), (round(time_s + over_s, 6), to)]

    def jump(self, time_s: float, to: float) -> None:
        """Be at another level from now on, for a quantity that does not act yet."""
        self.knots = [knot for knot in self.knots if knot[0] < time_s - 1e-9]
        self.knots.append((time_s, to))

    def finish(self) -> Ramps:
        times, levels = zip(*self.knots, strict=True)
        return Ramps(np.array(times), np.array(levels))


@dataclass(frozen=True)
class Timeline:
    """What one run does, drawn from its seed."""

    duration_s: float
    air: Ramps
    """degC."""
    plate: Ramps
    """degC."""
    lamp: Ramps
    """W."""
    switches: tuple[tuple[float, bool, float], ...]
    """From when on: whether on a plate, and the airflow in W/m2K."""
    load: tuple[Programme, ...]
    supply: Programme
    humidity: Programme
    light: Programme
    acceleration: tuple[Programme, Programme, Programme]
    powered_before: bool
    reference: str
    """weights | capacitive."""
    striding: bool
    """Whether there is a gait, which needs fine steps where an effect follows the load."""

    def surround(self, step_s: float, count: int) -> Surroundings:
        """Return the surroundings on a fine grid of `count` instants."""
        time_s = np.arange(count, dtype=np.float64) * step_s
        begins = np.array([begin for begin, _, _ in self.switches])
        index = np.searchsorted(begins, time_s + 1e-6, side="right") - 1
        on_plate = np.array([on for _, on, _ in self.switches])
        airflow = np.array([flow for _, _, flow in self.switches])
        return Surroundings(
            step_s=step_s,
            air=self.air.evaluate(time_s),
            plate=self.plate.evaluate(time_s),
            on_plate=on_plate[index],
            lamp=self.lamp.evaluate(time_s),
            airflow=airflow[index],
            powered_before=self.powered_before,
        )

    def as_stimulus(self) -> Stimulus:
        """Return what the additive effects want to know of the run."""
        return Stimulus(
            duration_s=self.duration_s,
            air=self.air,
            contact=self.plate,
            infrared=self.lamp,
            load=self.load,
            supply=self.supply,
            humidity=self.humidity,
            ambient_light=self.light,
            acceleration=self.acceleration,
            powered_before=self.powered_before,
            finest_s=0.01,
        )


@dataclass
class _Writer:
    """Walks through a protocol and writes its tracks."""

    protocol: Protocol
    rng: np.random.Generator
    network: ThermalNetwork
    clock_s: float = 0.0
    on_plate: bool = False
    airflow: float = STILL_AIR
    powered_before: bool = True
    reference: str = "weights"
    switches: list[tuple[float, bool, float]] = field(default_factory=list)
    gaits: list[tuple[float, float, dict[str, float]]] = field(default_factory=list)
    walking: dict[str, float] | None = None
    walking_since_s: float = 0.0
    shakes: list[tuple[float, float, float, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        room = next((s for s in self.protocol.statements if s.word == "room"), None)
        start = self.draw(room.values["to"]) if room else 23.0
        self.air, self.plate = _Track([(0.0, start)]), _Track([(0.0, start)])
        self.lamp = _Track([(0.0, 0.0)])
        self.supply, self.light = _Track([(0.0, SUPPLY_NOMINAL)]), _Track([(0.0, 0.0)])
        self.humidity = _Track([(0.0, ROOM_HUMIDITY)])
        self.load = {name: _Track([(0.0, 0.0)]) for name in OUTPUTS}
        self.levels = {
            "supply": self.supply,
            "light": self.light,
            "humidity": self.humidity,
        }

    def draw(self, quantity: Quantity) -> float:
        if quantity.low == quantity.high:
            return quantity.low
        return float(self.rng.uniform(quantity.low, quantity.high))

    def time(self, quantity: Quantity) -> float:
        """Return a duration, drawn, in whole ticks, at least one."""
        return max(1, round(self.draw(quantity) / TICK_S)) * TICK_S

    def error(self, statement: Statement, message: str) -> InputError:
        return InputError(f"{self.protocol.where}:{statement.line}: {message}")

    def wait(self, seconds: float) -> None:
        self.clock_s = round(self.clock_s + seconds, 6)

    def switch(self) -> None:
        self.switches.append((self.clock_s, self.on_plate, self.airflow))

    def end_gait(self) -> None:
        if self.walking is not None and self.clock_s > self.walking_since_s:
            self.gaits.append((self.walking_since_s, self.clock_s, self.walking))
        self.walking = None

    def play(self, statements: tuple[Statement, ...]) -> None:
        for statement in statements:
            if statement.word == "repeat":
                for _ in range(int(statement.values["times"].low)):
                    self.play(statement.body)
            else:
                self.do(statement)

    def do(self, statement: Statement) -> None:
        word, text, values = statement.word, statement.text, statement.values
        if word == "wait":
            self.wait(self.time(values["for"]))
        elif word == "power":
            self.powered_before = text == "before"
        elif word == "reference":
            self.reference = text
        elif word == "air":
            to = self.draw(values["to"])
            if "rate" in values:
                way = abs(to - self.air.at(self.clock_s)) / self.draw(values["rate"])
                over_s = max(1, round(way / TICK_S)) * TICK_S
            else:
                over_s = self.time(values["over"])
            self.air.move(self.clock_s, to, over_s)
            if "then_wait" in values:
                self.wait(over_s + self.time(values["then_wait"]))
        elif word == "airflow":
            self.airflow = self.draw(values["to"])
            self.switch()
        elif word == "plate":
            self.do_plate(statement)
        elif word == "lamp":
            self.do_lamp(statement)
        elif word in self.levels:
            self.levels[word].move(self.clock_s, self.draw(values["to"]), self.time(values["over"]))
        elif word == "load":
            over_s = self.time(values["over"])
            for name in OUTPUTS if text == "none" else (text,):
                to = 0.0 if text == "none" else self.draw(values["to"])
                self.check_load(statement, name, to)
                self.load[name].move(self.clock_s, to, over_s)
        elif word == "gait":
            self.end_gait()
            if text == "on":
                self.walking = {key: self.draw(value) for key, value in values.items()}
                self.walking_since_s = self.clock_s
                for name in OUTPUTS:
                    self.check_load(statement, name, self.walking.get(name, 0.0))
        elif word == "shake":
            self.shakes.append(
                (
                    self.clock_s,
                    self.time(values["for"]),
                    self.draw(values["peak"]),
                    self.draw(values["often"]),
                )
            )

    def check_load(self, statement: Statement, name: str, load: float) -> None:
        full = float(FULL_SCALE[OUTPUTS.index(name)])
        if abs(load) > full:
            unit = UNITS[OUTPUTS.index(name)]
            raise self.error(
                statement,
                f"{name} is {load:g} {unit}; the sensor's range is {full:g} {unit} to both sides.",
            )

    def do_plate(self, statement: Statement) -> None:
        values = statement.values
        if statement.text == "none":
            self.on_plate = False
            self.switch()
            return
        room = self.air.at(self.clock_s)
        touched = not self.on_plate
        if touched:
            self.plate.jump(self.clock_s, room)
            self.on_plate = True
            self.switch()
        if statement.text == "hold":
            self.plate.move(self.clock_s, self.draw(values["to"]), self.time(values["over"]))
            return
        within_s = self.time(values["in"])
        rise = self.draw(values["rise"])
        if touched:
            rise -= measure_touch(self.network, self.airflow, within_s)
        gain = measure_rise(self.network, "plate", self.airflow, True, within_s, PLATE_RAMP_S)
        to = self.plate.at(self.clock_s) + rise / gain
        if not ABSOLUTE_ZERO < to <= HOTTEST_DEGC:
            raise self.error(
                statement,
                f"a plate would have to be at {to:.0f} degC for that; ask for less or for longer.",
            )
        self.plate.move(self.clock_s, to, PLATE_RAMP_S)

    def do_lamp(self, statement: Statement) -> None:
        values = statement.values
        if statement.text == "hold":
            self.lamp.move(self.clock_s, self.draw(values["to"]), self.time(values["over"]))
            return
        within_s = self.time(values["in"])
        gain = measure_rise(
            self.network, "lamp", self.airflow, self.on_plate, within_s, LAMP_RAMP_S
        )
        watts = self.draw(values["rise"]) / gain
        if watts > 100.0:
            raise self.error(
                statement,
                f"the lamp would need {watts:.0f} W on the sensor for that; "
                "ask for less or for longer.",
            )
        self.lamp.move(self.clock_s, watts, LAMP_RAMP_S)

    def finish(self) -> Timeline:
        self.end_gait()
        begins = [(0.0, False, STILL_AIR), *self.switches]
        # Of several switches at one moment the last one holds.
        kept = {begin: (begin, on, flow) for begin, on, flow in begins}
        loads: list[Programme] = []
        for name in OUTPUTS:
            parts: list[Programme] = [self.load[name].finish()]
            for begin, end, gait in self.gaits:
                if name in gait:
                    duty = gait["duty"] / 100.0
                    parts.append(Gait(begin, end, gait["stride"], duty, gait[name], SKEW[name]))
            loads.append(Sum(tuple(parts)) if len(parts) > 1 else parts[0])
        accelerations: list[Programme] = []
        for axis in range(3):
            swings: list[Programme] = [
                Gait(begin, end, gait["stride"], 1.0, *SWINGS[axis])
                for begin, end, gait in self.gaits
            ]
            for begin, lasts_s, peak, often in self.shakes:
                share = float(self.rng.uniform(0.3, 1.0))
                swings.append(
                    Shaking(np.array([begin]), lasts_s, np.array([share * peak]), np.array([often]))
                )
            accelerations.append(Sum(tuple(swings)))
        return Timeline(
            duration_s=self.clock_s,
            air=self.air.finish(),
            plate=self.plate.finish(),
            lamp=self.lamp.finish(),
            switches=tuple(kept.values()),
            load=tuple(loads),
            supply=self.supply.finish(),
            humidity=self.humidity.finish(),
            light=self.light.finish(),
            acceleration=(accelerations[0], accelerations[1], accelerations[2]),
            powered_before=self.powered_before,
            reference=self.reference,
            striding=bool(self.gaits),
        )


def draw_timeline(
    protocol: Protocol, rng: np.random.Generator, network: ThermalNetwork
) -> Timeline:
    """Draw what a protocol does in one run to a sensor with this thermal network.

    Raises:
        InputError: what is asked for is beyond the sensor or physics, with file and line.
    """
    writer = _Writer(protocol, rng, network)
    writer.play(protocol.statements)
    return writer.finish()
