"""Pictures are exact where it counts: places, ticks, peaks, and words for those who cannot see."""

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from tests.report.conftest import make_comparison, make_findings, make_trace

from zerodrift.diagnosis.drivers import DriftDriver
from zerodrift.diagnosis.history import Step
from zerodrift.diagnosis.summary import WorstSegment
from zerodrift.report.cause import (
    PANES,
    CauseView,
    choose_against,
    choose_panes,
    draw_cause,
    list_channels,
    read_driven,
)
from zerodrift.report.pictures import draw_stairs
from zerodrift.report.svg import (
    INKS,
    AxisScale,
    Curve,
    Panel,
    Picture,
    list_log_ticks,
    list_round_ticks,
    render_svg,
    write_style,
)
from zerodrift.report.tables import tabulate_worst
from zerodrift.report.window import Window, choose_clock, lay_out_cause
from zerodrift.workbench.first_look import HEADING, TALL, FirstLook, LoggedLine, draw_waiting


def draw_one(curve, x=None, y=None):
    panel = Panel(
        left=50.0,
        top=20.0,
        width=400.0,
        height=100.0,
        x=x or AxisScale(0.0, 10.0),
        y=y or AxisScale(0.0, 1.0),
        curves=(curve,),
    )
    return render_svg(Picture(500.0, 150.0, (panel,), "A <line> & more"))


def test_points_stand_where_the_axes_say():
    text = draw_one(Curve(np.array([0.0, 5.0, 10.0]), np.array([0.0, 1.0, 0.5]), "model"))
    assert 'd="M50 120L250 20L450 70"' in text


def test_what_is_not_a_number_is_a_gap_and_what_lies_outside_is_cut():
    text = draw_one(Curve(np.arange(4.0), np.array([0.5, np.nan, 9.0, 0.5]), "model"))
    assert 'd="M50 70M130 17L170 70"' in text


def test_logarithmic_axis():
    scale = AxisScale(1.0, 100.0, log=True)
    text = draw_one(Curve(np.array([0.0, 10.0]), np.array([1.0, 10.0]), "model"), y=scale)
    assert 'd="M50 120L450 70"' in text


def test_picture_is_xml_without_scripts_and_says_what_it_shows():
    text = draw_one(Curve(np.arange(3.0), np.arange(3.0), "left", "a < b"))
    root = ElementTree.fromstring(text)
    assert root.get("role") == "img"
    assert root.get("aria-label") == "A <line> & more"
    assert "script" not in text


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0.0, 1.0, ("0.0", "0.5", "1.0")),
        (-0.06, 0.06, ("−0.05", "0.00", "0.05")),
        (0.0, 3600.0, ("0", "2000")),
        (1e6, 3e6, ("1e+06", "2e+06", "3e+06")),
    ],
)
def test_ticks_are_round_and_hold_their_digits(low, high, expected):
    assert tuple(words for _, words in list_round_ticks(low, high, 3)) == expected


def test_ticks_of_a_point_and_of_decades():
    assert list_round_ticks(2.0, 2.0, 4) == ((2.0, "2"),)
    assert [words for _, words in list_log_ticks(0.9, 12.0)] == ["1", "2", "5", "10"]


def read_luminance(colour):
    parts = [int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_every_ink_stands_out_from_its_ground():
    for name, (light, dark) in INKS.items():
        assert 1.05 / (read_luminance(light) + 0.05) >= 3.0, name
        assert (read_luminance(dark) + 0.05) / (read_luminance("#14181d") + 0.05) >= 3.0, name
        assert f".s-{name}{{stroke:{light}}}" in write_style()


@pytest.mark.parametrize("count", [1, 2, 7])
def test_each_step_of_the_staircase_is_seen_and_labelled(count):
    steps = [
        Step(f"+ e{i}", {"Fz": 4.0 - 0.5 * i}, {"Fz": 1.0}, {"Fz": "N"}, (), "")
        for i in range(count)
    ]
    picture = draw_stairs(steps, 760.0)
    (panel,) = picture.panels
    (curve,) = panel.curves
    places = panel.left + panel.width * panel.x.place(curve.x)
    assert places[1] - places[0] > 60.0
    assert places[-1] <= picture.width
    text = render_svg(picture)
    for number in range(count):
        assert f"{number} + e{number}" in text
    assert "noise floor" in text


@pytest.fixture
def long_run():
    """Return findings of a long run with one wild sample, and a lag."""
    count = 200_000
    rng = np.random.default_rng(0)
    temperature = 25.0 + 10.0 * np.sin(np.arange(count) / 3000.0)
    error = 0.01 * rng.standard_normal(count)
    error[123_456] = 7.0
    load = np.repeat([0.0, 5.0], count // 2)
    trace = make_trace(2.0 * error, error, temperature=temperature, load=load)
    worst = (WorstSegment("run", "Fz", 1000.0, 2000.0, 1.0, "heating", 0.5),)
    return make_findings(traces=(trace,), comparison=make_comparison(worst))


def view_of(findings, **changes):
    (trace,) = findings.traces
    channels = list_channels(findings)
    suspects = (DriftDriver("temperature", "lag", 50.0),)
    told = {
        "trace": trace,
        "output": "Fz",
        "window": Window("run"),
        "panes": choose_panes(suspects, channels),
        "against": choose_against(suspects),
        **changes,
    }
    return draw_cause(
        CauseView(**told),
        findings.comparison,
        channels,
        lambda driver: read_driven(findings, trace, driver),
    )


def test_no_peak_is_lost_and_few_points_are_sent(long_run):
    drawn = view_of(long_run)
    left = next(c for p in drawn.picture.panels for c in p.curves if c.name == "what is left")
    assert left.y.max() == 7.0
    assert left.y.size < 4.0 * drawn.width
    assert len(render_svg(drawn.picture)) < 250_000


def test_panes_are_drift_left_temperature_and_what_is_suspected(long_run):
    keys = [pane.key for pane in view_of(long_run).panes]
    assert keys == ["drift", "left", "value:60:temperature", "lag:50:temperature"]
    assert list_channels(long_run) == {"temperature": "degC", "load Fz": "N", "time": "min"}


def test_worst_segment_is_shaded_in_every_pane_of_time(long_run):
    drawn = view_of(long_run)
    shaded = [panel for panel in drawn.picture.panels if panel.bands]
    assert len(shaded) == len(drawn.panes)


def test_what_is_read_under_the_cursor_are_the_samples(long_run):
    drawn = view_of(long_run)
    (trace,) = long_run.traces
    rows = np.array(drawn.times_s).astype(int)
    for name, values in (("what is left", trace.error[0]), ("temperature", trace.temperature_degC)):
        curve = next(c for c in drawn.curves if c.name == name)
        assert curve.values == pytest.approx(values[rows], rel=1e-4, abs=1e-9)
        assert curve.unit
    assert drawn.scatter.against == pytest.approx(trace.temperature_degC[rows], rel=1e-4)


@pytest.mark.parametrize("width", [300.0, 1100.0])
def test_nothing_stands_outside_of_the_picture(long_run, width):
    contribution = 0.5 * long_run.traces[0].error[0]
    drawn = view_of(long_run, width=width, effect="thermal_lag", contribution=contribution)
    for panel in drawn.picture.panels:
        assert 0.0 <= panel.left <= panel.left + panel.width <= width
        assert 0.0 <= panel.top <= panel.top + panel.height <= drawn.picture.height
    text = render_svg(drawn.picture)
    assert "thermal_lag would explain" in text
    assert re.search(r"heating.*cooling", text)


@pytest.mark.parametrize(
    ("begin_s", "title", "first"),
    [
        (0.0, "time on the log's clock, min", 0.0),
        (120.0, "time on the log's clock, min", 2.0),
        (1772352000.0, "time since 2026-03-01 08:00:00, min", 0.0),
    ],
)
def test_a_clock_of_dates_is_told_from_the_runs_first_row(begin_s, title, first):
    flat = np.zeros(900)
    trace = make_trace(flat, flat, temperature=flat, load=flat)
    trace = replace(trace, time_s=trace.time_s + begin_s)
    axis = choose_clock(trace)
    assert axis.title == title
    assert axis.place(trace.time_s)[[0, 60]].tolist() == [first, first + 1.0]
    worst = WorstSegment("run", "Fz", begin_s, begin_s + 60.0, 1.0, "", 0.5)
    table = tabulate_worst(make_comparison((worst,)))
    dated = begin_s > 1e8
    assert table.headings[4:6] == (("from", "to") if dated else ("from, s", "to, s"))
    ends = ("2026-03-01 08:00:00", "2026-03-01 08:01:00")
    assert table.rows[0][4:6] == (ends if dated else (f"{begin_s:g}", f"{begin_s + 60.0:g}"))


def test_page_shows_five_panes_whatever_is_suspected():
    channels = {"temperature": "degC", "time": "min"}
    none, lag = (), (DriftDriver("temperature", "lag", 50.0),)
    for suspects in (none, lag):
        for known in (channels, {**channels, "load Fz": "N", "supply": "V"}):
            panes = choose_panes(suspects, known, fills=True)
            assert len(panes) == len(set(panes)) == PANES
            assert panes[3:4] == tuple(driver.key for driver in suspects) or not suspects


@pytest.mark.parametrize("width", [340.0, 700.0, 1048.0])
def test_frame_that_waits_has_the_places_of_the_chart(long_run, width):
    keys = choose_panes((), list_channels(long_run), fills=True)
    drawn = view_of(long_run, panes=keys, width=width, heading=HEADING)
    waiting = draw_waiting(None, width)
    look = FirstLook("Fz", "N", "a.csv", *2 * (LoggedLine((0.0, 9.0), (1.0, 2.0)),), 0.0, 9.0)
    assert waiting.height == draw_waiting(look, width).height == drawn.picture.height
    places = [(pane.top, pane.height) for pane in drawn.panes]
    assert list(lay_out_cause(TALL, width).panes) == places
    assert not waiting.is_drawn and draw_waiting(look, width).svg.count('class="line') == 2


def test_narrow_legend_does_not_lie_over_the_pages_heading(long_run):
    curve = np.zeros(200_000)
    given = {"effect": "thermal_lag", "contribution": curve, "heading": HEADING}
    for width, names in ((340.0, ["", "thermal_lag would explain"]), (1048.0, None)):
        drawn = view_of(long_run, width=width, **given)
        told = [curve.name for curve in drawn.picture.panels[1].curves]
        assert told == (names or ["what is left", "thermal_lag would explain"])
        assert "what is left" in [read.name for read in drawn.curves]
