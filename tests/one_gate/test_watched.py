"""The units in use that the examination draws, and how it reads what `monitor` says."""

import numpy as np
import pytest
from benchmarks.one_gate import in_use, watched
from benchmarks.one_gate.in_use import DAY_S, NOISE, START_S
from benchmarks.one_gate.watched import OPEN, RIGHT, SILENT, WRONG


def draw(kind: str, seed: int = 0) -> tuple[in_use.Unit, in_use.Use]:
    rng = np.random.default_rng(seed)
    unit = in_use.draw_unit(rng)
    return unit, in_use.draw_use(unit, kind, rng)


@pytest.mark.parametrize("kind", (*in_use.CHANGES, *in_use.SOUND))
def test_a_use_has_a_gap_of_weeks(kind: str) -> None:
    _, use = draw(kind)
    assert len(use.logs) == (2 if kind.endswith("log after log") else 1)
    time_s = np.concatenate([log["time_s"] for log in use.logs])
    steps = np.diff(time_s)
    assert np.sum(steps > 400.0) == 1
    assert 13.9 < steps.max() / DAY_S < 63.1
    assert use.gap == (time_s[np.argmax(steps)], time_s[np.argmax(steps) + 1])


@pytest.mark.parametrize("kind", in_use.CHANGES[:2])
def test_a_step_lies_in_the_gap_and_is_as_large_as_stated(kind: str) -> None:
    unit, use = draw(kind)
    assert use.gap[0] <= use.at <= use.gap[1]
    left = np.concatenate([log["y_N"] - unit.drift(log["temperature_degC"]) for log in use.logs])
    time_s = np.concatenate([log["time_s"] for log in use.logs])
    moved = left[time_s > use.at].mean() - left[time_s < use.at].mean()
    assert abs(abs(moved) - in_use.STEP * NOISE) < 0.2


def test_ageing_goes_on_at_its_rate() -> None:
    unit, use = draw("ageing, within a log")
    (log,) = use.logs
    left = log["y_N"] - unit.drift(log["temperature_degC"])
    rate = np.polynomial.polynomial.polyfit((log["time_s"] - START_S) / DAY_S, left, 1)[1]
    assert rate == pytest.approx(use.rate_per_day, rel=0.2)


@pytest.mark.parametrize("seed", range(5))
def test_a_trained_model_misfits_by_less_than_the_noise(seed: int) -> None:
    rng = np.random.default_rng(seed)
    unit = in_use.draw_unit(rng)
    runs = [in_use.draw_chamber(rng) for _ in range(5)]
    misfit = in_use.measure_misfit(unit, runs, in_use.draw_field(rng, 2880))
    assert 0.05 * NOISE < misfit < 0.5 * NOISE


def test_the_field_is_within_what_was_calibrated() -> None:
    rng = np.random.default_rng(5)
    field, chamber = in_use.draw_field(rng, 30_000), in_use.draw_chamber(rng)
    assert chamber.min() < field.min() and field.max() < chamber.max()


def date(at_s: float) -> str:
    return str(np.datetime64(int(at_s), "s")).replace("T", " ") + " UTC"


def test_an_interval_is_read_from_the_verdict_or_the_text() -> None:
    low, high = START_S, START_S + 3.0 * DAY_S
    for output in (
        {"verdict": {"cause": "step", "between": [low, high]}},
        {"verdict": {"between": [date(low), date(high)]}},
        {"verdict": {"size": [1.0, 2.0], "since_earliest": low, "since_latest": high}},
        {"verdict": {"between": {"from": date(low), "to": date(high)}}},
        {"text": f"y moved by 3.1 N between {date(low)} and {date(high)}"},
    ):
        found = watched.read_between(output)
        assert found is not None
        assert found == pytest.approx((low, high), abs=1.1)
    assert watched.read_between({"verdict": {"size": [1.0, 2.0]}, "text": "moved at once"}) is None
    day = watched.read_between({"text": "between 2026-01-02 and 2026-01-03"})
    assert day == (START_S + DAY_S, START_S + 3.0 * DAY_S)


def test_a_step_is_right_only_between_times_that_hold_it() -> None:
    _, use = draw("step, log after log")

    def judged(cause: str, *between: float) -> str:
        told = {"verdict": {"cause": cause, "between": list(between) or None}}
        return watched.judge("step, log after log", use, told)

    assert judged("step", *use.gap) == RIGHT
    assert judged("undecided", *use.gap) == RIGHT
    assert judged("step", use.gap[1], use.gap[1] + 60.0) == WRONG
    assert judged("step") == WRONG
    assert judged("undecided") == OPEN
    assert judged("ageing", *use.gap) == WRONG
    assert judged("") == SILENT


def test_ageing_is_right_by_its_name_and_rate_or_open_over_the_whole_gap() -> None:
    _, use = draw("ageing, log after log")

    def judged(**verdict: object) -> str:
        return watched.judge("ageing, log after log", use, {"verdict": verdict})

    assert judged(cause="ageing") == RIGHT
    assert judged(cause="ageing", rate_per_day=[use.rate_per_day - 1, use.rate_per_day]) == RIGHT
    assert judged(cause="ageing", rate_per_day=[9.0, 10.0]) == WRONG
    assert judged(cause="step", between=[*use.gap]) == WRONG
    assert judged(cause="undecided", between=[*use.gap]) == RIGHT
    assert judged(cause="undecided", between=[use.gap[1], use.gap[1]]) == OPEN
    assert watched.judge("no change, within a log", use, {"verdict": {"cause": "step"}}) == WRONG
