"""The cause picture: drift, residual, an effect's share and the channels on one time axis.

Beside them the residual against a channel, its rate or its lag, with rising and falling parts in
different marks: there a lag or a hysteresis is a loop.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array, IntArray
from zerodrift.diagnosis.drivers import (
    LAG,
    RATE,
    TAU_S,
    TEMPERATURE,
    TIME,
    VALUE,
    DriftDriver,
    derive,
    read_driver,
    suspect,
)
from zerodrift.diagnosis.summary import ComparisonSummary
from zerodrift.report.findings import MOVING_SHARE, Findings, Trace, find_threshold
from zerodrift.report.svg import (
    AxisScale,
    Band,
    Cloud,
    Curve,
    Level,
    Panel,
    Picture,
    measure_legend,
    spread,
)
from zerodrift.report.window import (
    MARGIN_LEFT,
    TimeAxis,
    Window,
    choose_clock,
    find_rows,
    lay_out_cause,
    pick_rows,
    pick_spread,
)

DRIFT, LEFT, EFFECT = "drift", "left", "effect"
"""Panes that show no channel: drift and model, what is left, what an effect would explain."""
PANES = 5
ROWS_READ = 600
"""Samples that can be read under the cursor."""
ROWS_OF_CLOUD = 1200
ROWS_OF_MEANS = 40_000
SHAPES = 10
"""Marks of a branch that tell it without its colour."""


@dataclass(frozen=True)
class CauseView:
    """What a cause picture shows."""

    trace: Trace
    output: str
    window: Window
    panes: tuple[str, ...]
    """From top to bottom: drift | left | effect, or a driver's key."""
    against: DriftDriver
    """What the scatter holds what is left against."""
    effect: str = ""
    """Whose contribution is drawn; empty: none."""
    contribution: Array | None = None
    """[n] of it, in the output's unit."""
    width: float = 1000.0
    heading: float = 0.0
    """Pixels that a page keeps free for its own heading of a pane; 0: the picture writes one."""


@dataclass(frozen=True)
class PanePlace:
    """Where a pane stands in the picture."""

    key: str
    top: float
    height: float


@dataclass(frozen=True)
class ReadCurve:
    """One signal that can be read under the cursor."""

    name: str
    unit: str
    values: tuple[float, ...]


@dataclass(frozen=True)
class ScatterPlace:
    """Where the scatter stands, and what it shows."""

    left: float
    top: float
    width: float
    height: float
    x: tuple[float, float]
    """The range of its x axis."""
    y: tuple[float, float]
    against: tuple[float, ...]
    """x of the samples that can be read."""


@dataclass(frozen=True)
class CausePicture:
    """The picture, and what a page needs to read it by a cursor."""

    picture: Picture
    panes: tuple[PanePlace, ...]
    left: float
    """Pixels of the time axis' start, ..."""
    width: float
    """... and of its length."""
    from_s: float
    to_s: float
    times_s: tuple[float, ...]
    """Of the samples that can be read."""
    curves: tuple[ReadCurve, ...]
    scatter: ScatterPlace


def list_channels(findings: Findings) -> dict[str, str]:
    """Return the channels that can be drawn, with their units; loads only where they move."""
    channels = {TEMPERATURE: "degC"}
    for k, name in enumerate(findings.outputs):
        if any(float(np.ptp(trace.load[k, ::97])) > 0.0 for trace in findings.traces):
            channels[f"load {name}"] = findings.units[k]
    channels |= {one.name: one.unit for one in findings.inputs}
    return {**channels, TIME: "min"}


def read_channel(findings: Findings, trace: Trace, channel: str) -> Array:
    """Return a channel [n] of a run, in its unit.

    Raises:
        KeyError: there is none of this name.
    """
    if channel == TEMPERATURE:
        return trace.temperature_degC
    if channel == TIME:
        return np.asarray((trace.time_s - trace.time_s[0]) / 60.0)
    kind, _, output = channel.partition(" ")
    if kind == "load" and output in findings.outputs:
        return np.asarray(trace.load[findings.outputs.index(output)])
    names = [one.name for one in findings.inputs]
    if channel not in names:
        raise KeyError(channel)
    return np.asarray(trace.inputs[names.index(channel)])


def read_driven(findings: Findings, trace: Trace, driver: DriftDriver) -> Array:
    """Return a driver [n] of a run."""
    values = read_channel(findings, trace, driver.channel)
    return derive(driver, values, trace.time_s, trace.sample_period_s)


def name_effect(findings: Findings) -> str:
    """Return the effect whose contribution is drawn at first: the named one, or the nearest."""
    explained = findings.diagnosed
    if explained is None:
        return ""
    return explained.diagnosis.effect or explained.diagnosis.nearest or ""


def find_suspects(findings: Findings, effect: str, output: str) -> tuple[DriftDriver, ...]:
    """Return what an effect follows, by what it declares and what was fitted."""
    declared, explained = findings.catalogue.get(effect), findings.diagnosed
    if declared is None:
        return ()
    candidates = explained.diagnosis.candidates if explained is not None else ()
    fitted = next((c.parameters for c in candidates if c.effect == effect), {})
    return suspect(declared.needs, fitted, list(list_channels(findings)), output)


def choose_panes(
    suspects: Sequence[DriftDriver], channels: Mapping[str, str], *, fills: bool = False
) -> tuple[str, ...]:
    """Return the panes at first: drift, what is left, temperature, and what is suspected.

    Args:
        suspects: what the effect follows.
        channels: what can be drawn, with units.
        fills: whether `PANES` are shown whatever is suspected, so that none comes later.
    """
    further = [DriftDriver(name) for name in channels]
    wanted = [*suspects, DriftDriver(TEMPERATURE, RATE), *further]
    if fills:
        wanted.append(DriftDriver(TEMPERATURE, LAG, TAU_S))
    keys = [
        d.key for d in wanted if d.key != DriftDriver(TEMPERATURE).key and d.channel in channels
    ]
    keys = [key for key in dict.fromkeys(keys) if not key.endswith(f":{TIME}")]
    return (
        DRIFT,
        LEFT,
        DriftDriver(TEMPERATURE).key,
        *keys[: PANES - 3 if fills else max(1, min(len(suspects), PANES - 3))],
    )


def choose_against(suspects: Sequence[DriftDriver]) -> DriftDriver:
    """Return what to hold what is left against: the suspected channel as it is, for its loop."""
    return next((DriftDriver(d.channel) for d in suspects), DriftDriver(TEMPERATURE))


def draw_cause(
    view: CauseView,
    compared: ComparisonSummary,
    units: Mapping[str, str],
    read: Callable[[DriftDriver], Array],
) -> CausePicture:
    """Return the cause picture of one run and output.

    Args:
        view: what is shown.
        compared: what `compare` found, for the floor and the worst segments.
        units: channel -> its unit.
        read: driver -> [n] of this run.
    """
    trace, k = view.trace, list(compared.outputs).index(view.output)
    start, stop = find_rows(trace, view.window)
    place = lay_out_cause([key in (DRIFT, LEFT, EFFECT) for key in view.panes], view.width)
    width = place.width
    clock = choose_clock(trace)
    first, last = float(trace.time_s[start]), float(trace.time_s[stop - 1])
    if view.window.from_s is not None and view.window.to_s is not None:
        first, last = view.window.from_s, view.window.to_s
    bands = _list_bands(view, compared, clock)
    rows = start + pick_spread(stop - start, ROWS_READ)
    panels, places, curves = [], [], []
    for number, (key, (top, height)) in enumerate(zip(view.panes, place.panes, strict=True)):
        title, unit, drawn = _list_lines(view, k, key, compared, units, read)
        kept = [pick_rows(y, start, stop, max(int(2.0 * width), 100)) for _, y in drawn]
        # A second line of the legend would lie under the page's own heading, which says the same.
        is_long = measure_legend([c.name for c, _ in drawn]) > width
        unsaid = title if is_long and view.heading else ""
        names = ["" if c.name == unsaid else c.name for c, _ in drawn]
        lines = tuple(
            Curve(clock.place(trace.time_s[r]), np.asarray(y[r]), c.ink, name, c.dash, c.width)
            for (c, y), r, name in zip(drawn, kept, names, strict=True)
        )
        floor = float(compared.outputs[view.output].noise_floor)
        levels = (Level(-floor), Level(floor)) if key == LEFT and floor > 0.0 else ()
        around = (-floor, floor) if key == LEFT else ()
        is_last = number == len(view.panes) - 1
        x = AxisScale(
            clock.place(first),
            clock.place(last),
            clock.title,
            hidden=not is_last,
        )
        panels.append(
            Panel(
                left=MARGIN_LEFT,
                top=top,
                width=width,
                height=height,
                x=x,
                y=AxisScale(*spread(*(line.y for line in lines), around=around)),
                title="" if view.heading else f"{title}, {unit}",
                curves=lines,
                bands=bands,
                levels=levels,
                legend_at=0.0 if place.is_narrow else view.heading,
                stacked=place.is_narrow,
            )
        )
        places.append(PanePlace(key, top, height))
        curves += [ReadCurve(c.name or title, unit, _tell(y[rows])) for c, y in drawn]
    against = read(view.against)
    scatter, extent = _draw_scatter(view, k, compared, units, (start, stop), against)
    panels.append(
        Panel(
            left=place.scatter[0],
            top=place.scatter[1],
            width=place.scatter[2],
            height=place.scatter[3],
            x=scatter.x,
            y=scatter.y,
            title=scatter.title,
            curves=scatter.curves,
            clouds=scatter.clouds,
            stacked=True,
            levels=scatter.levels,
            note=scatter.note,
        )
    )
    words = f" and what {view.effect} would explain" if view.effect else ""
    label = (
        f"{view.output} in run {trace.run}: drift and model, what is left{words}, and channels on "
        f"one time axis; beside them what is left against {view.against.describe()}."
    )
    return CausePicture(
        picture=Picture(view.width, place.bottom, tuple(panels), label, f"{view.output}_cause"),
        panes=tuple(places),
        left=MARGIN_LEFT,
        width=width,
        from_s=first,
        to_s=last,
        times_s=_tell(trace.time_s[rows], 8),
        curves=tuple(curves),
        scatter=ScatterPlace(*place.scatter, *extent, _tell(against[rows])),
    )


def _tell(values: Array, digits: int = 5) -> tuple[float, ...]:
    """Return numbers with so many digits, which is what can be read."""
    return tuple(float(f"{value:.{digits}g}") for value in np.asarray(values).tolist())


def _list_bands(view: CauseView, compared: ComparisonSummary, clock: TimeAxis) -> tuple[Band, ...]:
    """Return the worst segments of this run and output, numbered as tabled."""
    return tuple(
        Band(clock.place(segment.from_s), clock.place(segment.to_s), str(number))
        for number, segment in enumerate(compared.worst, 1)
        if (segment.run, segment.output) == (view.trace.run, view.output)
    )


@dataclass(frozen=True)
class _Look:
    """How a line of a pane looks."""

    ink: str
    name: str
    dash: str = "solid"
    width: float = 1.3


def _list_lines(
    view: CauseView,
    k: int,
    key: str,
    compared: ComparisonSummary,
    units: Mapping[str, str],
    read: Callable[[DriftDriver], Array],
) -> tuple[str, str, list[tuple[_Look, Array]]]:
    """Return a pane's title, its unit, and its lines [n]."""
    trace, unit = view.trace, compared.outputs[view.output].unit
    drift, error = trace.drift[k], trace.error[k]
    explained = view.contribution
    lines: list[tuple[_Look, Array]]
    if key == DRIFT:
        lines = [
            (_Look("measured", "drift as measured", width=2.2), drift),
            (_Look("model", "model", "dash", 1.6), drift - error),
        ]
        return f"drift of {view.output}", unit, lines
    if key == LEFT:
        lines = [(_Look("left", "what is left"), error)]
        if explained is not None:
            lines.append((_Look("effect", f"{view.effect} would explain", "dash", 2.0), explained))
        return "what is left", unit, lines
    if key == EFFECT:
        lines = [] if explained is None else [(_Look("effect", view.effect, width=1.8), explained)]
        return f"contribution of {view.effect or 'no effect'}", unit, lines
    driver = read_driver(key)
    if driver is None or driver.channel not in units:
        return "unknown", "", []
    values = read(driver)
    look = _Look("driver", "" if view.heading == 0.0 else driver.describe())
    return driver.describe(), driver.name_unit(units[driver.channel]), [(look, values)]


def _draw_scatter(
    view: CauseView,
    k: int,
    compared: ComparisonSummary,
    units: Mapping[str, str],
    rows: tuple[int, int],
    against: Array,
) -> tuple[Panel, tuple[tuple[float, float], tuple[float, float]]]:
    """Return what is left against a driver, still without its place, and the ranges shown."""
    trace = view.trace
    unit = compared.outputs[view.output].unit
    chosen = rows[0] + pick_spread(rows[1] - rows[0], ROWS_OF_MEANS)
    x, y = np.asarray(against[chosen]), np.asarray(trace.error[k][chosen])
    rate, moving, words = _find_branches(view, chosen, x)
    clouds: list[Cloud] = []
    branches = (
        (words[0], rate > moving, "heating", "triangle"),
        (words[1], rate < -moving, "cooling", "square"),
        (words[2], np.abs(rate) <= moving, "still", "cross"),
    )
    shown = pick_spread(chosen.size, ROWS_OF_CLOUD)
    for name, here, ink, mark in branches:
        own = shown[here[shown]]
        if own.size:
            few = own[pick_spread(own.size, SHAPES)]
            clouds.append(Cloud(x[own], y[own], ink, size=3.2))
            clouds.append(Cloud(x[few], y[few], ink, name, mark))
    curves: tuple[Curve, ...] = ()
    if view.contribution is not None:
        told = np.asarray(view.contribution[chosen[shown]])
        curves = (Curve(x[shown], told, "effect", f"{view.effect} would explain", "dot", 1.2),)
    floor = float(compared.outputs[view.output].noise_floor)
    reach = 1.25 * float(np.quantile(np.abs(y), 0.998)) or floor or 1.0
    low, high = spread(x)
    title = (
        f"{view.against.describe()}, {view.against.name_unit(units.get(view.against.channel, ''))}"
    )
    note = "does not move in these logs" if float(np.ptp(x)) == 0.0 else ""
    heading = f"what is left of {view.output}, {unit}"  # against what, the axis says
    panel = Panel(
        left=0.0,
        top=0.0,
        width=1.0,
        height=1.0,
        x=AxisScale(low, high, title),
        y=AxisScale(-reach, reach),
        title=heading,
        curves=curves,
        clouds=tuple(clouds),
        levels=(Level(-floor), Level(floor)) if floor > 0.0 else (),
        note=note,
    )
    return panel, ((low, high), (-reach, reach))


def _find_branches(
    view: CauseView, rows: IntArray, x: Array
) -> tuple[Array, float, tuple[str, str, str]]:
    """Return the rate that tells ways up from ways down, the rate of rest, and words for them."""
    trace, channel = view.trace, view.against.channel
    if channel in (TEMPERATURE, TIME):
        rate = np.asarray(trace.rate_K_per_min[rows])
        return rate, find_threshold([trace]), ("heating", "cooling", "at rest")
    rate = np.gradient(x) if x.size > 1 else np.zeros(x.size)
    fast = float(np.quantile(np.abs(rate), 0.9)) if rate.size else 0.0
    return rate, MOVING_SHARE * fast, ("rising", "falling", "steady")


def list_choices(
    channels: Mapping[str, str], tau_s: float, effect: str
) -> tuple[tuple[str, str], ...]:
    """Return what can be put into a pane: key and words."""
    first = [(DRIFT, "drift and model"), (LEFT, "what is left")]
    if effect:
        first.append((EFFECT, f"contribution of {effect}"))
    drivers = [
        DriftDriver(name, form, tau_s if form == LAG else DriftDriver(name).tau_s)
        for name in channels
        for form in ((VALUE, RATE, LAG) if name != TIME else (VALUE,))
    ]
    units = {d.key: d.name_unit(channels[d.channel]) for d in drivers}
    return (*first, *((d.key, f"{d.describe()}, {units[d.key]}") for d in drivers))
