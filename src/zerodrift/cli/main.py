"""The command line: names the commands and loads each one's module only when it is called."""

import contextlib
import importlib
import io
import os
import signal
import sys
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import click

from zerodrift import __version__
from zerodrift.base.errors import InputError, ZerodriftError
from zerodrift.base.files import NOTHING_HALF, explain_refusal, explain_write, is_refused_write
from zerodrift.base.plugins import COMMANDS as GROUP
from zerodrift.base.plugins import load_parts
from zerodrift.base.terminal import guard_streams
from zerodrift.base.threads import use_one_thread

# The environment of the command line: output streams and memory limits.

LEAST_ADDRESS_SPACE = 2_500_000_000
"""Bytes below which the numerical libraries may stop the process without a message of theirs."""

_NO_ROOM = ("failed to map segment", "cannot map", "annot allocate memory")
"""What the loader says of a library that found no room in the address space."""

LEAST_TO_COMPUTE = 1_250_000_000
"""Bytes below which NumPy and Polars abort, or wait for ever, while they are loaded."""


def prepare_streams() -> None:
    """Make stdout and stderr accept any text, whatever the locale and the caller's streams.

    A closed stream is replaced by one that discards its text. Characters that the stream's encoding
    lacks are written as escapes such as \\xe4.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115 - stays open
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def describe_memory_limit(arguments: Sequence[str]) -> str:
    """Return a note on a limit of the address space at which libraries fail, or nothing.

    Raises:
        InputError: the limit is too small for any command; help needs next to nothing.
    """
    limit = read_address_space()
    if limit is None or limit >= LEAST_ADDRESS_SPACE:
        return ""
    asks_for_help = not arguments or {"-h", "--help", "--version"} & set(arguments)
    if limit < LEAST_TO_COMPUTE and not asks_for_help:
        raise InputError(
            f"this process may use {limit / 1e9:.1f} GB of address space (ulimit -v); expected"
            f" {LEAST_TO_COMPUTE / 1e9:.2f} GB at least, since the numerical libraries cannot be"
            f" loaded in less, and {LEAST_ADDRESS_SPACE / 1e9:.1f} GB for long logs. Raise the"
            " limit. Nothing was changed."
        )
    return (
        f"this process may use {limit / 1e9:.1f} GB of address space (ulimit -v); expected"
        f" {LEAST_ADDRESS_SPACE / 1e9:.1f} GB or more. Below that a numerical library or the"
        " compiler may stop without a message of zerodrift's. Raise the limit if that happens."
    )


def read_address_space() -> int | None:
    """Return the limit of this process's address space in bytes; None = none, or not known."""
    try:
        import resource
    except ImportError:  # there is no such limit on Windows
        return None
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if soft == resource.RLIM_INFINITY else soft


def is_out_of_memory(error: BaseException) -> bool:
    """Tell whether a library could not be loaded, or a thread not started, for want of memory."""
    if isinstance(error, ImportError):
        return any(words in str(error) for words in _NO_ROOM)
    return isinstance(error, RuntimeError) and "can't start new thread" in str(error)


def explain_memory() -> str:
    """Return the message for a run that needed more memory than there is."""
    limit = read_address_space()
    allowed = f" (the limit is {limit / 1e9:.1f} GB, ulimit -v)" if limit is not None else ""
    return (
        f"not enough memory{allowed}; expected room for the logs, three times over. Close other"
        " programs, raise the limit, or name fewer or shorter logs in [logs]. The files in the"
        " project are as they were."
    )


# The command line: names the commands and loads each one's module only when it is called.

#: Command name -> one-line help. The command itself is `zerodrift.cli.<name>:command`;
#: further commands come from installed packages, by entry points that each give a mapping:
#: command name -> (one-line help, "module:attribute").
COMMANDS: dict[str, str] = {
    "init": "Write a commented zerodrift.toml guessed from the logs.",
    "effects": "The catalogue of physical effects; with a name, everything about one.",
    "compare": "Model against measurements, run by run; where it fails.",
    "diagnose": "Name the physical effect that the model lacks.",
    "propose": "A formula where no effect of the catalogue explains what is left.",
    "plan": "The next experiment, computed: temperatures, loads and inputs over time.",
    "record": "A log from a serial port, CAN, MQTT or a command, and what it still lacks.",
    "add": "Add an effect, refit, and show the held-out error before and after.",
    "remove": "Remove an effect, refit, and show the held-out error before and after.",
    "history": "The staircase of errors so far.",
    "train": "Fit the effects, then train the network on what is left.",
    "export": "Write float ONNX, integer model, integer ONNX and golden vectors.",
    "firmware": "Everything up to C sources, built and checked bit for bit on the host.",
    "verify": "Replay the golden vectors on every back end there is.",
    "apply": "The finished model over any log: drift, compensated value, uncertainty, flags.",
    "monitor": "The deployed model against new logs: ageing, steps, another unit; alarms.",
    "diff": "What changed between two models, and by how much their drifts differ.",
    "package": "Write the model as a package: CMake, Zephyr, Arduino, Python, ROS 2 and others.",
    "neighbour": "The model as PX4, ArduPilot or chrony take it, and what that loses.",
    "report": "One self-contained file: verdict, errors, effects, firmware, provenance.",
    "workbench": "The same loop in a browser, on 127.0.0.1.",
    "fleet": "Many sensors of one design: all of the above for each, and the yield.",
    "block": "What a unit's block of coefficients holds, and whether it is sound.",
    "registry": "Units by serial number: calibrations, blocks, logs, what is on each.",
    "doctor": "What this machine has and lacks for all of this.",
    "calibrate": "The calibration matrix from converter codes and test weights.",
}


COMPLETION = "_ZERODRIFT_COMPLETE"
"""Variable by which a shell asks for completions (click)."""
LABORATORY = ("twin", "paper")
"""Commands of zerodrift-lab, a distribution of its own."""


@cache
def list_commands() -> dict[str, tuple[str, str]]:
    """Return every command there is: its help, and the place it is loaded from."""
    own = {name: (text, f"zerodrift.cli.{name}:command") for name, text in COMMANDS.items()}
    for told in load_parts(GROUP, dict):
        for name, place in told.items():
            own.setdefault(name, place)
    return own


class LazyGroup(click.Group):
    """A click group that imports a command's module on first use, so that `--help` stays fast."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the command names in the order of a user's work."""
        return list(list_commands())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return the command named `cmd_name`, or None for an unknown name."""
        if cmd_name not in list_commands():
            return None
        module, _, attribute = list_commands()[cmd_name][1].partition(":")
        command = getattr(importlib.import_module(module), attribute)
        assert isinstance(command, click.Command)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Resolve the command, naming the nearest ones when it is unknown."""
        from zerodrift.base.errors import nearest

        known = list_commands()
        if args and not args[0].startswith("-") and args[0] not in known:
            if args[0] in LABORATORY:
                raise click.UsageError(
                    f"'{args[0]}' is a command of zerodrift-lab, which is not installed."
                    " Run in zerodrift's checkout: pip install ./lab",
                    ctx,
                )
            raise click.UsageError(f"no command '{args[0]}'{nearest(args[0], known)}", ctx)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the command list without importing any of the commands."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (text, _) in list_commands().items()])


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="zerodrift")
def cli() -> None:
    """Turn a sensor's temperature logs into fixed-point drift-compensation firmware."""


def run() -> None:
    """Run the command that the arguments name.

    Raises:
        InputError: code that is not zerodrift's, such as a file of effects, ended the process
            during a command, which is then incomplete.
    """
    try:
        cli.main(standalone_mode=False, complete_var=COMPLETION)
        sys.stdout.flush()
    except SystemExit as ended:
        if is_own_exit(ended) or COMPLETION in os.environ:  # click completes, and exits
            raise
        if is_closed_pipe(ended):
            raise BrokenPipeError from ended
        raise InputError(
            f"something that this command ran called sys.exit({ended.code!r}), so that the command"
            " was not done; expected a file of effects, or an installed one, that only declares"
            " effects. Take the call out."
        ) from ended


def is_own_exit(ended: SystemExit) -> bool:
    """Tell whether one of zerodrift's own commands ended the process, its work done."""
    return find_raiser(ended).startswith("zerodrift.")


def is_closed_pipe(ended: SystemExit) -> bool:
    """Tell whether rich or click ended the process because the reader of its output has gone."""
    trace = ended.__traceback__
    called = trace.tb_next if trace is not None else None  # by `run`: click, which else returns
    is_own = called is not None and called.tb_next is None
    return find_raiser(ended) == "rich.console" or (is_own and find_raiser(ended) == "click.core")


def find_raiser(ended: SystemExit) -> str:
    """Return the name of the module that ended the process; "" if unknown."""
    trace = ended.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return str(trace.tb_frame.f_globals.get("__name__", "")) if trace is not None else ""


def drop_output() -> None:
    """Discard what is still to be written on stdout."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def end_on_request() -> None:
    """Let SIGTERM end a command as Ctrl-C does, so that locks and scratch files are removed."""
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, signal.default_int_handler)


def main() -> None:
    """Run the command line; a user's error becomes one message on stderr and its exit code."""
    use_one_thread()
    prepare_streams()
    guard_streams()
    end_on_request()
    try:
        if note := describe_memory_limit(sys.argv[1:]):
            click.echo(f"note: {note}", err=True)
            # the threads of a library that cannot all be started may wait for each other for ever
            os.environ.setdefault("POLARS_MAX_THREADS", "1")
        run()
    except ZerodriftError as error:
        click.echo(f"error: {error}", err=True)
        sys.exit(error.exit_code)
    except BrokenPipeError:
        # the reader of our output has closed it: nothing more can be written
        drop_output()
        sys.exit(1)
    except MemoryError:
        click.echo(f"error: {explain_memory()}", err=True)
        sys.exit(2)
    except OSError as error:
        if is_refused_write(error):
            place = error.filename or f"standard output, or {tempfile.gettempdir()}"
            click.echo(f"error: {explain_write(place, error, NOTHING_HALF)}", err=True)
            drop_output()  # pending output would fail again as the process ends
        elif told := explain_refusal(error):
            click.echo(f"error: {told}", err=True)
        else:
            raise
        sys.exit(2)
    except click.ClickException as error:
        error.show()
        sys.exit(2)
    except click.exceptions.Abort:
        click.echo("interrupted; nothing was left half-written", err=True)
        sys.exit(130)
    except (ImportError, RuntimeError) as error:  # click's Abort and Exit are RuntimeErrors
        if not is_out_of_memory(error):
            raise
        click.echo(f"error: {explain_memory()}", err=True)
        sys.exit(2)
