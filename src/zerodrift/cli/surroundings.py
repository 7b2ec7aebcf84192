"""The environment of the command line: output streams and memory limits."""

import io
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from zerodrift.base.errors import InputError

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
