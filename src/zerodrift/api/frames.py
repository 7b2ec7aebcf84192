"""Data frames, of pandas or Polars, as the logs and the zerodrift.toml of a project."""

import json
import re
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, Self, TypedDict

import numpy as np
import polars as pl
from numpy.typing import NDArray

from zerodrift.base.config import FILE_NAME
from zerodrift.base.errors import InputError
from zerodrift.base.journal import write_all
from zerodrift.dataset.chip_codes import CLOCK, DESIGN_FORMAT, propose_codes
from zerodrift.dataset.guess import round_up
from zerodrift.dataset.units import read_unit

NO_UNIT = "1"
LEAST_ROWS = 2
_UNSAFE = re.compile(r"[^\w.-]+")


class PandasTimes(Protocol):
    """The methods of a pandas column of times that are used."""

    def tz_convert(self, zone: str, /) -> "PandasColumn":
        """Return the same instants in another zone."""
        ...

    def tz_localize(self, zone: None, /) -> "PandasColumn":
        """Return the times without their zone."""
        ...


class PandasColumn(Protocol):
    """A column of a pandas frame."""

    @property
    def dtype(self) -> object:
        """Its type."""

    @property
    def dt(self) -> PandasTimes:
        """Its times."""
        ...

    def to_numpy(self) -> NDArray[np.generic]:
        """Return its values [n]."""
        ...


class PandasIndex(Protocol):
    """The index of a pandas frame."""

    @property
    def names(self) -> Iterable[object]:
        """The names of its levels; None for a plain row count."""
        ...


class PandasFrame(Protocol):
    """A pandas frame, as far as it is read; pandas itself is not needed here."""

    @property
    def columns(self) -> Iterable[Hashable]:
        """The columns' names."""
        ...

    @property
    def index(self) -> PandasIndex:
        """The index of its rows."""
        ...

    def reset_index(self) -> Self:
        """Return the frame with its index as a column."""
        ...

    def __getitem__(self, column: Hashable, /) -> PandasColumn:
        """Return a column."""
        ...

    def assign(self, **columns: NDArray[np.generic]) -> Self:
        """Return the frame with more columns."""
        ...


class BeginningOptions(TypedDict, total=False):
    """The fields of `Beginning`, each of which may be left out."""

    test: Sequence[str]
    dwell: Sequence[str]
    effects: Sequence[str]
    network: str
    sample_period_s: float | None
    name: str


class FrameOptions(BeginningOptions, total=False):
    """What `Project.from_frames` takes besides the frames and their columns."""

    inputs: Mapping[str, str]
    path: str | Path | None


@dataclass(frozen=True)
class Output:
    """A quantity that drifts, by the columns of the frames.

    Example:
        >>> zd.Output("fz_N", reference="ref_N", full_scale=2000.0).measured
        'fz_N'
    """

    measured: str
    """Column of the readings before compensation."""
    reference: str | float = 0.0
    """Column of the true value, or a number, in the output's unit."""
    unit: str = ""
    """Unit; if left out, the one that the column's name ends in, or none."""
    full_scale: float | None = None
    """Full scale in that unit; if left out, a round number above the largest reading."""


@dataclass(frozen=True)
class FrameColumns:
    """The roles of the frames' columns."""

    time: str
    temperature: str
    outputs: Mapping[str, Output]
    inputs: Mapping[str, str]


@dataclass(frozen=True)
class Beginning:
    """How the frames are used, and the first model."""

    test: Sequence[str] = ()
    """Runs that nothing is learnt from."""
    dwell: Sequence[str] = ()
    """Isothermal, unloaded runs, for the noise floor."""
    effects: Sequence[str] = ("zero_tempco",)
    network: str = "lag_bank"
    """`[network] kind`."""
    sample_period_s: float | None = None
    """Period of the firmware's step in s; None: the frames' median interval."""
    name: str = "sensor"
    """Name of the sensor, and prefix of its C."""


def to_polars(name: str, frame: pl.DataFrame | pl.LazyFrame | PandasFrame) -> pl.DataFrame:
    """Return a pandas or Polars frame as one of Polars; a pandas index with a name is a column.

    Args:
        name: the run's, for messages.
        frame: the rows.

    Raises:
        InputError: it is no data frame.
    """
    if isinstance(frame, pl.LazyFrame):
        return frame.collect()
    if isinstance(frame, pl.DataFrame):
        return frame
    if not (hasattr(frame, "columns") and hasattr(frame, "reset_index")):
        raise InputError(
            f"frame '{name}': is of type {type(frame).__name__}; expected a data frame of pandas "
            "or Polars."
        )
    if any(level is not None for level in frame.index.names):
        frame = frame.reset_index()
    columns: dict[str, object] = {}
    for column in frame.columns:
        if str(column) in columns:
            raise InputError(
                f"frame '{name}': two columns are called '{column}'; expected names that differ. "
                "Rename or drop one of them."
            )
        columns[str(column)] = None
    for column in frame.columns:
        values = frame[column]
        zone = getattr(values.dtype, "tz", None)
        if zone is not None:  # the same instants without the zone
            values = values.dt.tz_convert("UTC").dt.tz_localize(None)
        array = values.to_numpy()
        columns[str(column)] = array if array.dtype != object else _unify(array.tolist())
    return pl.DataFrame(columns)


def _unify(values: Sequence[object]) -> list[object]:
    """Return the cells of a column of objects: missing ones as None, all as text where one is
    text."""
    plain = [None if isinstance(v, float) and np.isnan(v) else v for v in values]
    if not any(isinstance(v, str) for v in plain):
        return plain
    return [None if v is None else str(v) for v in plain]


def write_project(
    folder: Path,
    frames: Mapping[str, pl.DataFrame],
    columns: FrameColumns,
    begin: Beginning,
) -> None:
    """Write frames as Parquet logs, and the zerodrift.toml that names them.

    Args:
        folder: of the project, without a zerodrift.toml yet.
        frames: run -> its rows.
        columns: the roles of their columns.
        begin: how they are used, and the first model.

    Raises:
        InputError: there is a project already, a run that is not among the frames is named, or a
            column is missing.
    """
    if (folder / FILE_NAME).exists():
        raise InputError(
            f"{folder / FILE_NAME}: exists already; expected a folder without a project. Open it "
            "by Project(...), or name another path."
        )
    if not frames:
        raise InputError("from_frames: no frames; expected a run's name -> its frame.")
    for use, runs in (("test", begin.test), ("dwell", begin.dwell)):
        for run in runs:
            if run not in frames:
                raise InputError(
                    f"from_frames: {use} names '{run}', which is no frame; expected one of "
                    f"{', '.join(frames)}."
                )
    places = {run: f"logs/{_UNSAFE.sub('_', run) or 'run'}.parquet" for run in frames}
    if len(set(places.values())) < len(places):
        raise InputError(
            f"from_frames: two runs would be one file ({', '.join(frames)}); expected names that "
            "differ in letters or digits."
        )
    for run, frame in frames.items():
        for column in _list_columns(columns):
            if column not in frame.columns:
                raise InputError(
                    f"frame '{run}': there is no column '{column}'; it has "
                    f"{', '.join(frame.columns)}. Correct the name, or rename the column."
                )
    train = [run for run in frames if run not in {*begin.test, *begin.dwell}]
    uses = {"train": train, "test": begin.test, "dwell": begin.dwell}
    logs = {use: [places[run] for run in runs] for use, runs in uses.items() if runs}
    text = _render(frames, columns, logs, begin)
    (folder / "logs").mkdir(parents=True, exist_ok=True)
    for run, frame in frames.items():
        frame.write_parquet(folder / places[run])
    write_all(folder, {folder / FILE_NAME: text.encode()})


def _list_columns(columns: FrameColumns) -> list[str]:
    named = [columns.time, columns.temperature, *columns.inputs.values()]
    for output in columns.outputs.values():
        named.append(output.measured)
        if isinstance(output.reference, str):
            named.append(output.reference)
    return named


def measure_period_s(frames: Mapping[str, pl.DataFrame], time: str) -> float:
    """Return the median interval of the frames' times in seconds, to three digits.

    Raises:
        InputError: no frame has two rows.
    """
    intervals = []
    for frame in frames.values():
        column = frame[time]
        if column.dtype.is_temporal():
            column = column.cast(pl.Datetime("us")).dt.timestamp("us") / 1e6
        known = column.cast(pl.Float64, strict=False).drop_nulls().drop_nans()
        steps = np.diff(known.to_numpy())
        if steps.size:
            intervals.append(float(np.median(steps)))
    if not intervals:
        raise InputError(f"from_frames: fewer than {LEAST_ROWS} rows; expected a run per frame.")
    return float(f"{np.median(intervals):.3g}")


def _find_largest(column: pl.Series) -> float:
    """Return the largest magnitude among a column's numbers; 0 where it has none."""
    numbers = column.cast(pl.Float64, strict=False).drop_nulls().to_numpy()
    finite = numbers[np.isfinite(numbers)]
    return float(np.abs(finite).max()) if finite.size else 0.0


def _render(
    frames: Mapping[str, pl.DataFrame],
    columns: FrameColumns,
    logs: Mapping[str, Sequence[str]],
    begin: Beginning,
) -> str:
    """Return zerodrift.toml."""
    q = json.dumps
    period_s = begin.sample_period_s or measure_period_s(frames, columns.time)
    lines = [
        f"format = {DESIGN_FORMAT}",
        "",
        "[sensor]",
        f"name = {q(begin.name)}",
        f"time = {q(columns.time)}",
        f"temperature = {q(columns.temperature)}",
        f"sample_period_s = {period_s:g}",
    ]
    for output, told in columns.outputs.items():
        largest = max(_find_largest(frame[told.measured]) for frame in frames.values()) or 1.0
        reference = q(told.reference) if isinstance(told.reference, str) else told.reference
        lines += [
            "",
            f"[outputs.{q(output)}]",
            f"measured = {q(told.measured)}",
            f"reference = {reference}",
            f"unit = {q(told.unit or read_unit(told.measured) or NO_UNIT)}",
            f"full_scale = {told.full_scale or round_up(largest):g}",
        ]
    if columns.inputs:
        lines += ["", "[inputs]"]
        lines += [_render_input(frames, key, column) for key, column in columns.inputs.items()]
    lines += ["", "[logs]", *(f"{use} = {q(list(files))}" for use, files in logs.items())]
    for effect in begin.effects:
        lines += ["", "[[effect]]", f"kind = {q(effect)}"]
    lines += ["", "[network]", f"kind = {q(begin.network)}"]
    return "\n".join(lines) + "\n"


def _render_input(frames: Mapping[str, pl.DataFrame], key: str, column: str) -> str:
    """Return an input's line in zerodrift.toml, with an LSB whose codes hold all frames."""
    if key == CLOCK:
        return f"{key} = {json.dumps(column)}"
    largest = max(_find_largest(frame[column]) for frame in frames.values())
    raw, lsb = propose_codes(key, column, 0.0, largest, is_degc=False)
    return f'{key} = {{ column = {json.dumps(column)}, raw = "{raw}", lsb = {lsb!r} }}'
