"""A programme as files: a table, and protocols in the words of the six-axis twin."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from zerodrift.base.csv_text import render_rows
from zerodrift.base.files import write_whole
from zerodrift.discovery.limits import Limits
from zerodrift.discovery.programme import Log, SetProgramme
from zerodrift.discovery.summary import PlanSummary

P = TypeVar("P", bound=PlanSummary)

SOURCES = {
    "supply": ("supply", "V"),
    "humidity": ("humidity", "%"),
    "ambient_light": ("light", "lux"),
}
"""Input -> word and unit of a protocol."""
AIRFLOW = "airflow 25 W/m2K               # the chamber's fan"


def render_table(plan: PlanSummary) -> str:
    """Return the programme as CSV: a line for each change, columns with their units."""
    loads = list(dict.fromkeys(name for s in plan.programme for name in s.loads))
    inputs = list(dict.fromkeys(name for s in plan.programme for name in s.inputs))
    head = ["log", "from_s", "temperature_degC", "rate_K_per_min"]
    head += [f"{name}_{plan.units[name]}" for name in loads] + inputs
    rows = []
    for s in plan.programme:
        values = [s.log, s.from_s, s.temperature_degC, s.rate_K_per_min]
        values += [s.loads[name] for name in loads] + [s.inputs[name] for name in inputs]
        rows.append([f"{value:g}" if abs(value) < 1e5 else f"{value:.0f}" for value in values])
    return render_rows(head, rows)


def render_protocol(
    log: Log, start_degC: float, limits: Limits, units: Mapping[str, str], title: str
) -> str:
    """Return one log as a protocol of the six-axis twin.

    Args:
        log: what is set.
        start_degC: where it begins.
        limits: how fast loads and inputs change.
        units: output -> unit.
        title: its first line.
    """
    lines = [f"title {title}", f"room {start_degC:g} degC"]
    if log.power_on:
        lines.append("power on")
    lines.append(AIRFLOW)
    now: dict[str, float] = dict.fromkeys(limits.loads, 0.0)
    driven: dict[str, float] = {}
    going: tuple[float, float] | None = None
    ends = [setting.from_s for setting in log.settings[1:]] + [log.lasts_s]
    for setting, end_s in zip(log.settings, ends, strict=True):
        to = (setting.temperature_degC, setting.rate_K_per_min)
        if setting.rate_K_per_min > 0.0 and to != going:
            lines.append(f"air {to[0]:g} degC at {to[1]:g} K/min")
            going = to
        for name, load in setting.loads.items():
            if load != now[name]:
                over_s = limits.loads[name].change_s
                lines.append(f"load {name} {load:g} {units[name]} over {over_s:g} s")
                now[name] = load
        for name, value in setting.inputs.items():
            if value != driven.get(name) and name in SOURCES:
                word, unit = SOURCES[name]
                lines.append(f"{word} {value:g} {unit} over {limits.inputs[name].change_s:g} s")
                driven[name] = value
        lines.append(f"wait {end_s - setting.from_s:g} s")
    return "\n".join(lines) + "\n"


def list_protocols(
    programme: SetProgramme, limits: Limits, units: Mapping[str, str]
) -> dict[str, str]:
    """Return the protocol of each log, by the end of its file's name."""
    return {
        f"{number}.txt": render_protocol(
            log, programme.start_degC, limits, units, f"Planned log {number}"
        )
        for number, log in enumerate(programme.logs, start=1)
    }


def write_plan(plan: P, protocols: Mapping[str, str], file: Path) -> P:
    """Write the table and, beside it, the protocols; return the plan with their names.

    Args:
        plan: the programme.
        protocols: as `list_protocols` returns them.
        file: of the table; the protocols are called after it.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    written = [file]
    write_whole(file, render_table(plan).encode())
    for ending, text in protocols.items():
        path = file.with_name(f"{file.stem}_{ending}")
        write_whole(path, text.encode())
        written.append(path)
    return replace(plan, file=str(file), files=tuple(str(path) for path in written))
