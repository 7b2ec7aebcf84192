"""A picture as typed parts, panels with lines, dots, bars and marks, and its SVG."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np

from zerodrift.base.arrays import Array, Mask

# A picture as typed parts: panels with lines, dots, bars and marks; `report.svg` draws it.

INKS = {
    "measured": ("#8a94a0", "#97a2ae"),
    "model": ("#1668b8", "#6cb1f0"),
    "left": ("#5b6876", "#aebac6"),
    "effect": ("#c2570a", "#f09a4c"),
    "driver": ("#2d7a5c", "#6fc7a1"),
    "heating": ("#c2570a", "#f09a4c"),
    "cooling": ("#1668b8", "#6cb1f0"),
    "still": ("#7a8591", "#8f9ba7"),
    "floor": ("#7a8794", "#8f9ba7"),
    "good": ("#2d6e49", "#7cc79b"),
    "worst": ("#8a6500", "#e8bd66"),
    "s0": ("#1668b8", "#6cb1f0"),
    "s1": ("#c2570a", "#f09a4c"),
    "s2": ("#2d7a5c", "#6fc7a1"),
    "s3": ("#8a5aa8", "#c39ddc"),
    "s4": ("#7d6c1f", "#d3c268"),
    "s5": ("#b23a5b", "#ef8fa8"),
}
"""Ink -> its colour on light and on dark ground. No two that meet differ by colour alone."""
DASHES = {"solid": "", "dash": "7 4", "dot": "2 3", "dashdot": "7 3 2 3", "long": "12 4"}
DASH_ORDER = tuple(DASHES)
MARK_ORDER = ("circle", "square", "diamond", "triangle", "cross", "ring")


@dataclass(frozen=True)
class Curve:
    """A line through points."""

    x: Array
    y: Array
    ink: str
    name: str = ""
    """In the legend; empty: not there."""
    dash: str = "solid"
    width: float = 1.5
    steps: bool = False
    """Whether it goes on level and then up or down, as stairs do."""
    mark: str = ""
    """circle | square | diamond | triangle | cross | ring at each point; empty: none."""


@dataclass(frozen=True)
class Cloud:
    """Points that are not joined."""

    x: Array
    y: Array
    ink: str
    name: str = ""
    mark: str = ""
    """As `Curve.mark`; empty: small dots."""
    size: float = 3.0


@dataclass(frozen=True)
class Bar:
    """A bar from the left edge, in a panel of bars one below the other."""

    label: str
    value: float
    told: str
    """What is written at its end."""
    ink: str
    hatched: bool = False


@dataclass(frozen=True)
class Band:
    """A stretch of the x axis that is shaded."""

    low: float
    high: float
    label: str = ""


@dataclass(frozen=True)
class Level:
    """A dotted line across a panel."""

    at: float
    label: str = ""
    upright: bool = False


@dataclass(frozen=True)
class AxisScale:
    """One axis: what of it is shown, and what is written along it."""

    low: float
    high: float
    title: str = ""
    log: bool = False
    ticks: tuple[tuple[float, str], ...] | None = None
    """Places and words; None: round numbers."""
    hidden: bool = False
    """Whether neither numbers nor title are written."""

    def place(self, values: Array) -> Array:
        """Return where values stand on it, 0 at its low and 1 at its high end."""
        if self.log:
            low, high = math.log10(self.low), math.log10(self.high)
            safe = np.maximum(np.asarray(values, dtype=np.float64), 1e-300)
            return np.asarray((np.log10(safe) - low) / ((high - low) or 1.0))
        span = (self.high - self.low) or 1.0
        return np.asarray((np.asarray(values, dtype=np.float64) - self.low) / span)

    def list_ticks(self, most: int) -> tuple[tuple[float, str], ...]:
        """Return places and words along it, at most so many."""
        if self.ticks is not None:
            return self.ticks
        if self.log:
            return list_log_ticks(self.low, self.high)
        return list_round_ticks(self.low, self.high, most)


@dataclass(frozen=True)
class Panel:
    """One pair of axes with what is drawn in it; places in pixels of the picture."""

    left: float
    top: float
    width: float
    height: float
    x: AxisScale
    y: AxisScale
    title: str = ""
    curves: tuple[Curve, ...] = ()
    clouds: tuple[Cloud, ...] = ()
    bars: tuple[Bar, ...] = ()
    bands: tuple[Band, ...] = ()
    levels: tuple[Level, ...] = ()
    note: str = ""
    """Written in the middle of it."""
    legend_at: float = 0.0
    """Where the legend begins, right of `left`; 0: behind the title."""
    stacked: bool = False
    """Whether the title stands above the legend, for narrow panels."""


@dataclass(frozen=True)
class Picture:
    """Panels on one sheet."""

    width: float
    height: float
    panels: tuple[Panel, ...]
    label: str
    """For those who cannot see it."""
    name: str = field(default="")
    """For its file."""

    def _repr_html_(self) -> str:
        """Return the picture for a notebook."""
        return render_svg(self, alone=True)


def list_round_ticks(low: float, high: float, most: int) -> tuple[tuple[float, str], ...]:
    """Return 1, 2 or 5 times powers of ten between two numbers, at most so many."""
    span = high - low
    if not span > 0.0 or not math.isfinite(span):
        return ((low, f"{low:.4g}"),)
    power = 10.0 ** math.floor(math.log10(span))
    steps = [power * scale * s for scale in (1.0, 0.1, 0.01) for s in (5.0, 2.0, 1.0)]
    counts = [(math.ceil(low / s - 1e-9), math.floor(high / s + 1e-9), s) for s in steps]
    # The finest that is not too dense; one number alone tells nothing of a scale.
    fitting = [told for told in counts if told[1] - told[0] < most]
    first, last, step = fitting[-1]
    if first >= last:
        first, last, step = next(told for told in counts if told[1] > told[0])
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    ticks = []
    for number in range(first, last + 1):
        value = number * step
        far = abs(value) >= 1e5 or (digits > 4 and value != 0.0)
        text = f"{value:.4g}" if far else f"{value:.{digits}f}"
        ticks.append((value, text.replace("-", "−")))
    return tuple(ticks)


def list_log_ticks(low: float, high: float) -> tuple[tuple[float, str], ...]:
    """Return powers of ten between two numbers; where few, 2 and 5 times them as well."""
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    factors = (1.0,) if last - first > 4 else (1.0, 2.0, 5.0)
    values = [f * 10.0**power for power in range(first, last + 1) for f in factors]
    return tuple((v, f"{v:g}") for v in values if low * 0.999 <= v <= high * 1.001)


def spread(
    *values: Array, margin: float = 0.06, around: tuple[float, ...] = ()
) -> tuple[float, float]:
    """Return a range that holds all finite values, with some room on both sides."""
    ends = [float(x) for x in around]
    for array in values:
        finite = np.asarray(array)[np.isfinite(array)]
        if finite.size:
            ends += [float(finite.min()), float(finite.max())]
    if not ends:
        return 0.0, 1.0
    low, high = min(ends), max(ends)
    room = margin * (high - low) or margin * abs(high) or 1.0
    return low - room, high + room


# Pictures as SVG: no scripting, no browser; colours by class, for light and dark ground.

LETTER = 6.3
"""Pixels that a letter of the axis type is wide, about."""
KEY = 43.0
"""Pixels of a legend's item beside its words."""
LINE = 16.0
"""Pixels from line to line of a legend."""
TICK_GAP_X, TICK_GAP_Y = 85.0, 34.0
FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"
PATHS = {
    "circle": "M{x} {y}m-{r} 0a{r} {r} 0 1 0 {d} 0a{r} {r} 0 1 0 -{d} 0z",
    "ring": "M{x} {y}m-{r} 0a{r} {r} 0 1 0 {d} 0a{r} {r} 0 1 0 -{d} 0z",
    "square": "M{x} {y}m-{r} -{r}h{d}v{d}h-{d}z",
    "diamond": "M{x} {y}m0 -{r}l{r} {r}l-{r} {r}l-{r} -{r}z",
    "triangle": "M{x} {y}m0 -{r}l{r} {d}h-{d}z",
    "cross": "M{x} {y}m-{r} -{r}l{d} {d}m-{d} 0l{d} -{d}",
}
OPEN = ("cross", "ring")
"""Marks that are drawn by their line alone."""


def write_colours() -> str:
    """Return the style of all pictures: class `s-INK` strokes, `f-INK` fills."""
    base = (
        f".zd{{font:12px {FONT};font-variant-numeric:tabular-nums;"
        "--t:#3c4650;--g:#e3e6e8;--w:#f6e7bd}"
        ".zd text{fill:var(--t)}.zd .grid{stroke:var(--g);stroke-width:1}.zd .t{font-weight:600}"
        ".zd .worst{fill:var(--w)}.zd path{fill:none}"
        ".zd .level{stroke-dasharray:2 3;stroke-width:1.2}"
    )
    light = "".join(f".s-{n}{{stroke:{a}}}.zd .f-{n}{{fill:{a}}}" for n, (a, _) in INKS.items())
    return base + light


def write_dark_colours(prefix: str) -> str:
    """Return the same for dark ground.

    Args:
        prefix: a selector that stands before each rule, such as `:root[data-theme="dark"] `.
    """
    base = f"{prefix}.zd{{--t:#c4ccd4;--g:#303842;--w:#4a3d17}}"
    return base + "".join(
        f"{prefix}.s-{n}{{stroke:{b}}}{prefix}.zd .f-{n}{{fill:{b}}}" for n, (_, b) in INKS.items()
    )


def write_style() -> str:
    """Return the style of all pictures of a page whose theme is on its root."""
    return write_colours() + write_dark_colours(':root[data-theme="dark"] ')


def render_svg(picture: Picture, *, alone: bool = False) -> str:
    """Return a picture as SVG text.

    Args:
        picture: what to draw.
        alone: for a file of its own: with its style, following the reader's light or dark setting.
    """
    width, height = _write(picture.width), _write(picture.height)
    style = ""
    if alone:
        dark = write_dark_colours("")
        style = (
            f"<style>{write_colours()}.ground{{fill:#fff}}@media (prefers-color-scheme: dark)"
            f"{{{dark}.ground{{fill:#14181d}}}}</style>"
            f'<rect class="ground" width="{width}" height="{height}"/>'
        )
    hatch = (
        '<defs><pattern id="zd-h" width="6" height="6" patternUnits="userSpaceOnUse" '
        'patternTransform="rotate(45)"><path class="s-measured" d="M0 0V6" '
        'stroke-width="3"/></pattern></defs>'
    )
    has_hatch = any(bar.hatched for panel in picture.panels for bar in panel.bars)
    inner = "".join(_draw_panel(panel) for panel in picture.panels)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" class="zd" viewBox="0 0 {width} {height}" '
        f'width="{width}" height="{height}" role="img" aria-label="{escape(picture.label)}">'
        f"{style}{hatch if has_hatch else ''}{inner}</svg>"
    )


def _write(value: float) -> str:
    text = f"{value:.1f}"
    return text.removesuffix(".0")


def _text(x: float, y: float, words: str, anchor: str = "start", more: str = "") -> str:
    return (
        f'<text x="{_write(x)}" y="{_write(y)}" text-anchor="{anchor}"{more}>{escape(words)}</text>'
    )


def _draw_panel(panel: Panel) -> str:
    """Return one panel: bands below, then the grid, the data, and the words."""
    parts = [_draw_band(panel, band) for band in panel.bands]
    parts.append(_draw_axes(panel))
    parts += [_draw_level(panel, n) for n in range(len(panel.levels))]
    if panel.bars:
        parts.append(_draw_bars(panel, panel.bars))
    parts += [_draw_cloud(panel, cloud) for cloud in panel.clouds]
    parts += [_draw_curve(panel, curve) for curve in panel.curves]
    parts.append(_draw_heading(panel))
    if panel.note:
        middle = panel.left + 0.5 * panel.width
        parts.append(_text(middle, panel.top + 0.5 * panel.height, panel.note, "middle"))
    return "".join(parts)


def _find_x(panel: Panel, values: Array) -> Array:
    return np.asarray(panel.left + panel.width * panel.x.place(values))


def _find_y(panel: Panel, values: Array) -> Array:
    return np.asarray(panel.top + panel.height * (1.0 - panel.y.place(values)))


def _draw_band(panel: Panel, band: Band) -> str:
    low, high = np.clip(_find_x(panel, np.array([band.low, band.high])), panel.left, None)
    high = min(float(high), panel.left + panel.width)
    if not high > low:
        return ""
    words = ""
    if band.label:
        more = ' class="t f-worst"'
        words = _text(0.5 * (float(low) + high), panel.top + 13, band.label, "middle", more)
    return (
        f'<rect class="worst" x="{_write(float(low))}" y="{_write(panel.top)}" '
        f'width="{_write(max(high - float(low), 2.0))}" height="{_write(panel.height)}"/>{words}'
    )


def _draw_axes(panel: Panel) -> str:
    bottom, right = panel.top + panel.height, panel.left + panel.width
    parts = []
    most = max(int(panel.height / TICK_GAP_Y) + 1, 2)
    for value, words in () if panel.bars else panel.y.list_ticks(most):
        y = float(_find_y(panel, np.array([value]))[0])
        if panel.top - 0.5 <= y <= bottom + 0.5:
            parts.append(
                f'<path class="grid" d="M{_write(panel.left)} {_write(y)}H{_write(right)}"/>'
            )
            if not panel.y.hidden:
                parts.append(_text(panel.left - 6, y + 4, words, "end"))
    most = max(int(panel.width / TICK_GAP_X) + 1, 2)
    for value, words in panel.x.list_ticks(most):
        x = float(_find_x(panel, np.array([value]))[0])
        if panel.left - 0.5 <= x <= right + 0.5:
            path = f"M{_write(x)} {_write(panel.top)}V{_write(bottom)}"
            parts.append(f'<path class="grid" d="{path}"/>')
            if not panel.x.hidden:
                parts.append(_text(x, bottom + 16, words, "middle"))
    if panel.x.title and not panel.x.hidden:
        parts.append(_text(panel.left + 0.5 * panel.width, bottom + 33, panel.x.title, "middle"))
    return "".join(parts)


def _draw_level(panel: Panel, number: int) -> str:
    level = panel.levels[number]
    at = np.array([level.at])
    bottom, right = panel.top + panel.height, panel.left + panel.width
    if level.upright:
        x = float(_find_x(panel, at)[0])
        if not panel.left <= x <= right:
            return ""
        path, words = f"M{_write(x)} {_write(panel.top)}V{_write(bottom)}", (x + 4, panel.top - 4)
    else:
        y = float(_find_y(panel, at)[0])
        if not panel.top <= y <= bottom:
            return ""
        path, words = f"M{_write(panel.left)} {_write(y)}H{_write(right)}", (right - 4, y - 4)
    line = f'<path class="level s-floor" d="{path}"/>'
    anchor = "start" if level.upright else "end"
    return line + (_text(*words, level.label, anchor) if level.label else "")


def _join(x: Array, y: Array, *, steps: bool) -> str:
    """Return a path through points; a gap where a value is not a number."""
    texts, pen = [], False
    last_y = ""
    for one, other in zip(np.round(x, 1).tolist(), np.round(y, 1).tolist(), strict=True):
        if math.isnan(one) or math.isnan(other):
            pen = False
            continue
        tx, ty = f"{one:g}", f"{other:g}"
        if not pen:
            texts.append(f"M{tx} {ty}")
        elif steps:
            texts.append(f"H{tx}" if ty == last_y else f"H{tx}V{ty}")
        else:
            texts.append(f"L{tx} {ty}")
        pen, last_y = True, ty
    return "".join(texts)


def _draw_curve(panel: Panel, curve: Curve) -> str:
    x, y = _find_x(panel, curve.x), _find_y(panel, curve.y)
    # What lies outside is cut to a little beyond the panel's edges.
    y = np.clip(y, panel.top - 3.0, panel.top + panel.height + 3.0)
    x = np.clip(x, panel.left - 3.0, panel.left + panel.width + 3.0)
    drawn = ""
    if curve.width > 0.0:
        dash = f' stroke-dasharray="{DASHES[curve.dash]}"' if DASHES[curve.dash] else ""
        drawn = (
            f'<path class="line s-{curve.ink}" stroke-width="{curve.width:g}"{dash} '
            f'stroke-linejoin="round" d="{_join(x, y, steps=curve.steps)}"/>'
        )
    return drawn + (_draw_marks(x, y, curve.mark, curve.ink, 4.0) if curve.mark else "")


def _draw_marks(x: Array, y: Array, mark: str, ink: str, size: float) -> str:
    d, r = _write(2.0 * size), _write(size)
    shape = PATHS[mark]
    path = "".join(
        shape.format(x=f"{a:g}", y=f"{b:g}", r=r, d=d)
        for a, b in zip(np.round(x, 1).tolist(), np.round(y, 1).tolist(), strict=True)
        if not (math.isnan(a) or math.isnan(b))
    )
    if mark in OPEN:
        return f'<path class="s-{ink}" stroke-width="2" d="{path}"/>'
    return f'<path class="f-{ink}" d="{path}"/>'


def _draw_cloud(panel: Panel, cloud: Cloud) -> str:
    x, y = _find_x(panel, cloud.x), _find_y(panel, cloud.y)
    inside: Mask = (x >= panel.left) & (x <= panel.left + panel.width)
    inside &= (y >= panel.top) & (y <= panel.top + panel.height)
    x, y = x[inside], y[inside]
    if cloud.mark:
        return _draw_marks(x, y, cloud.mark, cloud.ink, cloud.size)
    path = "".join(
        f"M{a:g} {b:g}h0"
        for a, b in zip(np.round(x, 1).tolist(), np.round(y, 1).tolist(), strict=True)
    )
    return (
        f'<path class="s-{cloud.ink}" stroke-width="{cloud.size:g}" stroke-linecap="round" '
        f'opacity="0.45" d="{path}"/>'
    )


def _draw_bars(panel: Panel, bars: tuple[Bar, ...]) -> str:
    parts = []
    slot = panel.height / len(bars)
    for number, bar in enumerate(bars):
        top = panel.top + slot * number + 0.16 * slot
        end = float(np.clip(_find_x(panel, np.array([bar.value]))[0], panel.left, None))
        end = min(end, panel.left + panel.width)
        place = (
            f'x="{_write(panel.left)}" y="{_write(top)}" height="{_write(0.68 * slot)}" '
            f'width="{_write(max(end - panel.left, 1.0))}"'
        )
        fill = 'fill="url(#zd-h)"' if bar.hatched else f'class="f-{bar.ink}"'
        middle = top + 0.34 * slot + 4
        parts.append(f"<rect {place} {fill}/>")
        parts.append(_text(panel.left - 8, middle, bar.label, "end"))
        parts.append(_text(end + 6, middle, bar.told))
    return "".join(parts)


def _draw_heading(panel: Panel) -> str:
    """Return the panel's title and its legend, behind it or below it."""
    every: list[Curve | Cloud] = [*panel.clouds, *panel.curves]
    items = [item for item in every if item.name]
    lines = _break_legend(panel, items) if panel.stacked else [items]
    parts, y = [], panel.top - 7 - LINE * (len(lines) - 1)
    x = panel.left
    if panel.title:
        above = LINE if panel.stacked and items else 0.0
        parts.append(_text(x, y - above, panel.title, "start", ' class="t"'))
        x += 0.0 if panel.stacked else LETTER * 1.07 * len(panel.title) + 18
    start = max(x, panel.left + panel.legend_at)
    for line in lines:
        x = start
        for item in line:
            parts.append(_draw_key(item, x, y))
            x += KEY + LETTER * len(item.name)
        y += LINE
    return "".join(parts)


def measure_legend(names: Sequence[str]) -> float:
    """Return the pixels that a legend of these names takes in one line."""
    return sum(KEY + LETTER * len(name) for name in names if name)


def _break_legend(panel: Panel, items: list[Curve | Cloud]) -> list[list[Curve | Cloud]]:
    """Return the legend's items line by line, as many to a line as fit."""
    lines: list[list[Curve | Cloud]] = [[]]
    room = panel.width
    for item in items:
        needed = KEY + LETTER * len(item.name)
        if lines[-1] and needed > room + 12.0:
            lines.append([])
            room = panel.width
        lines[-1].append(item)
        room -= needed
    return lines


def _draw_key(item: Curve | Cloud, x: float, y: float) -> str:
    """Return one item of a legend: a piece of its line, its mark, its name."""
    parts = []
    if isinstance(item, Curve) and item.width > 0.0:
        dash = f' stroke-dasharray="{DASHES[item.dash]}"' if DASHES[item.dash] else ""
        parts.append(
            f'<path class="s-{item.ink}" stroke-width="{max(item.width, 1.5):g}"{dash} '
            f'd="M{_write(x)} {_write(y - 4)}h22"/>'
        )
    mark = item.mark or ("" if isinstance(item, Curve) else "circle")
    if mark:
        parts.append(_draw_marks(np.array([x + 11]), np.array([y - 4]), mark, item.ink, 3.5))
    parts.append(_text(x + 27, y, item.name))
    return "".join(parts)
