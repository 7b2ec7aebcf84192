"""The result of `plan`, as its record and in sentences."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from zerodrift.base.csv_text import render_rows
from zerodrift.base.files import write_whole
from zerodrift.base.records import OPTIONAL
from zerodrift.discovery.criterion import MOST, expect_pairs, expect_verdicts, tell_rivals_apart
from zerodrift.discovery.limits import Limits
from zerodrift.discovery.plan import Planned
from zerodrift.discovery.precise import COVERED, PlannedPrecisely, Width
from zerodrift.discovery.programme import Log, SetProgramme

MOST_HARD = 3
"""Effects that a sentence names."""


@dataclass(frozen=True)
class PlannedSetting:
    """One line of the programme: from then on, what is set."""

    log: int
    """Its number, from 1; each log is a file, and a run."""
    from_s: float
    """Since the first row of the first log, rests included."""
    temperature_degC: float
    """The chamber's set point."""
    rate_K_per_min: float
    """How fast it gets there, a positive number; 0: it stays."""
    loads: Mapping[str, float]
    """Output -> load in its unit."""
    inputs: Mapping[str, float]
    """Input -> value."""


@dataclass(frozen=True)
class PlannedLog:
    """One log of the programme."""

    log: int
    from_s: float
    lasts_s: float
    power_on: bool
    """Whether the power is to come on with its first row."""


@dataclass(frozen=True)
class Separation:
    """A pair of open effects."""

    effects: tuple[str, ...]
    probability: float
    """That `diagnose` names the one that is true, and without the other, over both of them."""


@dataclass(frozen=True)
class Outlook:
    """What is expected if one effect is the one that is missing."""

    effect: str
    probability: float
    """That it is named, and alone, over the draws of its values."""
    range: tuple[float, float]
    """Of that probability, from the least to the most favourable draw."""
    nearest: str | None
    """The rival that it is hardest to tell from; null without one."""


@dataclass(frozen=True)
class PastPlan:
    """The prediction of the plan before this one, with the result."""

    effects: tuple[str, ...]
    probability: float
    """Of the right verdict, as it was predicted."""
    verdict: str
    """Verdict of the logs now: missing | complete | unknown."""
    effect: str | None
    told_apart: bool
    """Whether one of those effects is named now, and alone."""


@dataclass(frozen=True, kw_only=True)
class PlanSummary:
    """The next experiment: a programme of set points, and what it is expected to show."""

    hours: float
    """What it takes, rests included."""
    criterion: str
    """discrimination: the mean probability of the right verdict; precision: the width of the
    model's values; error: its error in a use profile."""
    programme: tuple[PlannedSetting, ...]
    logs: tuple[PlannedLog, ...]
    rest_s: float
    """Between two logs, unloaded at the start temperature, nothing recorded."""
    start_degC: float
    """Where each log begins and ends."""
    separates: tuple[Separation, ...]
    outlooks: tuple[Outlook, ...]
    probability: float | None
    """Of the right verdict, over the open effects and their draws; null by other criteria."""
    units: Mapping[str, str]
    """Output -> unit of its loads."""
    programmes_tried: int
    cpu_s: float
    first_answer_cpu_s: float
    """Processor seconds to the first answer."""
    interrupted: bool
    notes: tuple[str, ...]
    """What was assumed."""
    file: str | None
    """The programme as CSV; null where none was written."""
    files: tuple[str, ...] = ()
    """All files that were written."""
    before: PastPlan | None = field(default=None, metadata=OPTIONAL)
    """Where logs followed an earlier plan."""
    widths: tuple[Width, ...] = field(default=(), metadata=OPTIONAL)
    """By precision or error: what each shared value of the model will be known to."""
    errors: Mapping[str, float] | None = field(default=None, metadata=OPTIONAL)
    """By precision or error: output -> RMS error of the model in the use profile, its unit."""
    aimed: Mapping[str, float] | None = field(default=None, metadata=OPTIONAL)
    """With a target: output -> the error that is aimed at, its unit."""
    covered: float | None = field(default=None, metadata=OPTIONAL)
    """By error: share of the use profile at temperatures and loads that the programme reaches."""
    further_units: int | None = field(default=None, metadata=OPTIONAL)
    """With `--units`: for how many; the hours are then the fewest of those that were tried."""


def summarise_plan(
    planned: Planned, units: Mapping[str, str], before: PastPlan | None = None
) -> PlanSummary:
    """Return what the command prints, before any file is written."""
    kinds = planned.kinds
    verdicts = expect_verdicts(planned.told)
    pairs = expect_pairs(planned.told)
    rivals = tell_rivals_apart(planned.told).mean(axis=1) + np.eye(len(kinds))
    settings, logs = _lay_out(planned.programme)
    return PlanSummary(
        hours=round(planned.programme.hours, 4),
        criterion="discrimination",
        programme=settings,
        logs=logs,
        rest_s=planned.programme.rest_s,
        start_degC=planned.programme.start_degC,
        separates=tuple(
            Separation((kinds[i], kinds[j]), round(float(pairs[i, j]), 3))
            for i in range(len(kinds))
            for j in range(i + 1, len(kinds))
        ),
        outlooks=tuple(
            Outlook(
                kind,
                round(float(verdicts[m].mean()), 3),
                (round(float(verdicts[m].min()), 3), round(float(verdicts[m].max()), 3)),
                kinds[int(rivals[m].argmin())] if len(kinds) > 1 else None,
            )
            for m, kind in enumerate(kinds)
        ),
        probability=round(float(verdicts.mean()), 3),
        units=dict(units),
        programmes_tried=planned.best.tried,
        cpu_s=round(planned.cpu_s, 2),
        first_answer_cpu_s=round(planned.first_cpu_s, 2),
        interrupted=planned.best.interrupted,
        notes=planned.notes,
        file=None,
        before=before,
    )


def summarise_precise(planned: PlannedPrecisely, units: Mapping[str, str]) -> PlanSummary:
    """Return what the command prints of a plan by precision, before any file is written."""
    settings, logs = _lay_out(planned.programme)
    best = planned.found.best
    question = planned.question
    return PlanSummary(
        hours=round(planned.programme.hours, 4),
        criterion="error" if question.units else question.criterion,
        programme=settings,
        logs=logs,
        rest_s=planned.programme.rest_s,
        start_degC=planned.programme.start_degC,
        separates=(),
        outlooks=(),
        probability=None,
        units=dict(units),
        programmes_tried=best.tried,
        cpu_s=round(planned.cpu_s, 2),
        first_answer_cpu_s=round(planned.cpu_s, 2),
        interrupted=best.interrupted,
        notes=planned.notes,
        file=None,
        widths=planned.widths,
        errors=planned.errors,
        aimed=planned.aimed,
        covered=None if question.criterion == "precision" else round(planned.found.covered, 4),
        further_units=question.units or None,
    )


def _lay_out(
    programme: SetProgramme,
) -> tuple[tuple[PlannedSetting, ...], tuple[PlannedLog, ...]]:
    """Return the lines and the logs of a programme, times counted from its beginning."""
    settings, logs = [], []
    at_s = 0.0
    for number, log in enumerate(programme.logs, start=1):
        logs.append(PlannedLog(number, at_s, log.lasts_s, log.power_on))
        settings += [
            PlannedSetting(
                number,
                at_s + setting.from_s,
                setting.temperature_degC,
                setting.rate_K_per_min,
                dict(setting.loads),
                dict(setting.inputs),
            )
            for setting in log.settings
        ]
        at_s += log.lasts_s + programme.rest_s
    return tuple(settings), tuple(logs)


def _tell_target(plan: PlanSummary) -> list[str]:
    """Return whether the error that is aimed at is reached; nothing without one."""
    errors, aimed, units = plan.errors or {}, plan.aimed or {}, plan.units
    if not aimed:
        return []
    if plan.covered is not None and plan.covered < COVERED:
        return [
            f"NOT reached: the programme reaches only {100.0 * plan.covered:.0f} % of the use "
            "profile's temperatures and loads; beyond them the chip flags and limits its inputs. "
            "More hours or faster ramps are needed."
        ]
    short = {name: errors[name] / aimed[name] for name in aimed if errors[name] > aimed[name]}
    if not short:
        told = ", ".join(f"{name} {size:.3g} {units[name]}" for name, size in aimed.items())
        if plan.further_units is not None:
            return [f"Reached: {told}. No fewer hours of those that were tried do."]
        return [f"Reached: {told}. `zerodrift plan --units 1` looks for the fewest hours that do."]
    told = ", ".join(f"{name} by {ratio:.2g} times" for name, ratio in short.items())
    return [f"NOT reached: {told}. More hours, wider limits or a larger --target are needed."]


def explain_plan(plan: PlanSummary, directory: Path) -> list[str]:
    """Return what is expected of the programme, in sentences."""
    sentences = []
    if plan.before is not None:
        past = plan.before
        came = "they are distinguished now" if past.told_apart else "they are not distinguished yet"
        sentences.append(
            f"The plan before this one gave {', '.join(past.effects)} a probability of "
            f"{past.probability:.2f}; {came} (verdict: {past.verdict}"
            + (f", {past.effect})." if past.effect else ").")
        )
    lasts = {log.lasts_s for log in plan.logs}
    each = f"{min(lasts) / 60.0:.0f} min"
    sentences.append(
        f"PLAN: {len(plan.logs)} log{'s' if len(plan.logs) > 1 else ''} of {each}, "
        f"{plan.rest_s / 60.0:.0f} min of rest after each, {plan.hours:.2g} h in all."
        + (
            f" Probability of the right verdict: {plan.probability:.2f}."
            if plan.probability is not None
            else ""
        )
    )
    if plan.errors:
        told = ", ".join(f"{n} {e:.3g} {plan.units[n]}" for n, e in plan.errors.items())
        sentences.append(f"Error of the model in the use profile that is expected then: {told}.")
        sentences += _tell_target(plan)
    hard = sorted(
        (o for o in plan.outlooks if o.probability < 0.8 * MOST), key=lambda o: o.probability
    )
    if hard:
        told = "; ".join(
            f"{o.effect} ({o.probability:.2f}" + (f", nearest {o.nearest})" if o.nearest else ")")
            for o in hard[:MOST_HARD]
        )
        sentences.append(f"Hard to name alone within these limits: {told}. More hours help most.")
    where = "" if str(directory) == "." else f" -C {directory}"
    sentences.append(
        "Begin each log at rest, unloaded, each in a file of its own under [logs] train; then "
        f"zerodrift diagnose{where}"
    )
    return sentences


# A programme as files: a table, and protocols in the words of the six-axis twin.

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
