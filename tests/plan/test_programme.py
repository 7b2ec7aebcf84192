"""Programmes keep to their limits wherever the search goes, and can be played."""

import numpy as np
import pytest

from tests.plan.projects import read
from zerodrift.discovery.limits import resolve_limits
from zerodrift.discovery.programme import (
    Log,
    SetProgramme,
    Setting,
    check_followed,
    follow,
    list_set_points,
)
from zerodrift.discovery.search import FEW, Space, choose_spaces, list_designs
from zerodrift.discovery.summary import list_protocols
from zerodrift_lab.twin.six_axis.heat import draw_network
from zerodrift_lab.twin.six_axis.protocol import parse_protocol
from zerodrift_lab.twin.six_axis.timeline import draw_timeline

LIMITS = resolve_limits(read(), (), 4.0)
SPACE = Space(LIMITS, 6, 2100.0)


def list_points():
    rng = np.random.default_rng(3)
    return [
        *list_designs(SPACE),
        *rng.random((40, SPACE.size)),
        *rng.integers(0, 2, (10, SPACE.size)) * 1.0,
    ]


@pytest.mark.parametrize("number", range(60))
def test_every_point_keeps_to_the_limits(number):
    programme = SPACE.build(np.asarray(list_points()[number]))
    assert check_followed(programme, LIMITS) == []
    assert len(programme.logs) == 6
    for log in programme.logs:
        begins = [s.from_s for s in log.settings]
        assert begins == sorted(set(begins))
        assert begins[0] == 0.0 and begins[-1] < log.lasts_s
        quiet = log.settings[0]
        assert quiet.temperature_degC == LIMITS.start_degC and not any(quiet.loads.values())
        _, levels = list_set_points(log, LIMITS.start_degC)
        assert levels[-1] == pytest.approx(LIMITS.start_degC, abs=0.7)


def test_the_check_of_limits_sees_what_breaks_them():
    fast = Log((Setting(0.0, 45.0, 9.0, {"Fz": 500.0}, {"supply": 6.0}),), 600.0)
    told = " ".join(check_followed(SetProgramme((fast,), 0.0, 23.0), LIMITS))
    assert "too fast" in told and "Fz = 500" in told and "supply = 6" in told


def test_hours_count_logs_and_rests():
    for space in choose_spaces(LIMITS, 4.0, runs=2, few=FEW):
        assert space.build(list_designs(space)[0]).hours <= 4.0 + 1e-9
        assert space.log_s >= LIMITS.log_s


def test_few_long_logs_are_worth_a_look_beside_the_likeliest():
    likely = choose_spaces(LIMITS, 4.0, runs=0)
    spaces = choose_spaces(LIMITS, 4.0, runs=0, few=FEW)
    assert spaces == [*likely, *spaces[len(likely) :]]
    assert {space.logs for space in spaces} == {space.logs for space in likely} | set(FEW)
    # Of two logs, either is judged by the other: they go to the same temperatures.
    two = next(space for space in spaces if space.logs == 2)
    logs = two.build(list_designs(two)[2]).logs
    settings = [[(s.from_s, s.temperature_degC) for s in log.settings] for log in logs]
    assert len(logs) == 2 and settings[0] == settings[1]
    # Where one log is all that there is time for, it is named once.
    assert [space.logs for space in choose_spaces(LIMITS, 0.5, runs=0, few=FEW)] == [1]


def test_what_uses_all_the_limits_is_the_same_whatever_the_hours():
    use = [space.use_all() for h in (0.5, 4.0, 40.0) for space in choose_spaces(LIMITS, h, 0)]
    assert all(one == use[0] for one in use)
    points = list_designs(use[0])
    reached = [s.temperature_degC for log in use[0].list_patterns(points[1]) for s in log.settings]
    assert min(reached) == LIMITS.low_degC and max(reached) == LIMITS.high_degC


def test_the_thermometer_follows_the_chamber_late():
    log = Log((Setting(0.0, 23.0, 0.0, {"Fz": 0.0}), Setting(60.0, 43.0, 2.0, {"Fz": 0.0})), 3600.0)
    course = follow(log, LIMITS, 1.0, 23.0)
    ramping = course.time_s == 600.5
    # On a ramp of rate r, what follows with tau is r tau behind, the beginning forgotten.
    behind = 23.0 + 2.0 / 60.0 * (600.5 - 60.0) - course.temperature_degC[ramping][0]
    expected = 2.0 / 60.0 * 200.0 * (1.0 - np.exp(-540.5 / 200.0))
    assert behind == pytest.approx(expected, abs=0.02)
    assert course.temperature_degC[-1] == pytest.approx(43.0, abs=0.01)


def test_protocols_say_what_the_table_says():
    point = list_points()[2]
    programme = SPACE.build(np.asarray(point))
    network = draw_network(0)
    rng = np.random.default_rng(0)
    texts = list_protocols(programme, LIMITS, {"Fz": "N"})
    assert list(texts) == [f"{n}.txt" for n in range(1, 7)]
    for log, text in zip(programme.logs, texts.values(), strict=True):
        timeline = draw_timeline(parse_protocol(text, "plan", "plan"), rng, network)
        assert timeline.duration_s == pytest.approx(log.lasts_s, abs=0.2)
        times, levels = list_set_points(log, programme.start_degC)
        at = np.linspace(0.0, log.lasts_s, 50)
        # The twin rounds moves to tenths of a second.
        assert timeline.air.evaluate(at) == pytest.approx(np.interp(at, times, levels), abs=0.05)
        course = follow(log, LIMITS, 1.0, programme.start_degC)
        loads = timeline.load[2].evaluate(course.time_s)
        assert loads == pytest.approx(course.loads["Fz"], abs=1.0)
