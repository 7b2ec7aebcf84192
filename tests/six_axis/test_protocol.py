"""Protocols: what they do, and what a wrong one is told, with file and line."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zerodrift.base.errors import InputError
from zerodrift_lab.twin.six_axis import (
    draw_sensor,
    list_protocols,
    load_protocol,
    parse_protocol,
    record,
)
from zerodrift_lab.twin.six_axis.heat import NODE, draw_network
from zerodrift_lab.twin.six_axis.protocol import WORDS
from zerodrift_lab.twin.six_axis.timeline import draw_timeline
from zerodrift_lab.twin.six_axis.words import DIMENSIONS

REPOSITORY = Path(__file__).resolve().parents[2]


def draw(text, seed=0):
    protocol = parse_protocol(text, "p.txt", "p")
    return draw_timeline(protocol, np.random.default_rng(seed), draw_network(None))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("air -300 degC", r"p\.txt:2: the air's temperature is -300 degC, below absolute zero"),
        ("room -274..20 degC", r"p\.txt:2: .*-274\.\.20 degC, below absolute zero"),
        ("plate -273.15 degC", "below absolute zero"),
        ("air 900 degC", "at most 500"),
        ("wait -5 s", r"p\.txt:2: the wait is -5 s; expected 0\.1 to"),
        ("wait 0 s", "the wait is 0 s"),
        ("air 60 degC over -9 s", "the time of the change is -9 s"),
        ("wait 5 K", "the wait is '5 K'; expected s or min or h"),
        ("wait 5", "ends too early; expected the unit of the wait"),
        ("wait", "ends too early; expected the wait as NUMBER or LOW..HIGH"),
        ("wait soon s", "'soon' is no number"),
        ("wait nan s", "is not finite"),
        ("wait 9..3 s", "swap the two"),
        ("wait 5 s please", "'please' is left over"),
        ("wiat 5 s", "unknown word 'wiat'; did you mean 'wait'"),
        ("air 60 K", r"'60 K'; expected degC"),
        ("air 60 degC at -2 K/min", "the rate of the air is -2 K/min; expected more than 0"),
        ("load Fq 5 N", "no output 'Fq'; did you mean"),
        ("load Mx 5 N", "the load on Mx is '5 N'; expected Nm"),
        ("load Fz 5000 N", r"p\.txt:2: Fz is 5000 N; the sensor's range is 2000 N"),
        ("gait 0.6 s", "a gait without load"),
        ("gait 0.6 s duty 140 % Fz 9 N", "expected 5 to 100 %"),
        ("gait 0.6 s Fz 9 N Fz 8 N", "Fz is named twice"),
        ("humidity 140 %", "the humidity is 140 %; expected 0 to 100 %"),
        ("lamp -1 W", "expected 0 to 100 W"),
        ("lamp 400 K in 10 s", "the lamp would need"),
        ("plate -90000 K in 10 s", "a plate would have to be at"),
        ("airflow 0 W/m2K", "expected 1 to 200 W/m2K"),
        ("shake 5 m/s2 at 99 Hz for 9 s", "expected 0.01 to 50 Hz"),
        ("power off", "power is 'off'; expected on or before|Expected on or before"),
        ("reference none", "Expected weights or capacitive"),
        ("end", "'end' without 'repeat'"),
        ("repeat 2", "'repeat' has no 'end'|nothing between"),
        ("repeat x", "expected a whole number from 1 to 1000"),
        ("wait 5 s\nroom 20 degC", r"p\.txt:3: 'room' stands after other statements"),
        ("wait 5 s\ntitle late", "the title stands first"),
        ("repeat 1000\nwait 99 h\nend", "expected at most"),
    ],
)
def test_wrong_protocol_is_refused_with_file_and_line(line, message):
    tail = "" if line.startswith("repeat") else "\nwait 9 s"
    with pytest.raises(InputError, match=message) as caught:
        draw(f"# a comment\n{line}{tail}")
    assert str(caught.value).startswith("p.txt:")


FOLDER = REPOSITORY / "lab" / "zerodrift_lab" / "twin" / "six_axis" / "protocols"
LINES = sorted({line for path in FOLDER.glob("*.txt") for line in path.read_text().splitlines()})
TOKENS = sorted({token for line in LINES for token in line.split()} | {*WORDS, *DIMENSIONS})
TOKENS += ["-5", "3..1", "1e999", "nan", "..", "%s", "\u2212" + "5", "0", "1e9"]


@st.composite
def draw_damaged_text(draw_from):
    """Lines of the bundled protocols, with words dropped, doubled or exchanged here and there."""
    lines = draw_from(st.lists(st.sampled_from(LINES).map(str.split), min_size=1, max_size=8))
    for words in lines:
        if words and draw_from(st.booleans()):
            place = draw_from(st.integers(0, len(words) - 1))
            words[place : place + 1] = draw_from(st.lists(st.sampled_from(TOKENS), max_size=2))
    return "\n".join(map(" ".join, lines))


@pytest.mark.long
@settings(max_examples=400, deadline=None)
@given(draw_damaged_text())
def test_any_text_is_drawn_or_refused_with_its_place(text):
    try:
        timeline = draw(text)
    except InputError as error:
        assert str(error).startswith("p.txt")
    else:
        assert timeline.duration_s > 0.0
        around = timeline.surround(60.0, int(timeline.duration_s / 60.0) + 1)
        assert np.all(np.isfinite(around.air))
        assert np.all(around.air > -273.15)


def test_empty_protocol_and_missing_file_are_refused(tmp_path):
    with pytest.raises(InputError, match="takes no time; expected a 'wait'"):
        parse_protocol("air 20 degC", "p.txt", "p")
    with pytest.raises(InputError, match="did you mean 'chamber'"):
        load_protocol("chambr")
    (tmp_path / "bad.txt").write_bytes(b"wait \xff s")
    with pytest.raises(InputError, match="not UTF-8"):
        load_protocol(tmp_path / "bad.txt")
    (tmp_path / "my plan.txt").write_text("wait 5 min\n")
    assert load_protocol(tmp_path / "my plan.txt").name == "my_plan"


def test_statements_move_what_they_name():
    timeline = draw(
        "title All\nroom 22 degC\nwait 10 s\nair 40 degC at 6 K/min\nwait 60 s\n"
        "load Fz 50 N over 5 s\n"
        "supply 5.2 V\nhumidity 70 % over 20 s\nlight 300 lux\nplate -20 degC over 4 s\n"
        "lamp 2 W over 1 s\nwait 200 s\nplate none\nairflow 20 W/m2K\nload none\nlamp off\n"
        "shake 4 m/s2 at 1 Hz for 30 s\nwait 100 s"
    )
    assert timeline.duration_s == 370.0

    def at(programme, time_s):
        return float(programme.evaluate(np.array([time_s]))[0])

    assert [at(timeline.air, t) for t in (0, 10, 70, 190, 360)] == pytest.approx(
        [22, 22, 28, 40, 40]
    )
    assert [at(timeline.load[2], t) for t in (70, 72.5, 75, 270, 273)] == pytest.approx(
        [0, 25, 50, 50, 0]
    )
    assert (at(timeline.supply, 65), at(timeline.supply, 80)) == pytest.approx((5.0, 5.2))
    assert at(timeline.humidity, 95) == pytest.approx(70.0)
    assert at(timeline.light, 95) == pytest.approx(300.0)
    assert at(timeline.plate, 100) == pytest.approx(-20.0)
    assert (at(timeline.lamp, 100), at(timeline.lamp, 300)) == pytest.approx((2.0, 0.0))
    around = timeline.surround(1.0, 371)
    assert not around.on_plate[69]
    assert around.on_plate[70]
    assert around.on_plate[269]
    assert not around.on_plate[270]
    assert (around.airflow[269], around.airflow[270]) == (10.0, 20.0)
    shaken = timeline.acceleration[0].evaluate(np.arange(260.0, 310.0, 0.05))
    assert 1.0 < np.abs(shaken).max() <= 4.0


def test_unfinished_move_is_given_up_where_it_stands():
    timeline = draw(
        "room 20 degC\nair 60 degC over 100 s\nwait 50 s\nair 0 degC over 40 s\nwait 99 s"
    )
    values = timeline.air.evaluate(np.array([0.0, 50.0, 70.0, 90.0, 140.0]))
    np.testing.assert_allclose(values, [20.0, 40.0, 20.0, 0.0, 0.0])


def test_ranges_are_drawn_anew_in_every_repetition_and_run():
    text = "room 20 degC\nrepeat 3\n  air 30..60 degC over 10..90 s\n  wait 100 s\nend"
    levels = draw(text).air.levels
    tops = levels[levels > 25.0]
    assert np.unique(tops.round(6)).size == 3
    assert np.all((tops >= 30.0) & (tops <= 60.0))
    assert draw(text, seed=1).air.levels.tolist() != levels.tolist()
    times = draw(text).air.times_s
    np.testing.assert_allclose(times, np.round(times, 1), atol=1e-9)


def test_gait_presses_within_its_stance_and_stops():
    timeline = draw(
        "wait 10 s\ngait 0.7 s duty 60 % Fz 120 N Fx -20 N\nwait 60 s\ngait off\nwait 10 s"
    )
    time_s = np.arange(0.0, 80.0, 0.01)
    press = timeline.load[2].evaluate(time_s)
    assert press.max() == pytest.approx(120.0, rel=1e-3)
    assert np.all(press[(time_s < 10.0) | (time_s > 70.0)] == 0.0)
    walking = (time_s > 10.0) & (time_s < 70.0)
    assert np.mean(press[walking] > 0) == pytest.approx(0.6, abs=0.02)
    assert timeline.striding


@pytest.mark.parametrize(
    ("statement", "rise"),
    [
        ("plate -5 K in 300 s", -5.0),
        ("plate 20 degC over 4 s\nwait 2 h\nplate 7 K in 100 s", 7.0),
        ("lamp 10 K in 200 s", 10.0),
        ("airflow 25 W/m2K\nwait 2 h\nlamp 4 K in 60 s", 4.0),
    ],
)
@pytest.mark.parametrize("seed", [None, 1, 2])
def test_board_moves_as_far_as_asked_in_the_time_asked(statement, rise, seed):
    within = int(statement.split(" in ")[1].split()[0])
    protocol = parse_protocol(f"room 20 degC\nwait 60 s\n{statement}\nwait {within} s", "p", "p")
    board = record(draw_sensor(seed), protocol).nodes[:, NODE["board"]]
    assert board[-1] - board[-1 - within] == pytest.approx(rise, abs=0.01)


@pytest.mark.parametrize("seed", range(3))
def test_heating_and_cooling_are_those_of_the_paper(seed):
    sensor = draw_sensor(seed)
    heating, cooling = (record(sensor, load_protocol(name)) for name in ("heating", "cooling"))

    def move(run, sign):
        temperature = sign * run.temperature_degC
        return temperature.max() - temperature[:60].mean()

    assert 8.0 < move(heating, 1.0) < 13.0
    assert 4.0 < move(cooling, -1.0) < 6.2


def test_chamber_spans_the_papers_range_and_walk_goes_cold_hot_cold():
    sensor = draw_sensor(1)
    chamber = record(sensor, load_protocol("chamber"))
    assert chamber.temperature_degC.min() < -8.0
    assert chamber.temperature_degC.max() > 52.0
    assert np.all(chamber.load == 0.0)
    walk = record(sensor, load_protocol("walking"))
    assert walk.seconds == pytest.approx(3660.0, abs=2.0)
    thirds = np.array_split(walk.temperature_degC[60:], 3)
    assert thirds[0][-1] < thirds[1][-1] - 20.0
    assert thirds[2][-1] < thirds[1][-1] - 20.0
    assert walk.load[:, 2].max() > 60.0


def test_every_bundled_protocol_has_a_title_and_records():
    assert {"chamber", "chamber_loaded", "heating", "cooling", "walking"} <= set(list_protocols())
    for name in list_protocols():
        protocol = load_protocol(name)
        assert protocol.title != name
        assert record(draw_sensor(0), protocol, period_s=10.0).time_s.size > 50


def test_reference_page_names_every_word_unit_and_bundled_protocol():
    page = (REPOSITORY / "docs" / "reference" / "six-axis-twin.md").read_text(encoding="utf-8")
    for word in WORDS:
        assert re.search(rf"`{word}\b", page), word
    for unit in DIMENSIONS:
        assert f"{unit}" in page, unit
    for name in list_protocols():
        assert f"`{name}`" in page, name
