"""The search for the best programme: designed ones first, then a global search.

Differential evolution (Storn and Price, J. Global Optimization 11 (1997)) over the cube of
`patterns`, begun with designed programmes, within a budget of processor time. Whatever interrupts
it, the best programme so far is kept.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.discovery.patterns import PER_SEGMENT, SEGMENTS, Space

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
