"""What `record` prints, and its sentences."""

from dataclasses import dataclass

from zerodrift.recording.coverage import Covered, CoveredRange


@dataclass(frozen=True, kw_only=True)
class RecordingSummary(Covered):
    """A log that was recorded."""

    file: str
    """The log."""
    source: str
    interrupted: bool
    """Whether it was ended by Ctrl-C or by the system."""
    why: str
    """Where the wanted ranges come from: a plan, the model's logs, or nothing."""
    notes: tuple[str, ...]
    """What arrived and is in no row."""


def explain_missing(covered: Covered) -> list[str]:
    """Return a sentence for each thing that is still to be covered."""
    return [_explain(one) for one in covered.wanted if not one.enough]


def _explain(one: CoveredRange) -> str:
    unit = f" {one.unit}" if one.unit else ""
    if one.what == "time":
        left = max(one.wanted_high - one.high, 0.0)
        reached, whole = _write_time(one.high), _write_time(one.wanted_high)
        return f"time: {reached} of {whole}, {_write_time(left)} more"
    if one.what in ("heating", "cooling"):
        return f"{one.what}: {one.high:.3g} of {one.wanted_high:.3g}{unit}"
    if one.low == one.high == 0.0 and one.share == 0.0:
        return f"{one.what}: nothing of {one.wanted_low:g} to {one.wanted_high:g}{unit}"
    lacks = []
    span = one.wanted_high - one.wanted_low
    if one.low > one.wanted_low + 0.01 * span:
        lacks.append(f"down to {one.wanted_low:g}")
    if one.high < one.wanted_high - 0.01 * span:
        lacks.append(f"up to {one.wanted_high:g}")
    return (
        f"{one.what}: {one.low:.4g} to {one.high:.4g}{unit} so far; go {' and '.join(lacks)}{unit}"
    )


def _write_time(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"
