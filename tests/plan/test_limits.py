"""What an experiment may do: read, completed and refused."""

import pytest

from tests.plan.projects import EXPERIMENT, HEAD, read, write_blank
from zerodrift.base.errors import InputError
from zerodrift.discovery.limits import resolve_limits
from zerodrift.discovery.plan import Question


def test_limits_are_read_with_their_units():
    limits = resolve_limits(read(), (), 8.0)
    assert (limits.low_degC, limits.high_degC, limits.start_degC) == (-10.0, 50.0, 23.0)
    assert limits.heating_K_per_s == pytest.approx(4.0 / 60.0)
    assert limits.cooling_K_per_s == pytest.approx(2.0 / 60.0)
    assert limits.inputs["supply"].hold_s == 30.0
    assert limits.nominal["supply"] == pytest.approx(5.0)
    assert not limits.notes


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("[-10, 50]", "[50, -10]", "the lower one first"),
        ("[-10, 50]", "[20, 20]", "the lower one first"),
        ("[-10, 50]", "[-300, 50]", "above -273.15"),
        ("heating_K_per_min = 4", "heating_K_per_min = 0", "a number > 0"),
        ("heating_K_per_min = 4", "heating_K_per_mim = 4", "heating_K_per_min"),
        ("heating_K_per_min = 4", "start_degC = 80", "within [experiment] temperature_degC"),
        ("heating_K_per_min = 4", "hours = 1\nlog_min = 90", "Allow more hours"),
        ("Fz = [", "Fx = [", "is no output"),
        ("supply = {", "humidity = {", "is no input"),
        ("hold_s = 30", "hold = 30", "hold_s"),
    ],
)
def test_limits_that_cannot_be_are_refused_with_their_line(old, new, told):
    assert old in EXPERIMENT
    text = HEAD + EXPERIMENT.replace(old, new)
    line = next(i for i, s in enumerate(text.splitlines(), 1) if new.splitlines()[0] in s)
    with pytest.raises(InputError) as refused:
        read(EXPERIMENT.replace(old, new))
    assert told in str(refused.value)
    assert f"zerodrift.toml:{line}:" in str(refused.value)


def test_a_chamber_that_cannot_move_in_time_is_refused():
    slow = EXPERIMENT.replace("_min = 4", "_min = 0.01").replace("_min = 2", "_min = 0.01")
    with pytest.raises(InputError, match="no chamber moves 1 K and back"):
        resolve_limits(read(slow), (), 1.0)


def test_without_limits_and_logs_it_says_what_is_missing(tmp_path, zerodrift):
    told = zerodrift("plan", "-C", write_blank(tmp_path, ""), "--hours", "2")
    assert told.code == 2
    assert "temperature_degC is missing" in told.err
    assert "--within" in told.err


def test_hours_without_room_for_a_log_are_refused():
    with pytest.raises(InputError, match="expected room for at least one"):
        resolve_limits(
            read(EXPERIMENT.replace("[experiment]", "[experiment]\nlog_min = 50")), (), 0.5
        )


@pytest.mark.parametrize(
    "given", [{"hours": float("nan")}, {"hours": 0.0}, {"budget_s": float("nan")}, {"target": -0.1}]
)
def test_what_is_no_number_of_hours_or_seconds_is_refused(given):
    with pytest.raises(InputError, match="finite and more than 0"):
        Question(**given)
