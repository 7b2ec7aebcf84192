"""What a first chart shows, read from one log alone while the others are still being read.

python -m zerodrift.workbench.sketch PROJECT FILE [--skip-invalid] [--sensor NAME]

Writes the first output's measured drift, and the temperature, of the first training run as JSON.
Nothing is written where the log cannot be read: the survey then says why.
"""

import sys
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.errors import ZerodriftError
from zerodrift.dataset.open_log import open_log
from zerodrift.dataset.selectors import expand_selectors
from zerodrift.fleet.sensors import load_unit
from zerodrift.report.window import pick_rows
from zerodrift.workbench.first_look import FirstLook, LoggedLine, write_look
from zerodrift.workbench.jobs import SENSOR, SKIP_INVALID

MOST_ROWS = 2400


def sketch(directory: Path, skip_invalid: bool, sensor: str | None) -> FirstLook:
    """Return what is to be seen of the first training run.

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
    of = f"{selection.path.name}{f', run {run}' if run else ''}"
    return FirstLook(
        output=output.name,
        unit=output.unit,
        of=of,
        drift=_thin(time_s, measured - known),
        temperature=_thin(time_s, temperature),
        first_s=float(time_s[0]),
        last_s=float(time_s[-1]),
    )


def _thin(time_s: Array, values: Array) -> LoggedLine:
    """Return a column with its least and largest values; what is no number is its median."""
    filled = np.where(np.isfinite(values), values, np.nanmedian(values))
    rows = pick_rows(filled, 0, filled.size, MOST_ROWS)
    return LoggedLine(tuple(time_s[rows].tolist()), tuple(filled[rows].tolist()))


def main() -> None:
    """Write it, whole or not at all."""
    directory, path, options = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:]
    sensor = options[options.index(SENSOR) + 1] if SENSOR in options else None
    try:
        text = write_look(sketch(directory, SKIP_INVALID in options, sensor))
        part = path.with_suffix(".part")
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    except (ZerodriftError, OSError):
        sys.exit(2)


if __name__ == "__main__":
    main()
