"""A calibration as `calibrate` prints it and as calibration.json holds it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from zerodrift.base.arrays import Array
from zerodrift.calibration.matrix import CalibrationMatrix


@dataclass(frozen=True)
class CalibratedOutput:
    """One load: its row of the matrix, and its residual error, in the load's unit."""

    ALIASES: ClassVar = ("rmse_heldout",)

    row: tuple[float, ...]
    """Load per code, in the order of `features`."""
    offset: float
    offsets_of_logs: tuple[float, ...] | None
    """Log by log; null where all share one."""
    rmse: float
    rmse_left_out: float | None
    """With each log left out in turn; null where that was not measured."""
    max_abs: float
    rmse_pct_of_span: float
    span: float
    """Of the reference load."""

    @property
    def rmse_heldout(self) -> float | None:
        """Older name of `rmse_left_out`."""
        return self.rmse_left_out


@dataclass(frozen=True)
class CalibrationSummary:
    """The matrix that turns converter codes into loads."""

    channels: tuple[str, ...]
    features: tuple[str, ...]
    """Channels, and their squares where asked for."""
    center: tuple[float, ...]
    """Mean codes, subtracted before the matrix is applied."""
    outputs: Mapping[str, CalibratedOutput]
    codes_without_load: tuple[float, ...] | None
    condition_number: float
    condition_number_of_loads: float
    rows: int
    notes: tuple[str, ...]


def summarise_calibration(fitted: CalibrationMatrix) -> CalibrationSummary:
    """Return a calibration as plain values."""
    squares = tuple(f"{name}^2" for name in fitted.channels) if fitted.squares else ()
    unloaded = fitted.unloaded_codes
    return CalibrationSummary(
        channels=tuple(fitted.channels),
        features=(*fitted.channels, *squares),
        center=_list(fitted.center),
        outputs={name: _summarise_output(fitted, k) for k, name in enumerate(fitted.outputs)},
        codes_without_load=None if unloaded is None else _list(unloaded),
        condition_number=fitted.condition,
        condition_number_of_loads=fitted.load_condition,
        rows=fitted.rows,
        notes=tuple(fitted.notes),
    )


def _summarise_output(fitted: CalibrationMatrix, k: int) -> CalibratedOutput:
    offsets, held_out = fitted.log_offsets, fitted.held_out
    return CalibratedOutput(
        row=_list(fitted.matrix[k]),
        offset=float(fitted.offset[k]),
        offsets_of_logs=None if offsets is None else _list(offsets[:, k]),
        rmse=float(fitted.rmse[k]),
        rmse_left_out=None if held_out is None else float(held_out[k]),
        max_abs=float(fitted.largest[k]),
        rmse_pct_of_span=float(100.0 * fitted.rmse[k] / fitted.span[k]),
        span=float(fitted.span[k]),
    )


def _list(values: Array) -> tuple[float, ...]:
    return tuple(values.tolist())
