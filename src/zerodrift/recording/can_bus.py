"""Frames of a CAN bus, decoded by a DBC file."""

import contextlib
from collections import Counter
from importlib import import_module
from pathlib import Path
from typing import Protocol

from zerodrift.base.errors import InputError
from zerodrift.base.extras import RECORD_CAN, RECORD_DBC, require
from zerodrift.recording.sources import Reading, SourceText, Values, now_s


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
