"""The search keeps the best programme, whatever ends it."""

from dataclasses import replace

import numpy as np
import pytest

from tests.plan.test_programme import SPACE
from zerodrift.discovery.search import Best, find_programme


def nearness(target):
    return lambda space, point: 0.9 - float(np.abs(point - target[: point.size]).mean())


TARGET = np.random.default_rng(5).random(SPACE.size)


@pytest.mark.long
def test_the_search_gets_nearer_than_designs_do():
    first: list[Best] = []
    best = find_programme([SPACE], nearness(TARGET), 1.5, lambda text: None, first.append)
    assert best.worth > first[0].worth + 0.02
    assert not best.interrupted and best.tried > 50


def test_an_interrupt_keeps_the_best_so_far():
    seen: list[float] = []

    def worth(space, point):
        if len(seen) == 40:
            raise KeyboardInterrupt
        seen.append(nearness(TARGET)(space, point))
        return seen[-1]

    best = find_programme([SPACE], worth, 60.0, lambda text: None)
    assert best.interrupted
    assert best.worth == max(seen) and best.tried == 40


def test_a_search_without_time_has_looked_at_every_number_of_logs():
    spaces = [replace(SPACE, logs=n) for n in (6, 2, 1)]
    seen: list[int] = []

    def worth(space, point):
        seen.append(space.logs)
        return 0.0

    find_programme(spaces, worth, 1e-9, lambda text: None)
    assert seen[:3] == [6, 2, 1]
