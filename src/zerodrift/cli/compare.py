"""`zerodrift compare`: the model against the measurements, run by run, and where it fails."""

from pathlib import Path

import click
from rich.console import Console

from zerodrift.cli.common import (
    directory_option,
    json_option,
    print_notes,
    print_result,
    sensor_option,
    skip_invalid_option,
    trust_option,
)
from zerodrift.cli.console import (
    open_console,
    open_table,
    print_advice,
    print_chip_error,
    print_statements,
    print_uncertainty,
    show_progress,
)
from zerodrift.dataset.units import is_unix, write_time
from zerodrift.diagnosis.compare import Comparison
from zerodrift.diagnosis.segments import MOST_SEGMENTS
from zerodrift.report.sentences import describe_patterns, explain_figures
from zerodrift.tasks.compare import KINDS, CompareRequest, compare
from zerodrift.tasks.project import ProjectFolder


@click.command()
@directory_option
@sensor_option
@click.option(
    "--model",
    "kind",
    type=click.Choice(KINDS),
    default=None,
    help="What predicts: the fitted effects, with the network, as integers, or as C on this host "
    "(default: the network if there is one, else physics).",
)
@click.option(
    "--worst",
    type=click.IntRange(0, 1000),
    default=MOST_SEGMENTS,
    show_default=True,
    help="How many of the worst segments to list.",
)
@click.option(
    "--html",
    type=click.Path(path_type=Path, dir_okay=False),
    default=None,
    help="Write a self-contained page: model over measurements, residuals, autocorrelation.",
)
@trust_option
@json_option
@skip_invalid_option
def command(
    directory: Path,
    sensor: str | None,
    kind: str | None,
    worst: int,
    html: Path | None,
    as_json: bool,
    skip_invalid: bool,
) -> None:
    """Compare the model with the measurements, run by run and output by output.

    Errors are those on data that the model did not learn from: the test logs, or each training run
    in turn. Then it says where the model fails: under which conditions the squared error is
    concentrated, found by a scan and checked on runs left out, and the worst segments of time.
    """
    project = ProjectFolder(directory, sensor, skip_invalid)
    request = CompareRequest(project, kind, worst, html)
    with show_progress() as progress:
        compared = compare(request, progress)
    predictor, comparison = compared.predictor, compared.comparison
    notes = (note.write() for note in compared.notes)
    print_notes((*project.dataset.notes, *predictor.notes, *notes))
    if as_json:
        print_result(compared.summarise())
        return
    console = open_console()
    effects = ", ".join(comparison.effects) or "a constant only"
    console.print(f"Model: {predictor.kind} ({effects})")
    print_comparison(comparison, console)
    if compared.firmware is not None:
        console.print()
        if compared.firmware_note:
            console.print(compared.firmware_note)
        print_chip_error(compared.firmware, console)
        print_statements(compared.firmware, console)
    print_uncertainty(compared.stated, console)
    print_advice(compared.advice, console)
    if html is not None:
        console.print(f"Wrote {html}")


def print_comparison(comparison: Comparison, console: Console) -> None:
    """Print the tables, and then their meaning in sentences."""
    _print_outputs(comparison, console)
    _print_runs(comparison, console)
    for sentence in explain_figures(comparison):
        console.print(sentence)
    console.print()
    _print_failures(comparison, console)


def _print_outputs(comparison: Comparison, console: Console) -> None:
    headings = "uncompensated|in sample|held out|% FS|largest|noise floor|x floor|explained"
    table = open_table("RMSE per output", ("output", "unit"), headings.split("|"))
    for k, name in enumerate(comparison.outputs):
        told, floor = comparison.told[k], float(comparison.floor.rms[k])
        held_out = comparison.held_out
        table.add_row(
            name,
            comparison.units[k],
            f"{told.rmse_uncompensated:.4g}",
            f"{comparison.in_sample[k].rmse:.4g}",
            "-" if held_out is None else f"{held_out[k].rmse:.4g}",
            f"{100.0 * told.rmse / comparison.full_scale[k]:.3g}",
            f"{told.max_abs:.4g}",
            f"{floor:.4g}",
            f"{told.rmse / floor:.2f}" if floor > 0.0 else "-",
            f"{100.0 * told.explained:.2f} %",
        )
    console.print(table)


def _print_runs(comparison: Comparison, console: Console) -> None:
    named = [f"{n} {u}" for n, u in zip(comparison.outputs, comparison.units, strict=True)]
    table = open_table("RMSE per run", ("run", ""), named)
    for run in comparison.runs:
        kind = "held out" if run.held_out is not None else "in sample"
        table.add_row(run.name, kind, *(f"{summary.rmse:.4g}" for summary in run.told))
    console.print(table)


def _print_failures(comparison: Comparison, console: Console) -> None:
    sentences = describe_patterns(comparison)
    failures = comparison.failures
    if not failures.worst and not sentences:
        console.print("Where it fails: nowhere in particular; no segment stands out of the noise.")
        return
    console.print("Where it fails:")
    for sentence in sentences:
        console.print(f"  {sentence}")
    if not sentences:
        console.print("  no pattern found that holds on runs left out.")
    if not failures.worst:
        return
    dated = any(is_unix(s.from_s) for s in failures.worst)
    table = open_table(
        "Worst segments",
        ("run", "output", "what was going on"),
        (*(("from", "to") if dated else ("from s", "to s")), "RMSE", "mean"),
    )
    units = dict(zip(comparison.outputs, comparison.units, strict=True))
    for s in failures.worst:
        table.add_row(
            s.run,
            s.output,
            s.pattern,
            write_time(s.from_s),
            write_time(s.to_s),
            f"{s.rmse:.3g} {units[s.output]}",
            f"{s.mean_error:+.3g} {units[s.output]}",
        )
    console.print(table)
