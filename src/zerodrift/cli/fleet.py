"""`zerodrift fleet`: hundreds of sensors of one design, each to checked C, and the yield."""

import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from zerodrift.cli.common import (
    changes_project,
    directory_option,
    json_option,
    out_option,
    packed,
    print_result,
    skip_invalid_option,
)
from zerodrift.cli.console import show_progress

if TYPE_CHECKING:
    from zerodrift.fleet.blocks import FleetBlocks
    from zerodrift.fleet.design import Design
    from zerodrift.fleet.report import FleetReport
    from zerodrift.fleet.run import FleetProgress

SHOWN = 10
"""Sensors of each kind that the terminal shows; the report has all."""
DEVICES = ("auto", "cpu", "cuda")


@dataclass(frozen=True)
class FleetOptions:
    """The options of `fleet`."""

    jobs: int | None
    batch: int | None
    with_firmware: bool
    force: bool
    fresh: bool
    device: str
    over_ray: bool
    ray_address: str | None
    uncertainty: bool
    out: Path | None = None
    """The firmware folder, in place of that of `[firmware] out`."""


@click.command("fleet")
@directory_option
@json_option
@skip_invalid_option
@click.option(
    "--jobs",
    type=click.IntRange(1, 512),
    default=None,
    help="Processes on this machine (default: one per core; 1 with a GPU).",
)
@click.option(
    "--batch",
    type=click.IntRange(1, 100_000),
    default=None,
    help="Sensors that are compiled, and trained, together (default: 16; 32 with a network).",
)
@click.option(
    "--firmware/--no-firmware",
    "with_firmware",
    default=True,
    help="Generate and check each sensor's C (default), or only fit, train and report.",
)
@click.option(
    "--force",
    is_flag=True,
    help="Write what the gate refuses; header, manifest and report say so.",
)
@click.option("--fresh", is_flag=True, help="Compute every sensor anew, kept results too.")
@click.option(
    "--device",
    type=click.Choice(DEVICES),
    default="auto",
    show_default=True,
    help="What trains the networks: a GPU if PyTorch has one, or what is named.",
)
@click.option("--ray", "over_ray", is_flag=True, help="Work over Ray instead of --jobs alone.")
@click.option(
    "--ray-address",
    metavar="ADDRESS",
    default=None,
    help="Of a running cluster, such as auto or 10.0.0.5:6379; implies --ray.",
)
@click.option(
    "--uncertainty/--no-uncertainty",
    default=True,
    help="Fit, or train, each sensor again without some of its runs, for the uncertainty of a"
    " compensated value (default), or state none.",
)
@out_option
@changes_project
@packed(FleetOptions)
def command(directory: Path, as_json: bool, skip_invalid: bool, options: FleetOptions) -> None:
    """Calibrate all sensors of one design: fit, train, generate, check, and report the yield.

    The design is zerodrift.toml; {sensor} in [fleet] folder or in the selectors of [logs] stands
    for a sensor's name. Writes firmware/SENSOR/ with header, source, parameters and certificate,
    the shared firmware/runtime/, and build/fleet/report.json, .csv and .md. With [firmware]
    coefficients = "block" one firmware/program/ in their place, and firmware/blocks/SENSOR.*.

    A rerun works only on sensors whose logs or design have changed, or that failed. A bad log
    spoils its own sensor only. Exit code 1: a sensor has no result, is refused by the gate and not
    forced, or exceeds a limit.
    """
    from zerodrift.base.config import load_config
    from zerodrift.base.errors import CheckError
    from zerodrift.dataset.design_codes import (
        DESIGN_FORMAT,
        list_unstated,
        require_design_lsb,
    )
    from zerodrift.fleet.design import Design
    from zerodrift.fleet.executors import Executor, OverRay, Processes, Serial, import_ray
    from zerodrift.fleet.register import enter_fleet
    from zerodrift.fleet.report import ERROR, FAIL, judge_fleet, summarise_report, write_report
    from zerodrift.fleet.run import run_fleet
    from zerodrift.tasks.project import place_firmware

    config = place_firmware(load_config(directory), options.out)
    place = choose_device(options.device, config.network.kind != "none")
    jobs = options.jobs or (1 if place != "cpu" else os.cpu_count() or 1)
    design = Design(
        config,
        options.with_firmware,
        skip_invalid,
        place,
        options.force,
        options.uncertainty,
    )
    executor: Executor
    if options.over_ray or options.ray_address:
        import_ray()
        executor = OverRay(options.ray_address, jobs)
    else:
        executor = Processes(jobs) if jobs > 1 else Serial()
    for name in list_unstated(config):
        if config.format >= DESIGN_FORMAT:
            require_design_lsb(config, name)
        click.echo(
            f"note: the codes of '{name}' follow from each unit's own logs, so that one may be"
            " worth something else from unit to unit; `zerodrift init --upgrade` writes down one"
            " for all",
            err=True,
        )
    state = _RunState()
    blocks, no_program = None, None
    try:
        with _show_progress(state) as tell, _open_spool(design) as design, closing(executor):
            outcomes = run_fleet(
                design, executor, jobs=jobs, batch=options.batch, fresh=options.fresh, report=tell
            )
            if design.in_block:
                from zerodrift.fleet.blocks import NoProgramError, write_blocks

                try:
                    outcomes, blocks = write_blocks(
                        design, executor, outcomes, jobs=jobs, batch=options.batch, report=tell
                    )
                except NoProgramError as error:
                    outcomes, no_program = error.outcomes, error
    except (KeyboardInterrupt, CheckError):
        click.echo(state.explain_stop(), err=True)
        raise
    if no_program is None:
        enter_fleet(design, outcomes)
    report = judge_fleet(design, outcomes)
    paths = write_report(design, report)
    if as_json:
        summary = summarise_report(report)
        if blocks is not None:
            from zerodrift.fleet.summary import BlocksSummary

            told = BlocksSummary(
                blocks.program, blocks.bytes, len(blocks.units), blocks.vectors, blocks.refused
            )
            summary = replace(summary, blocks=told)
        print_result(summary)
    else:
        _print(report, [str(path) for path in paths], config.directory)
        if blocks is not None:
            _print_blocks(blocks)
    if no_program is not None:
        raise no_program
    if report.count(ERROR) or report.count(FAIL) or (blocks is not None and blocks.refused):
        sys.exit(CheckError.exit_code)


def _print_blocks(blocks: "FleetBlocks") -> None:
    """Print the one program and the units that have a block for it."""
    for sensor, why in blocks.refused.items():
        click.echo(f"no block for {sensor}: {why}", err=True)
    click.echo(
        f"one program (design {blocks.program[:16]}) and {len(blocks.units)} blocks of"
        f" {blocks.bytes} bytes; {blocks.vectors} steps on reference = host, 0 LSB"
    )


def choose_device(device: str, needed: bool) -> str:
    """Return where networks are trained.

    Raises:
        InputError: a GPU is asked for and PyTorch has none.
    """
    if not needed or device == "cpu":
        return "cpu"
    import torch

    from zerodrift.base.errors import InputError

    there = torch.cuda.is_available()
    if device == "cuda" and not there:
        raise InputError(
            "--device cuda: PyTorch finds no GPU here; expected one. Leave the option out to train"
            " on the CPU."
        )
    return "cuda" if there else "cpu"


@contextmanager
def _open_spool(design: "Design") -> "Iterator[Design]":
    """Yield the design with a folder for what its second pass needs, where it has one."""
    if not design.in_block:
        yield design
        return
    with tempfile.TemporaryDirectory(prefix="zerodrift-fleet-") as folder:
        yield replace(design, spool=Path(folder))


class _RunState:
    """How far the run is, for the message when it ends early."""

    def __init__(self) -> None:
        self.progress: FleetProgress | None = None

    def explain_stop(self) -> str:
        """Return what is kept and how to go on."""
        if self.progress is None:
            return "stopped before the first sensor was done"
        p = self.progress
        return (
            f"stopped: {p.done - p.failed} of {p.total} sensors are done and kept; the same command"
            " goes on with the others"
        )


@contextmanager
def _show_progress(state: _RunState) -> "Iterator[Callable[[FleetProgress], None]]":
    """Show on stderr how many sensors are done."""
    with show_progress() as progress, progress.count("sensors") as report:

        def tell(p: "FleetProgress") -> None:
            state.progress = p
            parts = [f"{p.kept} kept"] * bool(p.kept) + [f"{p.failed} failed"] * bool(p.failed)
            report(p.done, p.total, ", ".join(parts))

        yield tell


def _print(report: "FleetReport", paths: list[str], directory: Path) -> None:
    """Print yield, spread, and the first sensors of each kind that need a look."""
    from zerodrift.cli.console import open_console, open_table
    from zerodrift.fleet.report import ERROR, FAIL, FORCED, PASS, tell_forced

    console = open_console()
    total = len(report.verdicts)
    kept = sum(v.kept for v in report.verdicts)
    if report.results:
        table = open_table(
            "Held-out RMSE over the fleet",
            ("output", "unit"),
            ("uncompensated", "median", "95 %", "worst", "floor", "x floor", "worst", "limit"),
        )
        for name, row in report.spread().items():
            errors = (row.rmse_uncompensated_median, row.rmse_median, row.rmse_p95, row.rmse_worst)
            numbers = [f"{value:.4g}" for value in (*errors, row.noise_floor_median)]
            numbers += [f"{row.ratio_median:.3g}", f"{row.ratio_worst:.3g}"]
            limit = "-" if row.limit is None else f"{row.limit:g}"
            table.add_row(name, row.unit, *numbers, limit)
        console.print(table)
    for title, lines in (
        ("could not be worked on", _explain(report, ERROR)),
        ("fail", _explain(report, FAIL)),
        ("forced", _explain(report, FORCED)),
        ("outliers", [f"{v.sensor}: {v.outliers[0]}" for v in report.outliers]),
    ):
        if lines:
            console.print(f"{title}:")
            for line in lines[:SHOWN]:
                console.print(f"  {line}")
            if len(lines) > SHOWN:
                console.print(f"  ... and {len(lines) - SHOWN} more, in the report")
    passed = report.count(PASS)
    console.print(
        f"{passed} of {total} sensors pass ({100.0 * passed / total:.1f} %),{tell_forced(report)}"
        f" {report.count(FAIL)} fail, {report.count(ERROR)} without result,"
        f" {len(report.outliers)} outliers" + (f"; {kept} kept from earlier runs" if kept else "")
    )
    console.print(_tell_check(report))
    console.print("wrote " + ", ".join(_relative(path, directory) for path in paths))


def _tell_check(report: "FleetReport") -> str:
    """Return in a sentence how much was compared bit for bit."""
    checked = [r.vectors for r in report.results if r.vectors]
    if not checked:
        return "no firmware was generated"
    return (
        f"bit-exact: {len(checked)} models on reference = host, {sum(checked)} steps, drift, flags"
        " and states, 0 LSB"
    )


def _explain(report: "FleetReport", status: str) -> list[str]:
    """Return a line per sensor of a status, with the first reason."""
    lines = []
    for v in report.verdicts:
        if v.status == status:
            more = f" (and {len(v.reasons) - 1} more)" if len(v.reasons) > 1 else ""
            lines.append(f"{v.sensor}: {v.reasons[0]}{more}")
    return lines


def _relative(path: str, directory: Path) -> str:
    return str(Path(path).relative_to(directory)) if Path(path).is_relative_to(directory) else path
