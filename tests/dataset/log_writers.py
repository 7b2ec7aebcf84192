"""Writes one small log in each format that is read, by the format's own writer where there is one.

Each holds the same run: `COUNT` rows, one a second, of times, temperature in degC and force in N.
ULog and DataFlash have no writer in Python; they are written by their specifications.
"""

import datetime
import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl

COUNT = 60
START = datetime.datetime(2024, 10, 21, 15, 52, 16)
UNIX_S = 1729525936.0
TIME = np.arange(COUNT, dtype=np.float64)
TEMPERATURE = np.round(20 + 5 * np.sin(TIME / 9) + 0.01 * TIME, 3)
FORCE = np.round(100 * np.cos(TIME / 7) + TIME, 3)
NAMES = ("time", "temperature_degC", "Fz_N")


def list_times() -> list[datetime.datetime]:
    """Return the rows' dates."""
    return [START + datetime.timedelta(seconds=float(t)) for t in TIME]


def write_text(
    path: Path, separator: str = ",", decimal: str = ".", encoding: str = "utf-8", head: str = ""
) -> None:
    """Write ISO 8601 times and decimals of either kind."""
    lines = [head + separator.join(NAMES)]
    for at, t, f in zip(list_times(), TEMPERATURE, FORCE, strict=True):
        values = [f"{t:.3f}", f"{f:.3f}"]
        lines.append(separator.join([at.isoformat(), *(v.replace(".", decimal) for v in values)]))
    path.write_bytes(("\n".join(lines) + "\n").encode(encoding))


def make_frame() -> pl.DataFrame:
    """Return the run with dates."""
    return pl.DataFrame(dict(zip(NAMES, (list_times(), TEMPERATURE, FORCE), strict=True)))


def write_parquet(path: Path) -> None:
    """Write datetimes of microseconds."""
    make_frame().write_parquet(path)


def write_feather(path: Path) -> None:
    """Write datetimes of microseconds."""
    make_frame().write_ipc(path)


def write_excel(path: Path) -> None:
    """Write a sheet with a title above its header and a row of units below."""
    import openpyxl

    workbook = openpyxl.Workbook()
    sheet = workbook.active
    sheet.title = "Messung"
    sheet.append(["Protokoll", "7", None])
    sheet.append([])
    sheet.append(["time", "temperature", "Fz"])
    sheet.append([None, "°C", "N"])
    for row in zip(list_times(), TEMPERATURE.tolist(), FORCE.tolist(), strict=True):
        sheet.append(list(row))
    workbook.save(path)


def write_hdf5(path: Path) -> None:
    """Write a group with two data sets of one length, and their times in seconds."""
    import h5py

    with h5py.File(path, "w") as file:
        group = file.create_group("run")
        group["time_s"] = TIME
        group["temperature_degC"] = TEMPERATURE
        group["Fz"] = FORCE
        group["Fz"].attrs["unit"] = "N"


WRENCH = """std_msgs/Header header
geometry_msgs/Wrench wrench
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: geometry_msgs/Wrench
geometry_msgs/Vector3 force
geometry_msgs/Vector3 torque
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""
TEMPERATURE_MESSAGE = """std_msgs/Header header
float64 temperature
float64 variance
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def write_mcap(path: Path) -> None:
    """Write wrenches and temperatures as ROS 2 topics, the latter 0.4 s later."""
    from mcap_ros2.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        wrench = writer.register_msgdef("geometry_msgs/msg/WrenchStamped", WRENCH)
        heat = writer.register_msgdef("sensor_msgs/msg/Temperature", TEMPERATURE_MESSAGE)
        zero = {"x": 0.0, "y": 0.0, "z": 0.0}
        for t, temperature, force in zip(TIME, TEMPERATURE, FORCE, strict=True):
            load = {**zero, "z": float(force)}
            for topic, schema, late_s, body in (
                ("/ft/wrench", wrench, 0.0, {"wrench": {"force": load, "torque": zero}}),
                ("/ft/temperature", heat, 0.4, {"temperature": float(temperature)}),
            ):
                at_ns = int((UNIX_S + t + late_s) * 1e9)
                stamp = {"sec": at_ns // 10**9, "nanosec": at_ns % 10**9}
                message = {"header": {"stamp": stamp, "frame_id": "ft"}, **body}
                writer.write_message(topic, schema, message, at_ns, at_ns)
        writer.finish()


def write_mcap_json(path: Path) -> None:
    """Write one topic of JSON."""
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("sensor", "jsonschema", b"{}")
        channel = writer.register_channel("sensor", "json", schema)
        for t, temperature, force in zip(TIME, TEMPERATURE, FORCE, strict=True):
            at_ns = int((UNIX_S + t) * 1e9)
            data = json.dumps({"temperature_degC": temperature, "Fz_N": force}).encode()
            writer.add_message(channel, at_ns, data, at_ns)
        writer.finish()


def write_rosbag2(folder: Path) -> Path:
    """Write both topics into a rosbag2 folder; return its SQLite file."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    vector, header = types["geometry_msgs/msg/Vector3"], types["std_msgs/msg/Header"]
    stamp, wrench = types["builtin_interfaces/msg/Time"], types["geometry_msgs/msg/Wrench"]
    stamped, heat = types["geometry_msgs/msg/WrenchStamped"], types["sensor_msgs/msg/Temperature"]
    with Writer(folder, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        forces = writer.add_connection("/ft/wrench", stamped.__msgtype__, typestore=store)
        heats = writer.add_connection("/ft/temperature", heat.__msgtype__, typestore=store)
        for t, temperature, force in zip(TIME, TEMPERATURE, FORCE, strict=True):
            at_ns = int((UNIX_S + t) * 1e9)
            head = header(stamp(at_ns // 10**9, at_ns % 10**9), "ft")
            message = stamped(head, wrench(vector(0.0, 0.0, float(force)), vector(0.0, 0.0, 0.0)))
            writer.write(forces, at_ns, store.serialize_cdr(message, stamped.__msgtype__))
            warm = heat(head, float(temperature), 0.0)
            writer.write(heats, at_ns, store.serialize_cdr(warm, heat.__msgtype__))
    return next(folder.glob("*.db3"))


def write_ulog(path: Path) -> None:
    """Write two topics by PX4's specification of ULog, version 1."""

    def pack(kind: str, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), ord(kind)) + body

    data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
    data += pack("B", bytes(40))
    for text in ("wrench:uint64_t timestamp;float fz;", "heat:uint64_t timestamp;float celsius;"):
        data += pack("F", text.encode())
    for number, name in enumerate((b"wrench", b"heat")):
        data += pack("A", struct.pack("<BH", 0, number) + name)
    for t, temperature, force in zip(TIME, TEMPERATURE, FORCE, strict=True):
        at_us = 1_000_000 + int(t * 1e6)
        data += pack("D", struct.pack("<HQf", 0, at_us, force))
        data += pack("D", struct.pack("<HQf", 1, at_us, temperature))
    path.write_bytes(data)


def write_ardupilot(path: Path) -> None:
    """Write two kinds of messages by the specification of DataFlash logs."""

    def define(kind: int, name: str, form: str, columns: str, size: int) -> bytes:
        body = struct.pack(
            "<BB4s16s64s", kind, size + 3, name.encode(), form.encode(), columns.encode()
        )
        return b"\xa3\x95\x80" + body

    data = define(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 86)
    data += define(1, "FRC", "Qf", "TimeUS,Fz", 12) + define(2, "HEAT", "Qf", "TimeUS,Temp", 12)
    for t, temperature, force in zip(TIME, TEMPERATURE, FORCE, strict=True):
        at_us = int(t * 1e6) + 500_000
        data += b"\xa3\x95\x01" + struct.pack("<Qf", at_us, force)
        data += b"\xa3\x95\x02" + struct.pack("<Qf", at_us, temperature)
    path.write_bytes(data)


WRITERS: dict[str, Callable[[Path], None]] = {
    "plain.csv": write_text,
    "comma.csv": lambda path: write_text(path, ";", ","),
    "tabs.tsv": lambda path: write_text(path, "\t", head="# logger\n"),
    "latin.csv": lambda path: write_text(path, ";", ",", "cp1252", "Prüfung 7\n"),
    "wide.txt": lambda path: write_text(path, "\t", ".", "utf-16"),
    "log.parquet": write_parquet,
    "log.feather": write_feather,
    "log.xlsx": write_excel,
    "log.h5": write_hdf5,
    "log.mcap": write_mcap,
    "json.mcap": write_mcap_json,
    "log.ulg": write_ulog,
    "log.bin": write_ardupilot,
}
"""Name of a file -> what writes it."""
COLUMNS = {
    "log.xlsx": ("time", "temperature", "Fz"),
    "log.h5": ("time_s", "temperature_degC", "Fz"),
    "log.mcap": ("time_s", "temperature", "wrench.force.z"),
    "json.mcap": ("time_s", "temperature_degC", "Fz_N"),
    "log.ulg": ("time_s", "celsius", "fz"),
    "log.bin": ("time_s", "Temp", "Fz"),
}
"""Name of a file -> times, temperature and force in it, where not `NAMES`."""
