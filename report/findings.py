"""What the commands found about a project, as plain data: the one source of figures and tables.

`told` holds the commands' own JSON; `traces` the signals behind it, at full rate. Both can be
written to a directory and read back with the arrays left on disk, so that a page of many million
samples opens at once.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zerodrift.dataset.runs import Run
from zerodrift.diagnosis.run_errors import RunError

Array = NDArray[np.float64]

RATE_SPAN_S = 60.0
"""Time over which rates are taken, so that the thermometer's steps do not show."""
FILE_NAME = "findings.json"


@dataclass(frozen=True)
class Trace:
    """One run as the figures show it, its stretches laid end to end."""

    run: str
    held_out: bool
    """Whether the prediction is for data that the model did not learn from."""
    sample_period_s: float
    time_s: Array
    """[n] on the log's own clock."""
    temperature_degC: Array
    """[n] what the chip's thermometer reported."""
    rate_K_per_min: Array  # noqa: N815 - the unit's own spelling
    """[n] slope of the temperature over `RATE_SPAN_S`."""
    load: Array
    """[K, n] true values of the outputs, in their units."""
    drift: Array
    """[K, n] measured minus reference."""
    error: Array
    """[K, n] drift minus model, without the run's own offset."""
    offset: Array
    """[K] what was taken off as the run's own offset; zeros where logs are not tared."""


@dataclass(frozen=True)
class Findings:
    """A project, its model and what the commands say about both."""

    sensor: str
    outputs: tuple[str, ...]
    units: tuple[str, ...]
    full_scale: tuple[float, ...]
    simulated: bool
    """Whether the logs came out of a simulation and not out of a sensor."""
    told: Mapping[str, Any]
    """Command -> the JSON that it prints, and the sentences that go with it."""
    traces: tuple[Trace, ...]

    def find_trace(self, run: str) -> Trace:
        """Return the trace of a run."""
        return next(trace for trace in self.traces if trace.run == run)


MOVING_K_PER_MIN = 0.1
"""Slower than this counts as neither heating nor cooling, ..."""
MOVING_SHARE = 0.2
"""... or slower than this share of the rate that nine tenths of the time stay below."""


def find_threshold(traces: Sequence[Trace]) -> float:
    """Return the rate in K/min below which these runs are at rest, to one digit."""
    rate = np.concatenate([np.abs(trace.rate_K_per_min) for trace in traces])
    fast = MOVING_SHARE * float(np.quantile(rate, 0.9))
    return float(f"{min(MOVING_K_PER_MIN, fast):.1g}") if fast > 0.0 else MOVING_K_PER_MIN


ARRAYS = ("time_s", "temperature_degC", "rate_K_per_min", "load", "drift", "error", "offset")


def measure_rate(time_s: Array, temperature_degC: Array, period_s: float) -> Array:
    """Return the slope [n] of the temperature in K/min, over a minute around each sample.

    Args:
        time_s: [n] of one uninterrupted stretch.
        temperature_degC: [n].
        period_s: from sample to sample.
    """
    reach = min(max(1, round(0.5 * RATE_SPAN_S / period_s)), max(time_s.size - 1, 1))
    rows = np.arange(time_s.size)
    late = np.minimum(rows + reach, time_s.size - 1)
    early = np.maximum(rows - reach, 0)
    span_s = np.maximum(time_s[late] - time_s[early], period_s)
    return np.asarray(60.0 * (temperature_degC[late] - temperature_degC[early]) / span_s)


def trace_runs(errors: Mapping[str, RunError], held_out: Sequence[str]) -> tuple[Trace, ...]:
    """Return the traces of runs, given what the model leaves of them.

    Args:
        errors: run -> its errors.
        held_out: runs whose prediction comes from a model that did not learn from them.
    """
    return tuple(
        Trace(
            run=error.group,
            held_out=error.group in held_out,
            sample_period_s=error.runs[0].sample_period_s,
            time_s=_join(error.runs, lambda run: run.time_s),
            temperature_degC=_join(error.runs, lambda run: run.temperature_degC),
            rate_K_per_min=_join(
                error.runs,
                lambda run: measure_rate(run.time_s, run.temperature_degC, run.sample_period_s),
            ),
            load=np.ascontiguousarray(np.concatenate([r.reference for r in error.runs]).T),
            drift=np.ascontiguousarray(error.drift.T),
            error=np.ascontiguousarray(error.error.T),
            offset=error.offset,
        )
        for error in errors.values()
    )


def _join(runs: Sequence[Run], read: Any) -> Array:
    return np.concatenate([read(run) for run in runs])


def save_findings(findings: Findings, directory: Path) -> None:
    """Write findings into an empty directory: one JSON file, and one file per array."""
    for number, trace in enumerate(findings.traces):
        for name in ARRAYS:
            np.save(directory / f"{number}.{name}.npy", getattr(trace, name), allow_pickle=False)
    told = {f.name: getattr(findings, f.name) for f in fields(Findings) if f.name != "traces"}
    told["traces"] = [
        {"run": t.run, "held_out": t.held_out, "sample_period_s": t.sample_period_s}
        for t in findings.traces
    ]
    text = json.dumps(told, ensure_ascii=False, allow_nan=False)
    (directory / FILE_NAME).write_text(text, encoding="utf-8")


def load_findings(directory: Path) -> Findings:
    """Return the findings that `save_findings` wrote; their arrays stay on disk until touched."""
    told = json.loads((directory / FILE_NAME).read_text(encoding="utf-8"))
    traces = tuple(
        Trace(
            **head,
            **{
                name: np.load(directory / f"{number}.{name}.npy", mmap_mode="r", allow_pickle=False)
                for name in ARRAYS
            },
        )
        for number, head in enumerate(told.pop("traces"))
    )
    for name in ("outputs", "units", "full_scale"):
        told[name] = tuple(told[name])
    return Findings(**told, traces=traces)
