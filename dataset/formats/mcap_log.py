"""Topics of an MCAP file, by mcap: ROS 2 messages and JSON."""

import json
from collections.abc import Iterable
from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from zerodrift.base.errors import InputError
from zerodrift.dataset.formats.tables import FormatTable, Recorder, read_stamp


def read(path: Path) -> Iterable[FormatTable]:
    """Yield a table for each topic; its times are the headers' stamps, else when it was logged.

    Raises:
        InputError: no topic has a known encoding.
    """
    topics: dict[str, Recorder] = {}
    unread: dict[str, str] = {}
    factory = DecoderFactory()
    with path.open("rb") as file:
        for schema, channel, record in make_reader(file).iter_messages():
            if channel.message_encoding == "json":
                message: object = json.loads(record.data)
            else:
                decode = factory.decoder_for(channel.message_encoding, schema)
                if decode is None:
                    unread[channel.topic] = channel.message_encoding
                    continue
                message = decode(record.data)
            stamp = read_stamp(message)
            time_s = 1e-9 * record.log_time if stamp is None else stamp
            topics.setdefault(channel.topic, Recorder()).add(time_s, message)
    if unread and not topics:
        shown = ", ".join(f"{topic} ({encoding})" for topic, encoding in list(unread.items())[:6])
        raise InputError(
            f"{path.name}: no topic can be read: {shown}; expected ROS 2 (cdr) or JSON. Record or "
            "convert it so."
        )
    for topic, recorder in topics.items():
        yield recorder.finish(topic)
