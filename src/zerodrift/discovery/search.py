"""The search for the best programme: programmes as points of a unit cube, designed ones first."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import hadamard

from zerodrift.base.arrays import Array
from zerodrift.base.experiment_config import Reach
from zerodrift.discovery.limits import Limits
from zerodrift.discovery.programme import Log, SetProgramme, Setting

# Programmes as points of a unit cube: segments of dwell, ramp and step, with steps of what is set.
#
# A pattern is one log: segments, each with its share of the time, a temperature, how much of it is
# spent ramping, and a train of load and input steps. Every point of the cube keeps to the limits:
# ramps that would be too fast are made as fast as the chamber, and excursions that would not fit
# into their segment are shortened.

SEGMENTS = 5
PATTERNS = 2
"""Different logs; the others repeat them, with loads and temperatures mirrored where they can."""
PER_SEGMENT = 7
"""Duration, temperature, share of ramp, number of steps, their shape, loads on, inputs on."""
MOST_STEPS = 12
SMALL_K = 1.0
CROSSINGS = 20.0
"""Log over the time from the coldest to the hottest, in which every segment has time for it."""
USE_CROSSINGS = 6.0
"""The same of a log that uses all that the limits allow, ..."""
USE_S = 3600.0
"""... and lasts so long at least."""
FEW = (2, 1)
"""Logs, each long enough for slow effects and for the whole range of temperatures."""
QUIET_S = 60.0
"""Each log begins at rest and unloaded for so long, for its tare."""
SIGNS = hadamard(32)
SHAPES = ("hold", "square", "stairs")


@dataclass(frozen=True)
class Space:
    """What a point stands for: so many logs of one length within the limits."""

    limits: Limits
    logs: int
    log_s: float
    patterns: int = PATTERNS
    """Different logs at most."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Loads first, then inputs."""
        return (*self.limits.loads, *self.limits.inputs)

    @property
    def per_pattern(self) -> int:
        """Numbers of one pattern."""
        return SEGMENTS * PER_SEGMENT + len(self.channels) + 1

    @property
    def size(self) -> int:
        """Numbers of a point."""
        return self.patterns * self.per_pattern

    @property
    def repeats(self) -> Array:
        """[patterns] how many logs each pattern stands for."""
        each, more = divmod(self.logs, self.patterns)
        return np.array([each + (p < more) for p in range(self.patterns)], dtype=np.float64)

    def lengthen(self, crossings: float = CROSSINGS) -> "Space":
        """Return the space with logs long enough for every temperature that the limits allow.

        Args:
            crossings: the log's length over the time from the coldest to the hottest.
        """
        limits = self.limits
        slowest = min(limits.heating_K_per_s, limits.cooling_K_per_s)
        crossing_s = (limits.high_degC - limits.low_degC) / slowest
        return replace(self, log_s=max(self.log_s, crossings * crossing_s))

    def list_patterns(self, point: Array) -> list[Log]:
        """Return the different logs of a point."""
        return [
            _decode(self, part, p)
            for p, part in enumerate(np.split(point, self.patterns))
            if self.repeats[p] > 0
        ]

    def use_all(self) -> "Space":
        """Return the space with a log of each pattern that uses all that the limits allow.

        It is the same whatever the hours: in it effects have their sizes.
        """
        least = replace(self, logs=PATTERNS, patterns=PATTERNS, log_s=max(self.limits.log_s, USE_S))
        return least.lengthen(USE_CROSSINGS)

    def build(self, point: Array) -> SetProgramme:
        """Return the programme of a point."""
        patterns = self.list_patterns(point)
        logs = []
        for number in range(self.logs):
            log = patterns[number % self.patterns]
            logs.append(_mirror(log, self.limits) if (number // self.patterns) % 2 else log)
        return SetProgramme(tuple(logs), self.limits.rest_s, self.limits.start_degC)


def choose_spaces(
    limits: Limits, hours: float, runs: int, wanted: int = 8, few: Sequence[int] = ()
) -> list[Space]:
    """Return the numbers of logs worth a look, the likeliest first.

    Args:
        limits: the shortest log and the rest.
        hours: in all.
        runs: logs that there are already.
        wanted: runs that evidence calls for.
        few: numbers of logs that are worth a look too, after the others. Before any log these are
            of one pattern: either has to predict the other, at temperatures that both have seen.
    """
    most = int((3600.0 * hours + 1e-6) // (limits.log_s + limits.rest_s))
    counts = {max(1, min(most, wanted - runs)), max(1, min(most, wanted)), max(1, min(most, 4))}
    counts |= {max(1, min(most, 12))}
    spaces = []
    likely = sorted(counts, key=lambda n: (abs(n - max(wanted - runs, 4)), n))
    for count in dict.fromkeys((*likely, *(max(1, min(most, n)) for n in few))):
        log_s = 3600.0 * hours / count - limits.rest_s
        patterns = 1 if count in few and runs == 0 else PATTERNS
        log_s = float(10.0 * np.floor(log_s / 10.0 + 1e-9))
        spaces.append(Space(limits, count, log_s, patterns))
    return spaces


def _decode(space: Space, part: Array, pattern: int) -> Log:
    """Return the log that a pattern's numbers stand for."""
    limits = space.limits
    table = part[: SEGMENTS * PER_SEGMENT].reshape(SEGMENTS, PER_SEGMENT)
    amplitudes = part[SEGMENTS * PER_SEGMENT : -1]
    quiet_s = min(QUIET_S, 0.1 * space.log_s)
    shares = 0.15 + table[:, 0]
    lasts_s = (space.log_s - quiet_s) * shares / shares.sum()
    settings = [Setting(0.0, limits.start_degC, 0.0, _rest(limits), dict(limits.nominal))]
    now_s, now = quiet_s, limits.start_degC
    for s in range(SEGMENTS):
        _, level, ramp, steps, shape, loaded, driven = table[s].tolist()
        to = limits.low_degC + level * (limits.high_degC - limits.low_degC)
        if abs(to - now) < 0.03 * (limits.high_degC - limits.low_degC):
            to = now
        last = s == SEGMENTS - 1
        to = _return_in_time(limits, to, float(lasts_s[s + 1 :].sum()))
        to, rate = _approach(limits, now, to, lasts_s[s], ramp)
        if last:
            # The way back is part of the log, as fast as the chamber goes; which way a small rest
            # of it leads, rounding decides.
            way = limits.start_degC - now
            fastest = limits.heating_K_per_s if way > 0.0 else limits.cooling_K_per_s
            if abs(way) < SMALL_K:
                fastest = min(limits.heating_K_per_s, limits.cooling_K_per_s)
            to, rate = _approach(limits, now, limits.start_degC, lasts_s[s], 0.0)
            rate = 60.0 * fastest if way != 0.0 else 0.0
        train = _Train(steps, shape, loaded > 0.5, driven > 0.5, pattern * SEGMENTS + s)
        settings += _step(space, (now_s, float(lasts_s[s])), (to, rate), train, amplitudes)
        now_s, now = now_s + lasts_s[s], to
    power_on = limits.power and bool(part[-1] > 0.5)
    return Log(tuple(_round(settings)), space.log_s, power_on)


def _approach(
    limits: Limits, now: float, to: float, lasts_s: float, ramp: float
) -> tuple[float, float]:
    """Return a temperature that can be reached in time, and the rate in K/min."""
    fastest = limits.heating_K_per_s if to > now else limits.cooling_K_per_s
    reach = fastest * lasts_s
    to = now + float(np.clip(to - now, -reach, reach))
    if to == now:
        return now, 0.0
    over_s = max(abs(to - now) / fastest, ramp * lasts_s)
    return to, 60.0 * abs(to - now) / over_s


def _return_in_time(limits: Limits, to: float, within_s: float) -> float:
    """Return the temperature from which the start is reached in time."""
    warmer = limits.start_degC + 0.9 * limits.cooling_K_per_s * within_s
    colder = limits.start_degC - 0.9 * limits.heating_K_per_s * within_s
    return float(np.clip(to, colder, warmer))


@dataclass(frozen=True)
class _Train:
    """Steps of loads and inputs within a segment."""

    steps: float
    shape: float
    loaded: bool
    driven: bool
    place: int
    """The segment's number, which chooses the channels' signs."""


def _step(
    space: Space,
    time: tuple[float, float],
    heat: tuple[float, float],
    train: _Train,
    amplitudes: Array,
) -> list[Setting]:
    """Return the settings of one segment: one, or a train of steps."""
    limits = space.limits
    begin_s, lasts_s = time
    active = [
        (c, name)
        for c, name in enumerate(space.channels)
        if (train.loaded if name in limits.loads else train.driven) and amplitudes[c] > 0.1
    ]
    if not active:
        return [Setting(begin_s, *heat, _rest(limits), dict(limits.nominal))]
    longest_s = max(_reach(limits, name).hold_s for _, name in active)
    kind = SHAPES[min(int(train.shape * len(SHAPES)), len(SHAPES) - 1)]
    most = max(1, min(MOST_STEPS, int(lasts_s // longest_s)))
    count = 2 if kind == "hold" and most >= 2 else max(1, round(1 + train.steps * (most - 1)))
    edges = np.linspace(0.0, lasts_s, count + 1)[:-1]
    settings = []
    for h, edge in enumerate(edges.tolist()):
        loads, inputs = _rest(limits), dict(limits.nominal)
        for c, name in active:
            sign = int(SIGNS[1 + c % 31, train.place % 32])
            share = float(amplitudes[c]) * _level(kind, h + (c if kind == "square" else 0), count)
            if name in limits.loads:
                loads[name] = _scale(limits.loads[name], 0.0, sign * share)
            else:
                inputs[name] = _scale(limits.inputs[name], limits.nominal[name], sign * share)
        settings.append(Setting(begin_s + edge, *heat, loads, inputs))
    return settings


def _level(kind: str, h: int, count: int) -> float:
    """Return the level of step h of a train, 0..1."""
    if kind == "hold":
        return 1.0 if h == 0 else 0.0
    if kind == "square":
        return 1.0 - h % 2
    rise = (h + 1) / max(1, (count + 1) // 2)
    return float(min(rise, max(0.0, 2.0 - rise)))


def _scale(reach: Reach, rest: float, share: float) -> float:
    """Return a value of a range: `share` of the way from rest to an end, the only one there is."""
    up, down = max(reach.high - rest, 0.0), max(rest - reach.low, 0.0)
    if share < 0.0 and down > 0.05 * up:
        return rest + share * down
    return rest + abs(share) * up if up > 0.0 else rest - abs(share) * down


def _reach(limits: Limits, name: str) -> Reach:
    return limits.loads[name] if name in limits.loads else limits.inputs[name]


def _rest(limits: Limits) -> dict[str, float]:
    return dict.fromkeys(limits.loads, 0.0)


def _round(settings: list[Setting]) -> list[Setting]:
    """Return the settings with numbers that people can set, and none that changes nothing."""
    kept: list[Setting] = []
    for one in settings:
        rounded = Setting(
            float(np.round(one.from_s, 0)),
            float(np.round(one.temperature_degC, 1)),
            float(np.floor(100.0 * one.rate_K_per_min) / 100.0) if one.rate_K_per_min else 0.0,
            {name: float(f"{value:.3g}") for name, value in one.loads.items()},
            {name: float(f"{value:.4g}") for name, value in one.inputs.items()},
        )
        if kept and (rounded.loads, rounded.inputs, rounded.temperature_degC) == (
            kept[-1].loads,
            kept[-1].inputs,
            kept[-1].temperature_degC,
        ):
            continue
        kept.append(rounded)
    return kept


def _mirror(log: Log, limits: Limits) -> Log:
    """Return the log with loads of the other sign, where both signs can be put on."""

    def turn(loads: dict[str, float]) -> dict[str, float]:
        turned = {}
        for name, load in loads.items():
            reach = limits.loads[name]
            possible = reach.low <= -load <= reach.high
            turned[name] = -load if possible and load else load
        return turned

    settings = tuple(
        Setting(s.from_s, s.temperature_degC, s.rate_K_per_min, turn(dict(s.loads)), s.inputs)
        for s in log.settings
    )
    return Log(settings, log.lasts_s, log.power_on)


# The search for the best programme: designed ones first, then a global search.
#
# Differential evolution (Storn and Price, J. Global Optimization 11 (1997)) over the cube of
# `patterns`, begun with designed programmes, within a budget of processor time. Whatever interrupts
# it, the best programme so far is kept.

POPULATION = 24
SEED = 20
"""Of the search; the same question has the same answer, but for where time ends it."""
DESIGNED = 0.35
"""Share of the time after which no more designed programmes are tried."""
ENOUGH = 0.999
"""A worth beyond which nothing is left to be gained."""


@dataclass(frozen=True)
class Best:
    """The best programme so far."""

    space: Space
    point: Array
    worth: float
    tried: int
    interrupted: bool = False


Worth = Callable[[Space, Array], float]
Say = Callable[[str], None]

# Duration, temperature, ramp, steps, shape, loads, inputs; shapes: 0 hold, 0.5 square, 0.9 stairs.
_DESIGNS: tuple[tuple[tuple[float, ...], ...], ...] = (
    (
        (0.4, 1.0, 0.0, 0.2, 0.0, 0.0, 0.0),
        (0.6, 0.0, 0.9, 0.3, 0.5, 1.0, 1.0),
        (0.6, 0.0, 0.0, 0.3, 0.0, 1.0, 1.0),
        (0.4, 0.8, 0.0, 0.6, 0.9, 1.0, 0.0),
        (0.3, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0),
    ),
    (
        (0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        (0.5, 1.0, 1.0, 0.3, 0.5, 1.0, 1.0),
        (0.8, 1.0, 0.0, 0.1, 0.0, 1.0, 0.0),
        (0.5, 0.2, 1.0, 0.8, 0.5, 1.0, 1.0),
        (0.3, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0),
    ),
    (
        (0.9, 0.5, 0.0, 0.0, 0.0, 1.0, 0.0),
        (0.5, 0.5, 0.0, 0.9, 0.9, 1.0, 0.0),
        (0.5, 0.5, 0.0, 0.9, 0.5, 1.0, 1.0),
        (0.3, 0.9, 0.0, 0.0, 0.0, 0.0, 0.0),
        (0.4, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0),
    ),
    (
        (0.2, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        (0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
        (0.7, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0),
        (0.7, 0.1, 1.0, 0.5, 0.5, 0.0, 1.0),
        (0.3, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0),
    ),
    (
        (0.3, 0.8, 0.0, 0.5, 0.9, 1.0, 1.0),
        (0.3, 0.2, 0.0, 0.5, 0.9, 1.0, 1.0),
        (0.3, 1.0, 0.0, 0.5, 0.5, 1.0, 1.0),
        (0.3, 0.0, 0.0, 0.5, 0.5, 1.0, 1.0),
        (0.3, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0),
    ),
)


def list_designs(space: Space) -> list[Array]:
    """Return points of programmes that people would think of, in pairs of patterns."""
    channels = len(space.channels)

    def encode(design: Sequence[Sequence[float]], power: float) -> Array:
        table = np.array(design)
        assert table.shape == (SEGMENTS, PER_SEGMENT)
        return np.concatenate([table.ravel(), np.full(channels, 0.9), [power]])

    points = []
    for i in range(len(_DESIGNS)):
        for j in (i, (i + 1) % len(_DESIGNS)):
            parts = [encode(_DESIGNS[i], 0.9), encode(_DESIGNS[j], 0.1)]
            points.append(np.concatenate(parts[: space.patterns]))
    return points


def find_programme(
    spaces: Sequence[Space],
    worth: Worth,
    budget_s: float,
    say: Say,
    first: Callable[[Best], None] = lambda best: None,
) -> Best:
    """Return the programme of most worth.

    Args:
        spaces: numbers and lengths of logs to choose from, the likeliest first.
        worth: of a programme, larger is better, 1 the most.
        budget_s: processor seconds.
        say: told how far it is.
        first: told the best of the designed programmes, the first answer.

    Returns:
        The best so far, also where Ctrl-C ends it early.
    """
    from scipy.optimize import differential_evolution

    begin = time.process_time()
    best: Best | None = None
    tried = 0

    def assess(space: Space, point: Array) -> float:
        nonlocal best, tried
        value = worth(space, point)
        tried += 1
        if best is None or value > best.worth:
            best = Best(space, point.copy(), value, tried)
        return value

    def is_over() -> bool:
        return time.process_time() - begin > budget_s

    try:
        designed: list[tuple[Space, float, Array]] = []
        # By turns: a short search has looked at every number of logs too.
        for turn in zip(*(list_designs(space) for space in spaces), strict=True):
            for space, point in zip(spaces, turn, strict=True):
                designed.append((space, assess(space, point), point))
            if time.process_time() - begin > DESIGNED * budget_s:
                break
        assert best is not None
        first(best)
        space = best.space
        starts = sorted(
            ((value, p) for of, value, p in designed if of is space), key=lambda one: -one[0]
        )[:6]
        rng = np.random.default_rng(SEED)
        population = [best.point, *(point for _, point in starts)]
        while len(population) < POPULATION:
            near = population[int(rng.integers(len(population)))]
            mixed = np.where(rng.random(near.size) < 0.3, rng.random(near.size), near)
            population.append(np.clip(mixed + 0.05 * rng.standard_normal(near.size), 0.0, 1.0))

        def cost(point: Array) -> float:
            if is_over() or (best is not None and best.worth > ENOUGH):
                return 0.0
            value = assess(space, np.asarray(point))
            assert best is not None
            say(f"{tried} programmes tried, the best is worth {best.worth:.3f}")
            return -value

        def stop(*_: object, **__: object) -> bool:
            return is_over() or (best is not None and best.worth > ENOUGH)

        differential_evolution(
            cost,
            [(0.0, 1.0)] * space.size,
            init=np.array(population[:POPULATION]),
            maxiter=10_000,
            mutation=(0.3, 0.9),
            recombination=0.4,
            tol=0.0,
            polish=False,
            rng=SEED,
            callback=stop,
        )
    except KeyboardInterrupt:
        if best is None:
            raise
        return Best(best.space, best.point, best.worth, tried, interrupted=True)
    return Best(best.space, best.point, best.worth, tried)
