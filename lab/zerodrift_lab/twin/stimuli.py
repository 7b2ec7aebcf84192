"""What one run does to the sensor, drawn from the seed: the paper's four experiments and a dwell.

`chamber` cycles between -20 and 60 degC, `heating` by an infrared lamp, `cooling` by an ice pack,
`walking` on cold and hot plates, `cold_start` powers on after a soak, `load_steps` hangs weights
at room temperature, `dwell` leaves the warmed-up sensor alone.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from zerodrift_lab.twin.heat import HeatNetwork, measure_response
from zerodrift_lab.twin.programmes import (
    Following,
    Gait,
    Programme,
    Ramps,
    Shaking,
    Steps,
    Sum,
    draw_steps,
    hold,
)
from zerodrift_lab.twin.sensor import (
    COLDEST,
    FULL_SCALE,
    HOTTEST,
    OUTPUTS,
    SUPPLY_NOMINAL,
    draw_stream,
)

#: What a run can move besides the temperature.
EXERCISES = ("load", "supply", "humidity", "ambient_light", "acceleration")

#: Peak (m/s2) and skew of a walking foot's acceleration over the stride along x, y, z.
SWINGS = ((12.0, 1.0), (3.0, 0.9), (9.0, 0.8))

BOARD_POWER_W = 0.05
"""The electronics' own heat."""
REST_S = 60.0
"""Every run starts unloaded and still for at least this long, as a log that is tared does."""


@dataclass(frozen=True)
class Stimulus:
    """The surroundings of one run as functions of time."""

    duration_s: float
    air: Programme
    """degC."""
    contact: Programme
    """degC of what the foot stands on."""
    infrared: Programme
    """W."""
    load: tuple[Programme, ...]
    """Per output; N or Nm."""
    supply: Programme
    """V."""
    humidity: Programme
    """% relative humidity."""
    ambient_light: Programme
    """lux."""
    acceleration: tuple[Programme, Programme, Programme]
    """m/s2 along x, y, z."""
    powered_before: bool
    """False: the log begins with the power-on."""
    finest_s: float
    """Longest integration step that resolves the programmes."""


@dataclass(frozen=True)
class Draw:
    """What a kind of run draws from."""

    rng: np.random.Generator
    network: HeatNetwork
    duration_s: float
    exercise: tuple[str, ...]
    first: bool
    """The first run of a campaign covers the whole temperature range."""

    def scale(self, low: float, high: float) -> float:
        """Return a number drawn uniformly."""
        return float(self.rng.uniform(low, high))


def _draw_weights(draw: Draw, share: float, dwell_range_s: tuple[float, float]) -> list[Programme]:
    """Draw one step-and-hold load per output, up to `share` of full scale to both sides."""
    if "load" not in draw.exercise:
        return [hold(0.0) for _ in OUTPUTS]
    return [
        draw_steps(
            draw.rng,
            draw.duration_s,
            0.0,
            (-share * full, share * full),
            dwell_range_s,
            3.0,
            REST_S,
        )
        for full in FULL_SCALE.tolist()
    ]


def _draw_supply(draw: Draw) -> Programme:
    if "supply" not in draw.exercise:
        return hold(SUPPLY_NOMINAL)
    level = SUPPLY_NOMINAL + draw.scale(-0.02, 0.02)
    around = (SUPPLY_NOMINAL - 0.25, SUPPLY_NOMINAL + 0.25)
    return draw_steps(draw.rng, draw.duration_s, level, around, (150.0, 600.0), 2.0, REST_S)


def _draw_humidity(draw: Draw) -> Programme:
    level = draw.scale(35.0, 50.0)
    if "humidity" not in draw.exercise:
        return hold(level)
    return draw_steps(draw.rng, draw.duration_s, level, (15.0, 85.0), (400.0, 1500.0), 90.0, REST_S)


def _draw_light(draw: Draw) -> Programme:
    if "ambient_light" not in draw.exercise:
        return hold(0.0)
    return draw_steps(draw.rng, draw.duration_s, 0.0, (150.0, 900.0), (100.0, 700.0), 1.5, REST_S)


def _draw_shaking(draw: Draw) -> tuple[Programme, Programme, Programme]:
    """Draw bursts of handling: the arm that carries the sensor moves it about."""
    if "acceleration" not in draw.exercise:
        return hold(0.0), hold(0.0), hold(0.0)
    lasts_s = draw.scale(25.0, 45.0)
    times_s = np.arange(REST_S + 30.0, draw.duration_s - 2.0 * lasts_s, 300.0)
    times_s = times_s + draw.rng.uniform(0.0, 200.0, times_s.size)
    bursts = [
        Shaking(
            times_s=times_s,
            lasts_s=lasts_s,
            amplitudes=draw.rng.uniform(1.0, 8.0, times_s.size),
            frequencies_hz=draw.rng.uniform(0.2, 1.7, times_s.size),
        )
        for _ in range(3)
    ]
    return bursts[0], bursts[1], bursts[2]


def _assemble(
    draw: Draw,
    air: Programme,
    *,
    contact: Programme | None = None,
    infrared: Programme | None = None,
    load: list[Programme] | None = None,
    acceleration: tuple[Programme, Programme, Programme] | None = None,
    powered_before: bool = False,
    finest_s: float = 0.1,
) -> Stimulus:
    """Fill in what a kind of run does not set: still, unloaded, standing in the air."""
    return Stimulus(
        duration_s=draw.duration_s,
        air=air,
        contact=air if contact is None else contact,
        infrared=hold(0.0) if infrared is None else infrared,
        load=tuple(load or [hold(0.0)] * len(OUTPUTS)),
        supply=_draw_supply(draw),
        humidity=_draw_humidity(draw),
        ambient_light=_draw_light(draw),
        acceleration=acceleration or (hold(0.0), hold(0.0), hold(0.0)),
        powered_before=powered_before,
        finest_s=finest_s,
    )


def _draw_cycles(draw: Draw, room: float) -> Ramps:
    """Draw chamber air: from room to one extreme, to the other, and so on, at drawn rates."""
    times_s, levels = [0.0], [room]
    now_s, now = draw.scale(40.0, 160.0), room
    times_s.append(now_s)
    levels.append(now)
    hot_next = draw.rng.random() < 0.5
    full = draw.first
    # Chip and body follow the air only in part within a short dwell, so the air overshoots.
    while now_s < draw.duration_s:
        if hot_next:
            target = HOTTEST + 3.0 if full else draw.scale(HOTTEST - 18.0, HOTTEST)
        else:
            target = COLDEST - 3.0 if full else draw.scale(COLDEST, COLDEST + 18.0)
        stop = draw.scale(0.25, 0.75) if draw.rng.random() < 0.3 else None
        for goal in ([now + stop * (target - now)] if stop is not None else []) + [target]:
            rate_k_per_s = (4.0 if full else draw.scale(1.8, 6.0)) / 60.0
            now_s += abs(goal - now) / rate_k_per_s
            now = goal
            times_s.append(now_s)
            levels.append(now)
            now_s += draw.scale(400.0 if full else 120.0, 700.0)
            times_s.append(now_s)
            levels.append(now)
        hot_next = not hot_next
    return Ramps(np.array(times_s), np.array(levels))


def draw_chamber(draw: Draw) -> Stimulus:
    """Draw a run in the thermal chamber, with weights, supply, moisture and light moved too.

    The sensor stands on a plate that follows the air slowly and is heated or cooled by itself at
    times, so that heat comes by more than one way.
    """
    air = _draw_cycles(draw, draw.scale(20.0, 26.0))
    stand = Sum(
        (
            Following(air, tau_s=draw.scale(800.0, 1800.0), share=0.25),
            draw_steps(draw.rng, draw.duration_s, 0.0, (-12.0, 12.0), (200.0, 900.0), 30.0, REST_S),
        )
    )
    load = _draw_weights(draw, 0.2, (120.0, 700.0))
    return _assemble(draw, air, contact=stand, load=load, acceleration=_draw_shaking(draw))


def draw_heating(draw: Draw) -> Stimulus:
    """Draw a run under the infrared lamp: about +10 degC in some 200 s, no load."""
    lasts_s = draw.scale(180.0, 240.0)
    rise = draw.scale(8.5, 11.5)
    power_w = rise / measure_response(draw.network, "infrared", lasts_s)
    begin_s = draw.scale(90.0, 180.0)
    lamp = Steps(0.0, np.array([begin_s, begin_s + lasts_s]), np.array([power_w, 0.0]), 2.0)
    return _assemble(draw, hold(draw.scale(20.0, 26.0)), infrared=lamp)


def draw_cooling(draw: Draw) -> Stimulus:
    """Draw a run on an ice pack: about -5 degC in some 300 s, no load."""
    room = draw.scale(20.0, 26.0)
    lasts_s = draw.scale(270.0, 340.0)
    fall = draw.scale(4.2, 5.8) / measure_response(draw.network, "contact", lasts_s)
    begin_s = draw.scale(90.0, 180.0)
    pack = Steps(room, np.array([begin_s, begin_s + lasts_s]), np.array([room - fall, room]), 4.0)
    return _assemble(draw, hold(room), contact=pack)


def draw_walking(draw: Draw) -> Stimulus:
    """Draw a walk: by thirds on a -20 degC plate, on a 70 degC plate and on ice again."""
    room = draw.scale(18.0, 25.0)
    third_s = (draw.duration_s - REST_S) / 3.0
    plates = np.array([-20.0, 70.0, -20.0]) + draw.rng.uniform(-2.0, 2.0, 3)
    contact = Steps(room, REST_S + third_s * np.arange(3.0), plates, 6.0)
    stride_s, duty = draw.scale(0.55, 0.75), draw.scale(0.5, 0.65)
    peaks = [
        (draw.scale(0.02, 0.05), 0.9),
        (draw.scale(0.01, 0.03), 0.4),
        (draw.scale(0.06, 0.11), 0.0),
        (draw.scale(0.02, 0.05), 0.3),
        (draw.scale(0.02, 0.06), 0.8),
        (draw.scale(0.01, 0.02), 0.7),
    ]
    load: list[Programme] = [
        Gait(REST_S, draw.duration_s, stride_s, duty, share * full, skew)
        for (share, skew), full in zip(peaks, FULL_SCALE.tolist(), strict=True)
    ]
    swings = [Gait(REST_S, draw.duration_s, stride_s, 1.0, a, s) for a, s in SWINGS]
    still = "acceleration" not in draw.exercise
    acceleration = None if still else (swings[0], swings[1], swings[2])
    return _assemble(
        draw,
        hold(room),
        contact=contact,
        load=load if "load" in draw.exercise else None,
        acceleration=acceleration,
        finest_s=0.01,
    )


def draw_cold_start(draw: Draw) -> Stimulus:
    """Draw a power-on after a soak at some temperature, then a slow move to another one."""
    begin = draw.scale(COLDEST, HOTTEST - 20.0)
    end = draw.scale(begin - 10.0, begin + 30.0)
    leave_s = draw.scale(0.4, 0.6) * draw.duration_s
    air = Ramps(np.array([0.0, leave_s, leave_s + 900.0]), np.array([begin, begin, end]))
    return _assemble(draw, air)


def draw_load_steps(draw: Draw) -> Stimulus:
    """Draw weights hung on and taken off at nearly constant temperature, with long holds."""
    room = draw.scale(20.0, 26.0)
    ends_s = np.array([0.0, draw.duration_s])
    air = Ramps(ends_s, np.array([room, room + draw.scale(-1.5, 1.5)]))
    return _assemble(draw, air, load=_draw_weights(draw, 0.4, (300.0, 1500.0)))


def draw_dwell(draw: Draw) -> Stimulus:
    """Draw the isothermal, unloaded, warmed-up dwell that sets the noise floor."""
    still = Draw(draw.rng, draw.network, draw.duration_s, (), draw.first)
    return _assemble(still, hold(draw.scale(22.0, 26.0)), powered_before=True)


#: Kind of run -> how it is drawn and how long it lasts; None = as long as the recipe says.
KINDS: dict[str, tuple[Callable[[Draw], Stimulus], float | None]] = {
    "chamber": (draw_chamber, None),
    "heating": (draw_heating, 900.0),
    "cooling": (draw_cooling, 900.0),
    "walking": (draw_walking, 3660.0),
    "cold_start": (draw_cold_start, None),
    "load_steps": (draw_load_steps, None),
    "dwell": (draw_dwell, 2400.0),
}


def draw_stimulus(
    kind: str,
    name: str,
    *,
    seed: int,
    network: HeatNetwork,
    duration_s: float,
    exercise: tuple[str, ...],
    first: bool,
) -> Stimulus:
    """Draw the run called `name` of a kind in `KINDS`."""
    draw_kind, own_duration_s = KINDS[kind]
    lasts_s = duration_s if own_duration_s is None else own_duration_s
    return draw_kind(Draw(draw_stream(seed, "run", name), network, lasts_s, exercise, first))
