"""The yield report of a fleet: who passes, who does not and why, as JSON, CSV and Markdown."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from zerodrift.base.csv_text import render_rows
from zerodrift.base.journal import write_all
from zerodrift.base.records import to_dict
from zerodrift.fleet.outliers import Outlier, find_outliers
from zerodrift.fleet.result import SensorOutcome, SensorResult
from zerodrift.fleet.sensors import Design
from zerodrift.fleet.summary import FleetSummary, OutlierSummary, SensorSummary, SpreadSummary
from zerodrift.verify.manifest import FILE_NAME as MANIFEST

FORMAT = 1
NAME = "report"
"""Of the files below build/fleet/."""
PASS, FORCED, FAIL, ERROR = "pass", "forced", "fail", "error"
RANGE = "out_of_range"
CAUSES = ("rounding", RANGE, "clamped", "saturated")
"""Of the difference of integer and float model."""
REASONS_SHOWN = 3


@dataclass(frozen=True)
class SensorVerdict:
    """One sensor, judged."""

    sensor: str
    status: str
    """pass | forced (refused by the gate and written all the same) | fail (refused, or a limit is
    exceeded) | error (there is no result)."""
    reasons: tuple[str, ...]
    """What the gate refuses, limits that are exceeded, or the error."""
    outliers: tuple[Outlier, ...]
    result: SensorResult | None
    kept: bool


@dataclass(frozen=True)
class FleetReport:
    """All sensors, judged, and how the fleet spreads."""

    design: str
    verdicts: tuple[SensorVerdict, ...]
    limits: dict[str, float]
    ratio_limit: float | None
    outlier_z: float
    simulated: bool = False

    def count(self, status: str) -> int:
        """Return the number of sensors of a status."""
        return sum(v.status == status for v in self.verdicts)

    @property
    def outliers(self) -> tuple[SensorVerdict, ...]:
        """Sensors that are unlike the others in something."""
        return tuple(v for v in self.verdicts if v.outliers)

    @property
    def results(self) -> list[SensorResult]:
        """Of the sensors that went through."""
        return [v.result for v in self.verdicts if v.result is not None]

    def spread(self) -> dict[str, SpreadSummary]:
        """Return per output the median and the quantiles of errors over the sensors."""
        results = self.results
        table: dict[str, SpreadSummary] = {}
        for name in results[0].outputs if results else ():
            own = [r.outputs[name] for r in results]
            judged = np.array([o.judged for o in own])
            ratios = np.array([o.ratio for o in own])
            table[name] = SpreadSummary(
                unit=own[0].unit,
                rmse_uncompensated_median=float(np.median([o.rmse_uncompensated for o in own])),
                rmse_median=float(np.median(judged)),
                rmse_p95=float(np.quantile(judged, 0.95, method="higher")),
                rmse_worst=float(judged.max()),
                noise_floor_median=float(np.median([o.noise_floor for o in own])),
                ratio_median=float(np.median(ratios)),
                ratio_worst=float(ratios.max()),
                limit=self.limits.get(name),
            )
        return table


def judge_fleet(design: Design, outcomes: Sequence[SensorOutcome]) -> FleetReport:
    """Return the report on these sensors, by the limits of `[fleet]`."""
    fleet = design.config.fleet
    results = [o.result for o in outcomes if o.result is not None]
    outliers = find_outliers(results, fleet.outlier_z)
    verdicts = []
    reasons: tuple[str, ...]
    for outcome in outcomes:
        if outcome.result is None:
            status, reasons = ERROR, (outcome.error,)
        else:
            exceeded = list_exceeded(outcome.result, dict(fleet.limits), fleet.ratio_limit)
            exceeded = explain_range(outcome.result, exceeded)
            reasons = (*outcome.result.refused, *exceeded, *tell_of_older(design, outcome.result))
            is_forced = outcome.result.forced and not exceeded
            status = FORCED if is_forced else FAIL if reasons else PASS
        verdicts.append(
            SensorVerdict(
                outcome.sensor,
                status,
                reasons,
                tuple(outliers.get(outcome.sensor, ())),
                outcome.result,
                outcome.kept,
            )
        )
    return FleetReport(
        design.config.sensor_name,
        tuple(verdicts),
        dict(fleet.limits),
        fleet.ratio_limit,
        fleet.outlier_z,
    )


def tell_of_older(design: Design, result: SensorResult) -> tuple[str, ...]:
    """Return a sentence where a refused sensor's folder holds the firmware of an earlier run."""
    folder = design.firmware_folder(result.sensor)
    if not result.refused or result.forced or not (folder / MANIFEST).is_file():
        return ()
    place = folder.relative_to(design.directory) if folder.is_relative_to(design.directory) else ""
    return (f"what lies in {place or folder}/ is the firmware of an earlier run",)


def explain_range(result: SensorResult, exceeded: tuple[str, ...]) -> tuple[str, ...]:
    """Return exceeded limits with what lies behind them, where that is a log beyond the ranges."""
    beyond = [
        name
        for name, output in result.outputs.items()
        if output.chip_error and max(output.chip_error, key=output.chip_error.__getitem__) == RANGE
    ]
    told = "; ".join(warning.rstrip(".") for warning in result.warnings)
    return tuple(
        f"{reason} ({told})" if told and reason.split(":")[0] in beyond else reason
        for reason in exceeded
    )


def list_exceeded(
    result: SensorResult, limits: dict[str, float], ratio_limit: float | None
) -> tuple[str, ...]:
    """Return a sentence for each limit that a sensor exceeds."""
    reasons = []
    for name, output in result.outputs.items():
        if not math.isfinite(output.judged):
            reasons.append(f"{name}: no error held out could be measured")
        elif name in limits and output.judged > limits[name]:
            reasons.append(
                f"{name}: RMSE {output.judged:.4g} {output.unit} > {limits[name]:g} {output.unit}"
            )
        if ratio_limit is not None and output.ratio > ratio_limit:
            reasons.append(
                f"{name}: RMSE is {output.ratio:.3g} x the noise floor > {ratio_limit:g} x"
            )
    return tuple(reasons)


def write_report(design: Design, report: FleetReport) -> tuple[Path, ...]:
    """Write report.json, report.csv and report.md below build/fleet/; return their paths."""
    contents = {
        "json": render_json(summarise_report(report)),
        "csv": render_csv(report),
        "md": render_markdown(report),
    }
    files = {design.build / f"{NAME}.{suffix}": t.encode() for suffix, t in contents.items()}
    write_all(design.directory, files)
    return tuple(files)


def render_json(summary: FleetSummary) -> str:
    """Return report.json."""
    return json.dumps(to_dict(summary), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def summarise_report(report: FleetReport) -> FleetSummary:
    """Return the report as plain values."""
    return FleetSummary(
        format=FORMAT,
        design=report.design,
        sensors=len(report.verdicts),
        passed=report.count(PASS),
        forced=report.count(FORCED),
        failed=report.count(FAIL),
        errors=report.count(ERROR),
        outliers=len(report.outliers),
        limits=report.limits,
        ratio_limit=report.ratio_limit,
        outlier_z=report.outlier_z,
        outputs=report.spread(),
        results=tuple(_summarise_sensor(v) for v in report.verdicts),
    )


def _summarise_sensor(verdict: SensorVerdict) -> SensorSummary:
    judged = SensorSummary(
        sensor=verdict.sensor,
        status=verdict.status,
        reasons=verdict.reasons,
        outliers=tuple(
            OutlierSummary(o.quantity, o.value, o.median, o.z, o.unit) for o in verdict.outliers
        ),
        kept=verdict.kept,
    )
    result = verdict.result
    if result is None:
        return judged
    return replace(
        judged,
        outputs=result.outputs,
        parameters=result.parameters,
        held_out=result.held_out,
        noise_floor_source=result.floor,
        floor=result.floor,
        network=result.network,
        vectors=result.vectors,
        model_hash=result.model_hash,
        temperature_degC=result.temperature_degC,
        notes=result.notes,
        refused=result.refused,
        forced=result.forced,
        warnings=result.warnings,
    )


def render_csv(report: FleetReport) -> str:
    """Return one line per sensor: verdict, errors per output with units in the names, values."""
    results = report.results
    outputs = list(results[0].outputs.items()) if results else []
    parameters = list(dict.fromkeys(name for r in results for name in r.parameters))
    header = ["sensor", "status", "reasons", "outliers", "model_hash"]
    for name, output in outputs:
        header += [
            f"{name} uncompensated [{output.unit}]",
            f"{name} rmse [{output.unit}]",
            f"{name} firmware rmse [{output.unit}]",
            f"{name} floor [{output.unit}]",
            f"{name} ratio",
            *(f"{name} chip {cause.replace('_', ' ')} [{output.unit}]" for cause in CAUSES),
        ]
    units = {n: p.unit for r in results for n, p in r.parameters.items()}
    header += [f"{name} [{units[name]}]" for name in parameters]
    rows = []
    for v in report.verdicts:
        row = [v.sensor, v.status, "; ".join(v.reasons), "; ".join(map(str, v.outliers))]
        if v.result is not None:
            row.append(v.result.model_hash)
            for name, _ in outputs:
                o = v.result.outputs[name]
                causes = o.chip_error or {}
                numbers = (
                    *(o.rmse_uncompensated, o.rmse, o.rmse_integer, o.noise_floor, o.ratio),
                    *(causes.get(cause) for cause in CAUSES),
                )
                row += ["" if x is None or not math.isfinite(x) else f"{x:.6g}" for x in numbers]
            row += [
                f"{v.result.parameters[name].value:.8g}" if name in v.result.parameters else ""
                for name in parameters
            ]
        rows.append(row)
    return render_rows(header, rows)


def render_markdown(report: FleetReport) -> str:
    """Return the report for people: yield, spread, then only the sensors that need a look."""
    total, passed = len(report.verdicts), report.count(PASS)
    lines = [
        f"# Fleet of {report.design}",
        "",
        f"{passed} of {total} sensors pass ({_percent(passed, total)}),{tell_forced(report)}"
        f" {report.count(FAIL)} fail,"
        f" {report.count(ERROR)} could not be worked on, {len(report.outliers)} are outliers.",
        "",
        _explain_limits(report),
        "",
    ]
    if report.results:
        lines += [
            f"Errors: {report.results[0].held_out}. Noise floor: {report.results[0].floor}.",
            "",
            "| output | unit | uncompensated, median | RMSE, median | 95 % | worst |"
            " floor, median | ratio, median | worst | limit |",
            "|---|---|---|---|---|---|---|---|---|---|",
        ]
        for name, row in report.spread().items():
            limit = "" if row.limit is None else f"{row.limit:g}"
            lines.append(
                f"| {_escape(name)} | {_escape(row.unit)} |"
                f" {row.rmse_uncompensated_median:.4g} | {row.rmse_median:.4g} |"
                f" {row.rmse_p95:.4g} | {row.rmse_worst:.4g} |"
                f" {row.noise_floor_median:.4g} | {row.ratio_median:.3g} |"
                f" {row.ratio_worst:.3g} | {limit} |"
            )
        lines.append("")
    for title, chosen in (
        ("Could not be worked on", [v for v in report.verdicts if v.status == ERROR]),
        ("Fail", [v for v in report.verdicts if v.status == FAIL]),
        ("Forced", [v for v in report.verdicts if v.status == FORCED]),
    ):
        if chosen:
            lines += [f"## {title}", ""]
            lines += [f"- **{_escape(v.sensor)}**: {_escape('; '.join(v.reasons))}" for v in chosen]
            lines.append("")
    if report.outliers:
        lines += ["## Outliers", ""]
        for v in report.outliers:
            more = len(v.outliers) - REASONS_SHOWN
            shown = "; ".join(map(str, v.outliers[:REASONS_SHOWN]))
            tail = f"; and {more} more" if more > 0 else ""
            lines.append(f"- **{_escape(v.sensor)}** ({v.status}): {_escape(shown)}{tail}")
        lines.append("")
    return "\n".join(lines)


def tell_forced(report: FleetReport) -> str:
    """Return how many sensors are forced, before the number of those that fail; "" for none."""
    forced = report.count(FORCED)
    return f" {forced} forced," if forced else ""


def _explain_limits(report: FleetReport) -> str:
    parts = [f"{name} {value:g}" for name, value in report.limits.items()]
    if report.ratio_limit is not None:
        parts.append(f"{report.ratio_limit:g} x the noise floor")
    if not parts:
        return "`[fleet]` names no limits, so whoever has a result passes."
    return f"Limits of the held-out RMSE: {', '.join(parts)}. Outlier: |z| > {report.outlier_z:g}."


def _percent(part: int, whole: int) -> str:
    return f"{100.0 * part / max(whole, 1):.1f} %"


def _escape(text: str) -> str:
    return text.replace("\\", "\\\\").replace("|", "\\|").replace("\n", " ").replace("<", "&lt;")
