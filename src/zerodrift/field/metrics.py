"""What `monitor` found as Prometheus' text, for the textfile collector of its node exporter."""

from collections.abc import Iterator
from pathlib import Path

from zerodrift.base.files import write_whole
from zerodrift.field.summary import ALARM, STATES, MonitorResult

PREFIX = "zerodrift_monitor_"


def render_metrics(results: tuple[MonitorResult, ...]) -> str:
    """Return the text (Prometheus exposition format 0.0.4), a family after the other."""
    lines: list[str] = []
    for name, kind, told, values in _list_families(results):
        lines += [f"# HELP {PREFIX}{name} {told}", f"# TYPE {PREFIX}{name} {kind}"]
        lines += [f"{PREFIX}{name}{{{labels}}} {value}" for labels, value in values]
    return "\n".join(lines) + "\n"


def write_metrics(path: Path, results: tuple[MonitorResult, ...]) -> None:
    """Write the text, whole or not at all, as the collector asks.

    Raises:
        InputError: it cannot be written.
    """
    write_whole(path, render_metrics(results).encode())


def _list_families(
    results: tuple[MonitorResult, ...],
) -> Iterator[tuple[str, str, str, list[tuple[str, str]]]]:
    """Yield (name, type, help, [(labels, value)]) of each family that has values."""
    units = [(_label(sensor=r.sensor), r) for r in results]
    every = [
        (_label(sensor=r.sensor, output=name, unit=o.unit), o)
        for r in results
        for name, o in r.outputs.items()
    ]
    yield (
        *("alarm", "gauge", "1 where an output carries an alarm."),
        [(labels, str(int(o.state == ALARM))) for labels, o in every],
    )
    yield (
        *("state", "gauge", "1 for the state that the output is in."),
        [
            (labels + f',state="{state}"', str(int(o.state == state)))
            for labels, o in every
            for state in STATES
        ],
    )
    caused = [
        (f'{labels},cause="{o.verdict.cause}"', "1") for labels, o in every if o.verdict.cause
    ]
    moved = [(labels, repr(o.zero_moved)) for labels, o in every if o.zero_moved is not None]
    left = [(labels, repr(o.rms_residual)) for labels, o in every if o.rms_residual is not None]
    for name, told, values in (
        ("cause", "1 for the cause of an alarm.", caused),
        ("zero_moved", "Zero of the last day less that of the days learnt from.", moved),
        ("residual_rms", "RMS of the residual of the last call.", left),
    ):
        if values:
            yield name, "gauge", told, values
    named = [
        (_label(sensor=r.sensor, serial=r.other_unit.named), "1")
        for r in results
        if r.other_unit is not None and r.other_unit.named
    ]
    if named:
        yield "other_unit", "gauge", "1 for the unit that is in its place.", named
    yield (
        *("steps_total", "counter", "Steps of the firmware that were read."),
        [(labels, str(r.steps_in_all)) for labels, r in units],
    )
    flags = [
        (f'{labels},flag="{flag}"', str(count))
        for labels, r in units
        for flag, count in r.flags_in_all.items()
    ]
    if flags:
        yield "flagged_steps_total", "counter", "Steps that carry a flag of the chip.", flags
    last = [(labels, f"{r.last_s!r}") for labels, r in units if r.last_s is not None]
    if last:
        yield "last_step_seconds", "gauge", "Time of the last step that was read.", last


def _label(**labels: str) -> str:
    """Return labels as text, their values escaped."""
    table = str.maketrans({"\\": "\\\\", '"': '\\"', "\n": "\\n"})
    return ",".join(f'{name}="{value.translate(table)}"' for name, value in labels.items())
