"""Sources of lines, and the values in each line by name."""

import queue
import shlex
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module

from zerodrift.base.errors import InputError
from zerodrift.base.extras import RECORD_SERIAL, require
from zerodrift.recording.sources import LONGEST, LineError, LineReader, Reading, now_s

GRACE_S = 2.0
"""For a command to end after it was asked to."""


@dataclass(frozen=True)
class Stream:
    """Bytes that come line by line."""

    read_line: Callable[[], bytes]
    """Waits for a line; a part of one after a time-out; nothing only at the end."""
    close: Callable[[], None]
    explain_end: Callable[[], str]
    """Why it ended, where that is an error; else nothing."""


class LineSource:
    """Each line is a row.

    Args:
        name: of the source, for messages.
        stream: where the lines come from.
        reader: turns them into values.
    """

    is_rows = True
    has_times = False

    def __init__(self, name: str, stream: Stream, reader: LineReader) -> None:
        self._name, self._stream, self._reader = name, stream, reader
        self._came: queue.SimpleQueue[tuple[float, bytes] | OSError | None] = queue.SimpleQueue()
        self._strays = 0
        self._first_stray = ""
        self._ended = False
        self._why = ""
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        try:
            while line := self._stream.read_line():
                self._came.put((now_s(), line))
        except OSError as error:
            self._came.put(error)
        self._came.put(None)

    def read(self, timeout_s: float) -> list[Reading] | None:
        """Return the rows that have come; see `LiveSource`."""
        found: list[Reading] = []
        wait_s = timeout_s
        while not self._ended:
            try:
                item = self._came.get(timeout=wait_s) if wait_s > 0 else self._came.get_nowait()
            except queue.Empty:
                return found
            wait_s = 0.0
            if isinstance(item, tuple):
                self._take(*item, found)
                continue
            self._ended = True
            if item is None:
                self._why = self._stream.explain_end()
            else:
                self._why = (
                    f"can no longer be read ({item.strerror or item}); expected it to stay "
                    "connected. What came before is kept."
                )
        if found:
            return found
        if self._why:
            raise InputError(f"{self._name}: {self._why}")
        return None

    def _take(self, at_s: float, line: bytes, found: list[Reading]) -> None:
        try:
            if len(line) >= LONGEST:
                raise LineError(f"{LONGEST} bytes came without an end of line")
            values = self._reader.read(line.decode("utf-8", errors="replace"))
        except LineError as error:
            self._strays += 1
            self._first_stray = self._first_stray or str(error)
            return
        if values:
            found.append(Reading(at_s, values))

    def explain_wait(self) -> str:
        """Return nothing: what will come is not known."""
        return ""

    def list_strays(self) -> list[str]:
        """Return how many lines were no rows, and the first of them."""
        if not self._strays:
            return []
        lines = "1 line was no row" if self._strays == 1 else f"{self._strays} lines were no rows"
        return [f"{lines}; the first: {self._first_stray}"]

    def close(self) -> None:
        """Close the port or end the command."""
        self._stream.close()


def open_serial(port: str, baud: int) -> Stream:
    """Open a serial port.

    Raises:
        InputError: it is not there, is in use, or may not be opened.
    """
    require(RECORD_SERIAL, f"serial:{port}")
    serial = import_module("serial")
    try:
        device = serial.Serial(port, baud, timeout=0.2)
    except (OSError, ValueError) as error:
        ports = [found.device for found in import_module("serial.tools.list_ports").comports()]
        there = f"This machine has {', '.join(ports)}." if ports else "This machine has none."
        raise InputError(
            f"serial:{port}: cannot be opened ({error}); expected a serial port that is free and "
            f"that this user may read. {there}"
        ) from None
    rest = bytearray()

    def read_line() -> bytes:
        while device.is_open:
            try:
                rest.extend(device.read_until(b"\n", LONGEST))
            except TypeError:  # pySerial's answer where the port is closed meanwhile
                return b""
            if rest.endswith(b"\n") or len(rest) >= LONGEST:
                line = bytes(rest)
                rest.clear()
                return line
        return b""

    return Stream(read_line, device.close, lambda: "")


def open_command(line: str) -> Stream:
    """Start a command; its standard output is the source, its standard error stays the user's.

    Raises:
        InputError: it cannot be started.
    """
    try:
        words = shlex.split(line)
        process = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE)
    except (OSError, ValueError) as error:
        raise InputError(
            f"command:{line}: cannot be started ({error}); expected a program and its arguments."
        ) from None
    output = process.stdout
    assert output is not None

    def close() -> None:
        process.terminate()
        try:
            process.wait(GRACE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def explain_end() -> str:
        code = process.wait()
        return f"ended with exit code {code}; what came before is kept." if code else ""

    return Stream(lambda: output.readline(LONGEST), close, explain_end)


def open_input() -> Stream:
    """Read standard input."""
    stdin = sys.stdin.buffer
    return Stream(lambda: stdin.readline(LONGEST), lambda: None, lambda: "")
