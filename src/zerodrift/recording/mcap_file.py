"""An MCAP file that is still being written: its messages, as they reach the disk.

A writer puts records one after the other: a byte for the kind, eight for the length, the content
(https://mcap.dev/spec). What is whole is read; what is not yet whole is waited for. The summary at
the end, which a file in the making lacks, is not needed.
"""

import json
import struct
import time
from collections import Counter
from io import BytesIO
from pathlib import Path

from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from zerodrift.base.errors import InputError, nearest
from zerodrift.dataset.formats.mcap_log import EXPECTED, MessageReader
from zerodrift.dataset.formats.tables import read_numbers
from zerodrift.recording.sources import Reading, SourceText, Values

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")
"""Before each record: its kind, and the bytes of its content."""
SCHEMA, CHANNEL, MESSAGE, CHUNK, DATA_END = 3, 4, 5, 6, 15
NAMES = {SCHEMA: "schema", CHANNEL: "channel", MESSAGE: "message", CHUNK: "chunk"}
LONGEST_RECORD = 2**32
"""Bytes; a longer record is no record."""
AT_ONCE = 2**22
"""Bytes that are read before the rows so far are kept and shown."""
MARK = ":"
"""Between topic and field, where several topics have the field, as in zerodrift.toml."""


class McapSource:
    """Topics of a file: each number of a message is a column called as its field.

    Where several topics have a field, the first to come has its name, the others TOPIC:FIELD.

    Args:
        wanted: the file; its topics, where not all are meant.
        columns: what the project reads; a TOPIC:FIELD among them names that field of that topic.

    Raises:
        InputError: there is no such file, or it is no MCAP file.
    """

    is_rows = False
    has_times = True

    def __init__(self, wanted: SourceText, columns: tuple[str, ...]) -> None:
        self._path = Path(wanted.place)
        self._name = f"mcap:{wanted.place}"
        self._reader = MessageReader()
        self._topics = tuple(each.strip() for each in wanted.detail.split(",") if each.strip())
        self._columns = frozenset(columns)
        try:
            self._file = self._path.open("rb")
        except OSError as error:
            raise InputError(
                f"{self._name}: cannot be opened ({error.strerror}); expected an MCAP file that is "
                "being written. Start its writer first."
            ) from None
        self._left = bytearray()
        """Bytes that are read and not yet a whole record."""
        self._at = 0
        """Where in the file they begin."""
        self._ended = False
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._owners: dict[str, str] = {}
        """Column -> its topic."""
        self._named: dict[tuple[str, str], str] = {}
        """Topic and field -> column."""
        self._came: set[str] = set()
        self._unread: dict[str, str] = {}
        """Topic -> why none of its messages can be read."""
        self._strays: Counter[str] = Counter()

    def read(self, timeout_s: float) -> list[Reading] | None:
        """Return the messages that have come, in the order of their times; see `LiveSource`."""
        if self._ended:
            return None
        try:
            come = self._file.read(AT_ONCE)
            size = self._path.stat().st_size
        except OSError as error:
            raise InputError(
                f"{self._name}: can no longer be read ({error.strerror}). What came before is kept."
            ) from None
        if size < self._at + len(self._left):
            raise InputError(
                f"{self._name}: has {size} bytes, and had {self._at + len(self._left)}: it was "
                "begun anew; expected one that grows. What came before is kept."
            )
        if not come:
            time.sleep(timeout_s)
            return []
        self._left += come
        found: list[Reading] = []
        self._check_magic()
        while not self._ended and (record := self._take_record()):
            self._read_record(*record, found)
        found.sort(key=lambda each: each.at_s)
        return found

    def _check_magic(self) -> None:
        if self._at:
            return
        begin = bytes(self._left[: len(MAGIC)])
        if not MAGIC.startswith(begin):
            raise InputError(
                f"{self._name}: begins with {begin!r}; expected an MCAP file, which begins with "
                f"{MAGIC!r}."
            )
        if len(begin) == len(MAGIC):
            del self._left[: len(MAGIC)]
            self._at = len(MAGIC)

    def _take_record(self) -> tuple[int, bytes] | None:
        """Return the next whole record: its kind, and its bytes with the head before them."""
        if not self._at or len(self._left) < HEAD.size:
            return None
        kind, length = HEAD.unpack_from(self._left)
        if not kind or length > LONGEST_RECORD:
            raise InputError(
                f"{self._name}: byte {self._at}: a record of kind {kind} and {length} bytes; "
                "expected the next record there. The file is damaged; what came before is kept."
            )
        end = HEAD.size + length
        if len(self._left) < end:
            return None
        record = bytes(self._left[:end])
        del self._left[:end]
        self._at += end
        return kind, record

    def _read_record(self, kind: int, record: bytes, found: list[Reading]) -> None:
        self._ended = kind == DATA_END
        if kind not in NAMES:
            return
        try:
            for one in _parse(record):
                self._follow(one, found)
        except Exception as error:  # noqa: BLE001 - of the libraries that unpack, many kinds
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            self._strays[
                f"byte {self._at - len(record)}: a damaged {NAMES[kind]} ({reason[:120]}); what it "
                "held was left out"
            ] += 1

    def _follow(self, one: McapRecord, found: list[Reading]) -> None:
        """Take a schema, a channel or a message."""
        if isinstance(one, Schema):
            self._schemas[one.id] = one
        elif isinstance(one, Channel):
            self._channels[one.id] = one
        elif isinstance(one, Message):
            self._take_message(one, found)

    def _take_message(self, record: Message, found: list[Reading]) -> None:
        channel = self._channels.get(record.channel_id)
        if channel is None:
            self._strays[f"a message of channel {record.channel_id}, which nothing describes"] += 1
            return
        topic = channel.topic
        if (self._topics and topic not in self._topics) or topic in self._unread:
            return
        schema = self._schemas.get(channel.schema_id)
        if schema is None and channel.message_encoding != "json":
            self._unread[topic] = f"{channel.message_encoding} without a schema"
            return
        form = f"{channel.message_encoding}, {schema.encoding}" if schema else "json"
        try:
            read = self._reader.read(schema, channel, record)
        except json.JSONDecodeError as error:
            self._strays[f"{topic}: a message that is no JSON ({error})"] += 1
            return
        except Exception as error:  # noqa: BLE001 - whatever the decoder finds wrong
            self._strays[f"{topic}: a message that is no {form} ({str(error)[:80]})"] += 1
            return
        if read is None:
            told = f" of {schema.name}" if schema else ""
            self._unread[topic] = f"{form}{told}"
            return
        at_s, message = read
        if values := read_numbers(message):
            self._came.add(topic)
            found.append(Reading(at_s, self._name_columns(topic, values)))

    def _name_columns(self, topic: str, values: Values) -> Values:
        return {self._name_column(topic, field): value for field, value in values.items()}

    def _name_column(self, topic: str, field: str) -> str:
        known = self._named.get((topic, field))
        if known is None:
            whole = f"{topic}{MARK}{field}"
            is_whole = whole in self._columns or self._owners.get(field, topic) != topic
            known = self._named[topic, field] = whole if is_whole else field
            self._owners.setdefault(known, topic)
        return known

    def explain_wait(self) -> str:
        """Return the topics that have not come, and those that cannot be read."""
        parts = [self._explain_topic(topic) for topic in self._topics if topic not in self._came]
        if not self._topics and not self._came:
            parts = [f"{topic} cannot be read ({why})" for topic, why in self._unread.items()]
        return "; ".join(parts)

    def _explain_topic(self, topic: str) -> str:
        if topic in self._unread:
            return f"{topic} cannot be read ({self._unread[topic]})"
        there = sorted({channel.topic for channel in self._channels.values()})
        if topic in there:
            return f"{topic} is there, without a number so far"
        shown = ", ".join(there[:6]) or "no topic"
        return f"{topic} has not come; the file has {shown}{nearest(topic, there)}".rstrip(".")

    def list_strays(self) -> list[str]:
        """Return what came and is in no row, what never came, and how the file ends."""
        told = [
            self._explain_topic(t) for t in self._topics if t not in {*self._came, *self._unread}
        ]
        told += [
            f"{topic}: {why} cannot be read; expected {EXPECTED}"
            for topic, why in self._unread.items()
        ]
        told += [
            f"'{field}' is that of {self._owners[field]}; that of {topic} is '{column}'"
            for (topic, field), column in self._named.items()
            if column != field and self._owners.get(field, topic) != topic
        ]
        told += [f"{what}: {_write_times(count)}" for what, count in self._strays.most_common(5)]
        if self._left and not self._ended:
            told.append(self._explain_rest())
        return told

    def _explain_rest(self) -> str:
        what, whole = "record", ""
        if self._at and len(self._left) >= HEAD.size:
            kind, length = HEAD.unpack_from(self._left)
            what, whole = NAMES.get(kind, what), f" of {HEAD.size + length}"
        return (
            f"the file ends within a {what}: {len(self._left)}{whole} bytes are there, from byte "
            f"{self._at} on; what it holds is not in the log. Its writer was still writing, or was "
            "cut off"
        )

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _parse(record: bytes) -> list[McapRecord]:
    """Return the schemas, channels and messages of a record; its check sums are checked."""
    reader = StreamReader(BytesIO(record), skip_magic=True, emit_chunks=True)
    one = next(iter(reader.records))
    return breakup_chunk(one, validate_crc=True) if isinstance(one, Chunk) else [one]


def _write_times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
