"""Tables of the report and the page: what the commands found, with units, written for people."""

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, fields, replace

import numpy as np

from zerodrift.dataset.units import is_unix, write_time
from zerodrift.diagnosis.diagnosis import Diagnosis, write_probability
from zerodrift.diagnosis.history import Step
from zerodrift.diagnosis.run_spread import RmseSpread
from zerodrift.diagnosis.summary import ComparisonSummary
from zerodrift.physics.summary import ModelSummary
from zerodrift.report.datasheet import DatasheetRow
from zerodrift.report.findings import Provenance, Trace
from zerodrift.report.sentences import explain_standing
from zerodrift.verify.summary import (
    CertificateSummary,
    ChipError,
    ConversionSummary,
    FirmwareSummary,
    ProvenError,
    StatedUncertainty,
)

# The curves along the runs as tables, part by part.

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


# Tables of the report and the page: what the commands found, with units, written for people.

MOST_DEGREES = 1000.0
"""Degrees of freedom from which on Student's quantile is the normal one."""


@dataclass(frozen=True)
class Table:
    """One table, all of its cells written out."""

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    texts: int = 1
    """How many of the first columns are text; the others are numbers, aligned to the right."""
    note: str = ""


def write_number(value: float | None, digits: int = 4) -> str:
    """Return a number with so many significant digits; a dash for none."""
    return "–" if value is None else f"{value:.{digits}g}".replace("-", "−")


def tabulate_outputs(compared: ComparisonSummary) -> Table:
    """Return the errors per output, in its unit, in %FS and in noise floors."""
    rows = []
    for name, told in compared.outputs.items():
        held_out = told.rmse_heldout
        error = told.rmse if held_out is None else held_out
        floor = told.noise_floor
        rows.append(
            (
                name,
                told.unit,
                write_number(told.full_scale),
                write_number(told.rmse_uncompensated),
                write_number(told.rmse),
                write_number(held_out),
                write_number(told.rmse_pct_fs, 3),
                write_number(told.max_abs),
                write_number(told.max_abs_pct_fs, 3),
                write_number(floor),
                f"{error / floor:.2f}" if floor > 0.0 else "–",
            )
            + ((write_number(told.run_offset),) if compared.tared else ())
        )
    offset = ("offsets taken off, RMS",) if compared.tared else ()
    headings = (
        *("output", "unit", "full scale", "RMSE uncompensated", "RMSE in sample", "RMSE held out"),
        *("RMSE, %FS", "largest error", "largest, %FS", "noise floor", "× floor", *offset),
    )
    return Table("Errors per output", headings, tuple(rows), texts=2)


def tabulate_errors(compared: ComparisonSummary, spread: Mapping[str, RmseSpread]) -> Table:
    """Return the errors that count, with their uncertainty.

    Args:
        compared: what `compare` found.
        spread: output -> how sure its RMSE is.
    """
    rows = []
    for name, told in compared.outputs.items():
        one = spread[name]
        percent = 100.0 / told.full_scale
        error = "–" if one.std_error is None else f"{write_number(one.std_error, 2)}"
        ratio = one.rmse / told.noise_floor if told.noise_floor > 0.0 else None
        rows.append(
            (
                name,
                told.unit,
                write_number(told.full_scale),
                write_number(told.rmse_uncompensated),
                write_number(one.rmse),
                error,
                write_number(percent * one.rmse, 3),
                write_number(told.max_abs, 3),
                write_number(told.noise_floor),
                "–" if ratio is None else f"{ratio:.2f}",
            )
        )
    some = next(iter(spread.values()))
    where = describe_held_out(compared)
    headings = (
        *("output", "unit", "full scale", "uncompensated", f"RMSE, {where}", "±"),
        *("%FS", "largest error", "noise floor", "× floor"),
    )
    note = (
        f"RMSE over {some.runs} runs ({where}); ± is one standard error, from how the runs differ. "
        "Noise floor: what no compensation takes away."
    )
    return Table("Errors per output", headings, tuple(rows), texts=2, note=note)


def describe_held_out(compared: ComparisonSummary) -> str:
    """Return on which runs the errors are told: test logs, runs left out, or those learnt from."""
    told = next(iter(compared.outputs.values()))
    if told.rmse_test is not None:
        return "test logs"
    return "runs left out" if told.rmse_left_out is not None else "runs learnt from"


def take_rows(table: Table, most: int) -> Table:
    """Return the first rows of a table, and a note where there are more."""
    if len(table.rows) <= most:
        return table
    more = f"The first {most} of {len(table.rows)}; all are in the annex."
    note = f"{table.note} {more}".strip()
    return replace(table, rows=table.rows[:most], note=note)


def tabulate_runs(compared: ComparisonSummary) -> Table:
    """Return the RMSE per run and output."""
    outputs = compared.outputs
    rows = []
    for run, told in compared.errors.items():
        held_out = any(told[name].held_out for name in outputs)
        numbers = (write_number(told[name].rmse) for name in outputs)
        rows.append((run, "held out" if held_out else "in sample", *numbers))
    headings = ("run", "told", *(f"{n}, {told.unit}" for n, told in outputs.items()))
    return Table("RMSE per run", headings, tuple(rows), texts=2)


def tabulate_worst(compared: ComparisonSummary) -> Table:
    """Return the worst segments, numbered as in the figures."""
    units = {name: told.unit for name, told in compared.outputs.items()}
    rows = tuple(
        (
            str(number),
            s.run,
            s.output,
            s.pattern,
            write_time(s.from_s),
            write_time(s.to_s),
            f"{write_number(s.rmse, 3)} {units[s.output]}",
            f"{s.mean_error:+.3g} {units[s.output]}".replace("-", "−"),
        )
        for number, s in enumerate(compared.worst, 1)
    )
    dated = any(is_unix(s.from_s) for s in compared.worst)
    ends = ("from", "to") if dated else ("from, s", "to, s")
    headings = ("#", "run", "output", "what was going on", *ends, "RMSE", "mean error")
    return Table("Worst segments", headings, rows, texts=4)


def tabulate_candidates(diagnosis: Diagnosis, titles: Mapping[str, str]) -> Table:
    """Return every candidate with its evidence, and every effect that could not be tested.

    Args:
        diagnosis: what was found.
        titles: effect -> the field's term.
    """
    rows = [
        (
            c.effect,
            titles.get(c.effect, ""),
            ", ".join(f"{k} {v:.4g}" for k, v in c.parameters.items()),
            explain_standing(diagnosis, c),
            f"{c.rmse_left_out_ratio:.3f}",
            write_probability(c.probability),
            f"{c.p_value:.2g}",
            f"{100.0 * c.excitation:.0f} %",
        )
        for c in diagnosis.candidates
    ]
    rows += [
        (u.effect, titles.get(u.effect, ""), "", f"not testable: {u.why}", "–", "–", "–", "–")
        for u in diagnosis.not_testable
    ]
    headings = (
        *("effect", "term", "fitted values", "standing"),
        *("held-out RMSE, of now", "probability", "p", "excitation"),
    )
    return Table("Effects that are not in the model", headings, tuple(rows), texts=4)


def tabulate_parts(parts: Sequence[ReportPart], unit: str) -> Table:
    """Return what was measured, modelled and left along the runs, part by part.

    Args:
        parts: equal parts of each run.
        unit: of the output.
    """
    rows = tuple(
        (
            part.run,
            write_time(part.from_s),
            write_time(part.to_s),
            write_number(part.temperature_degC),
            write_number(part.measured),
            write_number(part.model),
            write_number(part.left, 3),
            write_number(part.left_rms, 3),
        )
        for part in parts
    )
    dated = any(is_unix(part.from_s) for part in parts)
    ends = ("from", "to") if dated else ("from, s", "to, s")
    headings = (
        *("run", *ends, "mean temperature, degC", f"mean drift, {unit}"),
        *(f"mean of model, {unit}", f"mean of what is left, {unit}", f"its RMS, {unit}"),
    )
    return Table("Along the runs, as a table", headings, rows, note="Equal parts of each run.")


def tabulate_steps(steps: Sequence[Step]) -> Table:
    """Return the staircase of held-out errors."""
    outputs = list(dict.fromkeys(name for step in steps for name in step.errors))
    units = {name: unit for step in steps for name, unit in step.units.items()}
    rows = [
        (
            str(number),
            step.label,
            step.reason,
            *(write_number(step.errors.get(name)) for name in outputs),
            "–" if (ratio := step.ratio()) is None else f"{ratio:.2f}",
        )
        for number, step in enumerate(steps)
    ]
    headings = ("#", "change", "why", *(f"{n}, {units.get(n, '')}" for n in outputs), "× floor")
    return Table("Held-out RMSE, step by step", headings, tuple(rows), texts=3)


def tabulate_parameters(model: ModelSummary) -> Table:
    """Return the effects' parameters with standard errors and 95 % intervals."""
    rows: list[tuple[str, ...]] = []
    for term in model.terms:
        for name, p in term.parameters.items():
            interval = p.interval
            remark = "held" if p.held else "at its bound" if p.at_bound else ""
            told = "–"
            if interval is not None:
                told = f"{write_number(interval[0])} to {write_number(interval[1])}"
            unit = "" if p.unit == "1" else p.unit
            error = write_number(p.std_error, 2)
            rows.append((term.name, name, unit, remark, write_number(p.value), error, told))
        if not term.parameters:
            rows.append((term.name, "none", "", "", "–", "–", "–"))
    headings = ("effect", "parameter", "unit", "remark", "value", "standard error", "95 % interval")
    return Table("Parameters", headings, tuple(rows), texts=4)


def tabulate_coefficients(model: ModelSummary) -> Table:
    """Return the coefficients of all features, output by output."""
    rows = tuple(
        (
            term.name,
            c.feature,
            c.output,
            c.unit,
            write_number(c.value),
            write_number(c.std_error, 2),
        )
        for term in model.terms
        for c in term.coefficients
    )
    headings = ("effect", "feature", "output", "unit", "coefficient", "standard error")
    return Table("Coefficients", headings, rows, texts=4)


def tabulate_budget(firmware: FirmwareSummary, compared: ComparisonSummary) -> Table:
    """Return the error from measurement to integer model, each share in the unit and in %FS."""
    rows = []
    for name, unit in firmware.units.items():
        percent = 100.0 / compared.outputs[name].full_scale
        rmse = firmware.rmse
        cost = firmware.rmse_integer_to_float[name]
        rows.append(
            (
                name,
                unit,
                *(write_number(x[name]) for x in (rmse.uncompensated, rmse.float, rmse.integer)),
                write_number(cost, 2),
                write_number(percent * rmse.integer[name], 3),
                write_number(percent * cost, 2),
                write_number(compared.outputs[name].noise_floor),
            )
        )
    headings = (
        *("output", "unit", "uncompensated", "float", "integer", "integer − float"),
        *("integer, %FS", "integer − float, %FS", "noise floor"),
    )
    kind = "held-out" if firmware.held_out else "TRAINING"
    note = f"RMSE over the {kind} runs: {', '.join(firmware.runs)}."
    return Table("Error budget, float to integer", headings, tuple(rows), texts=2, note=note)


def tabulate_chip_error(firmware: FirmwareSummary) -> Table:
    """Return what separates the chip from the float model by cause, and what the gate says."""
    causes = (cause.name.replace("_", " ") for cause in fields(ChipError))
    rows = tuple(
        (name, unit, *(write_number(x, 2) for x in astuple(firmware.chip_error[name])))
        for name, unit in firmware.units.items()
    )
    said = [f"FORCED: {refused.text}" for refused in firmware.refused]
    said += [warning.text for warning in firmware.warnings]
    headings = ("output", "unit", *causes)
    return Table("Integer minus float by cause", headings, rows, texts=2, note=" ".join(said))


def tabulate_uncertainty(stated: Mapping[str, StatedUncertainty]) -> Table:
    """Return the uncertainty of each output's compensated value, by cause.

    Args:
        stated: output -> its uncertainty; at least one.
    """
    rows = tuple(
        (
            name,
            one.unit,
            *(
                write_number(value, 2)
                for value in (
                    *(one.expanded, one.noise, one.parameters, one.left_out, one.rounding),
                    min(one.degrees_of_freedom, MOST_DEGREES),
                )
            ),
            "–" if one.covered is None else f"{100.0 * one.covered:.1f} %",
        )
        for name, one in stated.items()
    )
    headings = (
        *("output", "unit", "expanded, k = 2", "noise", "parameters", "left out", "rounding"),
        *("degrees of freedom", "covered"),
    )
    note = next(iter(stated.values())).explain()
    title = "Uncertainty of a compensated value inside the calibrated ranges"
    return Table(title, headings, rows, texts=2, note=note)


def tabulate_firmware(firmware: FirmwareSummary) -> Table:
    """Return what the firmware needs of a chip, and how it was checked."""
    rows: list[tuple[str, ...]] = [
        ("flash", f"{firmware.flash_bytes} B", f"on {firmware.core}"),
        ("RAM", f"{firmware.ram_bytes} B", "state of one sensor"),
        ("stack", f"{firmware.stack_bytes} B", "deepest chain of calls below any function"),
        (
            "bit for bit",
            "equal" if firmware.bit_exact else "DIFFERENT",
            f"{firmware.vectors} steps, {' = '.join(firmware.backends)}",
        ),
        ("model", firmware.model_hash[:12], "first digits of its SHA-256"),
    ]
    return Table("Firmware", ("what", "value", "of"), tuple(rows), texts=3)


def tabulate_certificate(certificate: CertificateSummary) -> Table:
    """Return the bounds that come closest to their limits."""
    rows = tuple(
        (
            bound.where,
            str(bound.low).replace("-", "−"),
            str(bound.high).replace("-", "−"),
            str(bound.bits),
            f"{bound.headroom_bits:.2f}",
        )
        for bound in certificate.tightest
    )
    headings = ("where", "lowest", "highest", "bits", "headroom, bits")
    note = (
        f"{certificate.bounds} bounds hold for every input, whatever the logs; "
        "these come closest. Read from certificate.json, which `zerodrift verify --certificate` "
        "derives again from the C."
    )
    return Table("Certificate: no overflow", headings, rows, texts=1, note=note)


def tabulate_datasheet(rows: Sequence[DatasheetRow]) -> Table:
    """Return the datasheet's figures before and after compensation."""
    written = tuple(
        (
            row.quantity,
            row.output,
            row.unit,
            row.note,
            _write_pair(row.before),
            _write_pair(row.after),
        )
        for row in rows
    )
    headings = ("quantity", "output", "unit", "how", "before", "after")
    note = (
        "± is one standard uncertainty, from how runs differ. TK0 and TKC are mean slopes over the "
        "logs' temperatures; creep is the drift under a held load from the first moment to 30 min; "
        "hysteresis is the largest difference between heating and cooling at one temperature, at "
        "the rates of these logs, so lag is part of it; repeatability is the largest difference of "
        "readings of one load that is put on again at the same temperature."
    )
    return Table("Datasheet figures", headings, written, texts=4, note=note)


def _write_pair(value: tuple[float, float | None] | None) -> str:
    """Return a value with its standard uncertainty."""
    if value is None:
        return "–"
    number, error = value
    if error is None:
        return write_number(number, 3)
    return f"{write_number(number, 3)} ± {write_number(error, 2)}"


def tabulate_provenance(provenance: Provenance) -> tuple[Table, Table]:
    """Return what the report was made from: files with their hashes, and versions."""
    files = tuple((f.file, f.use, f.sha256[:16]) for f in provenance.files)
    versions = tuple((name, version) for name, version in provenance.versions.items())
    return (
        Table("Files", ("file", "use", "SHA-256, first 16 digits"), files, texts=3),
        Table("Versions", ("package", "version"), versions, texts=2),
    )


# The report's table of inputs whose raw codes the chip converts.


def tabulate_conversions(
    conversions: Mapping[str, ConversionSummary], bounds: Mapping[str, ProvenError] | None
) -> Table:
    """Return what each conversion costs, beside the rest of the error budget.

    Args:
        conversions: input -> how its raw codes are converted; at least one.
        bounds: output -> its proven bound, which holds the conversions' share.
    """
    rows = tuple(
        (
            name,
            told.unit,
            told.raw,
            " to ".join(write_number(end) for end in told.covers),
            write_number(told.error, 2),
            write_number(told.lsb, 2),
            " to ".join(write_number(worth, 2) for worth in told.code_worth),
            str(told.table_bytes),
        )
        for name, told in conversions.items()
    )
    headings = (
        *("input", "unit", "given", "covers", "largest error"),
        *("one code of the result", "one raw code is worth", "table, B"),
    )
    shares = [
        f"{name} {write_number(bound.causes.conversion, 2)} {bound.unit}"
        for name, bound in (bounds or {}).items()
        if bound.causes is not None
    ]
    note = (
        "Largest error: to the sensor's formula over every code that is covered, rounding included."
        " The worth of a raw code is the hardware's resolution; no arithmetic regains it."
    )
    if shares:
        note += f" What conversions are of the proven bound: {', '.join(shares)}."
    return Table("Conversion of raw codes", headings, rows, texts=4, note=note)
