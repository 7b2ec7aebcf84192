"""`zerodrift firmware`: logs in, host-checked C out."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click

from zerodrift.base.errors import CheckError
from zerodrift.base.files import show_path
from zerodrift.base.fleet_config import BlockConfig
from zerodrift.blocks.block import decode_header
from zerodrift.cli.common import (
    as_request,
    directory_option,
    json_option,
    out_option,
    print_result,
    sensor_option,
    skip_invalid_option,
)
from zerodrift.cli.console import (
    has_other_causes,
    open_console,
    open_table,
    print_chip_error,
    print_statements,
    show_progress,
)
from zerodrift.operations.input import IntegerInput
from zerodrift.tasks.firmware import FirmwareRequest, OnnxRequest, make_firmware
from zerodrift.verify.errors_told import OutputError, tell_conversions
from zerodrift.verify.firmware import Firmware
from zerodrift.verify.summary import ErrorCauses, FirmwareSummary, ProvenError

if TYPE_CHECKING:
    from rich.console import Console


# `zerodrift firmware --onnx`: a network from elsewhere as the compensator of a project.

Result = TypeVar("Result")


def onnx_options(function: Callable[..., Result]) -> Callable[..., Result]:
    """Add `--onnx` and its further options, passed on as `onnx: OnnxRequest | None`."""
    options = (
        click.argument("more_logs", nargs=-1, type=click.Path(path_type=Path), metavar="[LOG...]"),
        click.option(
            "--onnx",
            "onnx_path",
            type=click.Path(path_type=Path),
            metavar="FILE",
            help="Take the network of this ONNX file instead of training one.",
        ),
        click.option(
            "--calibrate",
            type=click.Path(path_type=Path),
            multiple=True,
            metavar="LOG...",
            help="With --onnx: the logs that set the ranges (default: [logs] train).",
        ),
        click.option(
            "--features",
            metavar="NAME,...",
            help="With --onnx: the network's inputs in order, of temperature and [inputs].",
        ),
        click.option(
            "--memory",
            metavar="stream|N",
            help="With --onnx: carry the state, or windows of N samples (default: as the file).",
        ),
        click.option("--output", metavar="NAME", help="With --onnx: the graph output to take."),
    )

    def wrapper(
        more_logs: tuple[Path, ...],
        onnx_path: Path | None,
        calibrate: tuple[Path, ...],
        features: str | None,
        memory: str | None,
        output: str | None,
        **others: object,
    ) -> Result:
        if more_logs and not calibrate:
            raise click.UsageError(f"unexpected '{more_logs[0]}'; logs follow --calibrate")
        given = (calibrate, features, memory, output)
        if onnx_path is None and any(option for option in given):
            raise click.UsageError("--calibrate, --features, --memory and --output go with --onnx")
        onnx = None
        if onnx_path is not None:
            names = tuple(name.strip() for name in features.split(",")) if features else ()
            logs = (*calibrate, *more_logs)
            onnx = OnnxRequest(onnx_path, logs, names, _read_memory(memory), output)
        return function(onnx=onnx, **others)

    wrapper.__doc__ = function.__doc__
    wrapper.__name__ = function.__name__
    wrapper.__click_params__ = getattr(function, "__click_params__", [])  # type: ignore[attr-defined]
    for option in reversed(options):
        wrapper = option(wrapper)
    return wrapper


def _read_memory(memory: str | None) -> str | int | None:
    if memory is None or memory == "stream":
        return memory
    if not memory.isdigit() or int(memory) < 1:
        raise click.BadParameter(
            f"'{memory}'; expected 'stream', or the number of samples of a window", None, None
        )
    return int(memory)


# `zerodrift firmware`: logs in, host-checked C out.

SMALL_BOUND = 0.1
"""Of what compensation gains: the share up to which a bound says something of the errors above it,
and is printed; the certificate has every bound."""
BUDGET_ROWS = 5
"""Nodes of the error budget that are printed; --json has them all."""


@click.command()
@directory_option
@sensor_option
@json_option
@skip_invalid_option
@click.option(
    "--force",
    is_flag=True,
    help="Write what the gate refuses; header and manifest say so.",
)
@click.option(
    "--uncertainty/--no-uncertainty",
    default=True,
    help="Fit, or train, again without some of the training runs, for the uncertainty of a"
    " compensated value (default), or state none.",
)
@out_option
@onnx_options
@as_request(FirmwareRequest)
def command(request: FirmwareRequest, as_json: bool) -> None:
    """Train if needed, quantize, generate C, and check it bit for bit on this host.

    Writes <out>/<sensor>.h and .c with runtime, certificate.json and manifest.json beside them,
    build/model.json, integer.onnx and golden.npz, and prints the errors in N or the like, with
    flash, RAM and stack. Nothing is written unless every compared bit is equal and every bound of
    the certificate is derived again from the C.

    Logs that hold wrong data stop it before anything is fitted: exit code 1, with run, column, rows
    and the line of zerodrift.toml that accepts them ([logs] accept).

    Nor is it where the chip is worse on held-out runs than no compensation, than a constant, a line
    in temperature or the physical model alone, or than the float model by more than rounding
    explains: exit code 1, unless --force.

    With --onnx FILE the network comes from any program that exports ONNX, and is treated the same;
    --calibrate LOG... names the logs that set the ranges of the integers.
    """
    with show_progress() as progress:
        made = make_firmware(request, progress)
    if as_json:
        print_result(made.result)
    else:
        _print(made.firmware, made.result, made.config.directory, made.config.block)
    if made.refusal:
        raise CheckError(
            f"{made.refusal}\nNothing was written to"
            f" {show_path(made.config.firmware_out, made.config.directory)}/. Mend what is named,"
            " or write it all the same with --force."
        )


def explain_worse_than_physics(errors: Sequence[OutputError]) -> str:
    """Return a sentence on outputs that the physical model alone predicts better, or ""."""
    worse = [
        f"{e.name} {e.float_model:.4g} against {e.physics:.4g} {e.unit}"
        for e in errors
        if e.is_hurt
    ]
    if not worse:
        return ""
    return (
        "On the held-out runs the physical model alone does better than with what was learnt"
        f' beside it ({", ".join(worse)}): record more runs, or set kind = "none" under [network].'
    )


def _print(firmware: Firmware, told: FirmwareSummary, directory: Path, asked: BlockConfig) -> None:
    console = open_console()
    kind = "held-out runs" if firmware.held_out else "TRAINING runs (no test logs are configured)"
    table = open_table(
        f"RMSE over the {kind}: {', '.join(firmware.error_runs)}",
        ("output", "unit"),
        (
            "uncompensated",
            *(["physics alone"] if any(e.physics is not None for e in firmware.errors) else []),
            "float",
            "integer",
            "% FS",
            "explained",
            "int - float",
        ),
    )
    for e in firmware.errors:
        physics = [] if e.physics is None else [e.physics]
        numbers = (*physics, e.float_model, e.integer_model, e.percent_of_full_scale)
        cells = (f"{x:.4g}" for x in (e.uncompensated, *numbers))
        explained = f"{100.0 * e.explained:.2f} %"
        table.add_row(e.name, e.unit, *cells, explained, f"{e.integer_to_float:.2g}")
    console.print(table)
    if firmware.held_out and (worse := explain_worse_than_physics(firmware.errors)):
        console.print(worse)
    console.print(
        "explained: the share by which the integer model's squared error is below that of a"
        " constant, the mean drift of the training runs."
    )
    if firmware.tared:
        console.print("The logs are tared: each run's own offset is taken off every error.")
    if firmware.untuned:
        pairs = zip(firmware.untuned, firmware.errors, strict=True)
        losses = [
            100.0 * (e.integer_model / max(e.float_model, 1e-300) - 1.0) for p in pairs for e in p
        ]
        console.print(
            "The 8-bit weights were fine-tuned in the chip's arithmetic: the error against the"
            f" measurements is up to {max(losses[1::2]):.2g} % larger than the float model's;"
            f" only rounded it would be {max(losses[::2]):.2g} %."
        )
    if has_other_causes(told):
        print_chip_error(told, console)
    _print_budget(firmware, console)
    size = firmware.footprint
    console.print(
        f"flash {size.flash_bytes} B, RAM {size.ram_bytes} B, stack {size.stack_bytes} B"
        f" ({size.stacks[0][0]}) on {size.core}, by {size.compiler} {' '.join(size.flags)}"
    )
    for line in tell_conversions(firmware.model):
        console.print(line)
    console.print(
        f"bit-exact: {firmware.check.vectors} steps on {' = '.join(firmware.check.backends)}, every"
        " node, state and flag, 0 LSB"
    )
    if firmware.chip is not None:
        console.print(
            f"{firmware.chip.core}, emulated: {firmware.chip.steps} steps with the same drifts and"
            f" flags; {firmware.chip.instructions_per_step} instructions per step"
        )
    else:
        console.print("not run on an emulated core: `pip install unicorn`")
    console.print(
        f"no overflow for any input: {firmware.certificate.holds} claims of certificate.json, each"
        " derived again from the C"
    )
    _print_bound(told, firmware, console)
    print_statements(told, console)
    if firmware.files and firmware.code.design is not None:
        console.print(tell_edition(firmware.code.block, asked))
    for folder in sorted({path.parent for path in firmware.files}):
        names = ", ".join(path.name for path in firmware.files if path.parent == folder)
        console.print(f"wrote {show_path(folder, directory)}/: {names}")


def tell_edition(block: bytes, asked: BlockConfig) -> str:
    """Return which block of the unit this is, and why its date is not the stated one if so."""
    notes = decode_header(block, "block").notes
    text = f"block of {notes.serial}: sequence {notes.sequence}, calibrated {notes.calibrated}"
    if asked.calibrated != notes.calibrated:
        text += f"; its numbers have not changed since, so that it is not dated {asked.calibrated}"
    return text


def _print_bound(told: FirmwareSummary, firmware: Firmware, console: "Console") -> None:
    """Print the proven bound on the error between chip and float model."""
    found = told.error_bound or {}
    proven = {name: bound for name, bound in found.items() if bound.value is not None}
    if not proven:
        why = next((bound.why for bound in found.values()), "")
        console.print(f"no bound is proven on the chip's distance from the float model: {why}")
        return
    told_of = list_small_bounds(told)
    if told_of:
        _print_bounds({name: proven[name] for name in told_of}, firmware, console)
    if wide := [name for name in proven if name not in told_of]:
        console.print(
            f"{', '.join(wide)}: what is proven of the chip's distance from the float model is more"
            " than a tenth of what compensation gains; certificate.json has it under `error_bound`."
        )


def list_small_bounds(told: FirmwareSummary) -> tuple[str, ...]:
    """Return the outputs whose proven bound is at most a tenth of what compensation gains.

    That is the RMS without compensation less the RMS that the chip leaves, on the runs of `rmse`.
    """
    gains = {
        name: told.rmse.uncompensated[name] - told.rmse.integer[name] for name in told.rmse.integer
    }
    return tuple(
        name
        for name, bound in (told.error_bound or {}).items()
        if bound.value is not None and bound.value <= SMALL_BOUND * gains[name]
    )


def _print_bounds(
    proven: Mapping[str, ProvenError], firmware: Firmware, console: "Console"
) -> None:
    """Print the table of some outputs' bounds by cause."""
    causes = [cause.name for cause in fields(ErrorCauses)]
    for cause in ("conversion", "range"):
        if not any(getattr(bound.causes, cause) for bound in proven.values()):
            causes.remove(cause)
    table = open_table(
        "Proven: given the same codes, the chip is never further from the float model than this",
        ("output", "unit"),
        ("bound", "% FS", *causes),
    )
    scales = {output.name: output.full_scale for output in firmware.model.outputs}
    for name, bound in proven.items():
        assert bound.value is not None and bound.causes is not None
        shares = (f"{getattr(bound.causes, cause):.2g}" for cause in causes)
        percent = 100.0 * bound.value / scales[name]
        table.add_row(name, bound.unit, f"{bound.value:.3g}", f"{percent:.2g}", *shares)
    console.print(table)
    console.print(
        "Both are given equal codes: it leaves out the rounding of inputs, which `int - float`"
        " above includes."
    )
    console.print(f"It holds for: {firmware.bound.holds}.")
    if "range" in causes:
        console.print(f"A smaller one is not proven: {firmware.bound.why}.")


def _print_budget(firmware: Firmware, console: "Console") -> None:
    """Print the error that quantization adds, node by node and over time."""
    table = open_table(
        "What quantization costs inside the calibrated ranges, RMS of integer minus float model",
        ("",),
        [f"{e.name} {e.unit}" for e in firmware.errors],
    )
    inputs = {
        node.name: f"input {channel.name}{', converted' if channel.conversion else ''}"
        for node in firmware.model.nodes
        if isinstance(node, IntegerInput)
        for channel in (firmware.model.channels[node.channel],)
    }
    budget = firmware.budget
    table.add_row("whole model", *(f"{x:.2g}" for x in budget.total), end_section=True)
    for node in budget.largest[:BUDGET_ROWS]:
        label = node.node if node.kind in node.node else f"{node.node} ({node.kind})"
        label = inputs.get(node.node, label)
        table.add_row(f"of it {label}", *(f"{x:.2g}" for x in node.rms))
    table.add_section()
    for span in budget.over_time:
        first = f"{span.first_step:.0e}" if span.first_step else "0"
        label = f"steps {first} to {span.last_step:.0e}".replace("e+0", "e")
        table.add_row(label, *(f"{x:.2g}" for x in span.rms))
    console.print(table)
