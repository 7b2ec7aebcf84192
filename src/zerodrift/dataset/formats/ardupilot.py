"""Messages of an ArduPilot DataFlash log (.bin), by pymavlink."""

from collections.abc import Iterable
from pathlib import Path

from pymavlink.DFReader import DFReader_binary

from zerodrift.dataset.formats.tables import FormatTable, Recorder


def read(path: Path) -> Iterable[FormatTable]:
    """Yield a table for each kind of message, and instance; times are seconds since power-on."""
    kinds: dict[str, Recorder] = {}
    reader = DFReader_binary(str(path), zero_time_base=True)
    while True:
        message = reader.recv_msg()
        if message is None:
            break
        fields = message.to_dict()
        time_us = fields.pop("TimeUS", None)
        kind = str(fields.pop("mavpackettype", message.get_type()))
        if not isinstance(time_us, int | float):
            continue
        instance = fields.get("I", fields.get("Instance"))
        name = f"{kind}_{instance}" if isinstance(instance, int) and instance else kind
        kinds.setdefault(name, Recorder()).add(1e-6 * time_us, fields)
    for name, recorder in kinds.items():
        yield recorder.finish(name)
