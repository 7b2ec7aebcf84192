"""What happens to a sensor in a run: chamber, loads, supply, humidity, weather, light, motion.

All are drawn at a fraction of the log's period. A chamber does not do what it is told at once, its
compressor switches, and its humidity falls when it heats, as warm air could hold more water.
"""

from dataclasses import dataclass, field

import numpy as np

from benchmarks.third_simulator.heat import Array, relax

CHAMBERS = ("ramps", "steps", "cycles", "walk")
ROOM_DEGC = 23.0
SATURATION_K = 17.27
SATURATION_DEGC = 237.3


@dataclass(frozen=True, eq=False)
class Run:
    """One run as it was, before anything is recorded.

    Attributes:
        name: of its file.
        use: train, test or dwell.
        period_s: of its rows.
        step_s: of the arrays, a fraction of the period.
        start_s: on the absolute clock, s since commissioning.
        air: shape (n,), degC around the sensor.
        load: shape (n, outputs), in the outputs' unit; zeros where nothing is applied.
        inputs: name as in [inputs] -> shape (n,).
    """

    name: str
    use: str
    period_s: float
    step_s: float
    start_s: float
    air: Array
    load: Array
    inputs: dict[str, Array] = field(default_factory=dict)

    @property
    def time(self) -> Array:
        """Seconds since the first sample, shape (n,)."""
        return np.asarray(np.arange(self.air.size) * self.step_s, dtype=np.float64)


def bend_points(points: list[tuple[float, float]], seconds: float, step_s: float) -> Array:
    """Return straight lines through (time, value), shape (n,)."""
    grid = np.arange(int(seconds / step_s) + 1) * step_s
    times, values = np.array(points).T
    found: Array = np.interp(grid, times, values)
    return found


def wander(rng: np.random.Generator, size: int, step_s: float, tau_s: float) -> Array:
    """Return a slow random process, RMS about 1, correlated over `tau_s`, shape (size,)."""
    driven = rng.standard_normal(size) * np.sqrt(2.0 * tau_s / step_s)
    found = relax(relax(driven, tau_s, step_s, 0.0), tau_s / 8.0, step_s, 0.0)
    start = rng.standard_normal() * np.exp(-np.arange(size) * step_s / tau_s)
    total: Array = found + start
    return total


def draw_setpoints(
    rng: np.random.Generator, kind: str, seconds: float, span: tuple[float, float]
) -> list[tuple[float, float]]:
    """Return (s, degC) of a chamber's programme, or of rooms that a device is carried through."""
    low, high = span
    reach = high - low
    now, value = 0.0, float(rng.uniform(low, high))
    points = [(now, value)]
    upwards = bool(rng.random() < 0.5)
    sweep = rng.uniform(0.75, 1.0)
    rate = float(rng.uniform(0.8, 3.0)) / 60.0
    while now < seconds:
        if kind == "cycles":
            goal = (high if upwards else low) - (1.0 - sweep) * reach * (0.5 if upwards else -0.5)
            hold = float(rng.uniform(0.0, 120.0))
        elif kind == "ramps":
            goal = float(
                rng.uniform(low + 0.6 * reach, high)
                if upwards
                else rng.uniform(low, low + 0.4 * reach)
            )
            hold = float(rng.choice([0.0, rng.uniform(200.0, 1200.0)]))
            rate = float(rng.uniform(0.5, 3.0)) / 60.0
        elif kind == "steps":
            goal, hold = float(rng.uniform(low, high)), float(rng.uniform(600.0, 1800.0))
            rate = float(rng.uniform(3.0, 6.0)) / 60.0
        else:
            goal, hold = float(rng.uniform(low, high)), float(rng.exponential(700.0))
            rate = float(rng.uniform(5.0, 20.0)) / 60.0
        upwards = not upwards
        now += max(abs(goal - value) / rate, 1.0)
        points.append((now, goal))
        now += hold + 1.0
        points.append((now, goal))
        value = goal
    return points


def draw_air(
    rng: np.random.Generator, kind: str, seconds: float, step_s: float, span: tuple[float, float]
) -> Array:
    """Return the air's temperature in a chamber, shape (n,), degC."""
    wanted = bend_points(draw_setpoints(rng, kind, seconds, span), seconds, step_s)
    followed = relax(relax(wanted, rng.uniform(60, 180), step_s), rng.uniform(15, 40), step_s)
    phase = np.cumsum(1.0 + 0.2 * wander(rng, wanted.size, step_s, 300.0)) * step_s
    ripple = rng.uniform(0.03, 0.15) * np.sin(2 * np.pi * phase / rng.uniform(60.0, 200.0))
    breeze = rng.uniform(0.02, 0.1) * wander(rng, wanted.size, step_s, 400.0)
    return followed + ripple + breeze


def draw_steps(
    rng: np.random.Generator, levels: Array, hold_s: tuple[float, float], grid: tuple[float, float]
) -> Array:
    """Return levels drawn in turn, each held, with rises of some seconds, shape (n,).

    Args:
        rng: draws.
        levels: to draw from; none twice in a row.
        hold_s: shortest and longest.
        grid: (seconds, step_s).
    """
    seconds, step_s = grid
    now, value = 0.0, float(levels[0])
    points = [(now, value)]
    while now < seconds:
        now += float(rng.uniform(*hold_s))
        points.append((now, value))
        value = float(rng.choice(levels[levels != value]))
        now += float(rng.uniform(3.0, 8.0)) * max(1.0, step_s)
        points.append((now, value))
    return bend_points(points, seconds, step_s)


def draw_load(
    rng: np.random.Generator, full_scale: float, both_signs: bool, grid: tuple[float, float]
) -> Array:
    """Return what is applied to one output, shape (n,): steps, or series up and down."""
    lowest = -1.0 if both_signs else 0.0
    if rng.random() < 0.6:
        levels = full_scale * np.concatenate([[0.0], rng.uniform(lowest, 1.0, 6), [0.9]])
        return draw_steps(rng, levels, (120.0, 900.0), grid)
    seconds, step_s = grid
    now, points = 0.0, [(0.0, 0.0)]
    while now < seconds:
        top = rng.uniform(0.6, 1.0) * full_scale
        rungs = np.linspace(0.0, 1.0, int(rng.integers(4, 8)))
        for rung in (*rungs[1:], *rungs[-2::-1]):
            now += rng.uniform(4.0, 8.0) * max(1.0, step_s)
            points.append((now, rung * top))
            now += rng.uniform(60.0, 240.0)
            points.append((now, rung * top))
        if both_signs:
            full_scale = -full_scale
    return bend_points(points, seconds, step_s)


def dry_by_heat(air: Array, humidity: float) -> Array:
    """Return the relative humidity of a closed chamber, %, shape (n,), by Magnus's formula.

    Args:
        air: degC, shape (n,).
        humidity: % at 23 degC.
    """
    pressure = np.exp(SATURATION_K * air / (SATURATION_DEGC + air))
    room = np.exp(SATURATION_K * ROOM_DEGC / (SATURATION_DEGC + ROOM_DEGC))
    found: Array = np.clip(humidity * room / pressure, 3.0, 97.0)
    return found


def draw_input(
    rng: np.random.Generator, name: str, air: Array, grid: tuple[float, float], stirred: bool
) -> Array:
    """Return one input, shape (n,), in the unit of its column.

    Args:
        rng: draws.
        name: as in [inputs].
        air: degC, shape (n,).
        grid: (seconds, step_s).
        stirred: whether the programme moves it, or it does what it does by itself.
    """
    seconds, step_s = grid
    slow = wander(rng, air.size, step_s, 1500.0)
    fast = wander(rng, air.size, step_s, 60.0)
    day = bend_points([(0.0, rng.uniform(-1, 1)), (seconds, rng.uniform(-1, 1))], seconds, step_s)
    if name == "supply":
        base = 5.0 + 0.01 * slow + 0.003 * fast + 0.02 * day
        if not stirred:
            return base
        return base + draw_steps(rng, np.linspace(-1.5, 1.0, 6), (300.0, 1500.0), grid)
    if name == "humidity":
        if not stirred:
            return np.clip(dry_by_heat(air, rng.uniform(30, 60)) + 0.5 * slow, 2.0, 98.0)
        wanted = draw_steps(rng, rng.uniform(20.0, 90.0, 6), (900.0, 3000.0), grid)
        return np.clip(relax(wanted, rng.uniform(60.0, 200.0), step_s) + 0.4 * fast, 2.0, 98.0)
    if name == "pressure":
        weather = rng.normal(1005.0, 6.0) + 1.5 * slow + 2.0 * day + 0.05 * fast
        if not stirred:
            return weather
        return weather + draw_steps(rng, np.linspace(-120.0, 0.0, 6), (300.0, 1200.0), grid)
    if name == "ambient_light":
        daylight = 300.0 * np.clip(1.0 + day + 0.3 * slow, 0.0, None)
        lamp = draw_steps(rng, np.array([0.0, 500.0, 1200.0]), (200.0, 1200.0), grid)
        return daylight + (lamp if stirred else 0.0)
    down = {"acceleration_z": 9.81}.get(name, 0.0)
    if not stirred:
        return down + 0.02 * fast
    tilt = draw_steps(rng, np.array([-9.81, -4.9, 0.0, 4.9, 9.81]), (60.0, 400.0), grid)
    return tilt + 0.3 * fast


def hold_input(rng: np.random.Generator, name: str, air: Array, step_s: float) -> Array:
    """Return an input while a dwell is recorded, shape (n,): it stands nearly still."""
    still, moves = {
        "supply": (5.0, 0.002),
        "humidity": (rng.uniform(35.0, 50.0), 0.1),
        "pressure": (rng.normal(1005.0, 6.0), 0.05),
        "ambient_light": (0.0, 0.0),
        "acceleration_z": (9.81, 0.01),
    }.get(name, (0.0, 0.01))
    return still + moves * wander(rng, air.size, step_s, 300.0)
