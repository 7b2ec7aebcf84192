"""The curves along the runs as tables, part by part."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.report.findings import Trace

MOST_PARTS = 10
"""Of one run."""
MOST_ROWS = 150
"""Of all runs, as long as each of them has one part at least."""


@dataclass(frozen=True)
class ReportPart:
    """A part of a run."""

    run: str
    from_s: float
    """On the log's own clock."""
    to_s: float
    temperature_degC: float
    """Mean."""
    measured: float
    """Mean drift, in the output's unit."""
    model: float
    """Mean."""
    left: float
    """Mean of what the model leaves."""
    left_rms: float


def list_parts(traces: Sequence[Trace], k: int) -> list[ReportPart]:
    """Return the means of equal parts of each run, in order.

    Args:
        traces: the runs.
        k: number of the output.
    """
    most = min(max(MOST_ROWS // max(len(traces), 1), 1), MOST_PARTS)
    parts = []
    for trace in traces:
        count = trace.time_s.size
        for rows in np.array_split(np.arange(count), min(most, count)):
            measured, left = trace.drift[k, rows], trace.error[k, rows]
            parts.append(
                ReportPart(
                    trace.run,
                    float(trace.time_s[rows[0]]),
                    float(trace.time_s[rows[-1]]),
                    float(np.mean(trace.temperature_degC[rows])),
                    float(np.mean(measured)),
                    float(np.mean(measured - left)),
                    float(np.mean(left)),
                    float(np.sqrt(np.mean(np.square(left)))),
                )
            )
    return parts
