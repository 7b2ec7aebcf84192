"""A first chart, drawn from one log alone while the others are still being read.

python -m zerodrift.app.sketch PROJECT FILE [--skip-invalid] [--sensor NAME]

Writes the SVG of the first output's measured drift, and of the temperature, in the first training
run. Nothing is written where the log cannot be read: the survey then says why.
"""

import sys
from html import escape
from pathlib import Path

import numpy as np

from zerodrift.base.errors import ZerodriftError
from zerodrift.dataset.open_log import open_log
from zerodrift.dataset.selectors import expand_selectors
from zerodrift.fleet.sensors import load_unit
from zerodrift.report.plot import AxisScale, Curve, Panel, Picture, spread
from zerodrift.report.svg import render_svg
from zerodrift.report.thin import pick_rows
from zerodrift.report.window import choose_axis
from zerodrift.workbench.events import SENSOR, SKIP_INVALID

WIDTH, LEFT, RIGHT, BETWEEN = 690.0, 62.0, 12.0, 30.0
TOP, TALL, LOW, BOTTOM = 26.0, 190.0, 90.0, 42.0


def sketch(directory: Path, skip_invalid: bool, sensor: str | None) -> str:
    """Return the chart as SVG text.

    Raises:
        InputError: zerodrift.toml is wrong, or the log is missing or damaged.
    """
    config = load_unit(directory, sensor)
    output, selection = config.outputs[0], expand_selectors(config, "train")[0]
    needed = {
        config.time_column: "[sensor] time",
        config.temperature_column: "[sensor] temperature",
        output.measured: f"[outputs.{output.name}] measured",
    }
    if isinstance(output.reference, str):
        needed.setdefault(output.reference, f"[outputs.{output.name}] reference")
    table, spans = open_log(config, selection, skip_invalid, [], needed)
    run, start, stop = spans[0]
    time_s, temperature, measured = (
        table.columns[name][start:stop]
        for name in (config.time_column, config.temperature_column, output.measured)
    )
    reference = output.reference
    known = (
        table.columns[reference][start:stop] if isinstance(reference, str) else (reference or 0.0)
    )
    clock = choose_axis(float(time_s[0]), float(time_s[-1]))
    width = WIDTH - LEFT - RIGHT
    panels, top = [], TOP
    lines = (
        (f"{output.name}: drift as measured, {output.unit}", measured - known, "measured", TALL),
        ("temperature, degC", temperature, "driver", LOW),
    )
    for number, (title, values, ink, height) in enumerate(lines):
        filled = np.where(np.isfinite(values), values, np.nanmedian(values))
        rows = pick_rows(filled, 0, filled.size, int(2.0 * width))
        x = clock.place(time_s[[0, -1]])
        panels.append(
            Panel(
                left=LEFT,
                top=top,
                width=width,
                height=height,
                x=AxisScale(float(x[0]), float(x[1]), clock.title, hidden=number == 0),
                y=AxisScale(*spread(filled[rows])),
                title=title,
                curves=(Curve(clock.place(time_s[rows]), filled[rows], ink),),
            )
        )
        top += height + BETWEEN
    name = f"{selection.path.name}{f', run {run}' if run else ''}"
    label = f"{output.name} in {name}: drift as measured, and the temperature."
    svg = render_svg(Picture(WIDTH, top - BETWEEN + BOTTOM, tuple(panels), label))
    return f"<figcaption>First look, from {escape(name)} alone.</figcaption>{svg}"


def main() -> None:
    """Write the chart, whole or not at all."""
    directory, path, options = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:]
    sensor = options[options.index(SENSOR) + 1] if SENSOR in options else None
    try:
        text = sketch(directory, SKIP_INVALID in options, sensor)
        part = path.with_suffix(".part")
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    except (ZerodriftError, OSError):
        sys.exit(2)


if __name__ == "__main__":
    main()
