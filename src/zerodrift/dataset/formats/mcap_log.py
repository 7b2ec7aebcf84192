"""Topics of an MCAP file, by mcap: ROS 2 messages and JSON."""

import json
from collections.abc import Iterable
from pathlib import Path

from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap_ros2.decoder import DecoderFactory

from zerodrift.base.errors import InputError
from zerodrift.dataset.formats.tables import FormatTable, Recorder, read_stamp

EXPECTED = "ROS 2 (cdr) or JSON"


class MessageReader:
    """Reads the messages of one file; its schemas are parsed once."""

    def __init__(self) -> None:
        self._factory = DecoderFactory()

    def read(
        self, schema: Schema | None, channel: Channel, record: Message
    ) -> tuple[float, object] | None:
        """Return the time in s of a message and what it holds; None: its encoding is not known.

        The time is the stamp of its header, else when it was logged.
        """
        if channel.message_encoding == "json":
            message: object = json.loads(record.data)
        else:
            decode = self._factory.decoder_for(channel.message_encoding, schema)
            if decode is None:
                return None
            message = decode(record.data)
        stamp = read_stamp(message)
        return 1e-9 * record.log_time if stamp is None else stamp, message


def read(path: Path) -> Iterable[FormatTable]:
    """Yield a table for each topic; its times are the headers' stamps, else when it was logged.

    Raises:
        InputError: no topic has a known encoding.
    """
    topics: dict[str, Recorder] = {}
    unread: dict[str, str] = {}
    reader = MessageReader()
    with path.open("rb") as file:
        for schema, channel, record in make_reader(file).iter_messages():
            found = reader.read(schema, channel, record)
            if found is None:
                unread[channel.topic] = channel.message_encoding
            else:
                topics.setdefault(channel.topic, Recorder()).add(*found)
    if unread and not topics:
        shown = ", ".join(f"{topic} ({encoding})" for topic, encoding in list(unread.items())[:6])
        raise InputError(
            f"{path.name}: no topic can be read: {shown}; expected {EXPECTED}. Record or "
            "convert it so."
        )
    for topic, recorder in topics.items():
        yield recorder.finish(topic)
