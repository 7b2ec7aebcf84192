"""Topics of a rosbag2 folder with an SQLite file in it, by rosbags."""

from collections.abc import Iterable
from pathlib import Path

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from zerodrift.base.errors import InputError
from zerodrift.dataset.formats.tables import FormatTable, Recorder, read_stamp


def read(path: Path) -> Iterable[FormatTable]:
    """Yield a table for each topic; its times are the headers' stamps, else when it was logged.

    Raises:
        InputError: metadata.yaml does not lie beside the file.
    """
    if not (path.parent / "metadata.yaml").is_file():
        raise InputError(
            f"{path.name}: there is no metadata.yaml beside it; expected a whole rosbag2 folder. "
            "Copy the folder, or write it again by `ros2 bag reindex`."
        )
    topics: dict[str, Recorder] = {}
    with AnyReader([path.parent], default_typestore=get_typestore(Stores.LATEST)) as reader:
        for connection, logged_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            stamp = read_stamp(message)
            time_s = 1e-9 * logged_ns if stamp is None else stamp
            topics.setdefault(connection.topic, Recorder()).add(time_s, message)
    for topic, recorder in topics.items():
        yield recorder.finish(topic)
