"""Guesses a project from its logs' headers: what each column is, by its name and its unit."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import polars as pl

from zerodrift.base.clock_config import TIME_UNITS
from zerodrift.base.config import MAX_OUTPUTS
from zerodrift.base.errors import InputError
from zerodrift.dataset.tables import RUN_COLUMN, Source, open_source
from zerodrift.dataset.time_units import guess_time_unit, read_time_unit
from zerodrift.dataset.units import TEMPERATURE_UNITS, read_unit, strip_unit

TIME_NAMES = ("time_s", "t_s", "elapsed_s", "time", "t", "elapsed", "seconds", "timestamp_s")
CLOCK_WORDS = ("clock", "unix", "epoch", "utc")
UNIT_WORDS = {"t", "millis", "micros", "nanos", "minutes", "hours"}
"""With a unit of time these are the time; alone `t` may be a temperature."""
REFERENCE_WORDS = ("ref", "reference", "true", "truth", "nominal", "ideal", "target")
IGNORED_WORDS = ("index", "id", "row", "sample", "count", "number", "")
#: Channel name that effects use -> pattern of columns that carry it.
INPUT_PATTERNS = {
    "supply": r"^(supply|vdd|vcc|vbat|v_?supply)(_m?v)?$",
    "humidity": r"^(relative_)?(humidity|rh)(_|$)",
    "ambient_light": r"(^|_)(light|lux)(_|$)",
    **{f"acceleration_{axis}": rf"^(a{axis}|acc(eleration)?_?{axis})(_|$)" for axis in "xyz"},
}
FULL_SCALE_STEPS = (1.0, 2.0, 5.0, 10.0)


@dataclass(frozen=True)
class GuessedOutput:
    """One output as the headers suggest it."""

    name: str
    measured: str
    reference: str | None
    unit: str
    full_scale: float


@dataclass(frozen=True)
class Guess:
    """A project as its logs suggest it, and what its user has to check."""

    sensor_name: str
    time: str
    temperature: str
    sample_period_s: float
    outputs: tuple[GuessedOutput, ...]
    inputs: Mapping[str, str]
    runs: tuple[str, ...]
    """Values of the first log's `run` column; empty without one."""
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Text columns with several values -> these, candidates for `[logs] where`."""
    checks: tuple[str, ...] = ()
    """What was uncertain."""
    time_unit: str = ""
    """Unit of the time column, guessed from its values; empty where its name states one."""


def guess_project(logs: Sequence[Path]) -> Guess:
    """Guess the columns, units and sample period of a project.

    Args:
        logs: its logs, which should have the same columns; the first one's values are looked at.

    Raises:
        InputError: a log cannot be read, or has no time, no temperature or nothing that drifts.
    """
    sources = [open_source(path, str(path), {}) for path in logs]
    first = sources[0]
    shared = set.intersection(*(set(source.names) for source in sources))
    common = [name for name in first.names if name in shared]
    checks = []
    if left := [name for source in sources for name in source.names if name not in shared]:
        names = ", ".join(dict.fromkeys(left))
        checks.append(f"not every log has these columns, which were left out: {names}")
    sample = first.scan().select(common).select(pl.all().cast(pl.String)).head(1000).collect()
    if sample.height == 0:
        raise InputError(f"{first.label}: there is a header but no row; expected one per sample.")
    numeric = _list_numeric(sample)
    known = {*numeric, RUN_COLUMN}
    texts = [name for name in common if name not in known]
    time, clock = _guess_time(first, numeric)
    temperatures = _guess_temperatures(first, [name for name in numeric if name != time])
    inputs = {"clock": clock} if clock else {}
    inputs |= {re.sub(r"_(degC|degF|K|C)$", "", name): name for name in temperatures[1:]}
    free = [name for name in numeric if name not in {time, *temperatures, *inputs.values()}]
    for channel, pattern in INPUT_PATTERNS.items():
        if found := [name for name in free if re.search(pattern, name, re.IGNORECASE)]:
            inputs[channel] = found[0]
            free.remove(found[0])
    outputs, ignored = _guess_outputs(first, free)
    if ignored:
        checks.append(f"not used: {', '.join(ignored)}")
    if (unit := read_unit(temperatures[0])) in ("degF", "K"):
        checks.append(f"'{temperatures[0]}' seems to be in {unit}; zerodrift wants degC")
    first_time, period = _measure_period(first, time)
    time_unit = "" if read_time_unit(time) else guess_time_unit(first_time, period)
    period_s = float(f"{period * TIME_UNITS[time_unit or read_time_unit(time) or 's']:.3g}")
    if time_unit:
        checks.append(
            f"'{time}' is taken as {time_unit}, a row every {period_s:g} s; if it is another "
            f"unit, of {', '.join(TIME_UNITS)}, change it and sample_period_s"
        )
    if len(temperatures) > 1:
        checks.append(f"'{temperatures[0]}' was taken as the chip's own thermometer")
    groups = {name: values for name in texts if 1 < len(values := _list_values(first, name)) <= 32}
    for name, values in groups.items():
        named = ", ".join(values[:3]) + (", ..." if len(values) > 3 else "")
        checks.append(
            f"'{name}' has {len(values)} values ({named}), all taken as one sensor; "
            "[logs] where picks one"
        )
    return Guess(
        sensor_name=re.sub(r"[^A-Za-z0-9_]+", "_", logs[0].stem).strip("_").lower() or "sensor",
        time=time,
        temperature=temperatures[0],
        sample_period_s=period_s,
        time_unit=time_unit,
        outputs=outputs,
        inputs=inputs,
        runs=_list_values(first, RUN_COLUMN) if RUN_COLUMN in common else (),
        groups=groups,
        checks=(
            *checks,
            *(f"full_scale of {output.name} is a guess from the data" for output in outputs),
        ),
    )


def _list_numeric(sample: pl.DataFrame) -> list[str]:
    """Return the columns of text of which nine in ten values, and at least one, are numbers."""
    bare = sample.select(pl.all().str.strip_chars().cast(pl.Float64, strict=False))
    counts = zip(sample.null_count().row(0), bare.null_count().row(0), strict=True)
    rows = sample.height
    return [
        name
        for name, (empty, unread) in zip(sample.columns, counts, strict=True)
        if empty < rows and rows - unread >= 0.9 * (rows - empty)
    ]


def _guess_time(source: Source, numeric: Sequence[str]) -> tuple[str, str | None]:
    """Return the column of the run's time, and that of the absolute time if it is another one."""
    lower = {name.lower(): name for name in reversed(numeric)}
    named = [lower[name] for name in TIME_NAMES if name in lower]
    clocks = [name for name in numeric if _words(name) & set(CLOCK_WORDS)]
    loose = [name for name in numeric if _words(name) & {"time", "timestamp", "elapsed"}]
    loose += [name for name in numeric if read_time_unit(name) and _words(name) & UNIT_WORDS]
    candidates = list(dict.fromkeys(named + [name for name in loose if name not in clocks]))
    if not candidates and not clocks:
        raise InputError(
            f"{source.label}:1: no column of numbers looks like the time (found: "
            f"{', '.join(numeric)}); expected one such as time_s, in seconds. Rename it."
        )
    time = (candidates or clocks)[0]
    return time, next((name for name in clocks if name != time), None)


def _guess_temperatures(source: Source, numeric: Sequence[str]) -> list[str]:
    """Return the thermometers' columns, the one most likely on the chip first."""
    found = [
        name
        for name in numeric
        if read_unit(name) in TEMPERATURE_UNITS or re.search("temp", name, re.IGNORECASE)
    ]
    if not found:
        raise InputError(
            f"{source.label}:1: no column looks like the temperature (found: {', '.join(numeric)}"
            "); expected one such as temperature_degC. Rename it."
        )

    def rank(name: str) -> int:
        if _words(strip_unit(name)) & {"chip", "tmp117", "board", "sensor"}:
            return 0
        if strip_unit(name).lower() in ("temperature", "temp", "t"):
            return 1
        return 3 if _words(name) & {"ambient", "room", "air"} else 2

    return sorted(found, key=rank)


def _guess_outputs(
    source: Source, free: Sequence[str]
) -> tuple[tuple[GuessedOutput, ...], list[str]]:
    """Return the outputs among the columns that nothing else claimed, and what is left over."""
    references = [name for name in free if _words(name) & set(REFERENCE_WORDS)]
    measured = [name for name in free if name not in references and read_unit(name)]
    measured = measured or [
        name for name in free if name not in references and name.lower() not in IGNORED_WORDS
    ]
    if not measured:
        raise InputError(
            f"{source.label}:1: no column looks like a quantity that drifts (found: "
            f"{', '.join(free)}); expected names with units, such as Fz_N. Rename them."
        )
    spans = _measure_spans(source, measured[:MAX_OUTPUTS])
    outputs: list[GuessedOutput] = []
    for name in measured[:MAX_OUTPUTS]:
        match = _match_reference(name, references, len(measured))
        short = re.sub(r"[^A-Za-z0-9_]+", "_", strip_unit(name)).strip("_")
        if not short or short in [output.name for output in outputs]:
            short = name
        unit = read_unit(name) or "LSB"
        outputs.append(GuessedOutput(short, name, match, unit, spans[name]))
    used = {output.measured for output in outputs} | {output.reference for output in outputs}
    return tuple(outputs), [name for name in free if name not in used]


def _match_reference(measured: str, references: Sequence[str], outputs: int) -> str | None:
    wanted = _words(measured)
    for name in references:
        if _words(name) - set(REFERENCE_WORDS) == wanted:
            return name
    alike = [name for name in references if read_unit(name) == read_unit(measured)]
    return alike[0] if outputs == 1 and len(alike) == 1 else None


def _words(name: str) -> set[str]:
    return {word.lower() for word in re.split(r"[^A-Za-z0-9]+", name) if word}


def _measure_spans(source: Source, columns: Sequence[str]) -> dict[str, float]:
    """Return for each column a round full scale that holds all of its values."""
    frame = source.scan(columns).select(pl.col(columns).cast(pl.Float64, strict=False))
    peaks = frame.select(pl.all().abs().max()).collect().row(0, named=True)
    spans = {}
    for name, peak in peaks.items():
        largest = peak if peak and np.isfinite(peak) else 1.0
        decade = 10.0 ** np.floor(np.log10(largest))
        spans[name] = next(s * decade for s in FULL_SCALE_STEPS if s * decade >= largest)
    return {name: float(f"{span:.3g}") for name, span in spans.items()}


def _measure_period(source: Source, time: str) -> tuple[float, float]:
    """Return the first time and the median interval between rows, in the column's unit."""
    column = pl.col(time).cast(pl.Float64, strict=False)
    frame = source.scan([time]).select(column.alias("time"), column.diff().alias("step"))
    rising = pl.col("step").filter(pl.col("step") > 0).median()
    first, median = frame.select(pl.col("time").drop_nulls().first(), rising).collect().row(0)
    if median is None:
        raise InputError(
            f"{source.label}: '{time}' never rises; expected times that rise from row to row."
        )
    return float(first), float(median)


def _list_values(source: Source, column: str) -> tuple[str, ...]:
    values = source.scan().select(pl.col(column).cast(pl.String).unique(maintain_order=True))
    return tuple(values.collect().to_series().drop_nulls())
