"""Sources that send: a serial port, a command, standard input, a CAN bus, an MQTT broker."""

import contextlib
import queue
import shlex
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Protocol

from zerodrift.base.errors import InputError
from zerodrift.base.extras import RECORD_CAN, RECORD_DBC, RECORD_MQTT, RECORD_SERIAL, require
from zerodrift.recording.sources import (
    LONGEST,
    LineError,
    LineReader,
    Reading,
    SourceText,
    Values,
    now_s,
)

# Frames of a CAN bus, decoded by a DBC file.


class _Message(Protocol):
    """What is used of a message of cantools."""

    def decode(self, data: bytes, *, decode_choices: bool, scaling: bool) -> dict[str, object]: ...


class CanSource:
    """Signals of a bus, by the names of its DBC file; a name of several messages is MESSAGE.SIGNAL.

    Args:
        wanted: interface of python-can, channel, bits per second.
        dbc: what the frames mean.

    Raises:
        InputError: no DBC file, one that cannot be read, or a bus that cannot be opened.
    """

    is_rows = False
    has_times = False

    def __init__(self, wanted: SourceText, dbc: Path | None) -> None:
        self._name = f"can:{wanted.detail}:{wanted.place}"
        require(RECORD_CAN, self._name)
        require(RECORD_DBC, self._name)
        if dbc is None:
            raise InputError(
                f"{self._name}: needs to know what the frames mean; expected --dbc FILE. "
                "`zerodrift package` writes one beside the C."
            )
        self._messages = _read_dbc(dbc)
        self._strays: Counter[str] = Counter()
        bitrate = {"bitrate": wanted.number} if wanted.number else {}
        can = import_module("can")
        try:
            self._bus = can.Bus(channel=wanted.place, interface=wanted.detail, **bitrate)
        except (OSError, ValueError, can.CanError) as error:
            raise InputError(
                f"{self._name}: cannot be opened ({error}); expected an interface of python-can "
                "(socketcan, slcan, virtual, ...) and a channel that is up."
            ) from None

    def read(self, timeout_s: float) -> list[Reading] | None:
        """Return the signals of the frames that have come; see `LiveSource`."""
        found: list[Reading] = []
        wait_s = timeout_s
        while True:
            try:
                frame = self._bus.recv(wait_s)
            except Exception as error:
                if not isinstance(error, OSError | import_module("can").CanError):
                    raise
                raise InputError(
                    f"{self._name}: can no longer be read ({error}). What came before is kept."
                ) from None
            if frame is None:
                return found
            wait_s = 0.0
            if values := self._decode(frame.arbitration_id, bytes(frame.data)):
                found.append(Reading(now_s(), values))

    def _decode(self, identifier: int, data: bytes) -> Values:
        if identifier not in self._messages:
            self._strays[f"frame {identifier:#x} is not in the DBC file"] += 1
            return {}
        message, names = self._messages[identifier]
        try:
            decoded = message.decode(data, decode_choices=False, scaling=True)
        except Exception as error:  # noqa: BLE001 - of cantools and bitstruct, several kinds
            self._strays[f"frame {identifier:#x} cannot be decoded ({error})"] += 1
            return {}
        return {
            names[name]: float(value)
            for name, value in decoded.items()
            if isinstance(value, int | float)
        }

    def explain_wait(self) -> str:
        """Return nothing: what will come is not known."""
        return ""

    def list_strays(self) -> list[str]:
        """Return which frames could not be decoded, and how often they came."""
        return [f"{what}: {count} times" for what, count in self._strays.most_common()]

    def close(self) -> None:
        """Leave the bus."""
        with contextlib.suppress(OSError):
            self._bus.shutdown()


def _read_dbc(path: Path) -> dict[int, tuple[_Message, dict[str, str]]]:
    """Return messages by identifier, each with the columns of its signals.

    Raises:
        InputError: the file is no DBC file.
    """
    try:
        database = import_module("cantools").database.load_file(str(path))
    except FileNotFoundError:
        raise InputError(f"--dbc {path}: there is no such file.") from None
    except Exception as error:  # noqa: BLE001 - whatever cantools finds wrong
        raise InputError(f"--dbc {path}: is no DBC file ({str(error)[:200]}).") from None
    count = Counter(signal.name for message in database.messages for signal in message.signals)
    return {
        message.frame_id: (
            message,
            {
                signal.name: (
                    signal.name if count[signal.name] == 1 else f"{message.name}.{signal.name}"
                )
                for signal in message.signals
            },
        )
        for message in database.messages
    }


# Messages of an MQTT broker.

CONNECT_S = 5.0


class MqttSource:
    """Topics of a broker: a number is a column called as its topic, a JSON object one for each key.

    With a wildcard in the topic, the key of an object follows its topic: `chamber/state.degC`.

    Args:
        wanted: host, port, topic.
        columns: names, where a message is a line of numbers alone.

    Raises:
        InputError: no broker answers, or it refuses the connection.
    """

    is_rows = False
    has_times = False

    def __init__(self, wanted: SourceText, columns: tuple[str, ...]) -> None:
        self._name = f"mqtt:{wanted.place}:{wanted.number}/{wanted.detail}"
        require(RECORD_MQTT, self._name)
        client = import_module("paho.mqtt.client")
        versions = import_module("paho.mqtt.enums").CallbackAPIVersion
        self._columns = columns
        self._many = "#" in wanted.detail or "+" in wanted.detail
        self._came: queue.SimpleQueue[Reading] = queue.SimpleQueue()
        self._answers: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._strays: Counter[str] = Counter()
        self._client = client.Client(versions.VERSION2)
        self._client.on_connect = self._greet
        self._client.on_message = self._take
        self._topic = wanted.detail
        try:
            self._client.connect(wanted.place, wanted.number)
        except (OSError, ValueError) as error:
            raise InputError(
                f"{self._name}: nobody answers ({error}); expected an MQTT broker there."
            ) from None
        self._client.loop_start()
        try:
            refused = self._answers.get(timeout=CONNECT_S)
        except queue.Empty:
            refused = f"no answer within {CONNECT_S:g} s"
        if refused:
            self.close()
            raise InputError(f"{self._name}: the broker refuses ({refused}).")

    def _greet(self, client: object, data: object, flags: object, code: object, *_: object) -> None:
        """Subscribe, at the first connection and after each that was lost."""
        failed = bool(getattr(code, "is_failure", False))
        if not failed:
            self._client.subscribe(self._topic)
        self._answers.put(str(code) if failed else "")

    def _take(self, client: object, data: object, message: object) -> None:
        topic = str(message.topic)  # type: ignore[attr-defined]
        text = bytes(message.payload).decode("utf-8", errors="replace")  # type: ignore[attr-defined]
        try:
            values = self._read(topic, text)
        except LineError as error:
            self._strays[f"{topic}: {error}"] += 1
            return
        if values:
            self._came.put(Reading(now_s(), values))

    def _read(self, topic: str, text: str) -> Values:
        try:
            return {topic: float(text)}
        except ValueError:
            pass
        values = LineReader(self._columns).read(text)
        if not values:
            raise LineError(f"'{text[:40]}' holds no number")
        return {f"{topic}.{name}" if self._many else name: v for name, v in values.items()}

    def read(self, timeout_s: float) -> list[Reading] | None:
        """Return what has come; see `LiveSource`."""
        found: list[Reading] = []
        try:
            found.append(self._came.get(timeout=timeout_s))
            while True:
                found.append(self._came.get_nowait())
        except queue.Empty:
            return found

    def explain_wait(self) -> str:
        """Return nothing: what will come is not known."""
        return ""

    def list_strays(self) -> list[str]:
        """Return which messages held no numbers, and how often they came."""
        return [f"{what}: {count} times" for what, count in self._strays.most_common(5)]

    def close(self) -> None:
        """Leave the broker."""
        self._client.disconnect()
        self._client.loop_stop()


# Sources of lines: a serial port, a command's output, standard input.

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
