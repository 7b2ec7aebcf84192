"""An MCAP file that grows while it is recorded: whole chunks, cut ones, and a writer that dies."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from click.testing import CliRunner, Result

from zerodrift.base.errors import InputError
from zerodrift.cli.main import cli
from zerodrift.recording.open_source import open_source
from zerodrift.recording.sources import Reading, SourceText

mcap_file = pytest.importorskip(
    "zerodrift.recording.mcap_file",
    reason="the extra 'formats' is not installed; `make setup-formats`",
    exc_type=ImportError,
)
HEAD, MAGIC = mcap_file.HEAD, mcap_file.MAGIC
UNIX_S = 1_700_000_000
TEMPERATURE = """\
std_msgs/Header header
float64 temperature
float64 variance
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""
WRITER = """\
import sys, time
sys.path.insert(0, {tests!r})
from test_mcap import Bag
bag = Bag({path!r}, chunked={chunked})
for k in range({rows}):
    bag.add(k)
    bag.file.flush()
    time.sleep({pause_s})
bag.finish()
time.sleep(600)
"""


class Bag:
    """A bag in the making: a ROS 2 topic of temperatures, 0.4 s late, and one of JSON."""

    def __init__(self, path: str | Path, *, chunked: bool = True, chunk_bytes: int = 300) -> None:
        from mcap_ros2.writer import Writer as RosWriter

        self.file = Path(path).open("wb")  # noqa: SIM115 - open as long as the bag is
        self.ros = RosWriter(self.file, chunk_size=chunk_bytes)
        self.plain: Any = self.ros._writer
        if not chunked:
            self.plain._Writer__chunk_builder = None
        self.heat = self.ros.register_msgdef("sensor_msgs/msg/Temperature", TEMPERATURE)
        schema = self.plain.register_schema("force", "jsonschema", b"{}")
        self.force = self.plain.register_channel("/ft/force", "json", schema)

    def add(self, k: int) -> None:
        """Write second k, of both topics."""
        at_ns = (UNIX_S + k) * 10**9
        data = json.dumps({"z": float(k), "name": "ft"}).encode()
        self.plain.add_message(self.force, at_ns, data, at_ns)
        late_ns = at_ns + 4 * 10**8
        stamp = {"sec": late_ns // 10**9, "nanosec": late_ns % 10**9}
        message = {"header": {"stamp": stamp}, "temperature": 20.0 + 0.5 * k, "variance": 0.0}
        self.ros.write_message("/ft/temperature", self.heat, message, late_ns, late_ns)

    def finish(self) -> None:
        """Write the end."""
        self.ros.finish()
        self.file.flush()


def write_bag(path: Path, rows: int, **options: Any) -> bytes:
    """Write a finished bag; return its bytes."""
    bag = Bag(path, **options)
    for k in range(rows):
        bag.add(k)
    bag.finish()
    bag.file.close()
    return path.read_bytes()


def list_records(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield kind, begin and end of each record of a finished file."""
    at = len(MAGIC)
    while at < len(content) - len(MAGIC):
        kind, length = HEAD.unpack_from(content, at)
        yield kind, at, at + HEAD.size + length
        at += HEAD.size + length


def follow(path: Path, topics: str = "", columns: tuple[str, ...] = ()) -> Any:
    return mcap_file.McapSource(SourceText("mcap", str(path), topics), columns)


def read_all(source: Any) -> list[Reading]:
    """Return what is in the file by now."""
    found: list[Reading] = []
    while some := source.read(0.0):
        found += some
    return found


def run_record(*arguments: str) -> Result:
    return CliRunner().invoke(cli, ["record", *arguments])


@pytest.mark.parametrize("chunked", [True, False])
def test_every_byte_may_be_the_last_so_far(tmp_path: Path, chunked: bool) -> None:
    content = write_bag(tmp_path / "whole.mcap", 4, chunked=chunked)
    growing = tmp_path / "growing.mcap"
    with growing.open("wb", buffering=0) as file:
        source = follow(growing)
        found: list[Reading] = []
        for byte in content:
            file.write(bytes([byte]))
            found += source.read(0.0) or []
    assert source.read(0.0) is None
    assert found == read_all(follow(tmp_path / "whole.mcap")) and len(found) == 8
    assert [one.values["z"] for one in found if "z" in one.values] == [0.0, 1.0, 2.0, 3.0]
    assert found[1].at_s == UNIX_S + 0.4 and found[1].values["temperature"] == 20.0
    assert source.list_strays() == []
    source.close()


def test_names_and_times_are_those_of_the_log_reader(tmp_path: Path) -> None:
    from zerodrift.dataset.formats.mcap_log import read

    write_bag(tmp_path / "a.mcap", 5)
    source = follow(tmp_path / "a.mcap")
    came = read_all(source)
    for table in read(tmp_path / "a.mcap"):
        assert table.frame is not None
        names = [name for name in table.frame.columns if name != "time_s"]
        own = [one for one in came if set(one.values) == set(names)]
        assert [one.at_s for one in own] == table.frame["time_s"].to_list()
        for name in names:
            assert [one.values[name] for one in own] == table.frame[name].to_list()


def test_a_bag_becomes_rows_by_its_own_clock(tmp_path: Path) -> None:
    write_bag(tmp_path / "a.mcap", 30)
    out = tmp_path / "log.parquet"
    done = run_record(f"mcap:{tmp_path / 'a.mcap'}", "--out", str(out), "--json")
    assert done.exit_code == 0, done.output
    frame = pl.read_parquet(out)
    assert frame["time_s"].to_list() == [float(k) for k in range(30)]
    assert frame["clock_s"].to_list() == [UNIX_S + 1.0 + k for k in range(30)]
    assert frame["z"].to_list()[:29] == [float(k) for k in range(29)]
    assert frame["temperature"].to_list() == [20.0 + 0.5 * k for k in range(30)]


def test_a_file_cut_within_a_chunk_says_so(tmp_path: Path) -> None:
    content = write_bag(tmp_path / "whole.mcap", 12)
    chunks = [(begin, end) for kind, begin, end in list_records(content) if kind == 6]
    assert len(chunks) > 3
    begin, end = chunks[2]
    (tmp_path / "cut.mcap").write_bytes(content[: end - 5])
    source = follow(tmp_path / "cut.mcap")
    some = read_all(source)
    assert 0 < len(some) < 24
    (told,) = source.list_strays()
    assert f"ends within a chunk: {end - begin - 5} of {end - begin} bytes" in told
    assert f"from byte {begin} on" in told


def test_a_damaged_chunk_is_left_out_alone_and_named(tmp_path: Path) -> None:
    content = bytearray(write_bag(tmp_path / "a.mcap", 12))
    whole = read_all(follow(tmp_path / "a.mcap"))
    begin, end = [(begin, end) for kind, begin, end in list_records(content) if kind == 6][3]
    content[end - 10] ^= 0xFF
    (tmp_path / "a.mcap").write_bytes(content)
    source = follow(tmp_path / "a.mcap")
    left = read_all(source)
    assert 0 < len(left) < len(whole) and all(one in whole for one in left)
    assert f"byte {begin}: a damaged chunk" in source.list_strays()[0]


def test_topics_that_cannot_be_read_or_never_come_are_named(tmp_path: Path) -> None:
    bag = Bag(tmp_path / "a.mcap")
    schema = bag.plain.register_schema("foxglove.Pose", "protobuf", b"x")
    odd = bag.plain.register_channel("/pose", "protobuf", schema)
    for k in range(3):
        bag.add(k)
        bag.plain.add_message(odd, k, b"\x01", k)
    bag.finish()
    bag.file.close()
    source = follow(tmp_path / "a.mcap", "/pose,/ft/temperatur,/ft/force")
    assert {name for one in read_all(source) for name in one.values} == {"z"}
    told = source.list_strays()
    assert told[0].startswith("/ft/temperatur has not come; the file has")
    assert "did you mean '/ft/temperature'" in told[0]
    assert "/pose: protobuf, protobuf of foxglove.Pose cannot be read; expected ROS 2" in told[1]
    assert "/pose cannot be read (protobuf" in source.explain_wait()
    done = run_record(f"mcap:{tmp_path / 'a.mcap'}#/wrench", "--out", str(tmp_path / "log.parquet"))
    assert isinstance(done.exception, InputError)
    assert "no row came" in str(done.exception) and "/wrench has not come" in str(done.exception)
    assert not (tmp_path / "log.parquet").exists()


def test_one_field_of_two_topics(tmp_path: Path) -> None:
    bag = Bag(tmp_path / "a.mcap")
    second = bag.plain.register_channel("/other", "json", 2)
    for k in range(3):
        bag.add(k)
        bag.plain.add_message(second, 1, json.dumps({"z": 7.0}).encode(), (UNIX_S + k) * 10**9)
    bag.finish()
    bag.file.close()
    source = follow(tmp_path / "a.mcap")
    names = {name for one in read_all(source) for name in one.values}
    assert names == {"z", "/other:z", "temperature", "variance"}
    assert "'z' is that of /ft/force; that of /other is '/other:z'" in source.list_strays()
    source = follow(tmp_path / "a.mcap", columns=("/ft/force:z", "temperature"))
    names = {name for one in read_all(source) for name in one.values}
    assert names == {"z", "/ft/force:z", "temperature", "variance"}


def test_what_is_no_mcap_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be opened"):
        open_source(f"mcap:{tmp_path / 'none.mcap'}", (), None)
    with pytest.raises(InputError, match="Leave --columns out"):
        open_source(f"mcap:{tmp_path / 'none.mcap'}", ("a",), None)
    with pytest.raises(InputError, match="expected mcap:FILE"):
        open_source("mcap:", (), None)
    (tmp_path / "text.mcap").write_text("time,temperature\n")
    with pytest.raises(InputError, match="begins with b'time,tem'"):
        follow(tmp_path / "text.mcap").read(0.0)
    content = write_bag(tmp_path / "a.mcap", 50)
    (tmp_path / "zeros.mcap").write_bytes(MAGIC + bytes(50))
    with pytest.raises(InputError, match="byte 8: a record of kind 0"):
        follow(tmp_path / "zeros.mcap").read(0.0)
    (tmp_path / "b.mcap").write_bytes(content[: len(content) // 3])
    source = follow(tmp_path / "b.mcap")
    source.read(0.0)
    (tmp_path / "b.mcap").write_bytes(content[:100])
    with pytest.raises(InputError, match="was begun anew"):
        source.read(0.0)


def test_a_clock_that_leaps_makes_no_rows_between(tmp_path: Path) -> None:
    bag = Bag(tmp_path / "a.mcap")
    for at_s in (100, 101, 102, UNIX_S, UNIX_S + 1, UNIX_S + 2, 103):
        data = json.dumps({"z": 1.0}).encode()
        bag.plain.add_message(bag.force, at_s * 10**9, data, at_s * 10**9)
    bag.finish()
    bag.file.close()
    out = tmp_path / "log.parquet"
    done = run_record(f"mcap:{tmp_path / 'a.mcap'}", "--out", str(out), "--json")
    assert done.exit_code == 0, done.output
    clock = pl.read_parquet(out)["clock_s"].to_list()
    assert len(clock) < 20 and clock[0] == 101.0 and UNIX_S < clock[-1] < UNIX_S + 5


def start_writer(folder: Path, rows: int, pause_s: float, *, chunked: bool) -> Any:
    """Start a process that appends to bag.mcap."""
    code = WRITER.format(
        tests=str(Path(__file__).parent), path=str(folder / "bag.mcap"), chunked=chunked,
        rows=rows, pause_s=pause_s,
    )  # fmt: skip
    process = subprocess.Popen([sys.executable, "-c", code])
    wait_for(lambda: (folder / "bag.mcap").exists() and (folder / "bag.mcap").stat().st_size)
    return process


def wait_for(there: Any, limit_s: float = 60.0) -> None:
    until = time.monotonic() + limit_s
    while not there():
        assert time.monotonic() < until, "waited in vain"
        time.sleep(0.02)


@pytest.mark.parametrize("chunked", [True, False])
def test_a_writer_that_appends_is_followed_to_its_end(tmp_path: Path, chunked: bool) -> None:
    out = tmp_path / "log.parquet"
    writer = start_writer(tmp_path, 60, 0.02, chunked=chunked)
    try:
        done = run_record(f"mcap:{tmp_path / 'bag.mcap'}", "--out", str(out), "--json")
    finally:
        writer.kill()
        writer.wait()
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert told["rows"] == 60 and told["notes"] == [] and told["interrupted"] is False
    assert pl.read_parquet(out)["temperature"].to_list() == [20.0 + 0.5 * k for k in range(60)]


def test_writer_and_recorder_killed_in_the_middle_leave_whole_rows(tmp_path: Path) -> None:
    out = tmp_path / "log.parquet"
    writer = start_writer(tmp_path, 100_000, 0.005, chunked=True)
    recorder = subprocess.Popen(
        [sys.executable, "-m", "zerodrift", "record", f"mcap:{tmp_path / 'bag.mcap'}",
         "--out", str(out), "--json"],
        cwd=tmp_path,
    )  # fmt: skip
    journal = tmp_path / ".log.parquet.rows"
    try:
        wait_for(lambda: journal.exists() and journal.read_bytes().count(b"\n") > 20)
    finally:
        recorder.kill()
        recorder.wait()
        writer.kill()
        writer.wait()
    done = run_record("--recover", str(out))
    assert done.exit_code == 0, done.output
    kept = pl.read_parquet(out)
    assert kept.height > 20
    assert kept["temperature"].to_list() == [20.0 + 0.5 * k for k in range(kept.height)]
    # The writer is dead and wrote no end: what is whole is recorded, until the user ends it.
    done = run_record(
        f"mcap:{tmp_path / 'bag.mcap'}", "--out", str(tmp_path / "b.parquet"), "--seconds", "1",
        "--json",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    again = pl.read_parquet(tmp_path / "b.parquet")
    assert again.height >= kept.height
    assert again["temperature"].to_list() == [20.0 + 0.5 * k for k in range(again.height)]


def test_a_recorder_asked_to_end_keeps_what_came(tmp_path: Path) -> None:
    out = tmp_path / "log.parquet"
    writer = start_writer(tmp_path, 100_000, 0.005, chunked=False)
    recorder = subprocess.Popen(
        [sys.executable, "-m", "zerodrift", "record", f"mcap:{tmp_path / 'bag.mcap'}",
         "--out", str(out), "--json"],
        stdout=subprocess.PIPE, cwd=tmp_path,
    )  # fmt: skip
    journal = tmp_path / ".log.parquet.rows"
    try:
        wait_for(lambda: journal.exists() and journal.stat().st_size)
        recorder.send_signal(signal.SIGINT)
        told, _ = recorder.communicate(timeout=60)
    finally:
        recorder.kill()
        writer.kill()
        writer.wait()
    assert json.loads(told)["rows"] == pl.read_parquet(out).height > 0
    assert not journal.exists()
