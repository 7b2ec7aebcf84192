"""What a command that leaves the model as it is found: training, firmware, formula, report."""

from pathlib import Path, PurePosixPath

from dash import html
from dash.development.base_component import Component

from zerodrift.codegen.snippet import write_snippet
from zerodrift.discovery.summary import explain_plan
from zerodrift.report import tables
from zerodrift.report.findings import Findings
from zerodrift.report.pictures import draw_error_budget
from zerodrift.report.pictures_plan import draw_programme
from zerodrift.report.proposal import draw_remainder
from zerodrift.report.results import ApplyResult, PlanResult, ProposeResult, TrainResult
from zerodrift.report.sentences import explain_black_boxes
from zerodrift.verify.summary import FirmwareSummary, LogsRefused, VerifySummary
from zerodrift.workbench.panels import show_picture, show_table
from zerodrift.workbench.workplace import Outcome


def show_outcome(outcome: Outcome) -> list[Component]:
    """Return what the last command found, in a sentence or a few."""
    if isinstance(outcome, VerifySummary):
        return _show_verified(outcome)
    if isinstance(outcome, FirmwareSummary):
        return _show_built(outcome)
    if isinstance(outcome, LogsRefused):
        return _show_refused_logs(outcome)
    if isinstance(outcome, ProposeResult):
        return _show_proposed(outcome)
    if isinstance(outcome, PlanResult):
        return _show_planned(outcome)
    if isinstance(outcome, ApplyResult):
        return _show_applied(outcome)
    if isinstance(outcome, TrainResult):
        rmse = ", ".join(
            f"{n} {tables.write_number(o.held_out.rmse)} {o.unit}"
            for n, o in outcome.outputs.items()
        )
        kept = "with a network" if outcome.network else "without a network"
        return [html.P(f"Trained {kept}; held-out RMSE: {rmse}.")]
    return [
        html.P(
            [
                "Report written: ",
                html.A("open report.html", href="/report.html", target="_blank"),
                " or ",
                html.A("download it", href="/report.html", download="report.html"),
                ".",
            ]
        )
    ]


def _show_applied(outcome: ApplyResult) -> list[Component]:
    lines = []
    for log in outcome.logs:
        drifts = ", ".join(
            f"{name} {tables.write_number(o.rms_drift)} {o.unit}" for name, o in log.outputs.items()
        )
        lines.append(
            f"Applied to {log.log}, {log.steps} steps, into {log.file}. RMS drift: {drifts}."
        )
    return [html.P(line) for line in lines]


def _show_verified(outcome: VerifySummary) -> list[Component]:
    equal = "equal in every bit" if outcome.bit_exact else "DIFFERENT"
    backends = " = ".join(outcome.backends)
    lines = [f"Verified: {equal} over {outcome.vectors} steps on {backends}."]
    lines += [finding.text for finding in (*outcome.changed, *outcome.stale)]
    lines += [f"{f.name} in the header is not the model's." for f in outcome.header]
    lines += outcome.failures
    lines += [f"Not checked: {n.what} ({n.why})." for n in outcome.not_checked]
    return [html.P(line) for line in lines]


def _show_built(outcome: FirmwareSummary) -> list[Component]:
    if not outcome.written:
        lines = [f"Refused, nothing was written: {one.text}" for one in outcome.refused]
        return [html.P(line, className="standing") for line in lines]
    equal = "bit-exact" if outcome.bit_exact else "DIFFERENT"
    return [
        html.P(
            f"Built: flash {outcome.flash_bytes} B, RAM {outcome.ram_bytes} B, stack "
            f"{outcome.stack_bytes} B on {outcome.core}; {equal} over {outcome.vectors} steps."
        )
    ]


def _show_refused_logs(outcome: LogsRefused) -> list[Component]:
    entries = dict.fromkeys(f'"{one.run}: {one.kind}"' for one in outcome.refused)
    return [
        *(
            html.P(f"Refused, nothing was written: {one.text}.", className="standing")
            for one in outcome.refused
        ),
        html.P(
            [
                "Mend the logs, or leave the runs out. If they are right as they are, say so in"
                " zerodrift.toml: ",
                html.Code(f"[logs] accept = [{', '.join(entries)}]"),
            ]
        ),
    ]


def _show_uncertainty(findings: Findings) -> list[Component]:
    if not findings.uncertainty:
        return []
    return [show_table(tables.tabulate_uncertainty(findings.uncertainty), folded=True)]


def _show_proposed(outcome: ProposeResult) -> list[Component]:
    if not outcome.found:
        nearest = f" Nearest: {outcome.nearest}." if outcome.nearest else ""
        told = [html.P(f"No formula was found: {outcome.reason}.{nearest}")]
        return told + [html.P(line, className="note") for line in explain_black_boxes(outcome)]
    units = {name: error.unit for name, error in outcome.rmse_left_out.items()}
    errors = ", ".join(
        f"{name} {tables.write_number(e.before)} to {tables.write_number(e.after)} {e.unit}"
        for name, e in outcome.rmse_left_out.items()
    )
    file = f"{outcome.kind}.py"
    commands = f"zerodrift propose --write {file} && zerodrift add {file}"
    return [
        html.P([html.Code(outcome.formula), f" ({outcome.physics})"], className="standing"),
        html.P(f"RMSE on runs left out: {errors}."),
        show_picture(draw_remainder(outcome.curves, units)),
        *[html.P(told, className="note") for told in explain_black_boxes(outcome)],
        html.P(f"To confirm it: {outcome.next_experiment}", className="note"),
        html.P(["To use it as an effect of your own: ", html.Code(commands)], className="note"),
    ]


def _show_planned(outcome: PlanResult) -> list[Component]:
    """Return a programme as a picture, what it is expected to tell, and where its files are."""
    told = [html.P(line) for line in explain_plan(outcome, Path())]
    notes = [html.P(line, className="note") for line in outcome.notes]
    return [show_picture(draw_programme(outcome)), *told, *notes]


def is_refused(outcome: Outcome | None) -> bool:
    """Tell whether the last command's outcome says why no firmware was written."""
    if isinstance(outcome, FirmwareSummary):
        return not outcome.written
    return isinstance(outcome, LogsRefused)


def show_firmware(findings: Findings, outcome: Outcome | None = None) -> list[Component]:
    """Return the last firmware where it is current: to take away, to use, and what it rests on.

    Args:
        findings: hold the firmware, or why there is none.
        outcome: what the last command found; reasons that it shows are not told twice.
    """
    firmware, certificate = findings.firmware, findings.certificate
    if firmware is None and is_refused(outcome):
        return []
    if firmware is None:
        return [html.P(findings.firmware_note, className="note")]
    compared = findings.comparison
    note = [html.P(findings.firmware_note, className="note")] if findings.firmware_note else []
    said = [f"Built by force, though refused: {one.text}" for one in firmware.refused]
    said += [f"Warning: {one.text}" for one in firmware.warnings]
    return [
        *note,
        *(html.P(line, className="standing") for line in said),
        *_show_delivery(firmware),
        show_picture(draw_error_budget(firmware, compared)),
        show_table(tables.tabulate_budget(firmware, compared), folded=True),
        show_table(tables.tabulate_chip_error(firmware), folded=True),
        *_show_uncertainty(findings),
        show_table(tables.tabulate_firmware(firmware)),
        *(
            [show_table(tables.tabulate_certificate(certificate), folded=True)]
            if certificate
            else []
        ),
    ]


def _show_delivery(firmware: FirmwareSummary) -> list[Component]:
    """Return the download, what to add to a build, and the lines that call it."""
    sources = [name for name in firmware.files if name.endswith(".c")]
    headers = [name for name in firmware.files if name.endswith(".h")]
    folders = dict.fromkeys(str(PurePosixPath(name).parent) for name in headers)
    download = html.A(
        "Download the firmware (zip)",
        href="/firmware.zip",
        download="",
        className="button primary",
        id="download",
    )
    return [
        html.P([download]),
        html.P(
            f"To flash: add {', '.join(sources)} to the build of your own program, with the "
            f"folder {', '.join(folders)} and its {len(headers)} headers on the include path. It "
            f"is C99 without heap or libm, and needs {firmware.flash_bytes} B of flash, "
            f"{firmware.ram_bytes} B of RAM for each sensor and {firmware.stack_bytes} B of stack "
            f"on {firmware.core}."
        ),
        html.Div(
            [
                html.Pre(
                    write_snippet(firmware.files, tuple(firmware.units)), id="snippet", tabIndex="0"
                ),
                html.Button("Copy", **{"data-copy": "snippet"}),
            ],
            className="snippet",
        ),
    ]
