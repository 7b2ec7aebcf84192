"""The calibration matrix of a force/torque sensor by least squares, from codes and test weights.

loads = C codes + offset, optionally with the squares of the codes. Loads that do not span every
direction determine no matrix; they are refused, and the missing direction is named.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.errors import InputError

SINGULAR = 1e-3
"""Smallest singular value of the scaled loads or codes, over the largest, that is accepted."""
POOR = 30.0
"""Condition number from which a note is due."""
ANSWERED = 0.5
"""Share of the variance of every combination of loads that the codes have to explain."""
WARM_SPAN_K = 3.0
"""Temperature span within a calibration from which a note is due."""


@dataclass(frozen=True)
class CalibrationMatrix:
    """A fitted calibration; K outputs, C converter channels, F features (C, or 2C with squares)."""

    outputs: tuple[str, ...]
    """[K] such as `Fz_N`."""
    channels: tuple[str, ...]
    """[C] the converter's columns."""
    squares: bool
    center: Array
    """[C] mean codes; the features are codes - center and, with `squares`, its squares."""
    matrix: Array
    """[K, F] each output's unit per code, or per code squared."""
    offset: Array
    """[K] the load at codes equal to `center`, in each output's unit; with offsets per log, their
    mean."""
    log_offsets: Array | None
    """[L, K] offset of every log; None where all logs share one."""
    rmse: Array
    """[K] of the residuals, in each output's unit."""
    largest: Array
    """[K] largest magnitude of a residual, in each output's unit."""
    held_out: Array | None
    """[K] RMSE with one log left out at a time, in each output's unit; None for a single log."""
    span: Array
    """[K] span of the reference loads, in each output's unit."""
    condition: float
    """Condition number of the matrix, with outputs and codes divided by their spans."""
    load_condition: float
    """Condition number of the loads, each divided by its largest: 1 is the best set of weights."""
    rows: int
    notes: tuple[str, ...]

    @property
    def unloaded_codes(self) -> Array | None:
        """[C] the codes without load; None where the matrix is not square or has squares."""
        if self.squares or self.matrix.shape[0] != self.matrix.shape[1]:
            return None
        return np.asarray(self.center - np.linalg.solve(self.matrix, self.offset))

    def apply(self, codes: Array) -> Array:
        """Return the loads [n, K] that codes [n, C] stand for."""
        away = codes - self.center
        features = np.concatenate([away, away**2], axis=1) if self.squares else away
        return features @ self.matrix.T + self.offset


def _name_direction(vector: Array, names: Sequence[str], largest: Array) -> str:
    """Return the combination of outputs that the loads never exercise, as text."""
    parts = [(abs(v), v, k) for k, v in enumerate(vector.tolist()) if abs(v) > 0.2]
    parts.sort(reverse=True)
    lead = parts[0][2]
    if len(parts) == 1:
        return f"{names[lead]} alone"
    others = " and ".join(names[k] for _, _, k in parts[1:])
    ratio = ", ".join(
        f"{abs(largest[k] * vector[lead] / (largest[lead] * vector[k])):.3g} {names[k]} to 1 "
        f"{names[lead]}"
        for _, _, k in parts[1:]
    )
    return f"{names[lead]} apart from {others} (they keep a fixed ratio, such as {ratio})"


def check_loads(loads: Array, names: Sequence[str], logs: Array | None = None) -> float:
    """Refuse loads [n, K] that leave a direction out; return their condition number.

    `logs` [n, L] says which rows share an offset; left out, all of them do.

    Raises:
        InputError: names the direction that is missing, and the weight to add.
    """
    largest = np.abs(loads).max(axis=0)
    missing = [name for name, most in zip(names, largest.tolist(), strict=True) if most == 0.0]
    still = [
        name
        for name, column in zip(names, loads.T, strict=True)
        if column.max() == column.min() and name not in missing
    ]
    if missing or still:
        every = ", ".join([*missing, *still])
        raise InputError(
            f"calibration: the loads never move {every}, so no matrix follows from them; expected "
            f"{len(names)} independent directions. Add weights along {every}, or name the other "
            "references alone by --reference."
        )
    shared = np.ones((loads.shape[0], 1)) if logs is None else logs
    scaled = _centre(loads, shared) / largest
    _, singular, directions = np.linalg.svd(scaled, full_matrices=False)
    if singular.size < len(names) or singular[-1] < SINGULAR * singular[0]:
        missing_direction = _name_direction(directions[-1], names, largest)
        raise InputError(
            f"calibration: the loads never move {missing_direction}: {_count(singular)} of "
            f"{len(names)} directions are there. Add weights that break this ratio, such as the "
            "same weight at another lever."
        )
    return float(singular[0] / singular[-1])


def _count(singular: Array) -> int:
    return int(np.sum(singular >= SINGULAR * singular[0]))


def check_codes(codes: Array, channels: Sequence[str]) -> None:
    """Refuse codes [n, C] of a channel that never moves, or that only copies others.

    Raises:
        InputError: names the channel, and what to check.
    """
    for name, column in zip(channels, codes.T, strict=True):
        if column.max() == column.min():
            raise InputError(
                f"calibration: {name} is {column[0]:g} in every row; expected a channel that "
                "answers to the loads. Check its coupler and its wiring."
            )
    scaled = (codes - codes.mean(axis=0)) / codes.std(axis=0)
    _, singular, directions = np.linalg.svd(scaled, full_matrices=False)
    if singular.size < len(channels) or singular[-1] < 1e-6 * singular[0]:
        involved = [
            name
            for name, share in zip(channels, np.abs(directions[-1]).tolist(), strict=True)
            if share > 0.2
        ]
        raise InputError(
            f"calibration: the codes of {', '.join(involved)} depend on each other exactly; "
            "expected channels of their own. Check whether one is logged twice, or add rows."
        )


def _solve(codes: Array, loads: Array, squares: bool, logs: Array) -> tuple[Array, Array, Array]:
    """Return center [C], matrix [K, F] and offsets [L, K] by least squares.

    `logs` [n, L] is one in the column of the offset that a row belongs to.
    """
    center = np.round(codes.mean(axis=0))
    away = codes - center
    features = np.concatenate([away, away**2], axis=1) if squares else away
    size = features.std(axis=0)
    design = np.column_stack([features / size, logs])
    solution, *_ = np.linalg.lstsq(design, loads, rcond=None)
    count = features.shape[1]
    return center, np.asarray((solution[:count] / size[:, None]).T), np.asarray(solution[count:])


def _tell_logs_apart(codes: Sequence[Array], per_log: bool) -> Array:
    """Return the columns [n, L] of the offsets: one for all rows, or one for each log's."""
    rows = [column.shape[0] for column in codes]
    if not per_log:
        return np.ones((sum(rows), 1))
    return np.repeat(np.eye(len(rows)), rows, axis=0)


def _centre(values: Array, logs: Array) -> Array:
    """Return the values [n, M] less their means over the rows that share an offset."""
    means = (logs.T @ values) / logs.sum(axis=0)[:, None]
    centred: Array = values - logs @ means
    return centred


def fit_calibration(
    codes: Sequence[Array],
    loads: Sequence[Array],
    channels: Sequence[str],
    outputs: Sequence[str],
    *,
    squares: bool = False,
    offset_per_log: bool = False,
    temperatures: Sequence[Array | None] = (),
) -> CalibrationMatrix:
    """Fit a calibration matrix.

    Args:
        codes: converter codes [n, C] of each log.
        loads: reference loads [n, K] of each log.
        channels: names of the C channels.
        outputs: names of the K outputs, with their units.
        squares: take the squares of the codes too, for sensors that are not linear.
        offset_per_log: give every log an offset of its own, for zeros that moved between them.
        temperatures: temperature [n] in degC of each log, for a note on drift within the
            calibration.

    Raises:
        InputError: the loads leave a direction out, or a channel does not answer.
    """
    every_code, every_load = np.concatenate(codes), np.concatenate(loads)
    logs = _tell_logs_apart(codes, offset_per_log)
    unknowns = len(channels) * (2 if squares else 1) + logs.shape[1]
    if every_code.shape[0] <= unknowns:
        raise InputError(
            f"calibration: {every_code.shape[0]} rows for {unknowns} unknowns per output; "
            "expected more rows than unknowns. Record more weights."
        )
    load_condition = check_loads(every_load, outputs, logs)
    check_codes(every_code, channels)
    check_answers(_centre(every_code, logs), _centre(every_load, logs), outputs)
    center, matrix, offsets = _solve(every_code, every_load, squares, logs)
    offset = offsets.mean(axis=0)
    span = np.ptp(every_load, axis=0)
    # Outputs and codes over their spans: the condition then measures how different the channels
    # are.
    linear = matrix[:, : len(channels)] * np.ptp(every_code, axis=0) / span[:, None]
    singular = np.linalg.svd(linear, compute_uv=False)
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0.0 else float("inf")
    bare = CalibrationMatrix(
        outputs=tuple(outputs),
        channels=tuple(channels),
        squares=squares,
        center=center,
        matrix=matrix,
        offset=offset,
        log_offsets=offsets if offset_per_log else None,
        rmse=np.zeros(len(outputs)),
        largest=np.zeros(len(outputs)),
        held_out=None,
        span=span,
        condition=condition,
        load_condition=load_condition,
        rows=every_code.shape[0],
        notes=(),
    )
    residual = bare.apply(every_code) - every_load + logs @ (offsets - offset)
    notes = _note(condition, load_condition, temperatures)
    return replace(
        bare,
        rmse=np.sqrt(np.mean(residual**2, axis=0)),
        largest=np.abs(residual).max(axis=0),
        held_out=_leave_out(bare, codes, loads),
        notes=notes,
    )


def check_answers(codes: Array, loads: Array, names: Sequence[str]) -> None:
    """Refuse centred loads [n, K] with a direction that centred codes [n, C] do not answer to.

    A reference sensor's noise has components in every direction, so that a load that was never
    applied looks like one. The smallest canonical correlation between codes and loads shows it.

    Raises:
        InputError: names the direction, and what to do.
    """
    of_codes, _ = np.linalg.qr(codes)
    of_loads, mixing = np.linalg.qr(loads)
    _, correlations, directions = np.linalg.svd(of_codes.T @ of_loads, full_matrices=False)
    explained = float(correlations[-1] ** 2) if correlations.size == len(names) else 0.0
    if explained >= ANSWERED:
        return
    share = np.abs(np.linalg.solve(mixing, directions[-1])) * loads.std(axis=0)
    order = np.argsort(-share)
    lead = names[int(order[0])]
    others = [names[int(k)] for k in order[1:] if share[k] > 0.3 * share[order[0]]]
    apart = f" apart from {', '.join(others)}" if others else ""
    raise InputError(
        f"calibration: the codes explain only {100.0 * explained:.0f} % of what {lead} does"
        f"{apart}: either it was never loaded so and its reference shows noise, or codes and "
        f"references are not of the same moments. Add weights along {lead}, or check the clocks."
    )


def _leave_out(
    bare: CalibrationMatrix, codes: Sequence[Array], loads: Sequence[Array]
) -> Array | None:
    """Return the RMSE [K] with one log left out at a time; None where the rest does not suffice."""
    if len(codes) < 2:
        return None
    squares = np.zeros(len(bare.outputs))
    count = 0
    for index, (left_codes, left_loads) in enumerate(zip(codes, loads, strict=True)):
        others = [k for k in range(len(codes)) if k != index]
        rest_codes = np.concatenate([codes[k] for k in others])
        rest_loads = np.concatenate([loads[k] for k in others])
        logs = _tell_logs_apart([codes[k] for k in others], bare.log_offsets is not None)
        try:
            check_loads(rest_loads, bare.outputs, logs)
            check_codes(rest_codes, bare.channels)
        except InputError:
            return None
        center, matrix, offsets = _solve(rest_codes, rest_loads, bare.squares, logs)
        rest = replace(bare, center=center, matrix=matrix, offset=offsets.mean(axis=0))
        residual = rest.apply(left_codes) - left_loads
        if bare.log_offsets is not None:
            residual = residual - residual.mean(axis=0)
        squares += np.sum(residual**2, axis=0)
        count += left_codes.shape[0]
    return np.asarray(np.sqrt(squares / count))


def _note(
    condition: float, load_condition: float, temperatures: Sequence[Array | None]
) -> tuple[str, ...]:
    notes = []
    if condition > POOR:
        notes.append(
            f"the matrix has condition number {condition:.0f}: some channels answer nearly alike, "
            "and noise of the converter is blown up in some direction"
        )
    if load_condition > POOR:
        notes.append(
            f"the loads have condition number {load_condition:.0f}: one direction is hardly moved; "
            "add weights along it"
        )
    known = [column for column in temperatures if column is not None]
    if known:
        every = np.concatenate(known)
        span = float(np.ptp(every))
        if span > WARM_SPAN_K:
            notes.append(
                f"the temperature spans {span:.1f} K: drift is in the residuals and may be in the "
                "matrix; calibrate at one temperature"
            )
    return tuple(notes)
