"""A calibration as files and as text: TOML, JSON, a C header, and what `calibrate` prints."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.errors import InputError
from zerodrift.base.records import to_dict
from zerodrift.calibration.matrix import CalibrationMatrix

# A calibration as `calibrate` prints it and as calibration.json holds it.


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
        center=_list_rows(fitted.center),
        outputs={name: _summarise_output(fitted, k) for k, name in enumerate(fitted.outputs)},
        codes_without_load=None if unloaded is None else _list_rows(unloaded),
        condition_number=fitted.condition,
        condition_number_of_loads=fitted.load_condition,
        rows=fitted.rows,
        notes=tuple(fitted.notes),
    )


def _summarise_output(fitted: CalibrationMatrix, k: int) -> CalibratedOutput:
    offsets, held_out = fitted.log_offsets, fitted.held_out
    return CalibratedOutput(
        row=_list_rows(fitted.matrix[k]),
        offset=float(fitted.offset[k]),
        offsets_of_logs=None if offsets is None else _list_rows(offsets[:, k]),
        rmse=float(fitted.rmse[k]),
        rmse_left_out=None if held_out is None else float(held_out[k]),
        max_abs=float(fitted.largest[k]),
        rmse_pct_of_span=float(100.0 * fitted.rmse[k] / fitted.span[k]),
        span=float(fitted.span[k]),
    )


def _list_rows(values: Array) -> tuple[float, ...]:
    return tuple(values.tolist())


# A calibration as TOML, as JSON, and as integers in a C header.

LARGEST_ENTRY = 2.0**30
MOST_SHIFT = 40
COUNTS = 1e6
"""An output's unit gets the power of ten of counts that gives its largest load a million or more,
as the firmware's outputs do for their full scale."""


def split_output(name: str) -> tuple[str, str]:
    """Return quantity and unit of an output's name such as `Fz_N`."""
    quantity, _, unit = name.rpartition("_")
    return (quantity, unit) if quantity else (name, "")


def _list(values: Array) -> str:
    return "[" + ", ".join(repr(value) for value in values.tolist()) + "]"


def render_toml(fitted: CalibrationMatrix) -> str:
    """Return a calibration as TOML; numbers read back as the same doubles."""
    lines = [
        "# load = row . (codes - center) + offset"
        + (", then the same with the squares" if fitted.squares else ""),
        f"channels = {json.dumps(list(fitted.channels), ensure_ascii=False)}",
        f"center = {_list(fitted.center)}",
        f"squares = {'true' if fitted.squares else 'false'}",
        f"condition_number = {fitted.condition!r}",
        f"rows = {fitted.rows}",
    ]
    for k, name in enumerate(fitted.outputs):
        lines += [
            "",
            f"[outputs.{json.dumps(name, ensure_ascii=False)}]",
            f"row = {_list(fitted.matrix[k])}",
            f"offset = {float(fitted.offset[k])!r}",
            f"rmse = {float(fitted.rmse[k])!r}",
            f"max_abs = {float(fitted.largest[k])!r}",
        ]
    return "\n".join(lines) + "\n"


def render_json(fitted: CalibrationMatrix) -> str:
    """Return a calibration as JSON."""
    return json.dumps(to_dict(summarise_calibration(fitted)), indent=1) + "\n"


def choose_counts(largest: float) -> int:
    """Return the counts of one unit for an output whose load reaches this far."""
    decades = int(np.ceil(np.log10(COUNTS / max(largest, 1e-9))))
    return int(10 ** max(0, min(9, decades)))


def quantize_row(
    row: Array, offset: float, center: Array, counts: int
) -> tuple[list[int], int, int]:
    """Return integer entries, integer offset and shift of one output.

    counts = (sum entries code + offset) / 2^shift, rounded to nearest, halves away from zero.
    `counts` are per unit of the output; `row` is in that unit per code. Entries are below 2^30, so
    that with codes of up to 24 bits every sum stays within 64 bits.
    """
    scaled = row * counts
    most = float(np.abs(scaled).max())
    shift = int(np.floor(np.log2(LARGEST_ENTRY / most))) if most > 0.0 else 0
    shift = max(0, min(MOST_SHIFT, shift))
    if most * 2.0**shift >= 2.0**31:
        raise InputError(
            f"calibration: an entry of {most:.3g} counts per code does not fit into 32 bits; "
            "write TOML or JSON."
        )
    entries = [round(value * 2.0**shift) for value in scaled.tolist()]
    middle = sum(entry * int(code) for entry, code in zip(entries, center.tolist(), strict=True))
    return entries, round(offset * counts * 2.0**shift) - middle, shift


def _make_identifier(text: str, fallback: str) -> str:
    """Return letters, digits and underscores of a text as a C identifier."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_")[:24] or fallback
    return f"s_{plain}" if plain[0].isdigit() else plain


def render_header(
    fitted: CalibrationMatrix, name: str, full_scale: Mapping[str, float] | None = None
) -> str:
    """Return a C header with the matrix as integers and a function that applies it.

    `full_scale`, by the output's name and in its unit, sets the counts per unit as the firmware
    does; without it the span of the reference loads is used.

    Raises:
        InputError: the calibration has squares, which the header cannot hold.
    """
    if fitted.squares:
        raise InputError(
            "calibration: a header holds the plain matrix only; leave --squares out, or write "
            "TOML or JSON."
        )
    prefix = _make_identifier(name, "sensor").lower()
    upper = prefix.upper()
    outputs, channels = len(fitted.outputs), len(fitted.channels)
    rows, offsets, shifts, counts = [], [], [], []
    for k in range(outputs):
        output = fitted.outputs[k]
        count = choose_counts((full_scale or {}).get(output, float(fitted.span[k])))
        entries, offset, shift = quantize_row(
            fitted.matrix[k], float(fitted.offset[k]), fitted.center, count
        )
        rows.append("    {" + ", ".join(str(entry) for entry in entries) + "},")
        offsets.append(f"INT64_C({offset})")
        shifts.append(str(shift))
        counts.append(count)
    names: list[str] = []
    for output in fitted.outputs:
        base = _make_identifier(split_output(output)[0], "output").upper()
        names.append(base if base not in names else f"{base}_{len(names) + 1}")
    units = [re.sub(r"[^A-Za-z0-9 %.]", "", split_output(o)[1]) or "unit" for o in fitted.outputs]
    defines = [
        f"#define {upper}_CAL_{output}_LSB_PER_UNIT {count} /* counts per {unit} */"
        for output, count, unit in zip(names, counts, units, strict=True)
    ]
    return f"""/* Calibration matrix, written by `zerodrift calibrate`.
 * loads in counts = (matrix . codes + offset) / 2^shift, rounded, halves away from zero. */
#ifndef {upper}_CALIBRATION_H
#define {upper}_CALIBRATION_H

#include <stdint.h>

#define {upper}_CAL_CHANNELS {channels}
#define {upper}_CAL_OUTPUTS {outputs}
{chr(10).join(defines)}

static const int32_t {prefix}_cal_matrix[{upper}_CAL_OUTPUTS][{upper}_CAL_CHANNELS] = {{
{chr(10).join(rows)}
}};
static const int64_t {prefix}_cal_offset[{upper}_CAL_OUTPUTS] = {{
{chr(10).join(f"    {offset}," for offset in offsets)}
}};
static const uint8_t {prefix}_cal_shift[{upper}_CAL_OUTPUTS] = {{{", ".join(shifts)}}};

/* Codes of up to 24 bits; every sum stays within 64 bits. */
static inline void {prefix}_calibrate(const int32_t codes[{upper}_CAL_CHANNELS],
                                      int32_t loads[{upper}_CAL_OUTPUTS]) {{
    for (int k = 0; k < {upper}_CAL_OUTPUTS; k++) {{
        int64_t sum = {prefix}_cal_offset[k];
        for (int c = 0; c < {upper}_CAL_CHANNELS; c++) {{
            sum += (int64_t){prefix}_cal_matrix[k][c] * codes[c];
        }}
        const uint64_t half = (UINT64_C(1) << {prefix}_cal_shift[k]) >> 1;
        const uint64_t size = (sum < 0) ? (0u - (uint64_t)sum) : (uint64_t)sum;
        const uint64_t steps = (size + half) >> {prefix}_cal_shift[k];
        const int32_t most = (steps > (uint64_t)INT32_MAX) ? INT32_MAX : (int32_t)steps;
        loads[k] = (sum < 0) ? -most : most;
    }}
}}

#endif
"""
